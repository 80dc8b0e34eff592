"""The robot's sense of space: clouds of points on arm, branches and target, and what the policy sees of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from itertools import pairwise
from typing import Any, Protocol

import numpy as np
import torch
import warp as wp

from ..kernels.points.cloud import NUM_CLOUDS, Shapes, blur_kernel, sample_kernel, side
from ..kernels.points.embedding import embed_clouds_kernel
from ..kernels.points.nearest import Few, finish_kernel, margin_kernel, nearest_kernel, occlusion_kernel
from ..sim.base.errors import InputError
from ..sim.base.host import num_threads, simd_width
from ..sim.base.thread_pool import recorded, together
from ..sim.engine import arrays
from .cloud_memory import CloudMemory
from .frequencies import draw_frequencies

#: First columns of what `Sensor.update` writes, in the 88 numbers of the thesis's table 5.1.
COLUMNS: Mapping[str, int] = {
    "wbr": 16, "zbr": 32, "clr": 48, "rob": 64, "distances": 81, "breach": 86, "occlusion": 87,
}  # fmt: skip
STAGES = (
    "sampling", "true occlusion", "true margin", "noise", "embedding", "occlusion", "nearest", "margin", "scores",
)  # fmt: skip
"""Launches of an update, in their order (`Sensor.plan`)."""
_EMBEDDED = ("rob", "clr", "wbr", "zbr")
_LOCAL = ("distances", "breach", "occlusion")
_BEYOND = 1.001  # the mean of five distances is not below the margin if the fifth is five margins, rounding included
_TEAM = 32  # GPU threads that share a world's pairs of points: a tile of 512 points each
_DRAWERS = 8  # GPU threads that draw a cloud together; each adds up all levels, so more of them repeat more
_BLOCK = 32  # worlds that a CPU thread takes through all kernels at a time: 768 KiB of clouds of 512 points


class Capsules(Protocol):
    """Capsules of all worlds, Warp arrays: ends of axes vec3 [worlds, S] in m, radius [worlds, S], 0 for none."""

    start: Any
    end: Any
    radius: Any
    num_arm: int


class Target(Protocol):
    """What is to be cleared, Warp arrays: ends of its axis vec3 [worlds], or of several [worlds, T], in m."""

    start: Any
    end: Any


@dataclass(frozen=True)
class SensorSettings:
    """How clouds are drawn and scored; defaults are the thesis's (5.3.3-5.3.6).

    Attributes:
        points: Points of a cloud, a multiple of 16.
        features: Frequencies R; a cloud's embedding has 2 R numbers.
        bandwidth: gamma of the kernel exp(-|x - y|^2 / (2 gamma^2)) [m].
        frequency_seed: Seed of the frequencies; a policy needs those that it was trained with.
        pairs: k of the occlusion score.
        threshold: Distance d_th below which a branch-target pair occludes [m].
        margin: Safety margin d_sm [m].
        clearance: Radius of the target's surface about its axis [m].
        rounded: Whether the target has round ends, as a sphere has (start = end); the power line has only its side.
        zoom: Distance from the target's axis within which branch points belong to the zoomed cloud [m].
        farthest: Distance reported where there is no branch point, and the greatest reported [m].
    """

    points: int = 512
    features: int = 8
    bandwidth: float = 1.0
    frequency_seed: int = 0
    pairs: int = 200
    threshold: float = 0.10
    margin: float = 0.04
    clearance: float = 0.05
    rounded: bool = False
    zoom: float = 0.30
    farthest: float = 10.0

    def __post_init__(self) -> None:
        """Refuse numbers that mean nothing."""
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name != "frequency_seed" and not isinstance(value, bool) and not 0 < value < math.inf:
                raise InputError("sensor", field.name, str(value), "a number above zero")
        if self.points % 16:
            raise InputError("sensor", "points", str(self.points), "a multiple of 16")


class Sensor:
    """Draws clouds for all worlds, embeds them, and scores occlusion and nearness, straight into the observation.

    What goes into the observation is seen through the points' noise; rewards take `occlusion` and `breach`, which are
    scored on the same points before the noise is on them.

    All memory is allocated here; `update` launches kernels and nothing else, on a GPU in the current stream. Numbers
    depend on (seed, world, tick) and the scene alone.

    Attributes:
        occlusion: Share of the ``pairs`` closest branch-target pairs closer than ``threshold``, of points without
            noise, torch view [worlds].
        breach: 1 where robot and target are closer than the margin, else 0, of points without noise, float32 torch view
            [worlds].
        distances: The 5 least distances from end-effector to branch points as they are seen, ascending [m], torch view
            [worlds, 5].
        max_noise: d_max, three deviations of the noise on every coordinate [m], torch view [worlds], to be written.
        tick: Number of the next draw of each world, int32 torch view [worlds]; write it to go on from a snapshot.
        frequencies: w_r [rad/m], float32 torch tensor [R, 3] on the sensor's device.
    """

    def __init__(
        self,
        capsules: Capsules,
        target: Target,
        ee_position: wp.array,
        settings: SensorSettings | None = None,
        *,
        seed: int = 0,
        device: Any = None,
        threads: int | None = None,
        width: int | None = None,
    ) -> None:
        """Allocate everything that sensing needs.

        Args:
            capsules: What points are drawn on; read anew at every update.
            target: The region to be cleared.
            ee_position: End-effector, vec3 [worlds], in m.
            settings: How to draw and score.
            seed: Seed of the points and their noise, any integer of 31 bits.
            device: Warp device; None is that of the capsules.
            threads: CPU threads; None takes all cores.
            width: Points a lane vector; None takes what the processor has, 1 on a GPU.
        """
        self.settings = settings or SensorSettings()
        self.device = wp.get_device(device if device is not None else capsules.start.device)
        self.num_worlds = int(capsules.start.shape[0])
        cuda = self.device.is_cuda
        self.width = width or (1 if cuda else simd_width())
        wanted = num_threads() if threads is None else threads
        self._worlds_inside = self.width == 1 and arrays.link_major(self.device)
        self.threads = 1 if cuda else max(1, min(wanted, self.num_worlds))
        self._seed, self._num_arm, self._ee = int(seed), int(capsules.num_arm), ee_position
        self._capsules = _shapes(capsules.start, capsules.end, capsules.radius)
        self._target = self._target_shapes(target)
        self._block = self.num_worlds if cuda else min(self.num_worlds, _BLOCK)
        self._clouds = self._memory(self._block * self.threads)
        self._team, self._drawers = (_TEAM, _DRAWERS) if self._worlds_inside else (1, 1)
        self._allocate_outputs()
        self._updates: dict[bool, Callable[[], None]] = {}
        self._observation: Any = None

    # ---- memory --------------------------------------------------------------------------------------------------

    def _target_shapes(self, target: Target) -> Any:
        """Shapes [worlds, T] of the target, seen through its own memory."""
        start, end = (a.reshape((self.num_worlds, -1)) if a.ndim == 1 else a for a in (target.start, target.end))
        self._clearance = wp.full(start.shape, self.settings.clearance, dtype=wp.float32, device=self.device)
        return _shapes(start, end, self._clearance)

    def _memory(self, rows: int) -> CloudMemory:
        points, inside = self.settings.points, self._worlds_inside
        return CloudMemory(rows, points, width=self.width, inside=inside, device=self.device)

    def _allocate_outputs(self) -> None:
        s, n, team = self.settings, self.num_worlds, self._team

        def zeros(dtype: Any, *shape: int) -> Any:
            """Return zeros on the device, [worlds, *shape]."""
            return wp.zeros((n, *shape), dtype=dtype, device=self.device)

        self._occlusion, self._breach, self._max_noise = (zeros(wp.float32) for _ in range(3))
        self._distances, self._tick = zeros(wp.float32, 5), zeros(int)
        self._count, self._point, self._pair = zeros(int, team), zeros(Few, team), zeros(Few, team)
        self._true_count, self._true_pair = zeros(int, team), zeros(Few, team)
        frequencies = draw_frequencies(s.features, s.bandwidth, s.frequency_seed)
        self._waves: Any = wp.array(frequencies.astype(float) / (2 * np.pi), dtype=wp.vec3, device=self.device)
        self.frequencies = torch.tensor(frequencies, device=wp.device_to_torch(self.device))
        self.occlusion: torch.Tensor = wp.to_torch(self._occlusion)
        self.breach: torch.Tensor = wp.to_torch(self._breach)
        self.distances: torch.Tensor = wp.to_torch(self._distances)
        self.max_noise: torch.Tensor = wp.to_torch(self._max_noise)
        self.tick: torch.Tensor = wp.to_torch(self._tick)

    @property
    def nbytes(self) -> int:
        """Bytes of the clouds and their bounds."""
        return self._clouds.nbytes

    # ---- sensing -------------------------------------------------------------------------------------------------

    def bind(self, observation: torch.Tensor | wp.array, columns: Mapping[str, int] = COLUMNS) -> None:
        """Name the tensor float32 [worlds, numbers] that `update` writes into, and the first column of each group.

        Args:
            observation: Memory on the sensor's device; it is kept, never copied.
            columns: Any of ``wbr``, ``zbr``, ``clr``, ``rob`` (2 R columns each), ``distances`` (5), ``breach`` and
                ``occlusion`` (1 each). A group that is not named is not written.

        Raises:
            InputError: A group that does not exist, columns outside the tensor, or a tensor on another device.
        """
        size = dict.fromkeys(_EMBEDDED, 2 * self.settings.features) | {"distances": 5, "breach": 1, "occlusion": 1}
        rows, numbers = observation.shape
        _check_device(observation, self.device)
        for name, first in columns.items():
            if name not in size:
                raise InputError("sensor", "columns", name, ", ".join(size))
            if not 0 <= first <= numbers - size[name] or rows != self.num_worlds:
                found = f"columns {first} to {first + size[name] - 1} of [{rows}, {numbers}]"
                raise InputError("sensor", name, found, f"columns of [{self.num_worlds}, {numbers}]")
        array: Any = wp.from_torch(observation) if isinstance(observation, torch.Tensor) else observation
        begin = [[columns.get(name, -1) for name in names] for names in (_EMBEDDED, _LOCAL)]
        self._columns: list[Any] = [wp.array(c, dtype=int, device=self.device) for c in begin]
        self._observation = array
        self._updates = {split: self._prepare(split=split) for split in (False, True)}

    def update(
        self, observation: torch.Tensor | wp.array | None = None, tick: int | torch.Tensor | None = None
    ) -> None:
        """Draw new points, write observation, `occlusion`, `breach` and `distances`, and count the tick.

        Capsules, target and end-effector are read as they are now. Inside a graph capture everything runs on the
        calling thread.

        Args:
            observation: Where to write, at `COLUMNS`, if that is not bound yet; None takes what is bound.
            tick: Draw to make, of all worlds or int32 [worlds]; None goes on from `tick` (inside a capture too).
        """
        if observation is not None:
            pointer = observation.data_ptr() if isinstance(observation, torch.Tensor) else observation.ptr
            if self._observation is None or pointer != self._observation.ptr:
                self.bind(observation)
        if tick is not None:
            self.tick.copy_(tick) if isinstance(tick, torch.Tensor) else self.tick.fill_(tick)
        self._updates[not self.device.is_capturing]()

    def _prepare(self, *, split: bool) -> Callable[[], None]:
        """Return a function that launches all kernels."""
        return together([[c for block in run for c in block] for run in self.plan(split=split)])

    def plan(self, *, split: bool = True) -> list[list[list[Any]]]:
        """Return the recorded launches of an update, after `bind`: for each thread, for each block of its worlds.

        A thread takes all its blocks through the same memory, which stays in its cache; on a GPU all worlds are one
        block. The launches of a block are `STAGES`: they sample, count occluding pairs and find the closest ones, put
        noise on the points, embed, count and find the closest again, and write the scores.

        Args:
            split: Whether all CPU threads take part; else one takes all worlds.
        """
        cuts = np.linspace(0, self.num_worlds, (self.threads if split else 1) + 1).astype(int).tolist()
        block = self._block
        return [[self._commands(i, min(block, b - i), block * thread) for i in range(a, b, block)]
                for thread, (a, b) in enumerate(pairwise(cuts))]  # fmt: skip

    def clouds(self, *, noise: bool = True) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw the clouds of the last `update` again, for all worlds, into memory of their own.

        An update keeps no more clouds than it is working on. Points are a function of (seed, world, tick) and the
        scene, which is read as it is now.

        Args:
            noise: Whether points are as the policy sees them, or as rewards are scored.

        Returns:
            Points [worlds, 3, 3, points] of robot, target and branches [m], coordinates before points, neighbours in
            memory being neighbours in space; and 1 for branch points of the zoomed cloud, else 0 [worlds, points].
        """
        memory, n = self._memory(self.num_worlds), self.num_worlds
        tick, reach = wp.from_torch(self.tick - 1), self._max_noise if noise else wp.zeros_like(self._max_noise)
        self._sample(0, n, 0, memory, tick).launch()
        self._blur(0, n, 0, memory, tick, reach).launch()
        return memory.points, memory.near

    def _threads(self, count: int, *inner: int) -> tuple[int, ...]:
        """Return the threads of a launch for ``count`` worlds: neighbours are neighbouring worlds on a GPU."""
        beside = side(self.width)
        return -(-count // beside), *inner, beside

    def _sample(self, first: int, count: int, row: int, clouds: CloudMemory, tick: Any) -> Any:
        """Return the launch that draws the clouds of ``count`` worlds from ``first`` into rows from ``row``."""
        cap = float(self.settings.rounded)
        place = [first, row, count, self._drawers, clouds.kernel]
        inputs = [self._capsules, self._num_arm, self._target, cap, self._seed, tick, *place]
        return recorded(sample_kernel(self.width), self._threads(count, NUM_CLOUDS, self._drawers), inputs, self.device)

    def _blur(self, first: int, count: int, row: int, clouds: CloudMemory, tick: Any, reach: Any) -> Any:
        """Return the launch that puts noise up to ``reach`` on those clouds."""
        place = [first, row, count, self._drawers, clouds.kernel]
        inputs = [self._target, self.settings.zoom, self._seed, tick, reach, *place]
        return recorded(blur_kernel(self.width), self._threads(count, NUM_CLOUDS, self._drawers), inputs, self.device)

    def _scored(self, first: int, count: int, row: int, found: Any, pair: Any) -> list[Any]:
        """Return the launches that count occluding pairs and find those closest to the robot, on clouds as they are."""
        s, w = self.settings, self.width
        near, limit = s.margin**2 * _BEYOND, (5 * s.margin) ** 2 * _BEYOND
        clouds, dim = self._clouds.kernel, self._threads(count, self._team)
        occluding = [clouds, _squared(s.threshold), s.pairs, first, row, count, found]
        closest = [clouds, near, limit, first, row, count, pair]
        return [
            recorded(occlusion_kernel(w), dim, occluding, self.device),
            recorded(margin_kernel(w), dim, closest, self.device),
        ]

    def _commands(self, first: int, count: int, row: int) -> list[Any]:
        """Return the launches (`STAGES`) for ``count`` worlds from ``first``, whose clouds go to rows from ``row``."""
        s, w = self.settings, self.width
        embedded, local = self._columns
        waves = s.features if self._worlds_inside else 1
        clouds, place = self._clouds.kernel, (first, row, count)
        embed = [clouds, self._waves, embedded, *place, waves, self._observation]
        nearest = [clouds, self._ee, s.farthest**2, *place, self._point]
        finish = [self._true_count, self._true_pair, self._count, self._point, self._pair, s.pairs, s.margin, local,
                  first, self._tick, self._occlusion, self._distances, self._breach, self._observation]  # fmt: skip
        occlusion, margin = self._scored(first, count, row, self._count, self._pair)
        return [
            self._sample(first, count, row, self._clouds, self._tick),
            *self._scored(first, count, row, self._true_count, self._true_pair),
            self._blur(first, count, row, self._clouds, self._tick, self._max_noise),
            recorded(embed_clouds_kernel(w), self._threads(count, NUM_CLOUDS, waves), embed, self.device),
            occlusion,
            recorded(nearest_kernel(w), self._threads(count, self._team), nearest, self.device),
            margin,
            recorded(finish_kernel, (count,), finish, self.device),
        ]


def _check_device(observation: torch.Tensor | wp.array, device: Any) -> None:
    """Refuse memory that the kernels cannot reach: they would write to wild addresses."""
    theirs = wp.device_from_torch(observation.device) if isinstance(observation, torch.Tensor) else observation.device
    if theirs != device:
        raise InputError("sensor", "observation", f"memory of {theirs}", f"memory of {device}, the sensor's device")


def _squared(distance: float) -> float:
    """Return the square of a distance rounded to float32, in float32, as the kernels compare."""
    return float(np.float32(distance) * np.float32(distance))


def _shapes(start: wp.array, end: wp.array, radius: wp.array) -> Any:
    shapes = Shapes()
    shapes.start, shapes.end, shapes.radius = start, end, radius
    return shapes
