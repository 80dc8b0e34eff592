"""Recordings of a simulated arm that is touched: `learn.touch.motions` run in `sim.arms`, told by a `TorqueSensor`.

What differs between a simulated arm and a real one is drawn anew for every batch of motions (servo gain) and for every
motion: noise and drift, gravity that the driver leaves in the torques, a payload that it knows nothing of, friction,
and how late the arm does what it is asked for.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ...sim.arms.arm import Arm
from ...sim.arms.jaco2 import jaco2
from ...sim.arms.simulator import ArmSimulator, Contacts
from ...sim.arms.statics import statics
from ...sim.base.errors import InputError, check_seed
from ...sim.base.files import output_folder
from ...sim.base.types import Array, IntArray
from .motions import COMMANDS, DIRECTIONS, OBSTACLES, PLACES, Motion, free_twin, obstructed_motion
from .read import INDEX, INDEX_COLUMNS
from .recording import Recording
from .sensor import JACO2, TorqueSensor

GRAVITY = 9.81
_STEPS = 4  # of the simulator for every command
_LATEST = 6  # commands that the arm is late by at most: a Jaco 2's speeds follow its commands 45 ms later


@dataclass(frozen=True)
class Settings:
    """What is recorded.

    Attributes:
        rounds: Each has 28 motions that meet a hand, 28 that meet a branch, and all of them again without, with one
            servo gain.
        seconds: Of every motion [s].
        force: Force on a link from which it counts as contact [N].
        seed: Of everything random.
        sensor: How torques are told.
    """

    rounds: int = 4
    seconds: float = 6.0
    force: float = 2.0
    seed: int = 0
    sensor: TorqueSensor = JACO2

    def check(self) -> None:
        """Raise `InputError` for a setting that nothing can be recorded with."""
        check_seed("touch record", self.seed)
        for name, value, good in (
            ("rounds", self.rounds, 1 <= self.rounds <= 1000),
            ("seconds", self.seconds, 2.0 <= self.seconds <= 600.0),
            ("force", self.force, 0.0 < self.force < 1.0e4),
        ):
            if not good:
                allowed = {"rounds": "1 to 1000", "seconds": "2 to 600", "force": "above 0, below 10000 N"}[name]
                raise InputError("touch record", f"--{name}", f"{value:g}", allowed)
        if not (1.0 <= self.sensor.rate <= COMMANDS and (COMMANDS / self.sensor.rate) % 1.0 < 1.0e-2):
            raise InputError("touch record", "sensor", f"{self.sensor.rate:g} Hz", f"{COMMANDS} Hz over a whole number")


def record(out: Path, settings: Settings, progress: Callable[[int], None] = lambda done: None) -> list[Recording]:
    """Simulate all motions and write a CSV file of each, with an index, into ``out``.

    Raises:
        InputError: A setting is out of its range, or ``out`` cannot be written.
    """
    settings.check()
    made: list[Recording] = []
    with output_folder(out) as work:
        for number in range(settings.rounds):
            for recording in simulate_round(settings, number):
                made.append(replace(recording, name=f"{len(made):05d}.csv"))
                write_csv(work / made[-1].name, made[-1])
            progress(1)
        write_index(work / INDEX, made)
        settings.sensor.write(work / "sensor.json")
    return made


def simulate_round(settings: Settings, number: int) -> list[Recording]:
    """Return the recordings of one round; the same for the same seed and number."""
    rng = np.random.default_rng([settings.seed, number])
    arm = replace(jaco2(), gain=np.full(6, 80.0 * np.exp(rng.uniform(np.log(0.3), np.log(1.5)))))
    motions = [
        obstructed_motion(arm, place, side, kind, rng, settings.seconds)
        for kind in OBSTACLES for place in PLACES for side in range(len(DIRECTIONS))
    ]  # fmt: skip
    motions += [free_twin(m, rng) for m in motions]
    q, velocity, torque, force = simulate(arm, motions, settings.sensor.rate)
    told = _told(arm, settings.sensor, q, velocity, torque, rng)
    command = _commanded(motions, settings.sensor.rate, rng.integers(0, _LATEST + 1, len(motions)))
    time = np.arange(1, q.shape[1] + 1) / settings.sensor.rate
    return [
        Recording("", time, told[k], settings.sensor.speeds(velocity[k]), command[k], np.zeros_like(told[k]),
                  (force[k] > settings.force).astype(np.int64), m.place, f"{m.direction} {m.obstacle}".strip())
        for k, m in enumerate(motions)
    ]  # fmt: skip


def simulate(arm: Arm, motions: Sequence[Motion], rate: float) -> tuple[Array, Array, Array, Array]:
    """Run motions side by side; return, sampled at a rate, positions, speeds and torques, and the greatest force.

    Returns:
        q [rad], qd [rad/s], servo torque [N m] with the weight in it, [R, T, D] each; the greatest contact force on a
        link since the last sample [N], [R, T].
    """
    simulator = ArmSimulator([m.tree for m in motions], arm, contacts=Contacts(), dt=1.0 / (COMMANDS * _STEPS))
    command = np.stack([m.command for m in motions], axis=1).astype(np.float32)
    simulator.start_q.copy_(_tensor(np.stack([m.start for m in motions])))
    simulator.reset()
    every = round(COMMANDS / rate)
    seen: list[tuple[Array, ...]] = []
    simulator.arm_peak.zero_()
    for k in range(len(command)):
        simulator.target.copy_(_tensor(command[k]))
        simulator.step(_STEPS)
        if (k + 1) % every == 0:
            parts = (simulator.q, simulator.qd, simulator.torque, simulator.arm_peak.amax(1))
            seen.append(tuple(x.cpu().numpy().astype(np.float64) for x in parts))
            simulator.arm_peak.zero_()
    if simulator.faults():
        raise RuntimeError(f"a simulated arm was lost: {simulator.faults()[0]}")
    q, qd, torque, force = (np.stack(x, axis=1) for x in zip(*seen, strict=True))
    return q, qd, torque, force


def _tensor(x: Array) -> Any:
    import torch

    return torch.from_numpy(np.ascontiguousarray(x, dtype=np.float32))


def carrying_torque(arm: Arm, q: Array, payload: float | Array = 0.0, *, links: bool = True) -> Array:
    """Return the joint torques that carry the arm's weight and a payload at its end [N m], [..., D].

    The payload is a force m g downwards at the end-effector, through the Jacobian.

    Args:
        arm: The arm.
        q: Joint positions [rad], [..., D].
        payload: Mass at the end-effector [kg], one or one for every leading index of ``q``.
        links: Whether the links' own weight counts.
    """
    hold, jacobian = statics(arm, q, GRAVITY)
    held: Array = np.asarray(payload, float)[..., None] * GRAVITY * jacobian[..., 2, :]
    return held + hold if links else held


def _told(arm: Arm, sensor: TorqueSensor, q: Array, velocity: Array, torque: Array, rng: np.random.Generator) -> Array:
    """Return what the driver tells of the torques: what is left of gravity, payload and friction, noise and drift."""
    count, joints = len(q), arm.num_dofs
    weight = carrying_torque(arm, q)
    left = rng.normal(0.0, 0.06, (count, 1, joints)) * weight
    left += carrying_torque(arm, q, rng.exponential(0.08, (count, 1)), links=False)
    friction = np.abs(np.array(sensor.dry)) * rng.normal(0.0, 1.0, (count, 1, joints)) * np.tanh(velocity / 0.02)
    scale = float(rng.uniform(0.7, 1.2))
    return sensor.measure(torque - weight + left + friction, velocity, rng, scale)


def _commanded(motions: Sequence[Motion], rate: float, late: IntArray) -> Array:
    """Return the mean of the commands since the last sample [rad/s], [R, T, D]; the arm obeys ``late`` commands later.

    Seen from the arm the commands come early: what it is to do later has been said already.
    """
    every = round(COMMANDS / rate)
    out = []
    for motion, ahead in zip(motions, late, strict=True):
        last = np.repeat(motion.command[-1:], ahead, axis=0)
        said = np.concatenate([motion.command[ahead:], last])
        count = len(said) // every
        out.append(said[: count * every].reshape(count, every, -1).mean(axis=1))
    return np.stack(out)


def write_csv(path: Path, recording: Recording) -> None:
    """Write one recording with the columns that `learn.touch.read` reads."""
    joints = range(1, recording.num_dofs + 1)
    names = ["time_s", *(f"tau{k}_Nm" for k in joints), *(f"dq{k}_rad_s" for k in joints),
             *(f"dq_cmd{k}_rad_s" for k in joints), "contact"]  # fmt: skip
    rows = np.column_stack([recording.time, recording.torque, recording.velocity, recording.command, recording.contact])
    np.savetxt(path, rows, delimiter=",", header=",".join(names), comments="", fmt="%.6g")


def write_index(path: Path, recordings: Sequence[Recording]) -> None:
    """Write what is touched where in each recording."""
    with path.open("w", newline="") as stream:
        rows = csv.writer(stream, lineterminator="\n")
        rows.writerow(INDEX_COLUMNS)
        for r in recordings:
            rows.writerow([r.name, r.link, r.direction, f"{r.tolerance:g}"])
