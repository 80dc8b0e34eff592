"""Initial guess of joints' unknowns by least squares on derivatives of the measured motion."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...sim.base.types import Array
from ..cases.case import JointCase
from ..cases.joints import JointSpec

#: Samples and order of the local polynomials that give the derivatives.
WINDOW, ORDER = 7, 4


def guess_joint(case: JointCase, joint: JointSpec) -> dict[str, float]:
    """Return guesses of a joint's unknowns by name, without those that the data do not determine.

    Non-negative least squares of

        m q'' + d q' + k q + A cos(zero) sin q - A sin(zero) cos q = effort,

    over all recordings in which the joint's position is measured; derivatives from local polynomials (Savitzky and
    Golay 1964). They are too soft for motion of fewer than some ten samples a period, and noise makes them worse: a
    start for a search, no estimate.
    """
    from scipy.optimize import nnls  # here, since scipy takes long to import and branches need none

    rows = list(_rows(case, joint))
    if not rows:
        return {}
    columns, right = (np.concatenate(x) for x in zip(*rows, strict=True))
    gravity = joint.gravity_torque
    turned = gravity is not None and gravity.zero_angle is None  # both parts of the torque are free, of either sign
    size = None if turned else gravity.amplitude if gravity else 0.0
    known = (joint.inertia, joint.damping, joint.stiffness, size, *([None if turned else 0.0] * 3))
    names = ("inertia", "damping", "stiffness", "gravity", "back", "left", "right")
    free = [c for c, value in enumerate(known) if value is None]
    for c, value in enumerate(known):
        right = right - (value or 0.0) * columns[:, c]
    scale = np.linalg.norm(columns[:, free], axis=0)
    if not free or not np.all(scale > 0.0):
        return {}
    found = dict(zip([names[c] for c in free], nnls(columns[:, free] / scale, right)[0] / scale, strict=True))
    if turned:
        along, across = found.pop("gravity") - found.pop("back"), found.pop("left") - found.pop("right")
        found |= {"gravity": np.hypot(along, across)}
        zero = {"zero": float(np.arctan2(across, along))} if found["gravity"] > 0.0 else {}
        return {n: float(v) for n, v in found.items() if v > 0.0} | zero
    return {name: float(v) for name, v in found.items() if v > 0.0}


def _rows(case: JointCase, joint: JointSpec) -> Iterator[tuple[Array, Array]]:
    """Yield what acts and the effort of every recording, without the ends of the polynomials.

    What acts is q'', q', q, sin(q - zero) and its opposite, -cos(q - zero) and its opposite; zero is 0 where unknown.
    """
    from scipy.signal import savgol_filter

    channel = [c for c, o in enumerate(case.outputs) if (o.joint, o.quantity) == (joint.name, "position")]
    driven = [i for i, item in enumerate(case.inputs) if item.joint == joint.name]
    zero = (joint.gravity_torque.zero_angle or 0.0) if joint.gravity_torque else 0.0
    inside = slice(WINDOW // 2, -(WINDOW // 2))
    for t in case.trajectories:
        if not channel or len(t.t) < 4 * WINDOW:
            continue
        y = t.output[:, channel[0]]
        q, v, a = (savgol_filter(y, WINDOW, ORDER, deriv=d, delta=case.dt)[inside] for d in range(3))
        effort = t.effort[inside, driven[0]] if driven else np.zeros_like(q)
        sine, cosine = np.sin(q - zero), np.cos(q - zero)
        yield np.column_stack([a, v, q, sine, -sine, -cosine, cosine]), effort
