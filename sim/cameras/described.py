"""A world as plain bytes, so that cameras can look at it from another process, and the world of an arm's simulator.

The bytes are a line of JSON (``count``, ``ground_m``, ``age_s`` of the state, ``hand_position_m`` and
``hand_rotation`` w, x, y, z), then float32 [count, 8] (both ends and both radii in m), then uint8 [count, 4] (label,
sRGB colour).
"""

from __future__ import annotations

import json
from dataclasses import dataclass

import numpy as np
import warp as wp

from ..arms.simulator import ArmSimulator
from ..base.types import Array
from ..formats.export_mesh import level_color
from ..pictures.tracer import Solids
from .label import Label
from .world import World

ARM_COLOUR, LINE_COLOUR = (0.75, 0.75, 0.78), (0.70, 0.10, 0.08)
_MOST = 1 << 16  # capsules
_HEAD = ("count", "ground_m", "age_s", "hand_position_m", "hand_rotation")


@dataclass(frozen=True)
class Scene:
    """A world of capsules at one time.

    Attributes:
        world: What there is.
        age: How old the state was when it was told [s].
        hand_position: Of the end-effector in the base frame [m], [3].
        hand_rotation: Its orientation there, w, x, y, z, [4].
    """

    world: World
    age: float
    hand_position: Array
    hand_rotation: Array


def arm_world(sim: ArmSimulator, index: int, ground: float) -> World:
    """Return one world of an arm's simulator as it is: arm, branches, and the line where it is longer than nothing.

    Args:
        sim: The simulator.
        index: Number of the world.
        ground: Height of the ground [m].
    """
    c = sim.capsules
    start, end, radius = (wp.to_torch(a)[index].cpu().numpy().astype(np.float64) for a in (c.start, c.end, c.radius))
    tree = sim.model.trees[index]
    label = np.full(len(radius), Label.BRANCH, np.uint8)
    label[: c.num_arm] = Label.ROBOT
    colour = np.tile(ARM_COLOUR, (len(radius), 1))
    colour[c.num_arm : c.num_arm + len(tree.shape_link)] = level_color(tree.level[tree.shape_link])
    world = World.capsules(start, end, radius, label, colour, ground)
    first, last = (x[index].cpu().numpy().astype(np.float64)[None] for x in (sim.line_start, sim.line_end))
    if first[0, 2] < -100.0:  # where the simulator keeps a line that there is none
        return world
    thick, kind = np.array([sim.line.radius]), np.array([Label.LINE], np.uint8)
    line = World.capsules(first, last, thick, kind, np.array([LINE_COLOUR]), ground)
    return World.joined([world, line])


def packed(scene: Scene) -> bytes:
    """Return a scene without leaves as bytes; `unpacked` turns them back."""
    s = scene.world.solids
    numbers = (scene.world.ground, scene.age, scene.hand_position.tolist(), scene.hand_rotation.tolist())
    head = json.dumps(dict(zip(_HEAD, (len(s.start), *numbers), strict=True)))
    shapes = np.column_stack([s.start, s.end, s.radius]).astype("<f4")
    looks = np.column_stack([scene.world.label, np.round(255 * s.color)]).astype(np.uint8)
    return head.encode() + b"\n" + shapes.tobytes() + looks.tobytes()


def unpacked(data: bytes) -> Scene:
    """Return a scene from bytes.

    Raises:
        ValueError: They are no scene.
    """
    line, _, rest = data.partition(b"\n")
    head = json.loads(line)
    if not isinstance(head, dict) or set(head) != set(_HEAD):
        raise ValueError("no scene")
    count = head["count"]
    if not (isinstance(count, int) and 0 < count <= _MOST and len(rest) == 36 * count):
        raise ValueError(f"{len(rest)} bytes for {count} capsules")
    shapes = np.frombuffer(rest, "<f4", 8 * count).reshape(count, 8).astype(np.float64)
    looks = np.frombuffer(rest, np.uint8, 4 * count, 32 * count).reshape(count, 4)
    hand, turn = np.array(head["hand_position_m"], float), np.array(head["hand_rotation"], float)
    numbers = [float(head["ground_m"]), float(head["age_s"])]
    if hand.shape != (3,) or turn.shape != (4,) or not all(np.isfinite(x).all() for x in (shapes, hand, turn, numbers)):
        raise ValueError("numbers that are not finite")
    solids = Solids.cones(shapes[:, :3], shapes[:, 3:6], shapes[:, 6:], looks[:, 1:] / 255.0)
    return Scene(World(solids, looks[:, 0].copy(), numbers[0]), numbers[1], hand, turn)
