"""A policy end to end on the twin, beside the same policy with perfect clouds in its task: success in the same scenes.

In the task the policy acts as `bough evaluate` lets it: observations and actions without delay, true forces, clouds
drawn on what is there. End to end it acts as `bough run` lets it: the service's guard with the limits within which the
policy learnt (`bough robot limits --scene`), commands that are a tick late, clouds of perfect points or of the twin's
three simulated D405s that are segmented by colour, touch by the true
forces. Both are judged by the task. The twin runs on a clock of its own, without a network: the same guard, observation
and policy code, as fast as the machine is. Episodes end at success, which nothing takes back, or at the step limit.

Without ``--run`` a policy of ``reach`` (PCAP) is trained first.

Run: ``python benchmarks/robots/deploy.py [--run FOLDER] [--camera truth|twin] [--episodes n] [--quick]``
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import measuring
import numpy as np
import torch
from bough.learn.cameras.clouds import capsules_at, cloud_of, joined
from bough.learn.cameras.colours import ByColour
from bough.learn.cameras.frames import Clouds, Frame
from bough.learn.cameras.open import open_source
from bough.learn.deploy.loop import Runner, Senses, prepare
from bough.learn.deploy.plan import Driver, limits_of, read_driver
from bough.learn.deploy.simulated import SimulatedTwin
from bough.learn.deploy.stage import Stage, make_world
from bough.learn.deploy.truth import TruthClouds
from bough.learn.policies.tables import wilson
from bough.learn.runs.threads import one_thread
from bough.learn.tasks.registry import known_tasks
from bough.sim.base.console import start_warp
from bough.sim.cameras.camera import Cameras
from bough.sim.cameras.described import unpacked
from measuring import Figure

DELAY = 0.033
"""How old perfect clouds are when they are told [s]: a picture's time."""


class SeenTwin:
    """The twin's D405s that look at a simulated twin ten times a second, segmented by colour; clouds a delay later."""

    trouble = ""

    def __init__(self, twin: SimulatedTwin) -> None:
        """Take the twin."""
        self._twin, self._arm = twin, twin.stage.task.simulator.arm
        self._source, self._rig = open_source("twin", url="http://twin")
        source: Any = self._source
        self._batch, self._label = Cameras(source._width, source._height), ByColour(self._rig)
        self.restart()

    def restart(self) -> None:
        """Forget what was seen."""
        self._seen: list[Clouds] = []

    def latest(self) -> Clouds | None:
        """Return clouds that are a delay old, or the first."""
        if not self._seen or self._twin.now - self._seen[-1].time >= 0.1 - 1e-6:
            self._seen = [*self._seen[-3:], self._shot()]
        ready = [c for c in self._seen if c.time <= self._twin.now - DELAY] or self._seen[:1]
        return ready[-1]

    def _shot(self) -> Clouds:
        scene, source = unpacked(self._twin.stage.scene()), self._source
        cameras: Any = self._rig.cameras
        eyes = [source._eye(c, scene.hand_position, scene.hand_rotation) for c in cameras]
        shot, parts = self._batch.shoot(scene.world, eyes), []
        body = capsules_at(self._arm, self._twin.state.q)
        for k, (camera, eye) in enumerate(zip(cameras, eyes, strict=True)):
            lens = source._lens(camera)
            frame = Frame(self._twin.now, shot.colour[k], shot.depth[k], lens, np.array(eye.position),
                          np.array(eye.rotation))  # fmt: skip
            parts.append((frame.time, *cloud_of(frame, self._label.label(frame), self._rig, body)))
        return joined(parts, self._rig.grain)

    def tell(self, time: float, q: np.ndarray) -> None:
        """Take joints, which are known already."""

    def close(self) -> None:
        """Do nothing."""


def measured(options: argparse.Namespace) -> list[Figure]:
    """Measure and print."""
    start_warp()
    with tempfile.TemporaryDirectory() as folder, one_thread():
        run = options.run or trained(Path(folder) / "run", 2 if options.quick else 60)
        count = 3 if options.quick else options.episodes
        driver = read_driver(run, known_tasks())
        prepare(driver)
        inside = np.array([in_task(driver, options.seed, k) for k in range(count)])
        told(f"{driver.plan.name}, {driver.trained.iteration} iterations, in the task", inside)
        outside = np.array(end_to_end(driver, options.seed, count, options.camera))
        told(f"end to end, clouds of {options.camera}", outside)
    points = 100.0 * float(outside.mean() - inside.mean())
    both = 100.0 * float((inside == outside).mean())
    print(f"difference {points:+.1f} points; the same outcome in {both:.0f} % of the scenes", flush=True)
    return [Figure("task", "success", 100.0 * float(inside.mean()), "%"),
            Figure("end to end", "success", 100.0 * float(outside.mean()), "%"),
            Figure("end to end", "points lost", max(0.0, -points), "points")]  # fmt: skip


def trained(out: Path, iterations: int) -> Path:
    """Train a policy of reach and return its folder."""
    from bough.cli.train import Train

    assert Train("reach", out, policy="pcap", preset="cpu", iterations=iterations).run() == 0
    return out


def told(what: str, found: np.ndarray) -> None:
    """Print a share with its interval."""
    low, high = wilson(float(found.mean()), len(found))
    share = f"{100 * found.mean():.1f} % ({100 * low:.1f} to {100 * high:.1f})"
    print(f"{what}: {int(found.sum())} of {len(found)} succeeded, {share}", flush=True)


@torch.inference_mode()
def in_task(driver: Driver, seed: int, number: int) -> bool:
    """Return whether the policy succeeds in a scene of its task."""
    task: Any = make_world(driver.plan, seed, number)
    policy, observations = driver.trained.on(task), task.get_observations()
    while True:
        observations, _, done, extras = task.step(policy(observations))
        if bool(extras["log"]["success"][0] > 0):
            return True
        if bool(done[0]):
            return False


def end_to_end(driver: Driver, seed: int, count: int, camera: str) -> list[bool]:
    """Return whether the policy succeeds in each scene of the twin, and print how episodes ended."""
    twin = SimulatedTwin(Stage(driver.plan, seed), limits_of(driver.plan), delay=DELAY)
    seen: Any = None
    if driver.plan.seeing:
        seen = SeenTwin(twin) if camera == "twin" else TruthClouds(twin)
    senses = Senses(seen, twin, true_touch=driver.plan.feeling)
    runner = Runner(driver, twin, senses, twin.clock, None)
    out, ended, began = [], [], time.process_time()
    for number in range(count):
        runner.begin(number)
        if isinstance(seen, SeenTwin):
            seen.restart()
        episode = runner.run(number)
        out.append(bool(episode.success))
        ended.append(episode.ended.split(":")[-1].strip()[:18])
    print({kind: ended.count(kind) for kind in sorted(set(ended))},
          f"{(time.process_time() - began) / count:.2f} s of processor time an episode", flush=True)  # fmt: skip
    return out


def parser() -> argparse.ArgumentParser:
    """Make the parser of its options."""
    out = measuring.quick_and_seed(__doc__, "3 episodes of a policy of 2 iterations")
    out.add_argument("--run", type=Path, help="folder of bough train; a policy of reach is trained if not given")
    out.add_argument("--camera", choices=("truth", "twin"), default="truth", help="what a clearing policy sees by")
    out.add_argument("--episodes", type=int, default=100)
    return out


if __name__ == "__main__":
    sys.exit(measuring.main(parser(), measured, "deploy"))
