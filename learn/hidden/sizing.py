"""Size of an effect, and the part of it that refitted springs and dampers cannot absorb."""

from __future__ import annotations

from typing import Any

import numpy as np

from .branch import Array, Branch
from .drive import Motion, drive
from .parts import Draft, Part, Readings, Scale
from .probes import Experiment, within_reach

#: Time steps [s] of runs that size an effect and of the refit; errors are 0.7 % and 0.3 % of displacement.
SIZING_STEP, REFIT_STEP = 4e-3, 2e-3
#: Tolerance of an effect's size, a factor of the target.
NEAR = 1.25


class Bench:
    """An experiment with large time steps, for finding strengths.

    Its forces are kept within reach of the branch without effects, as those of a case without are.

    Attributes:
        experiment: The experiment; its forces are changed.
        options: Options of `rig.build`.
        null: What the branch does without effects.
    """

    def __init__(self, experiment: Experiment, options: dict[str, Any]) -> None:
        self.experiment, self.options = experiment, options | {"dt": SIZING_STEP}
        experiment.forces, self.null = within_reach(
            experiment.branch, experiment.forces, experiment.rate, **self.options
        )

    def scale(self) -> Scale:
        """Return what the branch does without effects."""
        e, null = self.experiment, self.null
        return Scale(
            branch=e.branch, angle=null.angle.max(axis=(0, 1)), rate=null.rate.max(axis=(0, 1)),
            force=_longest(e.forces), moved=_longest(null.moved), speed=_longest(null.velocity),
            pushes=np.array([r["direction"] for r in e.recordings]), clock=e.clock,
            duration=float(e.time[-1]), samples=len(e.time),
        )  # fmt: skip

    def size(self, part: Part) -> float:
        """Return the rms of displacement that a true K and D do not explain from the recorded force, over the whole.

        Not a number if the branch leaves the finite.
        """
        motion = self.null
        if part.moves:
            e = self.experiment
            motion = drive(e.branch, e.forces, e.rate, parts=[part], clock=e.clock, **self.options)
        seen = readings(self.experiment, motion, [part])
        known = self.null if seen.force is self.experiment.forces else self._explained(seen)
        found = ratio(seen.moved - known.moved, self.null.moved)
        return found if found < 3.0 else float("nan")

    def _explained(self, seen: Readings) -> Motion:
        return drive(self.experiment.branch, known_force(self.experiment, seen), self.experiment.rate, **self.options)


def _longest(vectors: Array) -> float:
    return float(np.linalg.norm(vectors, axis=-1).max())


def ratio(part: Array, whole: Array) -> float:
    """Return the rms of one array over that of the other."""
    return float(np.sqrt(np.mean(part**2) / np.mean(whole**2)))


def readings(experiment: Experiment, motion: Motion, parts: list[Part]) -> Readings:
    """Return what the sensors say, with their faults and without noise."""
    seen = Readings(experiment.time, experiment.forces, motion.moved, motion.velocity, motion.turn)
    for part in parts:
        seen = part.sense(seen) if part.sense else seen
    return seen


def known_force(experiment: Experiment, seen: Readings) -> Array:
    """Return the recorded force, zero where the gripper is known to be open [N], shape [N, T, 3]."""
    return np.where(experiment.open_hand[..., None], 0.0, seen.force)


def strength(bench: Bench, draft: Draft, target: float, tries: int = 5) -> tuple[Part, float]:
    """Find the strength whose size is the target: secants of the logarithms, kept inside the draft's bounds.

    Returns:
        The part and its size; the nearest in size if the target is out of reach.
    """
    value, slope = float(np.clip(draft.start * target / 0.12, draft.low, draft.high)), 1.0
    tried: list[tuple[float, float, Part]] = []
    low, high = draft.low, draft.high
    for _ in range(tries):
        part = draft.make(value)
        found = bench.size(part)
        if not np.isfinite(found) or found <= 0:
            low, high = (low, value) if not np.isfinite(found) else (value, high)
            value = float(np.sqrt(low * high))
            continue
        tried.append((value, found, part))
        if max(found / target, target / found) < NEAR:
            break
        if len(tried) > 1 and tried[-1][0] != tried[-2][0]:
            slope = _slope(tried[-2], tried[-1])
        wanted = float(np.clip(value * np.clip((target / found) ** (1 / slope), 0.05, 20), low, high))
        if wanted == value:
            break
        value = wanted
    if not tried:
        return draft.make(value), float("nan")
    _, found, part = min(tried, key=lambda t: abs(np.log(t[1] / target)))
    return part, found


def _slope(a: tuple[float, float, Part], b: tuple[float, float, Part]) -> float:
    """Slope of log size over log strength, within what effects have."""
    return float(np.clip(np.log(b[1] / a[1]) / np.log(b[0] / a[0]), 0.3, 3.0))


def visible_gap(
    experiment: Experiment, seen: Readings, options: dict[str, Any], rounds: int = 3, branch: Branch | None = None
) -> float:
    """Return the rms misfit of displacement that is left when K and D are refitted, over the rms of the motion.

    Gauss-Newton in the logarithms of all springs and dampers, without noise and with the recorded force. Derivatives
    are forward differences of the branch with rigid segments at the true K and D; a step that does not help is halved.

    Args:
        experiment: What was done.
        seen: What the sensors say, without noise.
        options: Options of `rig.build`.
        rounds: Steps.
        branch: The branch whose springs are refitted; the experiment's if None.
    """
    branch = branch or experiment.branch
    force, rate = known_force(experiment, seen), experiment.rate
    if not all(np.isfinite(v).all() for v in (force, seen.moved)):
        return float("nan")
    pull = np.linalg.pinv(_sensitivity(branch, force, rate))
    logs = np.zeros(2 * len(branch.length))
    best, step = np.inf, logs
    for _ in range(rounds + 1):
        tried = np.clip(logs + step, -2.5, 2.5)
        moved = drive(scaled(branch, tried), force, rate, **options | {"dt": REFIT_STEP}).moved
        left = ratio(seen.moved - moved, seen.moved)
        if left < best:
            best, logs, step = left, tried, np.clip(pull @ (seen.moved - moved).ravel(), -0.7, 0.7)
        else:
            step = step / 2
    return best


def _sensitivity(branch: Branch, force: Array, rate: float, change: float = 0.05) -> Array:
    """Return derivatives of the displacement by log K and log D, shape [N T 3, 2 R]."""
    columns = np.eye(2 * len(branch.length)) * change

    def moved(logs: Array) -> Array:
        """Return the displacement [m] under the known forces with springs scaled by ``logs``, shape [N T 3]."""
        return drive(scaled(branch, logs), force, rate, sub=1, dt=SIZING_STEP).moved.ravel()

    base = moved(0 * columns[0])
    return np.stack([(moved(c) - base) / change for c in columns], axis=1)


def scaled(branch: Branch, logs: Array) -> Branch:
    """Return the branch with its springs and dampers times exp of the first and the second half of ``logs``."""
    factors = np.exp(logs).reshape(2, -1)
    return Branch(**{
        **vars(branch),
        "stiffness": (factors[0] * branch.stiffness).tolist(),
        "damping": (factors[1] * branch.damping).tolist(),
    })  # fmt: skip
