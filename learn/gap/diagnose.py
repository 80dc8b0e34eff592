"""What a model of a case lacks: the whole workflow."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from ...sim.base.errors import InputError
from ...sim.base.files import output_folder
from ...sim.base.types import Array
from ...version import __version__
from ..cases.case import BranchCase, JointCase, load_case
from ..inference.fit import Modes, climb_until_settled, precision_at
from ..inference.identify import split
from ..inference.posterior import Posterior, sample
from ..inference.predict import START_WINDOW, first_moments, main_channels
from ..inference.report import unit_of
from ..inference.settings import default_iterations
from ..inference.target import Target
from ..replay.equation_error import recordings_of
from ..replay.input_noise import Colour
from ..runs.checkpoint import Checkpoint, digest
from ..runs.threads import one_thread
from ..systems.acting import Acting
from ..systems.branch import Unknowns
from ..systems.model_file import BranchModel, write_model
from ..systems.system import Parameter
from .candidates import names_for
from .contest import Contest, Rows
from .decide import ALARM, Field, alternatives, chosen, known, lacks_fit, leading, needs_more, size
from .diagnosis import Diagnosis, Gap, Interval, Rival, Settings, VerdictName
from .evidence import family_wise, left_out, nulls, profiles
from .next_probe import next_experiment
from .refit import Fits, fit, normal_equations
from .search import LEADERS, Model, first_level, first_look, moved, next_level, overdispersion, reduced, refitted
from .setup import Base, add_wood, base_of, colour
from .where import locate, noise_seen

Progress = Callable[[str, int], None]
#: Stages in the order in which they report progress.
STAGES = ("base", "looking", "fitting", "evidence", "sampling")
#: Steps of a refit after the noise model has changed, and of one to the trajectories that are trained on.
AGAIN, TRAIN = 5, 8
#: Deviation that holds a parameter where it is.
FIXED = 1e-7
#: Noise may be at most this share of a channel's rms for anything to be said.
LOUDEST = 0.7


def check(case: BranchCase | JointCase, settings: Settings) -> None:
    """Raise `InputError` for settings that cannot be."""
    settings.check()
    names_for(case, settings.effects)


class Diagnoser:
    """The search for what a case's model lacks.

    Args:
        case: The case.
        settings: How to diagnose.
        checkpoint: Where to keep what has been reached.
        progress: Called with a stage of `STAGES` and the number of steps done.
    """

    def __init__(
        self, case: BranchCase | JointCase, settings: Settings, checkpoint: Checkpoint | None = None,
        progress: Progress = lambda stage, done: None,
    ) -> None:  # fmt: skip
        check(case, settings)
        self.case, self.settings, self.progress = case, settings, progress
        self.keep = checkpoint or Checkpoint()
        self.seconds: dict[str, float] = {}

    def run(self) -> Diagnosis:
        """Return what was found."""
        clock = time.perf_counter()
        poor = too_poor(self.case)
        names = names_for(self.case, self.settings.effects)
        base = base_of(self.case, names, self.settings.seed, fitted=still(self.case) is None)
        poor = poor or too_loud(_over_noise(base.contest))
        self.progress("base", 1)
        self._lap("base", clock)
        if poor is not None:
            return self._conclude(base, Field(base.contest, Model((), base.fit), []), 1.0, poor, clock)
        field, p_null = self._restored(base) or self._searched(base)
        return self._conclude(base, field, p_null, None, clock)

    def _searched(self, base: Base) -> tuple[Field, float]:
        """Search, and keep what was found."""
        field, p_null = self.search(base)
        models = [vars(m) | {"fit": {**vars(m.fit), "rows": vars(m.fit.rows)}} for m in (field.base, *field.models)]
        contest = field.contest
        noise = {"nuisance": contest.nuisance, "overdispersion": contest.overdispersion}
        noise["colour"] = None if contest.colour is None else vars(contest.colour)
        self.keep.save("search", {"models": models, "p_null": p_null, **noise})
        return field, p_null

    def _restored(self, base: Base) -> tuple[Field, float] | None:
        """Return what a killed run had found."""
        state = self.keep.load("search")
        if state is None:
            return None
        contest = base.contest
        contest.nuisance, contest.overdispersion = state["nuisance"], state["overdispersion"]
        contest.colour = None if state["colour"] is None else Colour(**state["colour"])
        models = [Model(m["members"], Fits(**{**m["fit"], "rows": Rows(**m["fit"]["rows"])}), m["settled"])
                  for m in state["models"]]  # fmt: skip
        return Field(contest, models[0], models[1:]), state["p_null"]

    def search(self, base: Base) -> tuple[Field, float]:
        """Fit all candidates that are worth it; return them and the family-wise p-value."""
        clock, contest = time.perf_counter(), base.contest
        basis, scan = first_look(contest, base.fit, nulls(base, self.settings.seed))
        self.progress("looking", 1)
        left = float(base.fit.chi2[0] - scan.gain[0].max())
        p_null = family_wise(scan, overdispersion(contest, left))
        self._lap("scan", clock)
        clock = time.perf_counter()
        level = first_level(contest, basis, scan, self.progress)
        models = level.models + moved(contest, level.models[:2])
        field = self._recoloured(base, Field(contest, Model((), base.fit), models))
        least = self.settings.tolerance * _over_noise(contest)
        missing = p_null <= ALARM or lacks_fit(contest, field.base, least)
        for count in range(2, self.settings.max_effects + 1):
            leaders = field.of_size(count - 1)[:LEADERS]
            if not missing or not leaders or not needs_more(field, leaders[0]):
                break
            contest.overdispersion = field.overdispersion
            further = next_level(contest, leaders, self.progress).models
            field.models += further + reduced(contest, further[:2])
        self._lap("fits", clock)
        return field, p_null

    def _recoloured(self, base: Base, field: Field) -> Field:
        """Take noise of the force and bending of wood through the best model instead of a base that is far off."""
        best = field.of_size(1)[0]
        field.contest.overdispersion = field.overdispersion
        if base.force_sigma is not None:
            colour(field.contest, best.fit.rows, base.force_sigma)
            add_wood(field.contest, best.fit.rows)
        settled = [m for m in field.models if m.settled]
        base_again = refitted(field.contest, [field.base], AGAIN)[0]
        return Field(field.contest, base_again, refitted(field.contest, settled, AGAIN))

    def _lap(self, stage: str, since: float) -> None:
        self.seconds[stage] = self.seconds.get(stage, 0.0) + time.perf_counter() - since

    def _conclude(self, base: Base, field: Field, p_null: float, poor: str | None, began: float) -> Diagnosis:
        clock, contest = time.perf_counter(), base.contest
        model = chosen(field, self.settings.max_effects)
        rms = _over_noise(contest)
        verdict: VerdictName = "effects" if known(field, model) else "unknown"
        small = p_null > ALARM or size(field, model, rms) < self.settings.tolerance
        if small and not lacks_fit(contest, field.base, self.settings.tolerance * rms):
            verdict = "none"
        if poor is not None:
            verdict = "unknown"
        final = model if verdict != "none" else field.base
        gap = held_out_gap(self.case, base, field.base, final)
        self.progress("evidence", 1)
        rivals = ranking(field, model, verdict != "none")
        self._lap("evidence", clock)
        named = tuple(contest.candidates[c].acting for c in model.members) if verdict == "effects" else ()
        others = alternatives(field, model) if verdict == "effects" else {}
        outputs = [contest.simulate(contest.values(m.fit.rows), m.fit.rows.start)[0].cpu().numpy().astype(np.float64)
                   for m in (field.base, final)]  # fmt: skip
        posterior = None if verdict != "effects" else self._posterior(field, model)
        self.seconds["total"] = time.perf_counter() - began
        seen = noise_seen(contest)
        nearest = None if verdict != "unknown" or poor else contest.candidates[leading(field, model)].name
        return Diagnosis(
            case=self.case, settings=self.settings, recordings=contest.recordings, sigma=seen, verdict=verdict,
            sentence=sentence(verdict, named, gap, field.explained(model), nearest, poor), effects=named,
            parameters=intervals(field, model, posterior) if named else {}, alternatives=others, nearest=nearest,
            where=locate(self.case, contest.recordings, seen, outputs[0], _stiffness(self.case, field)),
            gap=gap, ranking=rivals, explained=field.explained(model),
            base_misfit=field.base.chi2 / contest.num_samples, motion=rms, p_null=p_null,
            base_output=outputs[0], best_output=outputs[1], base_values=_values(field.base, contest),
            best_values=_values(final, contest),
            next_experiment=poor or next_experiment(field, model, verdict, others),
            posterior=posterior, world_steps=contest.world_steps, seconds=dict(self.seconds),
        )  # fmt: skip

    def _posterior(self, field: Field, model: Model) -> Posterior | None:
        """Infer base and effects together by Stein variational gradient descent, where it was asked for."""
        if not self.settings.particles:
            return None
        clock = time.perf_counter()
        out = posterior_of(field.contest, model, self.settings, self.keep, self.progress)
        self._lap("posterior", clock)
        return out


def posterior_of(
    contest: Contest, model: Model, settings: Settings, keep: Checkpoint, progress: Progress
) -> Posterior:  # fmt: skip
    """Infer the base's and the effects' parameters of a model together, about its fit.

    The simulator's kernel stays that of the search; effects that the model lacks are known to be neutral.
    """
    target = Target(contest.case, contest.recordings, torch.as_tensor(contest.sigma), unknowns=only(contest, model))
    target.colour = contest.colour
    rows = model.fit.rows
    theta = torch.cat([rows.free[rows.active][None], rows.start.flatten(1), target.log_noise0[None]], 1)
    theta = climb_until_settled(target, theta)
    modes = Modes(theta, target.log_density(theta), precision_at(target, theta))
    count = max(settings.particles, 2 * target.num_dims)
    return sample(
        target, modes, particles=count, iterations=default_iterations("svgd"), seed=settings.seed, checkpoint=keep,
        progress=lambda stage, done: progress("sampling", done),
    )  # fmt: skip


def only(contest: Contest, model: Model) -> Unknowns:
    """Return unknowns in which a model's effects are inferred and all others of the superset are off."""
    acting = []
    for c, candidate in enumerate(contest.candidates):
        off = {s.name: s.neutral for s in candidate.specs}
        acting.append(candidate.acting if c in model.members else replace(candidate.acting, known=off))
    return Unknowns(effects=tuple(acting))


def _over_noise(contest: Contest) -> float:
    """Rms of all channels in units of their noise."""
    used = contest.sigma > 0.0
    return float(((contest.measured[..., used] / contest.sigma[used]) ** 2).mean().sqrt())


def _stiffness(case: BranchCase | JointCase, field: Field) -> Array | None:
    """Return the springs of the base model, base first, None for joints."""
    if not isinstance(case, BranchCase):
        return None
    values = _values(field.base, field.contest)
    return np.array([values[f"stiffness {n}"] for n in case.segment_name])


def _values(model: Model, contest: Contest) -> dict[str, float]:
    values = contest.values(model.fit.rows)[0]
    active = model.fit.rows.active[0]
    return {p.name: float(v) for p, v, on in zip(contest.parameters, values, active, strict=True) if on}


def too_poor(case: BranchCase | JointCase) -> str | None:
    """Return why a case can say nothing, with the probe that is missing, or None."""
    if still(case) is not None:
        return still(case)
    if isinstance(case, BranchCase) and len(case.trajectories) < 2:
        return "one trajectory can be fitted by almost any effect; push in two more directions"
    return None


def still(case: BranchCase | JointCase) -> str | None:
    """Return that nothing acts or nothing moves, or None."""
    if isinstance(case, BranchCase) and not any(t.force.any() for t in case.trajectories):
        return "no trajectory has any force; push the branch"
    if not any(np.ptp(r.output, axis=0).any() for r in recordings_of(case)):
        return "nothing moves in any trajectory; push harder"
    return None


def too_loud(signal: float) -> str | None:
    """Return what to do where noise hides the motion, ``signal`` the rms in units of the noise."""
    if signal < 1.0 / LOUDEST:
        return "noise is as large as the motion; push harder, or average repeated pushes"
    return None


def held_out_gap(case: BranchCase | JointCase, base: Base, plain: Model, final: Model) -> Gap:
    """Refit base and final model to the training trajectories and return the rms misfit of the held-out ones.

    Segments do not bend, as in the model that is written and wherever that is simulated: springs and dampers that were
    fitted beside bending wood would be worse than the data allows, before more than after.
    """
    contest = base.contest.rigid()
    train, test = split(case) if len(case.trajectories) > 1 else ([0], [0])
    rows = Rows.joined([plain.fit.rows, final.fit.rows])
    rows.weight[:] = 0.0
    rows.weight[:, train] = 1.0
    fitted = fit(contest, rows, TRAIN).rows
    out = contest.simulate(contest.values(fitted), _held_start(contest, fitted))
    main = list(main_channels(case))
    misfit = [_rms(contest, out[s], test, main) for s in range(2)]
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
        outs.append(fit(short, own, AGAIN).rows.start)
    return torch.cat(outs)


def _rms(contest: Contest, output: torch.Tensor, test: Sequence[int], main: list[int]) -> float:
    parts = []
    for j in test:
        n = len(contest.recordings[j].t)
        parts.append((contest.measured[j, :n] - output[j, :n].double())[:, main].flatten())
    return float(torch.cat(parts).pow(2).mean().sqrt())


def ranking(field: Field, model: Model, deep: bool) -> tuple[Rival, ...]:
    """Return base and rivals, best first; the last rivals with their misfit in profiles they were not fitted to.

    Of models with more effects than the preferred one the best is shown: what one more would be good for.
    """
    best = field.criterion(model)
    every = sorted([field.base, *field.models], key=field.criterion)
    ahead = {m.members: m for m in reversed(every)}  # the same effects may have been fitted from two sides
    each = [m for m in every if ahead[m.members] is m]
    larger = [m.members for m in each if len(m.members) > len(model.members)][1:]
    ordered = [m for m in each if m.members not in larger][:12]
    if field.base not in ordered:
        ordered.append(field.base)
    groups = profiles(field.contest)
    scores: dict[int, float] = {}
    if deep and len(groups) > 1:
        rivals = [m for m in field.of_size(len(model.members)) if m.members != model.members]
        last = [model, *rivals[:1], field.base]
        squares = left_out(field.contest, [m.fit for m in last], groups).sum(1) / field.contest.num_samples
        scores = {id(m): float(x) for m, x in zip(last, squares, strict=True)}
    return tuple(
        Rival(tuple(field.contest.candidates[c].acting.label for c in m.members), m.chi2 / field.contest.num_samples,
              field.criterion(m) - best, field.explained(m), scores.get(id(m)))
        for m in ordered
    )  # fmt: skip


def intervals(field: Field, model: Model, posterior: Posterior | None) -> dict[str, dict[str, Interval]]:
    """Return medians and 95 % intervals of the effects' parameters, by the posterior or the curvature at the fit.

    Intervals end where the box does: beyond it a law means nothing.
    """
    contest, fits = field.contest, model.fit
    if posterior is not None:
        found = {p.name: _inside(p, [float(x) for x in row]) for p, row in
                 zip(posterior.parameters, zip(*posterior.interval(), strict=True), strict=True)}  # fmt: skip
        own = [contest.candidates[c] for c in model.members]
        return {c.acting.label: {s.name: found[f"{c.acting.label} {s.name}"] for s in c.specs} for c in own}
    residual, derivative, columns = contest.linearise(fits.rows)
    normal, _ = normal_equations(contest, fits.rows, residual, derivative, columns)
    diagonal = normal[0].diagonal()
    filled = normal[0] + torch.diag(torch.where(diagonal > 0.0, 0.0, 1.0))
    spread = torch.linalg.inv(filled / overdispersion(contest, model.chi2)).diagonal().clamp(min=0.0).sqrt()
    width = {int(c): float(s) for c, s in zip(columns[0], spread, strict=False) if c >= 0}
    out: dict[str, dict[str, Interval]] = {}
    for c in model.members:
        candidate = contest.candidates[c]
        out[candidate.acting.label] = {
            spec.name: _interval(contest.parameters[k], float(fits.rows.free[0, k]), width[k])
            for spec, k in zip(candidate.specs, candidate.columns, strict=True)
        }
    return out


def _interval(parameter: Parameter, free: float, spread: float) -> Interval:
    ends = [free, free - 1.96 * spread, free + 1.96 * spread]
    return _inside(parameter, [float(np.exp(min(x, 700.0))) if parameter.scale == "log" else x for x in ends])


def _inside(parameter: Parameter, values: Sequence[float]) -> Interval:
    middle, low, high = (min(max(x, parameter.low), parameter.high) for x in values)
    return Interval(middle, low, high, parameter.unit)


def sentence(
    verdict: VerdictName, named: Sequence[Acting], gap: Gap, explained: float, nearest: str | None, poor: str | None
) -> str:
    """Return the verdict in one sentence."""
    if poor is not None:
        return f"Nothing can be said: {poor}."
    if verdict == "none":
        left = f"the model leaves {gap.base:.3g} {gap.unit}, noise alone {gap.noise_floor:.3g}"
        return f"Nothing is missing that this data can show: {left}."
    if verdict == "unknown":
        return (f"Something is missing that is none of the known effects; the nearest, {nearest}, explains"
                f" {100 * explained:.0f} % of the gap.")  # fmt: skip
    what = " and ".join(a.name if a.joint is None else f"{a.name} at joint {a.joint}" for a in named)
    return (f"The model lacks {what}: with it the held-out gap shrinks from {gap.base:.3g} to {gap.repaired:.3g}"
            f" {gap.unit} (noise alone: {gap.noise_floor:.3g}).")  # fmt: skip


def diagnose(
    given: BranchCase | JointCase | str | Path, out: str | Path, settings: Settings, *, resume: bool = False,
    progress: Progress = lambda s, d: None,
) -> Diagnosis:  # fmt: skip
    """Diagnose a case, as loaded or by its folder, and write verdict, repaired model, figures and report into ``out``.

    Raises:
        InputError: The case or the settings cannot be used; nothing is written then.
    """
    target = Path(out)
    with output_folder(target) as work:
        case = given if isinstance(given, BranchCase | JointCase) else load_case(given)
        check(case, settings)
        keep = Checkpoint(target.absolute().parent / f".{target.name}.unfinished", _key(case, settings))
        keep.open(resume)
        try:
            with one_thread():
                found = Diagnoser(case, settings, keep, progress).run()
        except InputError:
            keep.close()
            raise
        from .report import write_diagnosis  # matplotlib, once there is something to show

        write_diagnosis(work, found)
        write_repaired(work / "model.yaml", found)
        if found.posterior is not None:
            found.posterior.save(work / "posterior.npz")
        keep.close()
    return found


def _key(case: BranchCase | JointCase, settings: Settings) -> str:
    return digest(case.folder, settings, __version__)


def write_repaired(path: Path, found: Diagnosis) -> None:
    """Write the repaired model of a branch; joints have no model file."""
    case = found.case
    if not isinstance(case, BranchCase):
        return
    names = case.segment_name
    values = found.best_values
    acting = tuple(replace(a, known={n: i.median for n, i in found.parameters[a.label].items()}) for a in found.effects)
    own = [[values[f"{kind} {n}"] for n in names] for kind in ("stiffness", "damping")]
    size = np.column_stack([case.length, case.radius])
    write_model(path, BranchModel(case.name, names, np.array(own[0]), np.array(own[1]), acting, size))
