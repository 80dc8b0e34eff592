"""Score tests of all candidate effects beside a fitted model, from one linearised simulation each.

The fitted model has the whitened residual r and the Jacobian J. A candidate adds columns C: changes of the simulation
when a parameter moves off its neutral value, or when the effect acts at a grid point. Its gain is the decrease of
|r|^2 when C is fitted together with J; under the model the gain is chi-squared distributed. One simulation per column
serves any number of residuals, including bootstrap ones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from .candidates import FURTHEST, Candidate, Probe, probes_of
from .contest import Batch, Contest
from .refit import Fits

#: Step off the neutral value, relative to the distance to the nearer end of the box.
REACH = 0.1
#: Change of the channels, in units of their noise, below which a probe does nothing.
NOTHING = 1e-3


@dataclass(frozen=True)
class Scan:
    """Gains of all probes for some residuals.

    Attributes:
        probes: Parameter points that were tested.
        gain: Decrease of chi-squared, shape [residuals, probes].
        strength: Fitted coefficients of each probe's columns for the first residual, tensors [q].
        compared: Number of probes that each was selected from (for multiple testing), length probes.
        absorbed: Change of the model's own parameters that imitates each probe at that strength, shape
            [probes, parameters]; once the effect is added they change by the opposite.
    """

    probes: list[Probe]
    gain: torch.Tensor
    strength: list[torch.Tensor]
    compared: list[int]
    absorbed: torch.Tensor

    def best(self, candidate: int, count: int) -> list[int]:
        """Return the probes of a candidate with the largest gain for the first residual, best first."""
        own = [k for k, p in enumerate(self.probes) if p.candidate == candidate]
        return sorted(own, key=lambda k: -float(self.gain[0, k]))[:count]


class Basis:
    """The span of a fitted model's own parameters: its whitened Jacobian with the priors.

    Attributes:
        fit: The model, a batch of one.
        residual: Whitened residual less the mean of the nuisance columns, and less those that are at their bounds and
            stay there, shape [N].
        columns: Indices of its free parameters, shape [q].
    """

    def __init__(self, contest: Contest, fit: Fits) -> None:
        self.fit = fit
        residual, derivative, columns = contest.linearise(fit.batch)
        self.columns, own = columns[0], derivative[0].flatten(1)
        at, nuisance = self.columns, contest.nuisance
        held = nuisance.held(fit.nuisance)[0]
        self.residual = residual[0].flatten() - torch.where(held, fit.nuisance[0], nuisance.mean) @ nuisance.flat
        loose = nuisance.flat[~held]
        prior = [contest.spread[at], own.new_full((len(own) - len(at),), 1e6), own.new_ones(len(loose))]
        self._jacobian = torch.cat([own, loose])
        precision = contest.overdispersion * torch.cat(prior) ** -2
        self._factor = torch.linalg.cholesky(self._jacobian @ self._jacobian.T + torch.diag(precision))

    def free_of(self, vectors: torch.Tensor) -> torch.Tensor:
        """Return vectors [V, N] minus their projection on the model's own span, M v.

        M is the inverse of the covariance of the noise, the nuisances and the model's parameters under their priors.
        """
        return self.split(vectors)[1]

    def split(self, vectors: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the coefficients [V, q + ...] of the projection of vectors [V, N], and what remains of them."""
        taken = torch.cholesky_solve(self._jacobian @ vectors.T, self._factor).T
        return taken, vectors - taken @ self._jacobian


def all_probes(contest: Contest, without: Sequence[int] = ()) -> list[Probe]:
    """Return the probes of all candidates but some."""
    out: list[Probe] = []
    for index, candidate in enumerate(contest.candidates):
        if index not in without:
            setting = contest.settings[candidate.acting.joint or 0]
            out += probes_of(index, candidate, [contest.parameters[c] for c in candidate.columns], setting)
    return out


def score_probes(contest: Contest, basis: Basis, probes: Sequence[Probe], residuals: torch.Tensor) -> Scan:
    """Test probes beside a fitted model for residuals [V, N]; the first is the measured one.

    Probes that change nothing are left out, such as those of springs' laws at a joint without a spring.
    """
    change, owner = _changes(contest, basis, probes)
    acts = change.abs().amax(1) > NOTHING
    imitated, beyond = basis.split(change)
    imitated = imitated[:, : len(basis.columns)]
    left = basis.free_of(residuals)
    kept = [k for k in range(len(probes)) if acts[owner == k].any()] or range(len(probes))
    gains, strength, absorbed = [], [], []
    for k in kept:
        own, apart = change[owner == k], beyond[owner == k]
        found, explained = _explained(own, apart, left, bounded=not probes[k].moved)
        gains.append(explained)
        strength.append(found[0])
        absorbed.append(found[0] @ imitated[owner == k])
    acting = [probes[k] for k in kept]
    return Scan(acting, torch.stack(gains, 1), strength, [1] * len(acting), torch.stack(absorbed))


def signatures(
    contest: Contest, basis: Basis, probes: Sequence[Probe]
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:  # fmt: skip
    """Return what columns of probes change [V, N], what the model cannot imitate of it, and whose each is [V]."""
    change, owner = _changes(contest, basis, probes)
    return change, basis.free_of(change), owner


def _changes(contest: Contest, basis: Basis, probes: Sequence[Probe]) -> tuple[torch.Tensor, torch.Tensor]:
    """Return whitened changes of the simulation [V, N] when probes act, and the probe of each [V]."""
    moved, owner = _moved_batch(contest, basis.fit.batch, probes)
    out = contest.simulate(contest.values(moved), moved.start)
    change = contest.whiten(out - contest.simulate(contest.values(basis.fit.batch), basis.fit.batch.start)).flatten(1)
    weight = basis.fit.batch.weight[0]
    return change * weight.repeat_interleave(change.shape[1] // len(weight)), owner


def _explained(
    columns: torch.Tensor, beyond: torch.Tensor, left: torch.Tensor, *, bounded: bool
) -> tuple[torch.Tensor, torch.Tensor]:
    """Coefficients [V, q] of columns C [q, N] fitted to residuals r [V, N], and the decrease of r M r [V].

    ``beyond`` and ``left`` are M C and M r, see `Basis.free_of`.
    """
    normal, pull = columns @ beyond.T, left @ columns.T
    size = normal.diagonal().clamp(min=1e-12)
    if bounded:  # the effect itself at some strength, which cannot become negative
        found = (pull / size).clamp(0.0, FURTHEST)
        return found, (2.0 * found * pull - found**2 * size).sum(1)
    found = torch.linalg.solve(normal + torch.diag(1e-6 * size), pull.T).T
    return found, (found * pull).sum(1).clamp(min=0.0)


def _moved_batch(contest: Contest, row: Batch, probes: Sequence[Probe]) -> tuple[Batch, torch.Tensor]:
    """Return a batch with one model per column of each probe, and the probe that each belongs to."""
    owner = [k for k, p in enumerate(probes) for _ in range(max(1, len(p.moved)))]
    batch = row[torch.zeros(len(owner), dtype=torch.long, device=contest.place)]
    s = 0
    for probe in probes:
        candidate = contest.candidates[probe.candidate]
        for entry in probe.moved or (None,):
            _place(contest, batch, s, candidate, probe)
            if entry is not None:
                batch.free[s, candidate.columns[entry]] += step_of(contest, candidate, entry)
            s += 1
    return batch, torch.tensor(owner, device=contest.place)


def _place(contest: Contest, batch: Batch, s: int, candidate: Candidate, probe: Probe) -> None:
    for column, value in zip(candidate.columns, probe.values, strict=True):
        batch.free[s, column] = contest.parameters[column].free(value)
        batch.active[s, column] = True


def step_of(contest: Contest, candidate: Candidate, entry: int) -> float:
    """Return the step of a free coordinate with which a parameter is moved off its neutral value."""
    column, spec = candidate.columns[entry], candidate.specs[entry]
    neutral = contest.parameters[column].free(spec.neutral)
    return REACH * min(float(contest.high[column]) - neutral, neutral - float(contest.low[column]))


def start_batch(contest: Contest, basis: Basis, scan: Scan, chosen: Sequence[int]) -> Batch:
    """Return start points of fits: each chosen probe at the strength that the scan found, twice.

    First with the model's own parameters as fitted, then corrected by what they had absorbed of the effect.
    """
    plain = _with_effects(contest, basis, scan, chosen)
    answered, columns = plain.copy(), basis.columns
    reach = contest.reach[columns]
    moved = answered.free[:, columns] - scan.absorbed[list(chosen)].clamp(-reach, reach)
    answered.free[:, columns] = moved.clamp(contest.low[columns], contest.high[columns])
    return Batch.joined([plain, answered])


def _with_effects(contest: Contest, basis: Basis, scan: Scan, chosen: Sequence[int]) -> Batch:
    batch = basis.fit.batch[torch.zeros(len(chosen), dtype=torch.long, device=contest.place)]
    for s, k in enumerate(chosen):
        probe, strength = scan.probes[k], scan.strength[k]
        candidate = contest.candidates[probe.candidate]
        _place(contest, batch, s, candidate, probe)
        for n, entry in enumerate(probe.moved):
            batch.free[s, candidate.columns[entry]] += float(strength[n]) * step_of(contest, candidate, entry)
        if not probe.moved:
            _scale(contest, batch, s, candidate, probe, float(strength[0]))
        own = [candidate.columns[entry] for entry in probe.moved or (0,)]  # the other values of a grid point stay
        edge = 0.02 * (contest.high[own] - contest.low[own])
        batch.free[s, own] = batch.free[s, own].clamp(contest.low[own] + edge, contest.high[own] - edge)
    return batch


def _scale(contest: Contest, batch: Batch, s: int, candidate: Candidate, probe: Probe, strength: float) -> None:
    """Scale an effect by its first parameter."""
    column = candidate.columns[0]
    batch.free[s, column] = contest.parameters[column].free(probe.values[0] * max(strength, 0.1))
