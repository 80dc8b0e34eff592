"""Is the misfit of the base model more than noise? The best of all candidates against a parametric bootstrap."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from scipy.special import gammaln
from scipy.stats import chi2

from ...sim.base.types import Array
from ..cases.case import BranchCase, JointCase
from ..inference.correlated import Correlation, correlation, drawn_as
from ..replay.rollout import Rollout
from .models.contest import Batch, Contest
from .models.fitted import FittedModels, Model, overdispersion
from .models.levels import scan_candidates
from .models.scan import Basis, Scan
from .prepare import Base
from .run import Run

#: Family-wise p-value above which no effect is claimed to be missing.
ALARM = 0.01
#: Excess of the base model's reduced chi-squared over one above which an effect is missing even if no candidate
#: explains it: the noise estimate is never so wrong. That of a branch is mended by what its best model leaves; bases of
#: nine branches without an effect, noise of 1 to 5 %, left 0.93 to 1.03 before.
LACK, LACK_BRANCH = 1.0, 0.4
#: Bootstrap experiments simulated under the base model.
NULLS = 48


@dataclass(frozen=True)
class Evidence:
    """Scan of all candidates beside the base model, and its significance.

    Attributes:
        basis: Span of the base model's own parameters.
        scan: Gains of all candidates for the measured residual and for the bootstrap residuals.
        p_value: Family-wise p-value of the best candidate under the base model.
    """

    basis: Basis
    scan: Scan
    p_value: float


def bootstrap_test(base: Base, run: Run, seen: Correlation | None = None) -> Evidence:
    """Scan all candidates beside the base model and test the best against a parametric bootstrap.

    ``seen`` is the correlation that the noise of a branch is drawn with; white if not given.
    """
    with run.timed("scan"):
        basis, scan = scan_candidates(base.contest, base.fit, nulls(base, run.settings.seed, seen))
        run.progress("scan", 1)
        left = float(base.fit.chi2[0] - scan.gain[0].max())
        return Evidence(basis, scan, family_wise(scan, overdispersion(base.contest, left)))


def lacks_fit(fitted: FittedModels, least: float) -> bool:
    """Return whether the base's reduced chi-squared exceeds 1 + `lack_of` and its excess rms exceeds ``least``."""
    excess = fitted.reduced_chi2(fitted.base) - 1.0
    return excess > lack_of(fitted.contest.case) and float(np.sqrt(excess)) > least


def lack_of(case: BranchCase | JointCase) -> float:
    """Return the excess of a base's reduced chi-squared over one that no noise makes.

    Of branches it is less: what a missing effect leaves is as correlated as noise with a memory, beside which its gain
    is not rare.
    """
    return LACK_BRANCH if isinstance(case, BranchCase) else LACK


def retested(base: Base, model: Model, evidence: Evidence, run: Run) -> Evidence:
    """Return the evidence beside noise that is as correlated as what the best model of a branch leaves.

    Sums of correlated noise scatter more than sums of white noise, so that the same gain is less rare. What the base
    model leaves would not do: an effect that it lacks is correlated as well.
    """
    contest = base.contest
    if not isinstance(contest.case, BranchCase):
        return evidence
    weight = model.fit.batch.weight
    left = contest.residual(model.fit.batch).flatten(1) - contest.nuisance.change(model.fit.nuisance, weight)
    used = int(model.fit.batch.active.sum()) + len(contest.nuisance)
    seen = correlation(left.view_as(contest.measured), [len(r.t) for r in contest.recordings], used)
    return evidence if seen.white else bootstrap_test(base, run, seen)


def nulls(base: Base, seed: int, seen: Correlation | None = None) -> torch.Tensor:
    """Return whitened residuals of a parametric bootstrap under the base model, shape [NULLS, N].

    The base model driven by the recorded force is the truth; noise is added to motion and force, and the base model is
    then driven by the noisy force. Geometry, mountings and wood are drawn from their priors; what is as far off as it
    can be is in the truth.
    """
    contest, force_sigma = base.contest, base.force_sigma
    generator = np.random.default_rng(seed)
    change = torch.as_tensor(base.noise.draw(generator, (NULLS, *contest.measured.shape)), device=contest.place)
    if isinstance(contest.case, BranchCase) and force_sigma is not None and float(force_sigma.max()) > 0.0:
        change = change - _force_response(contest, base.fit.batch, force_sigma, generator)
    white = contest.whiten(change)
    noise = white if seen is None else drawn_as(seen, white)
    own = contest.nuisance
    away = torch.as_tensor(generator.standard_normal((NULLS, len(own))), device=contest.place)
    return noise.flatten(1) + torch.where(own.held(base.fit.nuisance), 0.0, away) @ own.flat


def _force_response(contest: Contest, model: Batch, force_sigma: Array, generator: np.random.Generator) -> torch.Tensor:
    """Response of the motion [NULLS, R, T, C] to noise of the force, which is zero where the gripper is open."""
    noisy = list(contest.recordings)
    for _ in range(NULLS):
        for r in contest.recordings:
            noise = generator.standard_normal(r.input.shape) * force_sigma * r.contact[:, None]
            noisy.append(replace(r, input=r.input + noise))
    values = contest.values(model)[:, : contest.num_base]
    out = Rollout(contest.case, noisy, 1, device=contest.device)(values)[0].double()
    count = len(contest.recordings)
    return out[count:].unflatten(0, (NULLS, count)) - out[:count]


def family_wise(scan: Scan, overdispersion: float) -> float:
    """Return the family-wise p-value of the best candidate under the base model.

    Each probe's gain over q columns gives a chi-squared tail probability. The smallest over all probes is compared with
    the smallest in each bootstrap experiment; beyond the resolution of so few experiments, a Gumbel distribution fitted
    to them extrapolates.
    """
    freedom = np.array([max(1, len(p.moved)) for p in scan.probes])
    gain = scan.gain.cpu().numpy()
    rare = -log_tail(gain, freedom)
    rare[0] = -log_tail(gain[0] / overdispersion, freedom) - np.log(scan.compared)
    best, null = float(rare[0].max()), rare[1:].max(axis=1)
    scale = max(float(null.std()) * np.sqrt(6.0) / np.pi, 1e-3)
    place = float(null.mean()) - 0.5772 * scale
    tail = float(-np.expm1(-np.exp(-(best - place) / scale)))
    counted = (1.0 + float((null >= best).sum())) / (len(null) + 1.0)
    return tail if counted <= 2.0 / (len(null) + 1.0) else counted


def log_tail(x: Array, freedom: Array) -> Array:
    """Return the log probability that chi-squared of some degrees of freedom exceeds x, where it underflows as well.

    There by four terms of the asymptotic series of the incomplete gamma function (DLMF 8.11.2): below 1e-300 they are
    off by less than 1e-8 of a probability of up to twelve degrees of freedom.
    """
    half, a = np.maximum(0.5 * x, 1.0), 0.5 * freedom
    terms = np.cumprod([np.ones_like(half), *((a - k) / half for k in (1, 2, 3))], axis=0)
    far = -half + (a - 1.0) * np.log(half) - gammaln(a) + np.log(np.maximum(terms.sum(axis=0), 1e-300))
    near = chi2.sf(x, freedom)
    return np.where(near > 1e-300, np.log(np.maximum(near, 1e-300)), far)
