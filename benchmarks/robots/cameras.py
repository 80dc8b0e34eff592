"""Clouds from simulated cameras beside the kernel's own sampling: distances, embeddings, occlusion, what leaves do.

Scenes are those of the power-line task's tests, half of them as they begin, half after three seconds of random motion.
One, two and three D405s (424 x 240 pixels, `sim.cameras`) look at each, the third at the trunk;
masks are told by colour, the arm is cut out
with its own model, points are thinned and 512 of them drawn, as `learn.cameras` does. The kernel draws its 512 from
all surfaces, hidden ones too. What two draws of the kernel differ by is the floor. Leaves are those of
`sim.pictures.foliage`, on the outer links; they hide wood, and their twigs are taken for wood.

- reach: mean distance of the kernel's points from the camera's nearest [mm]; off: mean distance of camera points from
  the true surface [mm].
- embedding: distance of two embeddings over the spread of the kernel's embeddings over scenes, whole and near the line.
- occlusion: error of the score, with the kernel's points on the line's clearance; mean of absolute values, and mean.

Intervals are 95 %, of the mean over scenes, by bootstrap. Processor time of a picture and of what is made of it is
told too, on one thread.

Run: ``python benchmarks/robots/cameras.py [--quick] [--seed n] [--picture FILE.png]``
"""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import dataclass, replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import measuring
import numpy as np
import torch
from bough.learn.cameras.calibration import Mounted, Rig, plain_rig
from bough.learn.cameras.clouds import beside, capsules_at, cloud_of, contract, joined
from bough.learn.cameras.colours import ByColour
from bough.learn.cameras.frames import Frame
from bough.learn.tasks.clearing import make_task
from bough.learn.tasks.powerline import Powerline
from bough.perception.embedding import embed, occlusion
from bough.sim.base.console import start_warp
from bough.sim.cameras.camera import Cameras, Shot
from bough.sim.cameras.described import arm_world
from bough.sim.cameras.label import Label
from bough.sim.cameras.pinhole import Pinhole
from bough.sim.cameras.world import World
from bough.sim.pictures.foliage import foliage
from measuring import Figure
from scipy.spatial import cKDTree

TWIGS = 3  # on each outer link
STEPS = 30  # of random motion, at 10 Hz
FIGURES = ("reach", "off", "whole", "near", "occlusion", "occlusion bias")
UNITS = {"reach": "mm", "off": "mm"}


@dataclass
class Views:
    """Cameras before a scene, and how long they took.

    Attributes:
        cameras: The batch.
        seconds: Processor time by what it was spent on [s], and ``pictures``, their number.
    """

    cameras: Cameras
    seconds: dict[str, float]


def eyes(foot: np.ndarray, line: np.ndarray) -> list[Pinhole]:
    """Return cameras at the left and the right of the arm that look at the line's middle, and one at the trunk."""
    ahead = foot * [1.0, 1.0, 0.0] / np.linalg.norm(foot[:2])
    side, up = np.array([-ahead[1], ahead[0], 0.0]), np.array([0.0, 0.0, 1.0])
    target, trunk = line - 0.12 * up, foot + 0.55 * up
    left, right = (0.05 * ahead + sign * 0.75 * side + 0.75 * up for sign in (1.0, -1.0))
    low = 0.05 * ahead + 0.75 * side + (trunk[2] + 0.15) * up
    return [Pinhole.d405(left, target), Pinhole.d405(right, target), Pinhole.d405(low, trunk)]


def rig_of(cameras: list[Pinhole], ground: float) -> Rig:
    """Return the calibration of cameras as it is."""
    mounted = [Mounted(name=f"c{k}", position_m=list(c.position), rotation=list(c.rotation))
               for k, c in enumerate(cameras)]  # fmt: skip
    low = np.array([-1.2, -1.2, ground - 0.05])
    return replace(plain_rig(mounted), box_low=low, ground=ground, farthest=2.0)


def seen(task: Powerline, world: int, views: Views, leaves: bool, seed: int) -> tuple[list, Shot, Rig, World]:
    """Return what each camera's picture gives: time, points on branches and on the line; the pictures, and the rest."""
    sim, foot = task.simulator, task.foot[world].numpy().astype(float)
    ends = np.stack([x[world].numpy().astype(float) for x in (sim.line_start, sim.line_end)])
    cameras = eyes(foot, ends.mean(axis=0))
    shown = scene = arm_world(sim, world, float(foot[2]))
    if leaves:
        position, rotation = sim.observe()
        tree = sim.model.trees[world]
        pose = tuple(x[world, : tree.num_links].numpy().astype(float) for x in (position, rotation))
        grown = foliage(tree, pose, np.random.default_rng([seed, world]), twigs=TWIGS)
        shown = World.joined([scene, World.leaves(grown)])
    began = time.process_time()
    shot = views.cameras.shoot(shown, cameras)
    traced = time.process_time()
    rig = rig_of(cameras, float(foot[2]))
    segmenter, body = ByColour(rig), capsules_at(sim.arm, sim.q[world].numpy().astype(float))
    parts = []
    for k, camera in enumerate(cameras):
        frame = Frame(0.0, shot.colour[k], shot.depth[k], camera.intrinsics, np.array(camera.position),
                      np.array(camera.rotation))  # fmt: skip
        parts.append((0.0, *cloud_of(frame, segmenter.label(frame), rig, body)))
    for name, spent in (("trace", traced - began), ("segment", time.process_time() - traced)):
        views.seconds[name] = views.seconds.get(name, 0.0) + spent
    views.seconds["pictures"] = views.seconds.get("pictures", 0.0) + len(cameras)
    return parts, shot, rig, scene


def kernel_clouds(task: Powerline) -> tuple[np.ndarray, np.ndarray]:
    """Return clouds [worlds, 3, 512, 3] of robot, target, branches, and marks of branches near the line."""
    points, near = task.sensor.clouds(noise=False)
    return points.mT.numpy().copy(), near.numpy().astype(bool)


def embedded(task: Powerline, points: np.ndarray, marks: np.ndarray | None = None) -> np.ndarray:
    """Return the embedding of one cloud by the task's frequencies."""
    mask = None if marks is None else torch.from_numpy(marks)
    return embed(torch.from_numpy(points.astype(np.float32)), task.sensor.frequencies, mask).numpy()


def near_line(points: np.ndarray, ends: np.ndarray, zoom: float) -> np.ndarray:
    """Tell which points are within a distance of a line's axis."""
    return beside(points.astype(float), ends[:1], ends[1:], np.zeros(1)) <= zoom


def compared(task: Powerline, world: int, cloud: np.ndarray, kernel: np.ndarray, target: np.ndarray, spread: dict,
             wood: World | None) -> dict[str, float]:  # fmt: skip
    """Return the figures of one cloud [N, 3] beside the kernel's."""
    s, sim = task.cfg.sensor, task.simulator
    ends = np.stack([x[world].numpy().astype(float) for x in (sim.line_start, sim.line_end)])
    zoom = [near_line(points, ends, s.zoom) for points in (cloud, kernel)]
    score = [float(occlusion(torch.from_numpy(points), torch.from_numpy(target), pairs=s.pairs, threshold=s.threshold))
             for points in (cloud, kernel)]  # fmt: skip
    out = {"reach": 1e3 * float(cKDTree(cloud).query(kernel)[0].mean())}
    if wood is not None:
        solids = wood.solids
        away = beside(cloud.astype(float), solids.start, solids.end, solids.radius.max(axis=1))
        out["off"] = 1e3 * float(np.abs(away).mean())
    for name, marks in (("whole", (None, None)), ("near", zoom)):
        pair = [embedded(task, *pair) for pair in zip((cloud, kernel), marks, strict=True)]
        out[name] = float(np.linalg.norm(pair[0] - pair[1])) / spread[name]
    out["occlusion"], out["occlusion bias"] = abs(score[0] - score[1]), score[0] - score[1]
    return out


def spreads(task: Powerline, clouds: np.ndarray, near: np.ndarray) -> dict[str, float]:
    """Return the root mean square distance of the kernel's embeddings from their mean over scenes."""
    out = {}
    for name, marks in (("whole", None), ("near", near)):
        rows = np.stack([embedded(task, c[2], None if marks is None else marks[k]) for k, c in enumerate(clouds)])
        out[name] = float(np.sqrt(((rows - rows.mean(axis=0)) ** 2).sum(axis=1).mean()))
    return out


def interval(values: np.ndarray, random: np.random.Generator) -> tuple[float, float, float]:
    """Return the mean and its 95 % interval by bootstrap."""
    means = values[random.integers(0, len(values), (2000, len(values)))].mean(axis=1)
    return float(values.mean()), *(float(x) for x in np.percentile(means, (2.5, 97.5)))


def measured(options: argparse.Namespace) -> list[Figure]:
    """Measure and print."""
    start_warp()
    count = 8 if options.quick else 32
    task = make_task("powerline", num_envs=count, seed=options.seed, device="cpu", test=True)
    random = np.random.default_rng(options.seed)
    views, rows = Views(Cameras(424, 240, seed=options.seed), {}), {}
    for moved in (False, True):
        if moved:
            actions = 2.0 * torch.rand((count, task.num_actions), generator=torch.Generator().manual_seed(1)) - 1.0
            for _ in range(STEPS):
                task.step(actions)
        task.sensor.update()
        clouds, near = kernel_clouds(task)
        task.sensor.update()
        again = kernel_clouds(task)[0]
        spread = spreads(task, clouds, near)
        for world in range(int(moved), count, 2):
            _scene(task, world, views, clouds[world], again[world], spread, rows, options, random)
    return report(rows, views, random)


def _scene(task, world, views, clouds, again, spread, rows, options, random) -> None:
    """Add the figures of one scene to all rows."""
    target, kernel = clouds[1], clouds[2]
    rows.setdefault("kernel, drawn again", []).append(compared(task, world, again[2], kernel, target, spread, None))
    for leaves in (False, True):
        parts, shot, rig, scene = seen(task, world, views, leaves, options.seed)
        wood = World(*_wood(scene), scene.ground)
        for used in (1, 2, 3):
            name = f"{used} camera{'s' * (used > 1)}{', leaves' * leaves}"
            cloud = contract(joined(parts[:used], rig.grain).branches, len(kernel), random)
            if len(cloud):
                rows.setdefault(name, []).append(compared(task, world, cloud, kernel, target, spread, wood))
            rows.setdefault(f"blind: {name}", []).append(len(cloud) == 0)
        masks(shot, rig, rows, leaves)
        if options.picture and world == 0 and leaves:
            picture(shot, options.picture)


def _wood(scene: World):
    keep, s = scene.label == Label.BRANCH, scene.solids
    return type(s)(*(getattr(s, n)[keep] for n in ("start", "end", "radius", "color", "side", "through"))), scene.label[
        keep
    ]


def masks(shot: Shot, rig: Rig, rows: dict, leaves: bool) -> None:
    """Count the pixels with a depth whose mask is right, over branches and line, cameras together."""
    for k in range(len(shot.colour)):
        frame = Frame(0.0, shot.colour[k], shot.depth[k], (1.0, 1.0, 0.0, 0.0), np.zeros(3), np.array([1.0, 0, 0, 0]))
        told = ByColour(rig).label(frame)
        has, true = shot.depth[k] > 0, shot.label[k]
        for kind in (Label.BRANCH, Label.LINE):
            right, any_ = has & (told == kind) & (true == kind), has & (true == kind)
            rows.setdefault(f"mask {kind.name}{', leaves' * leaves}", []).append((right.sum(), any_.sum()))


def picture(shot: Shot, path: str) -> None:
    """Write what the cameras of a scene see: colour, depth, truth."""
    import PIL.Image

    depth = np.clip(shot.depth / 1.6, 0, 1)[..., None] * np.array([255, 255, 255])
    label = shot.label[..., None] * np.array([50, 50, 50])
    rows = [
        np.hstack([c, d.astype(np.uint8), t.astype(np.uint8)])
        for c, d, t in zip(shot.colour, depth, label, strict=True)
    ]
    PIL.Image.fromarray(np.vstack(rows)).save(path)


def report(rows: dict, views: Views, random: np.random.Generator) -> list[Figure]:
    """Print all rows and return them as figures."""
    figures = []
    for name, found in rows.items():
        if name.startswith("mask"):
            right, all_ = np.array(found).sum(axis=0)
            figures.append(Figure(name, "found", float(right / max(all_, 1))))
        elif name.startswith("blind"):
            if any(found):
                print(f"{name}: {sum(found)} of {len(found)} scenes without a point")
        else:
            for what in FIGURES:
                if what in found[0]:
                    mean, low, high = interval(np.array([row[what] for row in found]), random)
                    figures.append(Figure(name, what, mean, UNITS.get(what, ""), range=(low, high)))
    pictures = views.seconds["pictures"]
    for name in ("trace", "segment"):
        figures.append(Figure("processor time of a picture", name, 1e3 * views.seconds[name] / pictures, "ms"))
    for f in figures:
        between = "" if f.range is None else f"({f.range[0]:.3g} to {f.range[1]:.3g})"
        print(f"{f.case}: {f.what} {f.value:.3g} {f.unit} {between}")
    return figures


def parser() -> argparse.ArgumentParser:
    """Make the parser of its options."""
    out = measuring.quick_and_seed(__doc__, "8 scenes instead of 32")
    out.add_argument("--picture", help="write what the cameras of the first scene see")
    return out


if __name__ == "__main__":
    sys.exit(measuring.main(parser(), measured, "cameras"))
