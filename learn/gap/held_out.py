"""The gap in recordings that neither model was fitted to, before and after the repair."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from ..inference.identify import split
from ..inference.predict import START_WINDOW, first_moments, main_channels
from ..inference.report import unit_of
from .decide import Decision
from .diagnosis import Gap
from .models.contest import Contest, Rows
from .models.refit import fit
from .prepare import Base

#: Steps of a refit to the training trajectories, and of one of the start states alone.
TRAIN, START = 8, 5
#: Deviation that holds a parameter where it is.
FIXED = 1e-7


def held_out_gap(base: Base, decision: Decision) -> Gap:
    """Refit base and final model to the training trajectories and return the rms misfit of the held-out ones.

    Segments do not bend, as in the model that is written and wherever that is simulated: springs and dampers that were
    fitted beside bending wood would be worse than the data allows, before more than after.
    """
    contest, case = base.contest.rigid(), base.contest.case
    train, test = split(case) if len(case.trajectories) > 1 else ([0], [0])
    rows = Rows.joined([decision.base.fit.rows, decision.final.fit.rows])
    rows.weight[:] = 0.0
    rows.weight[:, train] = 1.0
    fitted = fit(contest, rows, TRAIN).rows
    out = contest.simulate(contest.values(fitted), _held_start(contest, fitted))
    main = list(main_channels(case))
    misfit = [_rmse(contest, own, test, main) for own in out]
    floor = float(np.sqrt(np.mean(base.noise.sigma[main] ** 2)))
    return Gap(misfit[0], misfit[1], floor, unit_of(case), tuple(test))


def _held_start(contest: Contest, fitted: Rows) -> torch.Tensor:
    """Return the start states [S, R, J, 2] that the first moments of each recording show, parameters fixed."""
    if not fitted.start.numel():
        return fitted.start
    cut = [first_moments(r, START_WINDOW) for r in contest.recordings]
    short = Contest(contest.case, cut, contest.sigma.cpu().numpy(), contest.names, device=contest.device)
    outs = []
    for s in range(len(fitted)):
        short.centre, short.spread = fitted.free[s], torch.full_like(short.spread, FIXED)
        row = fitted[slice(s, s + 1)]
        own = Rows(row.free, row.active, short.start0[None].clone(), torch.ones_like(row.weight))
        outs.append(fit(short, own, START).rows.start)
    return torch.cat(outs)


def _rmse(contest: Contest, output: torch.Tensor, test: Sequence[int], main: list[int]) -> float:
    parts = []
    for j in test:
        n = len(contest.recordings[j].t)
        parts.append((contest.measured[j, :n] - output[j, :n].double())[:, main].flatten())
    return float(torch.cat(parts).pow(2).mean().sqrt())
