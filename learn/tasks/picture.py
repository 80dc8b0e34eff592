"""Pictures of a world: arm, branches, target and ground, ray-traced."""

from __future__ import annotations

import numpy as np
import torch
import warp as wp
from numpy.typing import NDArray

from ...sim.arms.simulator import ArmSimulator
from ...sim.base.types import Array
from ...sim.formats.export_mesh import level_color
from ...sim.pictures.scale import caption, rod
from ...sim.pictures.tracer import Ground, Solids, Sunlight, View, develop, trace
from ...sim.scenes.scene import Scene

WIDTH, HEIGHT, SAMPLES = 480, 360, 8
ARM, LINE = (0.75, 0.75, 0.78), (0.70, 0.10, 0.08)
"""Colours of the arm and of the target, sRGB."""

TARGET, FORCE = (0.95, 0.75, 0.10), (0.85, 0.05, 0.05)
"""Colours of a point to reach and of forces, sRGB."""

BALL = 0.4
"""Radius of the ball that shows a target, of the distance that is success: it shows a place, and has no body."""

UP = (0.0, 0.0, 1e-4)
"""Length of that ball's axis [m]: a capsule must have one."""

NEWTONS = 200.0
"""Force of an arrow of one metre [N]."""

GROUND = (0.30, 0.31, 0.27)
"""Colour of the ground, linear light."""

SCALE = 0.5
"""Length of the rod that shows the scale, and edge of the squares on the ground [m]."""

_EYE = 2.3  # distance of the camera from the middle [m]


def world_picture(sim: ArmSimulator, scene: Scene, world: int) -> NDArray[np.uint8]:
    """Return a picture of one world, seen from the side of the line that the arm is on, [height, width, 3].

    A rod beside the arm's base, and as high up, shows the scale.
    """
    start, end, radius, color = solids(sim, scene, world)
    used = radius > 0.0
    bodies = Solids.cones(start[used], end[used], np.repeat(radius[used, None], 2, axis=1), color[used])
    return developed(_host(scene.root)[world], [bodies], view_of(sim, scene, world), str(sim.model.device))


def developed(root: Array, parts: list[Solids], view: View, device: str = "cpu") -> NDArray[np.uint8]:
    """Trace solids over a ground level with a trunk's foot, the sun behind the viewer, beside a rod for the scale.

    Args:
        root: Foot of the trunk [m], [3].
        parts: What is seen.
        view: Where it is seen from.
        device: Warp device.

    Returns:
        A picture, [height, width, 3].
    """
    ground = Ground(min(0.0, float(root[2])), GROUND, SCALE, contrast=0.1)
    seen_from = np.subtract(view.position, view.target)
    azimuth = float(np.degrees(np.arctan2(seen_from[1], seen_from[0]))) + 40.0
    foot = np.array([*(-0.35 * root[:2]), 0.0])
    seen = Solids.joined([*parts, rod(foot, SCALE)])
    radiance = trace(seen, ground, view, Sunlight(azimuth=azimuth, elevation=48.0), WIDTH, HEIGHT, samples=SAMPLES,
                     device=device)  # fmt: skip
    return caption(develop(radiance), view, foot, SCALE)


def reach_picture(sim: ArmSimulator, root: torch.Tensor, target: Array, within: float, world: int) -> NDArray[np.uint8]:
    """Return a picture of one world of reaching, [height, width, 3]: target, branches, and forces on the arm as arrows.

    An arrow on a link is as long as the net contact force on it is strong, `NEWTONS` a metre, and red.
    """
    start, end, radius, color = capsules_of(sim, world)
    arrows = force_arrows(sim, world)
    used = radius > 0.0
    branches = (start[used], end[used], np.repeat(radius[used, None], 2, axis=1), color[used])
    ball = (target[None], target[None] + UP, np.full((1, 2), BALL * within), np.array([TARGET]))
    parts = [Solids.cones(*branches), Solids.cones(*ball), *([Solids.cones(*arrows)] if len(arrows[0]) else [])]
    return developed(_host(root)[world], parts, reach_view(root, target, world), str(sim.model.device))


def reach_view(root: torch.Tensor, target: Array, world: int) -> View:
    """Return a view of one world of reaching, of the middle between the arm's base and the target."""
    return across(0.6 * target + np.array([0.0, 0.0, 0.12]), _host(root)[world])


def reach_solids(sim: ArmSimulator, target: Array, within: float, world: int) -> tuple[Array, Array, Array, Array]:
    """Return one world of reaching as capsules: start, end [C, 3] and radius [C] in m, colour [C, 3].

    They are those of arm and branches, the target, and the forces (`force_arrows`).
    """
    arrows = force_arrows(sim, world)
    ball = (target[None], target[None] + UP, np.full(1, BALL * within), np.array([TARGET]))
    parts = (capsules_of(sim, world), ball, (*arrows[:2], arrows[2].mean(axis=1), arrows[3]))
    joined = [np.concatenate(column) for column in zip(*parts, strict=True)]
    return joined[0], joined[1], joined[2], joined[3]


def force_arrows(sim: ArmSimulator, world: int) -> tuple[Array, Array, Array, Array]:
    """Return the arrows of the forces above 1 N on links: ends [A, 3], radii at both [A, 2], colour [A, 3].

    Each is a rod and a cone from the link's first capsule, the way that the branches push.
    """
    force, at = _host(sim.arm_force)[world], _link_middles(sim, world)
    strength = np.linalg.norm(force, axis=1)
    pushed = strength > 1.0
    tail, way = at[pushed], force[pushed] / NEWTONS
    neck, tip, ones = tail + 0.7 * way, tail + way, np.ones((int(pushed.sum()), 2))
    start, end = np.concatenate([tail, neck]), np.concatenate([neck, tip])
    radius = np.concatenate([0.008 * ones, ones * [0.02, 0.001]])
    return start, end, radius, np.tile(FORCE, (len(start), 1))


def _link_middles(sim: ArmSimulator, world: int) -> Array:
    """Middle of every moving link's first capsule [m], [dof, 3]."""
    c, link = sim.capsules, sim._arm.constants.shape_link.numpy()
    middle = 0.5 * (_host(wp.to_torch(c.start)[world]) + _host(wp.to_torch(c.end)[world]))
    first = [int(np.flatnonzero(link == j)[0]) if (link == j).any() else 0 for j in range(sim.arm.num_dofs)]
    return np.asarray(middle[first])


def _host(tensor: torch.Tensor) -> Array:
    return tensor.detach().cpu().numpy().astype(np.float64)


def capsules_of(sim: ArmSimulator, world: int) -> tuple[Array, Array, Array, Array]:
    """Return the capsules of arm and branches of one world: start, end [C, 3] and radius [C] in m, colour [C, 3]."""
    c = sim.capsules
    start, end, radius = (_host(wp.to_torch(a)[world]) for a in (c.start, c.end, c.radius))
    tree = sim.model.trees[world]
    color = np.zeros((len(radius), 3))
    color[: c.num_arm] = ARM
    color[c.num_arm : c.num_arm + len(tree.shape_link)] = level_color(tree.level[tree.shape_link])
    return start, end, radius, color


def solids(sim: ArmSimulator, scene: Scene, world: int) -> tuple[Array, Array, Array, Array]:
    """Return the capsules of one world: start, end [C, 3] and radius [C] in m, colour [C, 3]."""
    start, end, radius, color = capsules_of(sim, world)
    axes = [_host(wp.to_torch(a)[world]) for a in (scene.target.start, scene.target.end)]
    size = np.full(len(axes[0]), sim.line.radius)
    parts = ((start, axes[0]), (end, axes[1]), (radius, size), (color, np.tile(LINE, (len(size), 1))))
    joined = [np.concatenate(pair) for pair in parts]
    return joined[0], joined[1], joined[2], joined[3]


def view_of(sim: ArmSimulator, scene: Scene, world: int) -> View:
    """Return a view across the line, from a little above, of the middle between the arm's base and the line."""
    start, end = _host(sim.line_start)[world], _host(sim.line_end)[world]
    return across(0.6 * (start + end) / 2 + 0.4 * np.array([0.0, 0.0, 0.4]), _host(scene.root)[world])


def across(middle: Array, root: Array) -> View:
    """Return a view of a point [m], from the side of the way from the arm to the trunk, and from a little above."""
    outward = root * [1.0, 1.0, 0.0]
    outward /= max(float(np.linalg.norm(outward)), 1e-9)
    side = np.cross([0.0, 0.0, 1.0], outward)
    position = middle + _EYE * (0.86 * side - 0.30 * outward + np.array([0.0, 0.0, 0.35]))
    return View((position[0], position[1], position[2]), (middle[0], middle[1], middle[2]), fov=42.0)
