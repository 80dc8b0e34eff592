"""What is predicted of every joint of a free arm: its torque, by its motion, and its speed, by its command.

    torque:  tau = m(q, q', q'') + o_r + D q'                  m the known mechanism, o_r a constant of the recording
    speed:   Dq / Dt = mean command - m / K                    K the gain of the servo (`sim.arms.arm.Arm`)

Speeds are means over a window between samples, so that no derivative of a command is needed; torques, positions and
the mechanism's torques are averaged over the same window. Where the torques hold the weight, it belongs to m. Constants
of a recording are the torque sensor's: it drifts from one recording to the next.

Errors of torques remember the past for a second, so rows are no independent evidence. Blocks are: recordings, in pieces
of at least `LEAST_BLOCK`. What is learnt from all blocks but one is tested on it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...sim.arms.dynamics import motion_torques
from ...sim.arms.statics import statics
from ...sim.base.types import Array, IntArray
from ..cases.arm import ArmCase, ArmTrajectory

Kind = Literal["torque", "speed"]
UNITS: dict[Kind, str] = {"torque": "N m", "speed": "rad/s"}
#: Blocks that a verdict needs, and those that recordings are cut into.
LEAST_BLOCKS, MOST_BLOCKS = 8, 60
#: Least length of a piece of a recording that counts as a block [s], and of a window that speeds are means over.
LEAST_BLOCK, WINDOW = 2.0, 0.1


@dataclass(frozen=True)
class Rows:
    """All recordings of an arm on one grid of windows, N rows in order, D joints.

    Attributes:
        recording: Index of the recording of each row, [N].
        block: Index of the block of each row, counted from 0 without gaps, [N].
        start, end: The row's window, on its recording's clock [s], [N].
        position, speed, acceleration: Means over the window, [N, D].
        torque: Measured torque less what the mechanism needs [N m], [N, D]; None without torques.
        needed: Torque that the motion needs beside the weight, m [N m], [N, D].
        weight: Torque that carries the arm [N m], [N, D].
        noise: White noise of speeds and torques, by third differences of neighbouring rows, [D] each.
    """

    recording: IntArray
    block: IntArray
    start: Array
    end: Array
    position: Array
    speed: Array
    acceleration: Array
    torque: Array | None
    needed: Array
    weight: Array
    noise: dict[Kind, Array]

    @property
    def blocks(self) -> int:
        """Number of blocks."""
        return int(self.block.max()) + 1


def rows_of(case: ArmCase) -> Rows:
    """Return the rows of a case; recordings that are shorter than five windows have none."""
    every = max(1, round(WINDOW / case.dt))
    parts = [_windows(t, every) for t in recorded(case)]
    lengths = [len(p[0]) for p in parts]
    recording = np.repeat(np.arange(len(parts)), lengths)
    start, end, position, speed, acceleration, torque = (
        np.concatenate([p[k] for p in parts]) if parts else np.zeros((0, 1)) for k in range(6)
    )
    measured = torque if case.trajectories[0].torque is not None else None
    position = position if parts else np.zeros((0, case.arm.num_dofs))
    weight = statics(case.arm, position)[0]
    needed = motion_torques(case.arm, position, speed, acceleration)
    left = None if measured is None else measured - needed - (weight if case.weight_in else 0.0)
    noise: dict[Kind, Array] = {"speed": _white(speed, recording)}
    if measured is not None:
        noise["torque"] = _white(measured, recording)
    step = every * case.dt
    return Rows(recording, _blocks(recording, step), start, end, position, speed, acceleration, left, needed, weight,
                noise)  # fmt: skip


def recorded(case: ArmCase) -> list[ArmTrajectory]:
    """Return the recordings that are long enough to have rows."""
    every = max(1, round(WINDOW / case.dt))
    return [t for t in case.trajectories if len(t.t) > 5 * every]


def _windows(t: ArmTrajectory, every: int) -> tuple[Array, ...]:
    """Start, end, position, speed, acceleration and torque of the windows of a recording; the outermost are left out.

    Positions are those at the windows' ends, half and half; accelerations are of the neighbouring windows' speeds.
    """
    ends = np.arange(0, len(t.t), every)
    span = np.diff(t.t[ends])[:, None]
    speed = np.diff(t.position[ends], axis=0) / span
    position = 0.5 * (t.position[ends[1:]] + t.position[ends[:-1]])
    acceleration = np.gradient(speed, axis=0) / span
    torque = np.zeros_like(speed) if t.torque is None else _means(t.torque, ends)
    inner = slice(1, -1)
    return (
        t.t[ends[:-1]][inner],
        t.t[ends[1:]][inner],
        position[inner],
        speed[inner],
        acceleration[inner],
        torque[inner],
    )


def _means(values: Array, ends: IntArray) -> Array:
    """Return means between ends, of samples taken to be linear between each other, [W, D]."""
    total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(0.5 * (values[1:] + values[:-1]), axis=0)])
    out: Array = np.diff(total[ends], axis=0) / np.diff(ends)[:, None]
    return out


def _blocks(recording: IntArray, step: float) -> IntArray:
    """Return blocks: pieces of recordings, of like length and `MOST_BLOCKS` or so at most."""
    count = int(recording.max(initial=-1)) + 1
    lengths = np.bincount(recording, minlength=count)
    length = max(int(np.ceil(LEAST_BLOCK / step)), int(np.ceil(len(recording) / MOST_BLOCKS)))
    out, used = np.zeros(len(recording), dtype=np.int64), 0
    for r in range(count):
        pieces = max(1, lengths[r] // length)
        out[recording == r] = used + np.minimum(np.arange(lengths[r]) * pieces // lengths[r], pieces - 1)
        used += pieces
    return out


def _white(values: Array, recording: IntArray) -> Array:
    """Return the deviation of white noise, by third differences within recordings (their variance is 20 times it)."""
    parts = [np.diff(values[recording == r], n=3, axis=0) for r in range(int(recording.max(initial=-1)) + 1)]
    parts = [p for p in parts if len(p)]
    if not parts:
        return np.zeros(values.shape[1])
    return np.sqrt((np.concatenate(parts) ** 2).mean(axis=0) / 20.0)
