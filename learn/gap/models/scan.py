"""A first look at every candidate: what its response would explain beside a model that is fitted already.

About a fitted model the whitened residual is r and derivatives of what is free in it span J. A candidate adds columns
C: changes of the simulation, from moving a parameter about its neutral value or from the effect at a point of a grid.
Its gain is the part of |r|^2 that C explains after J has taken its own; under the model it is chi-square distributed.
One simulation a column serves any number of residuals, those of simulated nulls included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from .candidates import FURTHEST, Candidate, Probe, probes_of
from .contest import Contest, Rows
from .refit import Fits

#: Share of a parameter's way from neutral to the nearer end of its box by which it is moved.
REACH = 0.1


@dataclass(frozen=True)
class Scan:
    """Gains of all probes for some residuals.

    Attributes:
        probes: What was looked at.
        gain: Squares explained beside the model, shape [residuals, probes].
        strength: Coefficients of the columns of each probe for the first residual, a tensor [q] each.
        compared: How many probes each stands for, having been chosen for its gain, shape [probes].
        taken: What the model's own parameters would have to change by to do as each probe at that strength, shape
            [probes, parameters]; with the effect there they do the opposite.
    """

    probes: list[Probe]
    gain: torch.Tensor
    strength: list[torch.Tensor]
    compared: list[int]
    taken: torch.Tensor

    def best(self, candidate: int, count: int) -> list[int]:
        """Return the probes of a candidate that explain most of the first residual, best first."""
        own = [k for k, p in enumerate(self.probes) if p.candidate == candidate]
        return sorted(own, key=lambda k: -float(self.gain[0, k]))[:count]


class Basis:
    """What a fitted model can do about a residual by itself: its derivatives, whitened, priors as rows of data.

    Attributes:
        fit: The model, one row.
        residual: Whitened residual, shape [N].
        columns: Columns of its free parameters, shape [q].
    """

    def __init__(self, contest: Contest, fit: Fits) -> None:
        self.fit = fit
        residual, derivative, columns = contest.linearise(fit.rows)
        self.columns, own = columns[0], derivative[0].flatten(1)
        self.residual = residual[0].flatten()
        at = self.columns
        prior = [contest.spread[at], own.new_full((len(own) - len(at),), 1e6), contest.nuisance_spread]
        self._rows = torch.cat([own, contest.nuisance])
        precision = contest.overdispersion * torch.cat(prior) ** -2
        self._factor = torch.linalg.cholesky(self._rows @ self._rows.T + torch.diag(precision))

    def free_of(self, vectors: torch.Tensor) -> torch.Tensor:
        """Return vectors [V, N] without what the model would explain of them."""
        return self.split(vectors)[1]

    def split(self, vectors: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the coefficients [V, q + ...] with which the model explains vectors [V, N], and the rest."""
        taken = torch.cholesky_solve(self._rows @ vectors.T, self._factor).T
        return taken, vectors - taken @ self._rows


def all_probes(contest: Contest, without: Sequence[int] = ()) -> list[Probe]:
    """Return the probes of all candidates but some."""
    out: list[Probe] = []
    for index, candidate in enumerate(contest.candidates):
        if index not in without:
            setting = contest.settings[candidate.acting.joint or 0]
            out += probes_of(index, candidate, [contest.parameters[c] for c in candidate.columns], setting)
    return out


def look(contest: Contest, basis: Basis, probes: Sequence[Probe], residuals: torch.Tensor) -> Scan:
    """Look at probes beside a fitted model for residuals [V, N], the first of them the measured one."""
    moved, owner = _moved_rows(contest, basis.fit.rows, probes)
    out = contest.simulate(contest.values(moved), moved.start)
    change = contest.whiten(out - contest.simulate(contest.values(basis.fit.rows), basis.fit.rows.start)).flatten(1)
    weight = basis.fit.rows.weight[0]
    change = change * weight.repeat_interleave(change.shape[1] // len(weight))
    imitated, change = basis.split(change)
    imitated = imitated[:, : len(basis.columns)]
    left = basis.free_of(residuals)
    gain = left.new_zeros(len(residuals), len(probes))
    strength, taken = [], []
    for k, probe in enumerate(probes):
        own = change[owner == k]
        found, explained = _explained(own, left, bounded=not probe.moved)
        gain[:, k] = explained
        strength.append(found[0])
        taken.append(found[0] @ imitated[owner == k])
    return Scan(list(probes), gain, strength, [1] * len(probes), torch.stack(taken))


def _explained(columns: torch.Tensor, left: torch.Tensor, *, bounded: bool) -> tuple[torch.Tensor, torch.Tensor]:
    """Coefficients [V, q] of columns [q, N] for residuals [V, N] and squares that they explain [V]."""
    normal, pull = columns @ columns.T, left @ columns.T
    size = normal.diagonal().clamp(min=1e-12)
    if bounded:  # the effect itself at some strength: it can grow and shrink, not turn round
        found = (pull / size).clamp(0.0, FURTHEST)
        return found, (2.0 * found * pull - found**2 * size).sum(1)
    found = torch.linalg.solve(normal + torch.diag(1e-6 * size), pull.T).T
    return found, (found * pull).sum(1).clamp(min=0.0)


def _moved_rows(contest: Contest, row: Rows, probes: Sequence[Probe]) -> tuple[Rows, torch.Tensor]:
    """Rows of all columns of all probes, and whose they are."""
    owner = [k for k, p in enumerate(probes) for _ in range(max(1, len(p.moved)))]
    rows = row[torch.zeros(len(owner), dtype=torch.long, device=contest.place)]
    s = 0
    for probe in probes:
        candidate = contest.candidates[probe.candidate]
        for entry in probe.moved or (None,):
            _place(contest, rows, s, candidate, probe)
            if entry is not None:
                rows.free[s, candidate.columns[entry]] += step_of(contest, candidate, entry)
            s += 1
    return rows, torch.tensor(owner, device=contest.place)


def _place(contest: Contest, rows: Rows, s: int, candidate: Candidate, probe: Probe) -> None:
    for column, value in zip(candidate.columns, probe.values, strict=True):
        rows.free[s, column] = contest.parameters[column].free(value)
        rows.active[s, column] = True


def step_of(contest: Contest, candidate: Candidate, entry: int) -> float:
    """Return the step of a free coordinate with which a parameter is moved off its neutral value."""
    column, spec = candidate.columns[entry], candidate.specs[entry]
    neutral = contest.parameters[column].free(spec.neutral)
    return REACH * min(float(contest.high[column]) - neutral, neutral - float(contest.low[column]))


def start_rows(contest: Contest, basis: Basis, scan: Scan, chosen: Sequence[int]) -> Rows:
    """Return rows that set out from probes at the strength that the scan found, twice each.

    First the model's own parameters are as they were fitted, then they make up for what they did in the effect's stead.
    """
    plain = _with_effects(contest, basis, scan, chosen)
    answered, columns = plain.copy(), basis.columns
    reach = contest.reach[columns]
    moved = answered.free[:, columns] - scan.taken[list(chosen)].clamp(-reach, reach)
    answered.free[:, columns] = moved.clamp(contest.low[columns], contest.high[columns])
    return Rows.joined([plain, answered])


def _with_effects(contest: Contest, basis: Basis, scan: Scan, chosen: Sequence[int]) -> Rows:
    rows = basis.fit.rows[torch.zeros(len(chosen), dtype=torch.long, device=contest.place)]
    for s, k in enumerate(chosen):
        probe, strength = scan.probes[k], scan.strength[k]
        candidate = contest.candidates[probe.candidate]
        _place(contest, rows, s, candidate, probe)
        for n, entry in enumerate(probe.moved):
            rows.free[s, candidate.columns[entry]] += float(strength[n]) * step_of(contest, candidate, entry)
        if not probe.moved:
            _scale(contest, rows, s, candidate, probe, float(strength[0]))
        own = [candidate.columns[entry] for entry in probe.moved or (0,)]  # a grid's values, moments say, stay
        edge = 0.02 * (contest.high[own] - contest.low[own])
        rows.free[s, own] = rows.free[s, own].clamp(contest.low[own] + edge, contest.high[own] - edge)
    return rows


def _scale(contest: Contest, rows: Rows, s: int, candidate: Candidate, probe: Probe, strength: float) -> None:
    """Strengthen an effect by its first parameter."""
    column = candidate.columns[0]
    rows.free[s, column] = contest.parameters[column].free(probe.values[0] * max(strength, 0.1))
