"""Levels of the search, one more effect each: start points, joint fits, successive halving.

Every candidate is fitted jointly with the base parameters, since both explain parts of the same residual. The scan
gives the start points of the fits and ranks the candidates; successive halving then continues the better ones.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace

import torch

from ....sim.effects import effect_of
from ...cases.case import BranchCase
from .candidates import Candidate
from .contest import Batch, Contest, activated
from .fitted import FittedModels, Model, penalty
from .frequencies import frequency_probes
from .horizons import led, led_on
from .nested import neutral_of, switches
from .refit import Fits, evaluated, fit
from .scan import Basis, Scan, all_probes, score_probes, start_batch

#: Candidates that start beside a model and that continue after each round; and the most iterations of each round. The
#: last round is long enough to converge: a law of three parameters stopped early would lose to one of two.
KEPT = (14, 10, 5)
ITERATIONS = (4, 4, 24)
#: Fits of one candidate kept after the first and second round: the early leader may be in a local minimum.
SIDES = (3, 2)
#: Start points simulated per candidate, each with the base as fitted and corrected for the effect. A fit starts from
#: the best of them; the first few candidates start from several, because rotating axes have local minima.
STARTS, WIDELY = 4, 6
#: Leading models to which a further effect is added.
LEADERS = 3
#: At how many moments of every recording a law that happens once is tried, and from how many of them it begins.
MOMENTS, EARLIEST = 12, 2
#: How often leading models are begun again where they ended, and the share of the cost that such a fit must gain for
#: another.
BEGINNINGS, GAINED = 4, 0.01

Progress = Callable[[str, int], None]


def scan_candidates(
    contest: Contest, fits: Fits, nulls: torch.Tensor | None = None, without: Sequence[int] = ()
) -> tuple[Basis, Scan]:
    """Scan all candidates beside a fitted model; ``nulls`` [V, N] are further residuals to be explained."""
    basis = Basis(contest, fits)
    oscillating, compared = frequency_probes(contest, basis, without)
    probes = [*all_probes(contest, without), *oscillating]
    residuals = basis.residual[None] if nulls is None else torch.cat([basis.residual[None], nulls])
    scan = score_probes(contest, basis, probes, residuals)
    own = {p.candidate for p in oscillating}
    return basis, replace(scan, compared=[compared if p.candidate in own else 1 for p in scan.probes])


def first_level(contest: Contest, basis: Basis, scan: Scan, progress: Progress) -> list[Model]:
    """Fit every candidate beside the base; return the models, best first."""
    return _halved(contest, *_started(contest, [(basis, scan, ())], every=True), progress)


def better_of(contest: Contest, models: Sequence[Model], earlier: Sequence[Model]) -> list[Model]:
    """Return the better of two fits of the same effects, both under the present noise model, best first."""
    if not earlier:
        return list(models)
    again = evaluated(contest, Batch.joined([m.fit.batch for m in earlier]))
    every = [*models, *(replace(m, fit=again.one(s)) for s, m in enumerate(earlier))]
    out: dict[tuple[int, ...], Model] = {}
    for m in sorted(every, key=lambda m: m.cost + penalty(contest, m.members)):
        out.setdefault(m.members, m)
    return list(out.values())


def next_level(contest: Contest, leaders: Sequence[Model], progress: Progress) -> list[Model]:
    """Fit the candidates that the scan favours beside each of the leading models; return the models, best first.

    None are returned where the leading models have all candidates already.
    """
    scans = []
    for model in (m for m in leaders if len(m.members) < len(contest.candidates)):
        basis, scan = scan_candidates(contest, model.fit, without=model.members)
        scans.append((basis, scan, model.members))
        progress("scan", 1)
    return _halved(contest, *_started(contest, scans, every=False), progress) if scans else []


def reduced(contest: Contest, models: Sequence[Model], iterations: int = ITERATIONS[-1]) -> list[Model]:
    """Return models with one of their effects removed, refitted from their present parameters.

    An effect that fails from the base may succeed from a model whose other parameters are already near.
    """
    begun = [(tuple(m for m in model.members if m != c), _without(contest, model.fit.batch, [c]))
             for model in models for c in model.members]  # fmt: skip
    return _settled(contest, begun, iterations)


def moved(contest: Contest, models: Sequence[Model]) -> list[Model]:
    """Return models with one effect moved to another joint, refitted from their present parameters.

    The base parameters absorb an effect at its own joint more than at the next one, which can hide it there.
    """
    begun = [_at(contest, model, c, other)
             for model in models for c in model.members for other in _same_law(contest, c, model.members)]  # fmt: skip
    return _settled(contest, begun, sum(ITERATIONS[1:]))


def taken_for(fitted: FittedModels, count: int) -> list[Model]:
    """Return the best model of so many effects with each of its laws exchanged for those it is taken for, at its joint.

    They are laws that it is mistaken for, or that are mistaken for it. They begin as they were fitted alone, maybe at
    another joint: a law that fits slowly where it acts may have been dropped there and kept at its neighbour's; or
    where they were dropped everywhere, at their typical values. One that has settled at that joint begins again beside
    the springs of the best, since its own may be those of a false minimum. Where a scan beside what the best model has
    else finds a cheaper start, they begin there.
    """
    contest, best = fitted.contest, next(iter(fitted.of_size(count)), None)
    if best is None:
        return []
    done, begun = {m.members for m in fitted.of_size(count) if m.settled}, []
    for c in best.members:
        likely = _likely(contest, best, c)
        for other in _taken_for(contest, c):
            key = tuple(sorted((set(best.members) - {c}) | {other}))
            names = (contest.candidates[other].name,)
            alone = next((m for m in fitted.of_size(1) if m.settled and fitted.names(m) == names), None)
            if len(key) == count:
                own = _exchanged(contest, best, c, other, alone, again=key in done)
                begun.append((key, _cheapest(contest, [own, *likely.get(other, ())])))
    return _settled(contest, begun, sum(ITERATIONS[1:]))


def _likely(contest: Contest, model: Model, candidate: int) -> dict[int, list[Batch]]:
    """Return starts of the laws that one law of a model is taken for, as a scan beside the others' values finds them.

    The residual of the model without that law, all else as it was fitted, is what the law does.
    """
    others = _taken_for(contest, candidate)
    probes = [p for p in all_probes(contest, model.members) if p.candidate in others]
    if not probes:
        return {}
    basis = Basis(contest, evaluated(contest, _without(contest, model.fit.batch, [candidate])))
    scan = score_probes(contest, basis, probes, basis.residual[None])
    return {k: [start_batch(contest, basis, scan, best)] for k in others if (best := scan.best(k, STARTS))}


def _cheapest(contest: Contest, starts: Sequence[Batch]) -> Batch:
    """Return the start of least cost."""
    every = Batch.joined(starts)
    k = int(evaluated(contest, every).cost.argmin())
    return every[slice(k, k + 1)]


def _taken_for(contest: Contest, candidate: int) -> list[int]:
    """Return candidates at a candidate's joint, or of the whole branch, that it is mistaken for, or that are for it."""
    own = contest.candidates[candidate]
    return [
        k for k, c in enumerate(contest.candidates)
        if c.acting.joint in (own.acting.joint, None)
        and (c.name in effect_of(own.name).mistaken_for or own.name in effect_of(c.name).mistaken_for)
    ]  # fmt: skip


def _exchanged(
    contest: Contest, model: Model, candidate: int, other: int, alone: Model | None, *, again: bool
) -> Batch:
    """Return a model's start, one law exchanged for another as it was fitted alone.

    A single law brings its base, unless it is fitted again.
    """
    if alone is not None and len(model.members) == 1 and not again:
        return _at(contest, alone, alone.members[0], other)[1]
    own = _without(contest, model.fit.batch, [candidate])
    if alone is None:
        return _placed(contest, own, other, contest.typical[None], other)
    return _placed(contest, own, other, alone.fit.batch.free, alone.members[0])


def _placed(contest: Contest, own: Batch, other: int, source: torch.Tensor, candidate: int) -> Batch:
    """Add a candidate to models, with the values that one of its law has in ``source`` [S, n], inside its boxes."""
    old, new = (list(contest.candidates[k].columns) for k in (candidate, other))
    own.active[:, new] = True
    own.free[:, new] = torch.maximum(torch.minimum(source[:, old], contest.high[new]), contest.low[new])
    return own


def _at(contest: Contest, model: Model, candidate: int, other: int) -> tuple[tuple[int, ...], Batch]:
    """Return the members and the start of a model, a candidate's law moved to that of another joint."""
    own = _placed(contest, _without(contest, model.fit.batch, [candidate]), other, model.fit.batch.free, candidate)
    return tuple(sorted((set(model.members) - {candidate}) | {other})), own


def mirrored(contest: Contest, models: Sequence[Model]) -> list[Model]:
    """Return models with one law told from its other side (`Law.mirror`), alone and beside their other effects.

    Both sides fit alike in the plane in which such a law acts. A fit that ended on the wrong side does not cross over,
    and takes a further effect for what it has wrong across the plane.
    """
    begun = []
    for model in models:
        for c in model.members:
            turned = _mirrored(contest, model.fit.batch, c)
            if turned is not None:
                for key in {model.members, (c,)}:
                    begun.append((key, _without(contest, turned, set(model.members) - set(key))))
    return _settled(contest, begun, sum(ITERATIONS[1:]))


def _without(contest: Contest, batch: Batch, gone: Iterable[int]) -> Batch:
    """Return a model, a batch of one, without some of its effects."""
    out = batch.copy()
    for c in gone:
        out.active[:, list(contest.candidates[c].columns)] = False
    return out


def _settled(contest: Contest, begun: Sequence[tuple[tuple[int, ...], Batch]], iterations: int) -> list[Model]:
    """Return models fitted from where they begin, given with their members; none for none."""
    if not begun:
        return []
    fits = fit(contest, Batch.joined([batch for _, batch in begun]), iterations)
    return [Model(members, fits.one(s), True) for s, (members, _) in enumerate(begun)]


def at_other_moments(contest: Contest, models: Sequence[Model]) -> list[Model]:
    """Return models with a law that happens once (`Law.moment`) begun at the moments of all at which it leaves least.

    No slope leads from one recording to the next, and a break that bending makes may stand for one by the clock.
    """
    begun = []
    for model in models:
        for c in (c for c in model.members if contest.candidates[c].law.moment):
            tried = _at_moments(contest, model.fit.batch, contest.candidates[c])
            best = evaluated(contest, tried).cost.argsort()[:EARLIEST].tolist()
            begun += [(model.members, tried[slice(k, k + 1)]) for k in best]
    return _settled(contest, begun, ITERATIONS[-1])


def in_plain_form(contest: Contest, models: Sequence[Model]) -> list[Model]:
    """Return models begun again with the optional parameters of their laws off, at their strengths and at half of them.

    A law of many parameters may end where some of them make up for another: its strength at an end of its box.
    """
    begun = []
    for model in models:
        own = [c for c in model.members if any(spec.optional for spec in contest.candidates[c].specs)]
        begun += [(model.members, _plain(contest, model.fit.batch, own, share)) for share in (1.0, 0.5) if own]
    return _settled(contest, begun, ITERATIONS[-1])


def _plain(contest: Contest, batch: Batch, candidates: Sequence[int], share: float) -> Batch:
    """Return a model, a batch of one, some of its laws with a share of their strengths and no optional parameters."""
    out, values = batch.copy(), contest.values(batch)[0]
    for c in candidates:
        own = contest.candidates[c]
        for k in switches(contest, own):
            weaker = share * float(values[k]) + (1.0 - share) * float(contest.neutral[k])
            out.free[:, k] = contest.parameters[k].free(weaker)
        for k, spec in zip(own.columns, own.specs, strict=True):
            if spec.optional:
                out.free[:, k] = neutral_of(contest, k)
    return out


def _at_moments(contest: Contest, batch: Batch, own: Candidate) -> Batch:
    """Return a model, a batch of one, with its law at moments in every recording, and with no more than it needs.

    Its optional parameters are as fitted first and then off: half of the models each.
    """
    assert isinstance(contest.case, BranchCase)
    shares = torch.arange(MOMENTS) / MOMENTS
    moments = torch.cat([t.t_start + shares * float(t.t[-1]) for t in contest.case.trajectories])
    out = Batch.joined([batch] * (2 * len(moments)))
    for spec, column in zip(own.specs, own.columns, strict=True):
        if spec.name == own.law.moment:
            out.free[:, column] = moments.repeat(2).to(out.free)
        elif spec.optional:
            out.free[len(moments) :, column] = contest.parameters[column].free(spec.neutral)
    return out


def _mirrored(contest: Contest, batch: Batch, candidate: int) -> Batch | None:
    """Return a model, a batch of one, with a candidate told from its other side; None where its law has none."""
    own, case = contest.candidates[candidate], contest.case
    if not isinstance(case, BranchCase) or (mirror := effect_of(own.acting.name).law("branch").mirror) is None:
        return None
    out, values = batch.copy(), contest.values(batch)[0]
    turned, factor = mirror([float(values[k]) for k in own.columns])
    spring = f"stiffness {case.segment_name[own.acting.joint or 0]}"
    joint = next(k for k, p in enumerate(contest.parameters) if p.name == spring)
    pairs = [*zip(own.columns, turned, strict=True), (joint, factor * float(values[joint]))]
    for column, value in pairs:
        free = contest.parameters[column].free(value)
        out.free[:, column] = min(max(free, float(contest.low[column])), float(contest.high[column]))
    return out


def begun_again(contest: Contest, models: Sequence[Model]) -> None:
    """Fit models again from where they ended, as little damped as at first, while they gain by it.

    In a narrow curved valley steps fail until they are short, and a fit that only creeps is taken for settled.
    """
    ahead = list(models)
    for _ in range(BEGINNINGS):
        if not ahead:
            break
        fits = fit(contest, Batch.joined([m.fit.batch for m in ahead]), ITERATIONS[-1])
        gained = [m.cost - float(fits.cost[s]) > GAINED * m.cost for s, m in enumerate(ahead)]
        for s, m in enumerate(ahead):
            m.fit = fits.one(s) if float(fits.cost[s]) < m.cost else m.fit
        ahead = [m for m, more in zip(ahead, gained, strict=True) if more]


def led_whole(contest: Contest) -> list[Model]:
    """Return models of each law of the whole branch, led from typical values through growing shares of recordings.

    A mass or a trunk changes every period: springs that make up for it are a false minimum, from which no step leads
    the law to its place, and which the many swings of a release surround with others.
    """
    whole = [k for k, c in enumerate(contest.candidates) if c.acting.joint is None]
    if not whole or not isinstance(contest.case, BranchCase):
        return []
    begun = activated(contest, contest.base_batch(len(whole)), [[k] for k in whole])
    begun.free = contest.typical.expand_as(begun.free).clone()
    out = led_on(contest, begun)
    return _settled(contest, [((k,), out[slice(n, n + 1)]) for n, k in enumerate(whole)], ITERATIONS[-1])


def _same_law(contest: Contest, candidate: int, members: Sequence[int]) -> list[int]:
    """Return the candidates with a candidate's law at other joints that a model has not got."""
    name = contest.candidates[candidate].name
    return [k for k, c in enumerate(contest.candidates) if c.name == name and k != candidate and k not in members]


def _started(
    contest: Contest, scans: Sequence[tuple[Basis, Scan, tuple[int, ...]]], *, every: bool
) -> tuple[Batch, list[tuple[int, ...]]]:
    """Return the start points of the most promising candidates, from their best probes, and their members.

    With ``every`` all candidates start. A base fit biased by an effect can hide that effect from the scan and trap its
    fits in a local minimum; they therefore also start from the base at its typical values, those of joints with their
    effects at typical values too and first fitted to short horizons. Laws of a branch's joint that remember start from
    the base with a typical damper at their joint as well.
    """
    promised = _promised(contest, scans)
    keys = sorted(promised, key=lambda key: promised[key][0])[: None if every else KEPT[0]]
    starts = [_starts(contest, *scans[promised[key][1]][:2], promised[key][2]) for key in keys]
    cost = evaluated(contest, Batch.joined(starts)).cost.split([len(s) for s in starts])
    batches: list[Batch] = []
    members: list[tuple[int, ...]] = []
    for n, (key, own, misfit) in enumerate(zip(keys, starts, cost, strict=True)):
        batches.append(own[misfit.argsort()[: STARTS if n < WIDELY else 1]])
        members += [key] * len(batches[-1])
    loose = [(key, start) for key, own in zip(keys, starts, strict=True)
             if (start := _loosened(contest, own[slice(0, 1)], promised[key][2])) is not None]  # fmt: skip
    typical = Batch.joined([own[slice(0, 1)] for own in starts])
    known = typical.active.clone() if typical.start.numel() else typical.active & False
    known[:, : contest.num_base] = True
    typical.free = torch.where(known, contest.typical, typical.free)
    batches += [led(contest, typical), *(start for _, start in loose)]
    rows = [*members, *keys, *(key for key, _ in loose)]
    order = sorted(range(len(rows)), key=lambda s: keys.index(rows[s]))  # neighbours have about as many parameters
    return Batch.joined(batches)[torch.tensor(order, device=contest.place)], sorted(rows, key=keys.index)


def _loosened(contest: Contest, start: Batch, candidate: int) -> Batch | None:
    """Return a start with the law at typical values and a typical damper at its joint, None where that says nothing.

    A damper that stands for a law which takes energy leaves it nothing to explain, and no step leads from the one to
    the other: a creep at a joint that was damped 150 times too much stayed there.
    """
    own = contest.candidates[candidate]
    if not isinstance(contest.case, BranchCase) or own.acting.joint is None or not own.law.memory:
        return None
    damper = f"damping {contest.case.segment_name[own.acting.joint]}"
    columns = [*own.columns, next(k for k, p in enumerate(contest.parameters) if p.name == damper)]
    out = start.copy()
    out.free[:, columns] = contest.typical[columns]
    return out


def _promised(
    contest: Contest, scans: Sequence[tuple[Basis, Scan, tuple[int, ...]]]
) -> dict[tuple[int, ...], tuple[float, int, int]]:
    """Return by members the lowest predicted cost, which scan predicted it, and the candidate it adds."""
    out: dict[tuple[int, ...], tuple[float, int, int]] = {}
    for n, (basis, scan, beside) in enumerate(scans):
        for c in {p.candidate for p in scan.probes}:
            k = scan.best(c, 1)[0]
            misfit = float(basis.fit.cost[0]) - float(scan.gain[0, k]) + penalty(contest, [c])
            key = tuple(sorted((*beside, c)))
            if key not in out or misfit < out[key][0]:
                out[key] = (misfit, n, c)
    return out


def _starts(contest: Contest, basis: Basis, scan: Scan, candidate: int) -> Batch:
    """Return the start points of a candidate from its most promising probes."""
    return start_batch(contest, basis, scan, scan.best(candidate, STARTS))


def refitted(contest: Contest, models: Sequence[Model], iterations: int) -> list[Model]:
    """Return models refitted after the noise model has changed, best first."""
    fits = fit(contest, Batch.joined([m.fit.batch for m in models]), iterations)
    out = [replace(m, fit=fits.one(s)) for s, m in enumerate(models)]
    return sorted(out, key=lambda m: m.cost + penalty(contest, m.members))


def _halved(contest: Contest, batch: Batch, members: list[tuple[int, ...]], progress: Progress) -> list[Model]:
    """Fit in rounds by successive halving; return all models, best first."""
    done: dict[tuple[int, ...], Model] = {}
    for round_, iterations in enumerate(ITERATIONS):
        fits = fit(contest, batch, iterations, lambda n: progress("fits", n))
        sides: dict[tuple[int, ...], list[Model]] = {key: [] for key in members}
        for s in torch.argsort(fits.cost).tolist():
            sides[members[s]].append(Model(members[s], fits.one(s)))
        done |= {key: min([*own, done.get(key, own[0])], key=lambda m: m.cost) for key, own in sides.items()}
        ranked = sorted(done, key=lambda key: done[key].cost + penalty(contest, key))
        if round_ < len(SIDES):
            ahead = [m for key in ranked[: KEPT[round_ + 1]] for m in sides.get(key, [done[key]])[: SIDES[round_]]]
            batch, members = Batch.joined([m.fit.batch for m in ahead]), [m.members for m in ahead]
    for key in members:
        done[key].settled = True
    return [done[key] for key in ranked]
