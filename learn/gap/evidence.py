"""Is the misfit of the base model more than noise? The best of all candidates against a parametric bootstrap."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.stats import chi2

from ...sim.base.types import Array
from ..cases.case import BranchCase
from ..replay.rollout import Rollout
from .models.contest import Contest, Rows
from .models.field import Field, overdispersion
from .models.levels import first_look
from .models.scan import Basis, Scan
from .prepare import Base
from .run import Run

#: Family-wise p-value above which nothing is said to be missing.
ALARM = 0.01
#: Excess of the base's reduced chi-squared over one above which something is missing even where no candidate explains
#: any of it: no estimate of the noise is so wrong.
LACK = 1.0
#: Experiments that are simulated under the base model.
NULLS = 48


@dataclass(frozen=True)
class Evidence:
    """What a scan of all candidates beside the base model says.

    Attributes:
        basis: What the base model can explain by itself.
        scan: Gains of all candidates, measured and under the null hypothesis.
        p_value: Family-wise p-value of the best candidate under the base model.
    """

    basis: Basis
    scan: Scan
    p_value: float


def weigh(base: Base, run: Run) -> Evidence:
    """Scan all candidates beside the base model, and compare the best with the best in simulated experiments."""
    with run.timed("scan"):
        basis, scan = first_look(base.contest, base.fit, nulls(base, run.settings.seed))
        run.progress("looking", 1)
        left = float(base.fit.chi2[0] - scan.gain[0].max())
        return Evidence(basis, scan, family_wise(scan, overdispersion(base.contest, left)))


def lacks_fit(field: Field, least: float) -> bool:
    """Return whether the base model leaves far more than noise, and an rms of more than ``least`` noise deviations."""
    excess = field.reduced_chi2(field.base) - 1.0
    return excess > LACK and float(np.sqrt(excess)) > least


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
