"""Held-out RMSE of the base and the repaired model."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from ..inference.identify import split
from ..inference.predict import START_WINDOW, first_moments, main_channels
from ..inference.report import unit_of
from .decide import Decision
from .diagnosis import Gap
from .models.contest import Batch, Contest
from .models.refit import fit
from .prepare import Base

#: Steps of a refit to the training trajectories, and of one of the start states alone.
TRAIN, START = 8, 5
#: Prior standard deviation that fixes a parameter.
FIXED = 1e-7


def held_out_gap(base: Base, decision: Decision) -> Gap:
    """Refit base and repaired model to the training trajectories and return their RMSE on the held-out ones.

    Segments are rigid here, as in the model file and in every simulation of it. Springs and dampers fitted beside
    bending wood would have a larger RMSE in such a simulation, the base model more than the repaired one.
    """
    contest, case = base.contest.rigid(), base.contest.case
    train, test = split(case) if len(case.trajectories) > 1 else ([0], [0])
    batch = Batch.joined([decision.base.fit.batch, decision.final.fit.batch])
    batch.weight[:] = 0.0
    batch.weight[:, train] = 1.0
    fitted = fit(contest, batch, TRAIN).batch
    out = contest.simulate(contest.values(fitted), _held_start(contest, fitted))
    main = list(main_channels(case))
    misfit = [_rmse(contest, own, test, main) for own in out]
    floor = float(np.sqrt(np.mean(base.noise.sigma[main] ** 2)))
    return Gap(misfit[0], misfit[1], floor, unit_of(case), tuple(test))


def _held_start(contest: Contest, fitted: Batch) -> torch.Tensor:
    """Return start states [S, R, J, 2] fitted to the first moments of each recording with fixed parameters."""
    if not fitted.start.numel():
        return fitted.start
    cut = [first_moments(r, START_WINDOW) for r in contest.recordings]
    short = Contest(contest.case, cut, contest.sigma.cpu().numpy(), contest.names, device=contest.device)
    outs = []
    for s in range(len(fitted)):
        short.centre, short.spread = fitted.free[s], torch.full_like(short.spread, FIXED)
        model = fitted[slice(s, s + 1)]
        own = Batch(model.free, model.active, short.start0[None].clone(), torch.ones_like(model.weight))
        outs.append(fit(short, own, START).batch.start)
    return torch.cat(outs)


def _rmse(contest: Contest, output: torch.Tensor, test: Sequence[int], main: list[int]) -> float:
    parts = []
    for j in test:
        n = len(contest.recordings[j].t)
        parts.append((contest.measured[j, :n] - output[j, :n].double())[:, main].flatten())
    return float(torch.cat(parts).pow(2).mean().sqrt())
