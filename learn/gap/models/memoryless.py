"""What a model leaves of measured torques, against any function of a joint's angle and rate."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BSpline

from ....sim.base.types import Array
from ...cases.case import JointCase
from ...replay.equation_error import fits_torque
from .fitted import FittedModels, Model

#: Share of what a model leaves of torques that is too much for a name if a free function of angle and rate predicts it:
#: 0.04 of what friction leaves of a real arm's, 0.2 to 0.33 where friction grows with the load, 0.6 to 0.8 where a seal
#: rubs in one place of the turn.
MEMORYLESS = 0.4
#: Reduced chi-squared up to which residuals of torques pass for noise. Of fifty joints without an effect, fitted by
#: torques, 49 left 0.65 to 1.48: errors of the measured motion come on top of the noise of the efforts.
QUIET_TORQUE = 1.5
#: Splines over the angle and over the rate, their degree, stretches of a recording of which one is left out at a time,
#: and weights of the ridge, in units of the noise, of which the best is taken.
OVER_ANGLE, OVER_RATE, DEGREE, STRETCHES, RIDGES = 10, 8, 3, 8, (0.3, 3.0, 30.0, 300.0)
#: Numbers of splines of functions of the angle alone, as fine as the bumps of teeth and poles.
FINE = (30, 60, 120)
#: Least decrease of chi-squared, over the reduced one, by a function of the angle on stretches left out that is told.
#: Noise and errors of the measured motion gave 6 at most in 27 cases without an effect, cogging within the noise 37.
CLEAR = 20.0


def memoryless_share(fitted: FittedModels, model: Model) -> float:
    """Return the share of what a model leaves beyond noise that a function of a joint's angle and rate predicts.

    The function is free, so it says what no law of the registry does: friction in one place of the turn or that grows
    with the load, cogging, a torque that saturates. It is a tensor product of cubic B-splines with a ridge (Eilers &
    Marx 1996, Statist. Sci. 11:89, without their difference penalty), fitted to each driven joint, and predicts
    stretches of the recordings that it was not fitted to. Zero where nothing beyond noise is left.
    """
    excess = model.chi2 - fitted.contest.num_samples
    if excess <= 0.0:
        return 0.0
    gained = (float((y**2).sum()) - _left_out(_splines(q, w), y, fold) for q, w, y, fold in _joints(fitted, model))
    return sum(gained) / excess


def beyond_angle(fitted: FittedModels, model: Model) -> float:
    """Return the share that a model explains of what no function of a joint's angle does, beyond noise.

    The least over functions of three finenesses, predicted as in `memoryless_share`. Cogging and worn teeth push back
    and forth as they come by, and friction in their place takes the mean of that; friction itself is against the
    motion either way, which no function of the angle is.
    """
    samples = fitted.contest.num_samples
    both = [_joints(fitted, m) for m in (fitted.base, model)]
    found = []
    for count in FINE:
        base, own = (sum(_without_angle(*j, count) for j in joints) - samples for joints in both)
        found.append(1.0 - own / base if base > 0.0 else 0.0)
    return min(found)


def _without_angle(angle: Array, rate: Array, y: Array, fold: Array, count: int) -> float:
    """Return the squares of residuals that a function of the angle of so many splines leaves on stretches left out."""
    return _left_out(_basis(angle, count), y, fold)


def of_the_angle(fitted: FittedModels, model: Model) -> float:
    """Return by how much a function of a joint's angle lowers the chi-squared that a model leaves, or 0.

    The most over the finenesses, on stretches left out; 0 for replays and where that may be chance (`CLEAR`). So
    cogging is seen that leaves no more than errors of the measured motion do.
    """
    if not fits_torque(fitted.contest.case):
        return 0.0
    joints = _joints(fitted, model)
    gain = model.chi2 - min(sum(_without_angle(*j, count) for j in joints) for count in (OVER_ANGLE, *FINE))
    return gain if gain >= CLEAR * max(1.0, fitted.reduced_chi2(model)) else 0.0


def left_without_memory(fitted: FittedModels, model: Model) -> float:
    """Return the share of what a model leaves of torques that is a function of angle and rate; 0 where that is little.

    Little is left, or `MEMORYLESS` of it is not reached, and no function of the angle alone stands out.
    """
    if not fits_torque(fitted.contest.case):
        return 0.0
    if fitted.reduced_chi2(model) > QUIET_TORQUE and (share := memoryless_share(fitted, model)) >= MEMORYLESS:
        return share
    return min(1.0, of_the_angle(fitted, model) / max(1.0, model.chi2 - fitted.contest.num_samples))


def without_memory(share: float) -> tuple[str, ...]:
    """Return in words that what a model leaves of torques is in large part a function of angle and rate, if it is."""
    if share == 0.0:
        return ()
    return (f"{share:.0%} of the torques left beyond noise is a function of the joint's angle and rate alone: a"
            " law without memory that the registry does not have, such as friction in one place of the turn or by the"
            " weight carried there, cogging or a limit of the drive; motion.png shows its form.",)  # fmt: skip


def _joints(fitted: FittedModels, model: Model) -> list[tuple[Array, Array, Array, Array]]:
    """Return for each driven joint angle, rate and whitened residuals, and the stretch of each sample, each [N]."""
    contest = fitted.contest
    case, runs = contest.case, contest.recordings
    assert isinstance(case, JointCase)
    left = contest.residual(model.fit.batch)[0].cpu().numpy()
    names, lengths = [joint.name for joint in case.joints], [len(r.t) for r in runs]
    fold = np.concatenate([k * STRETCHES + np.arange(n) * STRETCHES // n for k, n in enumerate(lengths)])
    out = []
    for c, item in enumerate(case.inputs):
        j = 3 * names.index(item.joint)
        angle, rate = (np.concatenate([r.input[:, j + d] for r in runs]) for d in (0, 1))
        out.append((angle, rate, np.concatenate([left[k, :n, c] for k, n in enumerate(lengths)]), fold))
    return out


def _splines(angle: Array, rate: Array) -> Array:
    """Return the tensor product of splines; those of the rate are as much finer about zero as its root is steeper."""
    over_angle, over_rate = _basis(angle, OVER_ANGLE), _basis(np.sign(rate) * np.sqrt(np.abs(rate)), OVER_RATE)
    product: Array = (over_angle[:, :, None] * over_rate[:, None]).reshape(len(angle), -1)
    return product


def _basis(x: Array, count: int) -> Array:
    low, high = np.quantile(x, (0.002, 0.998))
    u = np.clip((x - low) / max(high - low, 1e-300), 0.0, 1.0)
    knots = np.concatenate([np.zeros(DEGREE), np.linspace(0.0, 1.0, count - DEGREE + 1), np.ones(DEGREE)])
    basis: Array = BSpline.design_matrix(u, knots, DEGREE).toarray()
    return basis


def _left_out(x: Array, y: Array, fold: Array) -> float:
    """Return the sum of squares that is left on stretches which were left out, with the best ridge; or all of it."""
    left = np.zeros(len(RIDGES))
    for k in np.unique(fold):
        own = fold == k
        inner, outer = x[~own], x[own]
        gram, moment = inner.T @ inner, inner.T @ y[~own]
        for i, ridge in enumerate(RIDGES):
            weights = np.linalg.solve(gram + ridge * np.eye(x.shape[1]), moment)
            left[i] += float(((y[own] - outer @ weights) ** 2).sum())
    return float(min(left.min(), (y**2).sum()))
