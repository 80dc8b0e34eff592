"""Levels of the search, one effect more each: where fits set out, joint refits, successive halving.

Every candidate is fitted together with the base parameters (a residual fitted afterwards is confounded with them). The
scan says where fits set out and which candidates are worth one; the better part of these goes on until few are left.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import torch

from .contest import Contest, Rows
from .field import Model, penalty
from .frequencies import frequency_probes
from .refit import Fits, evaluated, fit
from .scan import Basis, Scan, all_probes, look, start_rows

#: Further effects that set out beside a model, the candidates that go on after each round, and the most iterations of
#: the rounds. The last goes on until all have settled: a law of three parameters cut short loses to one of two.
FIELD = (14, 10, 5)
ITERATIONS = (4, 4, 24)
#: Fits of one candidate that go on after the first and after the second round: what leads early may be a side minimum.
SIDES = (3, 2)
#: Points of a candidate that are simulated, each with the base as fitted and as it would be with the effect there. It
#: sets out from the best of them; the first few candidates from as many, for an axis that turns has side minima.
STARTS, WIDELY = 4, 6
#: Models to which a further effect is tried.
LEADERS = 3

Progress = Callable[[str, int], None]


def first_look(
    contest: Contest, fits: Fits, nulls: torch.Tensor | None = None, without: Sequence[int] = ()
) -> tuple[Basis, Scan]:
    """Look at all candidates beside a fitted model; ``nulls`` [V, N] are further residuals to be explained."""
    basis = Basis(contest, fits)
    oscillating, compared = frequency_probes(contest, basis, without)
    probes = [*all_probes(contest, without), *oscillating]
    residuals = basis.residual[None] if nulls is None else torch.cat([basis.residual[None], nulls])
    scan = look(contest, basis, probes, residuals)
    return basis, replace(scan, compared=[1] * (len(probes) - len(oscillating)) + [compared] * len(oscillating))


def first_level(contest: Contest, basis: Basis, scan: Scan, progress: Progress) -> list[Model]:
    """Fit every candidate beside the base; return the models, best first."""
    return _halved(contest, *_field(contest, [(basis, scan, ())], every=True), progress)


def next_level(contest: Contest, leaders: Sequence[Model], progress: Progress) -> list[Model]:
    """Fit the candidates that the scan favours beside each of the leading models; return the models, best first."""
    looks = []
    for model in leaders:
        basis, scan = first_look(contest, model.fit, without=model.members)
        looks.append((basis, scan, model.members))
        progress("looking", 1)
    return _halved(contest, *_field(contest, looks, every=False), progress)


def reduced(contest: Contest, models: Sequence[Model]) -> list[Model]:
    """Return models without one of their effects each, fitted from where they are.

    An effect that no search from the base has found may stand once another has brought the rest near.
    """
    rows, members = [], []
    for model in models:
        for c in model.members:
            own = model.fit.rows.copy()
            own.active[:, list(contest.candidates[c].columns)] = False
            rows.append(own)
            members.append(tuple(m for m in model.members if m != c))
    fits = fit(contest, Rows.joined(rows), ITERATIONS[-1])
    return [Model(m, fits.one(s), True) for s, m in enumerate(members)]


def moved(contest: Contest, models: Sequence[Model]) -> list[Model]:
    """Return models with one effect at another joint each, fitted from where they are.

    A base bent by an effect hides it at its own joint better than at the next one.
    """
    rows, members = [], []
    for model in models:
        for c in model.members:
            for other in _same_law(contest, c, model.members):
                own = model.fit.rows.copy()
                old, new = (list(contest.candidates[k].columns) for k in (c, other))
                own.active[:, old], own.active[:, new] = False, True
                own.free[:, new] = torch.maximum(
                    torch.minimum(model.fit.rows.free[:, old], contest.high[new]), contest.low[new]
                )
                rows.append(own)
                members.append(tuple(sorted((set(model.members) - {c}) | {other})))
    if not rows:
        return []
    fits = fit(contest, Rows.joined(rows), sum(ITERATIONS[1:]))
    return [Model(m, fits.one(s), True) for s, m in enumerate(members)]


def _same_law(contest: Contest, candidate: int, members: Sequence[int]) -> list[int]:
    """Return the candidates with a candidate's law at other joints that a model has not got."""
    name = contest.candidates[candidate].name
    return [k for k, c in enumerate(contest.candidates) if c.name == name and k != candidate and k not in members]


def _field(
    contest: Contest, looks: Sequence[tuple[Basis, Scan, tuple[int, ...]]], *, every: bool
) -> tuple[Rows, list[tuple[int, ...]]]:
    """Rows that set out, and their members: the candidates that promise the least misfit, from their best probes.

    With ``every`` the others set out too: a base that an effect has bent far enough hides that effect from the scan,
    and may be a trap for its fits, which therefore set out beside the base at its typical values as well.
    """
    promised = _promised(contest, looks)
    keys = sorted(promised, key=lambda key: promised[key][0])[: None if every else FIELD[0]]
    starts = [_starts(contest, *looks[promised[key][1]][:2], promised[key][2]) for key in keys]
    cost = evaluated(contest, Rows.joined(starts)).cost.split([len(s) for s in starts])
    rows: list[Rows] = []
    members: list[tuple[int, ...]] = []
    for n, (key, own, misfit) in enumerate(zip(keys, starts, cost, strict=True)):
        rows.append(own[misfit.argsort()[: STARTS if n < WIDELY else 1]])
        if every or n < FIELD[0]:
            rows.append(own[slice(0, 1)])
            rows[-1].free[:, : contest.num_base] = contest.centre[: contest.num_base]
        members += [key] * (sum(map(len, rows)) - len(members))
    return Rows.joined(rows), members


def _promised(
    contest: Contest, looks: Sequence[tuple[Basis, Scan, tuple[int, ...]]]
) -> dict[tuple[int, ...], tuple[float, int, int]]:
    """Return by members the least misfit that a scan promises, which of the looks it was, and what is new in it."""
    out: dict[tuple[int, ...], tuple[float, int, int]] = {}
    for n, (basis, scan, beside) in enumerate(looks):
        for c in {p.candidate for p in scan.probes}:
            k = scan.best(c, 1)[0]
            misfit = float(basis.fit.cost[0]) - float(scan.gain[0, k]) + penalty(contest, [c])
            key = tuple(sorted((*beside, c)))
            if key not in out or misfit < out[key][0]:
                out[key] = (misfit, n, c)
    return out


def _starts(contest: Contest, basis: Basis, scan: Scan, candidate: int) -> Rows:
    """Return the rows that set out from the probes of a candidate that promise most."""
    return start_rows(contest, basis, scan, scan.best(candidate, STARTS))


def refitted(contest: Contest, models: Sequence[Model], iterations: int) -> list[Model]:
    """Return models fitted further, after the noise model has changed; best first."""
    fits = fit(contest, Rows.joined([m.fit.rows for m in models]), iterations)
    out = [Model(m.members, fits.one(s), m.settled) for s, m in enumerate(models)]
    return sorted(out, key=lambda m: m.cost + penalty(contest, m.members))


def _halved(contest: Contest, rows: Rows, members: list[tuple[int, ...]], progress: Progress) -> list[Model]:
    """Fit rows in rounds; after each the better candidates go on. All models, best first."""
    done: dict[tuple[int, ...], Model] = {}
    for round_, iterations in enumerate(ITERATIONS):
        fits = fit(contest, rows, iterations, lambda n: progress("fitting", n))
        sides: dict[tuple[int, ...], list[Model]] = {key: [] for key in members}
        for s in torch.argsort(fits.cost).tolist():
            sides[members[s]].append(Model(members[s], fits.one(s)))
        done |= {key: min([*own, done.get(key, own[0])], key=lambda m: m.cost) for key, own in sides.items()}
        ranked = sorted(done, key=lambda key: done[key].cost + penalty(contest, key))
        if round_ < len(SIDES):
            ahead = [m for key in ranked[: FIELD[round_ + 1]] for m in sides.get(key, [done[key]])[: SIDES[round_]]]
            rows, members = Rows.joined([m.fit.rows for m in ahead]), [m.members for m in ahead]
    for key in members:
        done[key].settled = True
    return [done[key] for key in ranked]
