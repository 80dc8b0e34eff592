"""A recording as a motion on a report's page: what was measured, and what models make of it.

Models miss by millimetres on a branch of a metre. So that an eye sees it, what each model misses is drawn larger, by a
factor that the caption names; the measured motion of a branch is drawn as it was.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ...sim.base.rotation import quat_rotate
from ...sim.base.types import Array
from ..cases.case import BranchCase, BranchTrajectory, JointCase
from ..reports.figures import MEASURED
from ..reports.motion import MotionLine, ReportMotion
from .bend import bent
from .recording import Recording

#: Size of the larger miss in the picture, relative to the motion, that is sought, and the factors to reach it.
SEEN, FACTORS = 0.2, (1, 2, 5, 10, 20, 50, 100)
#: Largest turn of a joint in the picture [rad], and distance of the joints' pivots, lengths of a needle.
TURN, APART = 0.8, 2.5
TITLE = "The motion, before and after"

Models = Mapping[str, tuple[str, Array]]


def case_motion(case: BranchCase | JointCase, j: int, recording: Recording, models: Models) -> ReportMotion | None:
    """Return recording ``j`` as a motion; None where joints are compared by torques or rates alone.

    Args:
        case: The case.
        j: Index of the trajectory.
        recording: It, as it was fitted, T samples.
        models: By the name of each model its colour as ``#rrggbb`` and its channels, shape [T, C].
    """
    columns = _positions(case) if isinstance(case, JointCase) else [0, 1, 2]
    if not columns:
        return None
    measured = recording.output[:, columns]
    missed = {name: out[: len(measured), columns] - measured for name, (_, out) in models.items()}
    factor = _factor(list(missed.values()), measured)
    drawn = {name: (models[name][0], measured + factor * off) for name, off in missed.items()}
    drawn["measured"] = (MEASURED, measured)
    if isinstance(case, BranchCase):
        lines, how = _branch(case, case.trajectories[j], drawn, measured)
    else:
        lines, how = _needles(drawn, measured)
    larger = "" if factor == 1 else f" What a model misses is drawn {factor} times as large as it is."
    caption = f"Recording {j + 1}, {case.trajectories[j].file}. {how}{larger}"
    return ReportMotion(TITLE, caption, recording.t, lines)


def _positions(case: JointCase) -> list[int]:
    """Return the channels that are positions of joints."""
    return [] if case.fit == "torque" else [c for c, o in enumerate(case.channels) if o.quantity == "position"]


def _factor(missed: Sequence[Array], measured: Array) -> int:
    """Return by how much the misses are drawn larger: the least factor at which the larger is plain to see, or 100."""
    motion = float(np.sqrt(np.mean((measured - measured.mean(axis=0)) ** 2)))
    worst = max(float(np.sqrt(np.mean(x**2))) for x in missed)
    return next((f for f in FACTORS if f * worst >= SEEN * motion), FACTORS[-1]) if worst > 0.0 else 1


def _branch(
    case: BranchCase, trajectory: BranchTrajectory, drawn: Models, measured: Array
) -> tuple[list[MotionLine], str]:
    _, vector = np.linalg.eigh(measured[:, :2].T @ measured[:, :2])
    side = vector[:, -1] * (1.0 if vector[np.abs(vector[:, -1]).argmax(), -1] > 0.0 else -1.0)
    lines = [MotionLine(name, colour, _shape(case, trajectory, moved, side)) for name, (colour, moved) in drawn.items()]
    return lines, (
        "Seen along the level direction across its largest motion. Only the held point, the dot, is measured and "
        "compared; each line is the least bending that takes it there."
    )


def _shape(case: BranchCase, trajectory: BranchTrajectory, moved: Array, side: Array) -> Array:
    """Return the segments' lower ends and the held point as seen from the side, [T, P, 2] in m."""
    held, point = trajectory.grasp
    position, rotation = bent(case, trajectory.grasp, moved, np.ones(case.num_segments))
    at = position[:, held] + quat_rotate(rotation[:, held], np.broadcast_to(point, moved.shape))
    points = np.concatenate([position[:, : held + 1], at[:, None]], axis=1)
    return np.stack([points[..., :2] @ side, points[..., 2]], axis=-1)


def _needles(drawn: Models, measured: Array) -> tuple[list[MotionLine], str]:
    """Return a needle per joint and model, side by side, hanging down at the middle of what was measured."""
    middle = 0.5 * (measured.max(axis=0) + measured.min(axis=0))
    largest = np.maximum(np.abs(measured - middle).max(axis=0), 1e-300)
    lines = []
    for name, (colour, position) in drawn.items():
        turn = TURN * (position - middle) / largest
        pivot = APART * np.arange(turn.shape[1])
        tip = np.stack([pivot + np.sin(turn), -np.cos(turn)], axis=-1)
        foot = np.stack([np.broadcast_to(pivot, turn.shape), np.zeros_like(turn)], axis=-1)
        lines += [MotionLine(name, colour, np.stack([foot[:, c], tip[:, c]], axis=1)) for c in range(len(pivot))]
    return lines, "A needle for each position, all as wide as they fit; it hangs down in the middle of the motion."
