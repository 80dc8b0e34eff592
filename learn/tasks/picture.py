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
    view, root = view_of(sim, scene, world), _host(scene.root)[world]
    ground = Ground(min(0.0, float(root[2])), GROUND, SCALE, contrast=0.1)
    seen_from = np.subtract(view.position, view.target)
    azimuth = float(np.degrees(np.arctan2(seen_from[1], seen_from[0]))) + 40.0  # the sun is behind the viewer
    foot = np.array([*(-0.35 * root[:2]), 0.0])
    parts = Solids.joined([bodies, rod(foot, SCALE)])
    radiance = trace(parts, ground, view, Sunlight(azimuth=azimuth, elevation=48.0), WIDTH, HEIGHT, samples=SAMPLES,
                     device=str(sim.model.device))  # fmt: skip
    return caption(develop(radiance), view, foot, SCALE)


def _host(tensor: torch.Tensor) -> Array:
    return tensor.detach().cpu().numpy().astype(np.float64)


def solids(sim: ArmSimulator, scene: Scene, world: int) -> tuple[Array, Array, Array, Array]:
    """Return the capsules of one world: start, end [C, 3] and radius [C] in m, colour [C, 3]."""
    c = sim.capsules
    start, end, radius = (_host(wp.to_torch(a)[world]) for a in (c.start, c.end, c.radius))
    tree = sim.model.trees[world]
    color = np.zeros((len(radius), 3))
    color[: c.num_arm] = ARM
    color[c.num_arm : c.num_arm + len(tree.shape_link)] = level_color(tree.level[tree.shape_link])
    axes = [_host(wp.to_torch(a)[world]) for a in (scene.target.start, scene.target.end)]
    size = np.full(len(axes[0]), sim.line.radius)
    parts = ((start, axes[0]), (end, axes[1]), (radius, size), (color, np.tile(LINE, (len(size), 1))))
    joined = [np.concatenate(pair) for pair in parts]
    return joined[0], joined[1], joined[2], joined[3]


def view_of(sim: ArmSimulator, scene: Scene, world: int) -> View:
    """Return a view across the line, from a little above, of the middle between the arm's base and the line."""
    start, end = _host(sim.line_start)[world], _host(sim.line_end)[world]
    outward = _host(scene.root)[world] * [1.0, 1.0, 0.0]
    outward /= max(float(np.linalg.norm(outward)), 1e-9)
    side = np.cross([0.0, 0.0, 1.0], outward)
    middle = 0.6 * (start + end) / 2 + 0.4 * np.array([0.0, 0.0, 0.4])
    position = middle + _EYE * (0.86 * side - 0.30 * outward + np.array([0.0, 0.0, 0.35]))
    return View((position[0], position[1], position[2]), (middle[0], middle[1], middle[2]), fov=42.0)
