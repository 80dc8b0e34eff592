"""Table 5.3: what the four global embeddings cost a policy step, by kernels and by a learnt encoder."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import torch
import warp as wp

from ....perception.sensor import STAGES
from ....sim.base.thread_pool import together
from ...tasks.registry import TaskRegistry
from .pointnet import PointNet

WORLDS = (1024, 1)
"""Worlds that the thesis times: training, and inference on a robot."""
KERNELS, LEARNT = "kernel mean embedding", "PointNet++, plain torch"
_REPEATS = {KERNELS: 20, LEARNT: 3}
_PART = {"cpu": 16, "cuda": 256}  # clouds that the encoder takes at a time
_EMBED = STAGES.index("embedding")


@dataclass(frozen=True)
class EmbeddingTime:
    """Time of the four embeddings of every world, once.

    Attributes:
        name: `KERNELS` or `LEARNT`.
        worlds: Number of worlds.
        seconds: Median wall time [s].
        clouds: Clouds that were timed; the time of four a world follows in proportion where they are fewer.
    """

    name: str
    worlds: int
    seconds: float
    clouds: int


def measure(
    task: str, settings: Any, registry: TaskRegistry, *, seed: int, device: str,
    advance: Callable[[], None] = lambda: None,
) -> list[EmbeddingTime]:  # fmt: skip
    """Return the times of kernels and encoder on the clouds of the task, at 1024 worlds and at one.

    Args:
        task: Name of the task.
        settings: Its settings, with all observation groups.
        registry: Where it is found.
        seed: Seed of the worlds.
        device: Torch device.
        advance: Called after every measurement.
    """
    found = []
    for worlds in WORLDS:
        sensor: Any = registry.make(task, settings, num_envs=worlds, seed=seed, device=device, test=False)
        for timed in (kernels, learnt):
            found.append(timed(sensor.sensor))
            advance()
    return found


def kernels(sensor: Any) -> EmbeddingTime:
    """Time bough's kernels as training runs them: every CPU thread a share of the worlds, or one launch on a GPU."""
    parts = [[block[_EMBED] for block in run] for run in sensor.plan()]
    seconds = _median(together(parts), _REPEATS[KERNELS])
    return EmbeddingTime(KERNELS, sensor.num_worlds, seconds, 4 * sensor.num_worlds)


@torch.inference_mode()
def learnt(sensor: Any) -> EmbeddingTime:
    """Time PointNet++ on as many clouds as it takes at a time; the zoomed cloud counts as another whole one."""
    points, _near = sensor.clouds()
    device = points.device
    torch.manual_seed(0)
    encode, wanted = PointNet().to(device), 4 * sensor.num_worlds
    clouds = points[:, [0, 1, 2, 2]].flatten(0, 1)[: _PART[device.type]].mT.contiguous()
    seconds = _median(lambda: encode(clouds), _REPEATS[LEARNT])
    return EmbeddingTime(LEARNT, sensor.num_worlds, seconds * wanted / len(clouds), len(clouds))


def _median(call: Callable[[], object], repeats: int) -> float:
    """Return the median wall time of a call [s], the device waited for; the first call warms up."""
    taken = []
    for _ in range(repeats + 1):
        wp.synchronize()
        began = time.perf_counter()
        call()
        wp.synchronize()
        taken.append(time.perf_counter() - began)
    return statistics.median(taken[1:])
