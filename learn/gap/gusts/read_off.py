"""Gusts of any course read off recordings, and whether they are there: what a branch that sways untouched lacks.

The course is read off every recording, also off those held out: nobody foretells a gust. What it must bear out besides
is that it explains what is missing in every part of a recording, before the gripper closes, while it holds and after it
opened, and that it blows on: a branch that was still swinging when a recording began has a course that ends there. Nor
does a wind wait for a gripper: springs that drift from recording to recording have a course that is there while they
are bent.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from ....sim.base.types import Array
from ..models.contest import Batch, Contest, activated
from ..models.fitted import FURTHER
from ..models.refit import Fits, fit
from .answers import GUST, acting_along
from .course import Gusts, Process, rms_of
from .sway import differs, untouched

#: Steps of the fits beside a course, and how often the course is read off again about them.
STEPS, AGAIN = 6, 2
#: Share of the excess that gusts must explain, of all and in each part of the recordings.
EXPLAINED, IN_EACH = 0.95, 0.87
#: Reduced chi-squared of the base in a part of the recordings above which gusts must explain it.
MORE = 1.5
#: Least share of what gusts explain that those explain which blow once the gripper has closed.
BLOWS_ON = 0.3
#: Least mean square of what blows while the gripper is open over that while it is closed. Springs that drift gave 0.10,
#: gusts of two blind cases 0.97 and 2.4; of few recordings a fair one may give half.
BLOWS_OPEN = 0.25
#: Decimals of a course in units of its rms, as it is written.
DECIMALS = 4


def gusts_in(contest: Contest, plain: Fits) -> tuple[Contest, Fits] | None:
    """Return a contest along the gusts that were read off, and base and gusts fitted to it; None if there are none.

    Args:
        contest: Of a branch, with the noise that the data alone show: a search takes gusts for noise.
        plain: Its base model fitted, a batch of one.
    """
    if not differs(contest, contest.residual(plain.batch)[0]):
        return None
    gusts = Process(contest, plain.batch).fit()
    if gusts.deviance > float(plain.chi2[0]) - FURTHER:
        return None
    own, fits = read_off(contest, plain, gusts)
    return (own, fits) if explains(own, fits) and blows_on(own, fits) and blows_open(own) else None


def read_off(contest: Contest, plain: Fits, gusts: Gusts) -> tuple[Contest, Fits]:
    """Return a contest of recordings with their courses, and base and gusts fitted to it.

    The course is read off again about the motion with the first one: a branch that is blown far is not linear.
    """
    own, fits = _fitted(contest, plain, gusts)
    for _ in range(AGAIN):
        again = Process(own, fits.one(1).batch, gusts.pressure).given(gusts.process)
        other, better = _fitted(contest, plain, again)
        if better.chi2[1] >= fits.chi2[1]:
            break
        own, fits, gusts = other, better, again
    return own, fits


def _fitted(contest: Contest, plain: Fits, gusts: Gusts) -> tuple[Contest, Fits]:
    """Return a contest of recordings with the course of gusts, and the base and the model with gusts fitted to it."""
    courses = [k.course(p, r) for k, p, r in zip(gusts.knots, gusts.pressure, contest.recordings, strict=True)]
    size = rms_of(courses)
    own = _along(contest, [np.round(c / size, DECIMALS) for c in courses])
    base, count = own.base_batch(1), own.num_base
    base.free[0, :count] = plain.batch.free[0, :count]
    with_gusts = activated(own, own.base_batch(1), [(0,)])
    with_gusts.free[0, :count] = gusts.free.clamp(own.low[:count], own.high[:count])
    with_gusts.free[0, own.candidates[0].columns[0]] = size
    return own, fit(own, Batch.joined([base, with_gusts]), STEPS)


def _along(contest: Contest, courses: Sequence[Array]) -> Contest:
    """Return a contest of the same recordings with courses, in which gusts along these act or nothing does."""
    blown = [replace(r, course=c, sways=True) for r, c in zip(contest.recordings, courses, strict=True)]
    sigma = contest.sigma.cpu().numpy()
    out = Contest(contest.case, blown, sigma, (GUST,), effects=(acting_along(),), device=contest.device)
    out.colour, out.nuisance, out.data_sigma = contest.colour, contest.nuisance, contest.data_sigma
    return out


def blows_on(contest: Contest, fits: Fits) -> bool:
    """Return whether gusts explain less if they end as a gripper closes: what does not was a swing that lasted."""
    ended = []
    for r in contest.recordings:
        assert r.course is not None
        course = r.course.copy()
        course[len(course) - len(r.t) + untouched(r) :] = 0.0
        ended.append(course)
    residual = _along(contest, ended).residual(fits.one(1).batch)
    without, plain, left = float((residual**2).sum()), *fits.chi2.tolist()
    return without - left > BLOWS_ON * (plain - left)


def blows_open(contest: Contest) -> bool:
    """Return whether a course blows while the gripper is open about as hard, about its mean, as while it is closed."""
    blown, held = [], np.concatenate([r.contact for r in contest.recordings])
    for r in contest.recordings:
        assert r.course is not None
        blown.append(r.course[len(r.course) - len(r.t) :])
    every = np.concatenate(blown)
    squares = ((every - every.mean(0)) ** 2).sum(1)
    if held.all() or not held.any():
        return True
    return bool(squares[~held].mean() > BLOWS_OPEN * squares[held].mean())


def explains(contest: Contest, fits: Fits) -> bool:
    """Return whether gusts explain what the base leaves: of all recordings, and of each part of them."""
    squares = contest.residual(fits.batch) ** 2
    parts = [torch.stack([_of_part(contest, own, k) for own in squares]) for k in range(3)]
    every = torch.stack(parts).sum(0)
    shares = [_share(own) for own in parts if own[0, 0] > MORE * own[0, 1]]
    return _share(every) > EXPLAINED and min(shares, default=1.0) > IN_EACH


def _share(own: torch.Tensor) -> float:
    """Return the share that the second of two models explains of what the first leaves: sums and counts, [2, 2]."""
    excess = own[:, 0] - own[:, 1]
    return float((excess[0] - excess[1]) / excess[0])


def _of_part(contest: Contest, squares: torch.Tensor, part: int) -> torch.Tensor:
    """Return sum and count of squares [R, T, C] before the gripper closes, while it may hold, or after: 0, 1, 2."""
    found = []
    for j, r in enumerate(contest.recordings):
        held = np.flatnonzero(r.contact)
        ends = (0, untouched(r), int(held[-1]) + 1 if len(held) else len(r.t), len(r.t))
        found.append(squares[j, ends[part] : ends[part + 1]].flatten())
    every = torch.cat(found)
    return torch.stack([every.sum(), every.new_tensor(float(len(every)))])
