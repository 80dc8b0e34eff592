"""A folder of pictures as a user records one: two of a tree and a line, listed again and again."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import PIL.Image
from bough.sim.arms.jaco2 import jaco2
from bough.sim.cameras.camera import Cameras
from bough.sim.cameras.described import ARM_COLOUR, LINE_COLOUR
from bough.sim.cameras.label import Label
from bough.sim.cameras.pinhole import Pinhole
from bough.sim.cameras.world import World

SIZE = (120, 212)  # height, width
WOOD = (0.36, 0.25, 0.14)
BRANCH = (np.array([0.5, -0.55, 0.2]), np.array([0.35, -0.35, 0.9]), 0.012)
LINE = (np.array([0.0, -0.65, 0.75]), np.array([0.6, -0.25, 0.72]), 0.01)
HEAD = "time_s,camera,colour,depth"


def shown_world() -> World:
    """Return a branch, a line, and the arm at home, over a ground."""
    from bough.learn.cameras.clouds import capsules_at

    arm = jaco2()
    start, end, radius = capsules_at(arm, arm.home)
    ends = (np.vstack([start, BRANCH[0], LINE[0]]), np.vstack([end, BRANCH[1], LINE[1]]))
    label = np.array([Label.ROBOT] * len(radius) + [Label.BRANCH, Label.LINE], np.uint8)
    colour = np.array([ARM_COLOUR] * len(radius) + [WOOD, LINE_COLOUR])
    return World.capsules(*ends, np.append(radius, [BRANCH[2], LINE[2]]), label, colour, ground=-0.4)


def camera() -> Pinhole:
    """Return a D405 beside the arm."""
    return Pinhole.d405(np.array([0.7, 0.2, 0.8]), np.array([0.35, -0.4, 0.65]), decimation=4)


def written_rig(folder: Path, **more: object) -> Path:
    """Write cameras.yaml for that camera; JSON is YAML."""
    eye = camera()
    mounted = {"name": "side", "position_m": list(eye.position), "rotation": list(eye.rotation),
               "intrinsics_px": list(eye.intrinsics)} | more  # fmt: skip
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "cameras.yaml"
    path.write_text(json.dumps({"format": "cameras/1", "cameras": [mounted], "ground_m": -0.4}))
    return path


def write_folder(folder: Path, *, frames: int = 4, joints: bool = True):
    """Write the folder; return the pictures (`sim.cameras.camera.Shot`) that alternate in it."""
    written_rig(folder)
    batch, arm = Cameras(SIZE[1], SIZE[0]), jaco2()
    shots = [batch.shoot(shown_world(), [camera()]) for _ in range(2)]
    for k, shot in enumerate(shots):
        PIL.Image.fromarray(shot.colour[0]).save(folder / f"{k}.png")
        np.savez_compressed(folder / f"{k}.npz", depth=shot.depth[0])
    names = "".join(f",q{k + 1}_rad" for k in range(6)) if joints else ""
    values = "".join(f",{x:.6f}" for x in arm.home) if joints else ""
    rows = [f"{k / 30:.4f},side,{k % 2}.png,{k % 2}.npz{values}" for k in range(frames)]
    (folder / "frames.csv").write_text("\n".join([HEAD + names, *rows]) + "\n")
    return shots
