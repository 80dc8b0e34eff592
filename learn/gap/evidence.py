"""Is the misfit more than noise, and which rivals hold where they were not fitted?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch
from scipy.stats import chi2

from ...sim.base.types import Array
from ..cases.case import BranchCase
from ..replay.rollout import Rollout
from .contest import Contest, Rows
from .refit import Fits, fit
from .scan import Scan
from .setup import Base

#: Simulated nulls, and steps of a refit without one profile.
NULLS, REFIT = 48, 4


def nulls(base: Base, seed: int) -> torch.Tensor:
    """Return whitened residuals of experiments in which nothing is missing, shape [NULLS, N].

    Parametric bootstrap: the base model is the truth, driven by the recorded force; sensors of force and motion add
    their noise, and the base model is driven by what the force's sensor then reads.
    """
    contest, force_sigma = base.contest, base.force_sigma
    generator = np.random.default_rng(seed)
    change = torch.as_tensor(base.noise.draw(generator, (NULLS, *contest.measured.shape)), device=contest.place)
    if isinstance(contest.case, BranchCase) and force_sigma is not None and float(force_sigma.max()) > 0.0:
        change = change - _felt(contest, base.fit.rows, force_sigma, generator)
    return contest.whiten(change).flatten(1)


def _felt(contest: Contest, row: Rows, force_sigma: Array, generator: np.random.Generator) -> torch.Tensor:
    """Change of the motion [NULLS, R, T, C] by noise of the force, none where the gripper is open."""
    noisy = list(contest.recordings)
    for _ in range(NULLS):
        for r in contest.recordings:
            noise = generator.standard_normal(r.input.shape) * force_sigma * r.contact[:, None]
            noisy.append(replace(r, input=r.input + noise))
    values = contest.values(row)[:, : contest.num_base]
    out = Rollout(contest.case, noisy, 1, device=contest.device)(values)[0].double()
    count = len(contest.recordings)
    return out[count:].unflatten(0, (NULLS, count)) - out[:count]


def family_wise(scan: Scan, overdispersion: float) -> float:
    """Return the probability that the best of all candidates looks as good as it does when nothing is missing.

    A probe's gain over q columns is as rare as its chi-square tail says. The rarest of all probes is compared with the
    rarest in each null; beyond what so few nulls can count, a Gumbel distribution fitted to them goes on.
    """
    freedom = np.array([max(1, len(p.moved)) for p in scan.probes])
    rare = -chi2.logsf(scan.gain.cpu().numpy(), freedom)
    rare[0] = -chi2.logsf(scan.gain[0].cpu().numpy() / overdispersion, freedom) - np.log(scan.compared)
    best, null = float(rare[0].max()), rare[1:].max(axis=1)
    scale = max(float(null.std()) * np.sqrt(6.0) / np.pi, 1e-3)
    place = float(null.mean()) - 0.5772 * scale
    tail = float(-np.expm1(-np.exp(-(best - place) / scale)))
    counted = (1.0 + float((null >= best).sum())) / (len(null) + 1.0)
    return tail if counted <= 2.0 / (len(null) + 1.0) else counted


def profiles(contest: Contest) -> list[list[int]]:
    """Return groups of recordings that repeat one experiment."""
    groups: dict[int, list[int]] = {}
    for i, t in enumerate(contest.case.trajectories):
        groups.setdefault(i if t.replicate_of is None else t.replicate_of, []).append(i)
    return list(groups.values())


def left_out(contest: Contest, models: Sequence[Fits], groups: Sequence[Sequence[int]]) -> torch.Tensor:
    """Return the squares left in every profile by models [S] that were refitted without it, shape [S, G]."""
    rows = []
    for model in models:
        for group in groups:
            weight = model.rows.weight.clone()
            weight[:, list(group)] = 0.0
            rows.append(Rows(model.rows.free, model.rows.active, model.rows.start, weight))
    fitted = fit(contest, Rows.joined(rows), REFIT)
    full = Rows(fitted.rows.free, fitted.rows.active, fitted.rows.start, torch.ones_like(fitted.rows.weight))
    residual = contest.residual(full)
    if len(contest.nuisance):
        residual = residual - (fitted.nuisance @ contest.nuisance).view_as(residual)
    by_recording = (residual**2).sum((-1, -2)).view(len(models), len(groups), -1)
    return torch.stack([by_recording[:, g, list(group)].sum(-1) for g, group in enumerate(groups)], 1)
