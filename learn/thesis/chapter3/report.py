"""What a reproduction of chapter 3 says: tables beside the thesis's figures, pictures, where they differ and why."""

from __future__ import annotations

from collections.abc import Sequence
from statistics import median

import numpy as np
from matplotlib.figure import Figure

from ....sim.base.host import describe
from ....sim.base.types import Array
from ...reports.page import KeyNumber, ReportContent, ReportFigure, ReportTable
from ...samplers.diagnostics import MAX_R_HAT
from . import baselines, cost, figures, literal
from .bench import DISPLACEMENT, KT
from .findings import Findings
from .prior import ETA, ETA_KT, TEMPERATURES, Pair
from .robust import STAND_IN_NOISE, STAND_INS, Study

WIDTH_FACTOR, NLL_FACTOR = 0.19 / 0.11, 3050.7 / 2268.1
"""What the inequality prior gains in the thesis (table 3.1)."""
THESIS_MINUTES = {"Baseline (R = 3)": 3.5, "svgd vs nnsvgd (R = 3)": 3.5, "Robustness (R = 2)": 3.1}


def tables(found: Findings) -> dict[str, ReportTable]:
    """Return every table by the thesis's number."""
    return {
        "table_3_1": _table_3_1(found),
        "table_3_1_sweep": _sweep(found),
        "table_3_1_letter": _letter(found),
        "figure_3_5": _samplers(found),
        "figure_3_6": _spreads(found),
        "figure_3_7": _noise(found),
        "figure_3_8": _grasp(found),
        "figure_3_9": _stand_ins(found),
        "table_a_1": _times(found),
        "cost": _cost(found),
    }


def _middle(pairs: Sequence[Pair], name: str) -> float:
    return median(getattr(p, name) for p in pairs)


def _table_3_1(found: Findings) -> ReportTable:
    rows: list[tuple[object, ...]] = [
        ("thesis, NNSVGD, kT 1/100", 11.0, "< 1", 2268.1, ""),
        ("thesis, SVGD, kT 1/100", 19.0, "< 1", 3050.7, ""),
    ]
    for kt in (TEMPERATURES[0], TEMPERATURES[-1]):
        for name, label in (("with_prior", "NNSVGD"), ("without", "SVGD")):
            runs = [getattr(p, name) for p in found.at(kt)]
            scores = [r.scores for r in runs]
            done = sum(r.convergence.converged for r in runs)
            rows.append((f"bough, {label}, kT {kt:g}", 100 * median(s.width for s in scores),
                         100 * median(s.outside for s in scores), median(s.nll for s in scores),
                         f"{done} of {len(runs)}"))  # fmt: skip
    strict = found.at(KT)
    width, nll, spread = (_middle(strict, f"{name}_ratio") for name in ("width", "nll", "spread"))
    note = (
        f"Medians over {len(strict)} simulated branches; NLL is the training loss over kT. At kT 1/100 the prior "
        f"divides each branch's width by {width:.2f}, its NLL by {nll:.2f} and the spread of its parameters by "
        f"{spread:.2f} (medians); the thesis has {WIDTH_FACTOR:.2f} and {NLL_FACTOR:.2f}. Noise-free data at that "
        f"temperature fix what a prediction depends on to {0.19 / _width(strict, 'without'):.0f} times below the "
        "thesis's width: little is left for a prior to narrow. The thesis's NLL of 2268 means a loss of 4.5 a "
        "trajectory, so its particles have "
        "used little of the data: a weak likelihood, or particles still on their way. The next table tries the first, "
        "and the one after it the thesis's algorithm by the letter."
    )
    header = ("run", "95 % width [cm]", "truth outside [%]", "NLL", "converged")
    return ReportTable("Table 3.1: what the inequality prior gains", header, rows, note)


def _sweep(found: Findings) -> ReportTable:
    rows: list[tuple[object, ...]] = []
    for kt in TEMPERATURES:
        pairs = found.at(kt)
        rows.append(_gains(f"kT {kt:g}, eta {ETA:g}", pairs))
    rows += [_gains(f"kT {ETA_KT:g}, eta {p.eta:g}, first branch", [p]) for p in found.etas]
    reached = [kt for kt in TEMPERATURES if _middle(found.at(kt), "width_ratio") >= 1.7]
    best = max(TEMPERATURES, key=lambda kt: _middle(found.at(kt), "width_ratio"))
    said = (
        f"The factor 1.7 is reached at kT {', '.join(f'{kt:g}' for kt in reached)}"
        if reached
        else f"The factor 1.7 is not reached; the largest: {_middle(found.at(best), 'width_ratio'):.2f} at kT {best:g}"
    )
    note = (
        f"{said}. As the likelihood weakens the posterior becomes the prior, and the ordered part of the box is a "
        f"thirty-sixth of the box at R = 3. eta is the prior's sharpness in logarithms ({ETA:g} unless stated)."
    )
    header = (
        "posterior",
        "width without [cm]",
        "width with [cm]",
        "width ratio",
        "NLL ratio",
        "parameter spread ratio",
    )
    return ReportTable("Why: the prior's gain over temperature and eta", header, rows, note)


def _gains(label: str, pairs: Sequence[Pair]) -> tuple[object, ...]:
    width = [100 * median(getattr(p, name).scores.width for p in pairs) for name in ("without", "with_prior")]
    return (label, *width, *(_middle(pairs, f"{name}_ratio") for name in ("width", "nll", "spread")))


def _letter(found: Findings) -> ReportTable:
    gains = literal.gains(found.letter, found.options.marks)
    rows: list[tuple[object, ...]] = []
    for (sigma, eta), branches in found.letter.items():
        for m, mark in enumerate(found.options.marks):
            own = [scores[m] for scores in branches]
            gain = next((g for g in gains if (g.sigma, g.eta, g.iterations) == (sigma, eta, mark)), None)
            label = f"box of sigma {sigma:g}, {'alone' if eta is None else f'eta {eta:g}'}, {mark} iterations"
            ratios = ("1", "1") if gain is None else (_ratio(gain.width), _ratio(gain.nll))
            rows.append((label, 100 * median(s.width for s in own), 100 * median(s.outside for s in own),
                         median(s.nll for s in own), *ratios))  # fmt: skip
    count = len(next(iter(found.letter.values())))
    note = (
        f"{count} branches, each with starts of its own, at kT 1/100. Springs and dampers themselves (no logarithms), "
        "finite differences of 0.5, one Gaussian kernel whose sigma is the median distance, Adam with a step of 3.0, "
        "eq. 3.17 per N m/rad: the thesis's algorithm, its eta and the box's sigma not stated (0.01 is GPyTorch's "
        "default: a particle that leaves the box then brakes Adam for all). Width, share and NLL are medians; ratios "
        "are geometric means of box alone over eta, branch by branch, with a 95 % interval (Student's t). "
        f"{letter_says(gains)} The NLL says how far the particles are from rest (compare table 3.1): such a width is "
        "how far they have come, not how much the data say."
    )
    header = ("run", "95 % width [cm]", "truth outside [%]", "NLL", "width ratio", "NLL ratio")
    return ReportTable("SVGD by the letter of the thesis", header, rows, note)


def _ratio(ratios: Array) -> str:
    middle, low, high = literal.interval(ratios)
    return f"{middle:.2f} ({low:.2f} to {high:.2f})"


def letter_says(gains: Sequence[literal.Gain]) -> str:
    """Say what the letter's runs allow to conclude about the thesis's factors, from intervals alone."""
    said = []
    for name, factor in (("width", WIDTH_FACTOR), ("nll", NLL_FACTOR)):
        ends = {(g.sigma, g.eta, g.iterations): literal.interval(getattr(g, name)) for g in gains}
        gained = [key for key, (_, low, _) in ends.items() if low > 1.0]
        holds = [key for key, (_, low, high) in ends.items() if low <= factor <= high]
        label = {"width": "width", "nll": "NLL"}[name]
        listed = ", ".join(f"sigma {sigma:g}, eta {eta:g} at {count}" for sigma, eta, count in holds)
        said.append(
            f"{label}: the prior gains beyond doubt in {len(gained)} of {len(ends)} rows; the thesis's {factor:.2f} is "
            + (f"inside the interval of {listed}." if holds else "outside every interval.")
        )
    return " ".join(said)


def _full(found: Findings, origin: baselines.Origin) -> dict[str, list[baselines.Entry]]:
    """Entries from one kind of start at the full budget by method, one a branch."""
    out: dict[str, list[baselines.Entry]] = {}
    for e in found.entries:
        if e.share == 1.0 and e.origin == origin:
            out.setdefault(e.method, []).append(e)
    return out


def settled(found: Findings) -> list[int]:
    """Return the branches whose reference is one: its chains agree."""
    return [b for b, reference in enumerate(found.references) if reference.settled]


def beaten(found: Findings, origin: baselines.Origin) -> tuple[list[str], list[str]]:
    """Return the gradient methods that beat, and those that do not beat, every Metropolis-Hastings from equal starts.

    To beat is a smaller energy distance to the posterior, a smaller NLL and a narrower interval, each the median over
    the branches with a settled reference, at equal calls. Where no branch has one, nobody is ranked: both lists are
    empty.
    """
    judged = settled(found)
    if not judged:
        return [], []
    full = {name: [e for e in own if e.branch in judged] for name, own in _full(found, origin).items()}
    rivals = [name for name in full if name not in baselines.GRADIENT]
    wins: tuple[list[str], list[str]] = ([], [])
    for name in baselines.GRADIENT:
        mine = _measures(full[name])
        better = all(a < b for rival in rivals for a, b in zip(mine, _measures(full[rival]), strict=True))
        wins[0 if better else 1].append(name)
    return wins


def ranking(found: Findings) -> str:
    """Say who beats Metropolis-Hastings from each kind of start, or why nobody is ranked."""
    if not settled(found):
        return f"no ranking of samplers: R-hat {max(r.worst_r_hat for r in found.references):.2g}"
    said = []
    for origin in baselines.ORIGINS:
        better, other = beaten(found, origin)
        said.append(f"{len(better)} of {len(better) + len(other)} from the {origin}")
    return f"gradient methods that beat Metropolis-Hastings at equal calls and starts: {', '.join(said)}"


def _measures(entries: Sequence[baselines.Entry]) -> tuple[float, float, float]:
    return (
        median(e.distance for e in entries), median(e.scores.nll for e in entries),
        median(e.scores.width for e in entries),
    )  # fmt: skip


def _samplers(found: Findings) -> ReportTable:
    judged = settled(found)
    rows: list[tuple[object, ...]] = []
    for origin in baselines.ORIGINS:
        for name, entries in _full(found, origin).items():
            _, nll, width = _measures(entries)
            outside, calls = 100 * median(e.scores.outside for e in entries), median(e.calls for e in entries)
            own = [e for e in entries if e.branch in judged]
            ranked = [median(e.distance for e in own), median(e.worst_mean for e in own)] if own else ["no ranking"] * 2
            rows.append((f"from the {origin}: {name}", round(calls), 100 * width, outside, nll, *ranked))
    worst = ", ".join(f"{r.worst_r_hat:.3g}" for r in found.references)
    who = [f"From the {origin}: {', '.join(beaten(found, origin)[0]) or 'none'}." for origin in baselines.ORIGINS]
    note = (
        f"Medians over {found.options.branches} branches at kT 1/100. A call is one rollout of one training "
        "trajectory; finite differences and the search for modes count, the latter for every method that starts there. "
        "Energy distance is to a long run of emcee from starts of its own, in units of what as many exact draws score "
        f"(1 is perfect); emcee's largest split R-hat by branch is {worst}; only branches below {MAX_R_HAT:g} are "
        f"ranked: {len(judged)}. NNSVGD is compared with the posterior under its own prior. "
        + ("Better than every Metropolis-Hastings in distance, NLL and width. " + " ".join(who) if judged else
           f"{ranking(found).capitalize()}.")
        + " The thesis says that all of them are, without numbers."
    )  # fmt: skip
    header = ("method", "calls", "95 % width [cm]", "truth outside [%]", "NLL", "energy distance", "worst mean [sd]")
    return ReportTable("Figure 3.5: samplers from equal starts at equal simulator calls", header, rows, note)


def _spreads(found: Findings) -> ReportTable:
    names = [p.name for p in found.benches[0].system.parameters]
    pairs = {kt: found.at(kt) for kt in (TEMPERATURES[0], TEMPERATURES[-1])}
    rows: list[tuple[object, ...]] = []
    for i, name in enumerate(names):
        cells = [median(getattr(p, run).scores.spread[i] for p in pairs[kt])
                 for kt in pairs for run in ("without", "with_prior")]  # fmt: skip
        rows.append((name, *cells))
    header = ("parameter", *(f"{label}, kT {kt:g}" for kt in pairs for label in ("SVGD", "NNSVGD")))
    note = "Standard deviation of the parameter's logarithm (0.1 is 10 %), medians over the branches."
    return ReportTable("Figure 3.6: spread of springs and dampers", header, rows, note)


def _row(study: Study) -> tuple[object, ...]:
    p = study.prediction
    done = "yes" if study.convergence.converged else "no"
    return (study.label, 100 * p.width, 100 * study.outside, 100 * p.rms, 100 * float(study.error.max()), done)


_STUDY = ("study", "95 % width [cm]", "points outside [%]", "rms misfit [cm]", "worst error of K [%]", "converged")


_LETTER = (
    "Rows by the letter: planar branches on revolute joints, the published loss, the thesis's SVGD with its kT and "
    "iterations, and an interval of the particles' motions alone, without a sensor's noise, as the thesis draws it."
)


def _by_the_letter(found: Findings, name: str) -> list[tuple[object, ...]]:
    rest = ("not scored", "not scored", "not judged")
    return [(f"by the letter, {s.label}, kT 1/{1 / s.kt:.0f}, {s.iterations} iterations", 100 * s.width,
             100 * s.outside, *rest) for s in found.letter_studies[name]]  # fmt: skip


def _noise(found: Findings) -> ReportTable:
    note = (
        "Gaussian noise of this share of the rms on force and on motion alike, R = 2, spherical joints; the likelihood "
        "is Gaussian with inferred noise, the predicted interval that of the sensor's reading, and points are what "
        "it read: 5 % outside is right. At 0 % there is no noise to infer; what is left is the round-off of float32, "
        "which is not the Gaussian that the likelihood supposes, and the sampler may say so. "
        "The thesis's text has no numbers for this figure."
    )
    rows = [*(_row(s) for s in found.noise), *_by_the_letter(found, "figure_3_7")]
    return ReportTable("Figure 3.7: noise on force and motion", _STUDY, rows, f"{note} {_LETTER}")


def _grasp(found: Findings) -> ReportTable:
    note = (
        "Trained at 0.9 of the last segment's length, predicted elsewhere, 3 % noise. The thesis has no numbers here."
    )
    rows = [*(_row(s) for s in found.grasp), *_by_the_letter(found, "figure_3_8")]
    return ReportTable("Figure 3.8: another grasp location", _STUDY, rows, f"{note} {_LETTER}")


def _stand_ins(found: Findings) -> ReportTable:
    both = [map(_row, found.stand_ins), _by_the_letter(found, "figure_3_9")]
    rows = [(*row, item[3]) for part in both for row, item in zip(part, STAND_INS, strict=True)]
    note = (
        f"No hardware here: simulated branches with {100 * STAND_IN_NOISE:g} % noise stand in for the thesis's arms, "
        "as many segments, samples and trajectories (3 + 3, two folds). They show the method at work on that little "
        "data, not that the model is true of real branches: the thesis's 23.9 % outside is what its model lacked. "
        f"{_LETTER}"
    )
    header = (*_STUDY, "thesis, outside [%]")
    return ReportTable("Figure 3.9 and table 3.2: stand-ins for the hardware", header, rows, note)


def _times(found: Findings) -> ReportTable:
    first = found.pairs[0]
    rows: list[tuple[object, ...]] = []
    for label, run in (("SVGD", first.without), ("NNSVGD", first.with_prior)):
        rows.append((f"bough, {label}, R = 3", found.options.particles, found.options.iterations, run.seconds,
                     run.simulating, run.world_steps, "yes" if run.convergence.converged else "no"))  # fmt: skip
    rows += [(f"thesis, {name}", "not given", 90 if "Robustness" in name else 70, 60 * minutes, "not given",
              "not given", "not given") for name, minutes in THESIS_MINUTES.items()]  # fmt: skip
    machine = describe()
    note = (
        f"First branch, on {machine['cores']} cores of {machine['cpu']}; the thesis's are on a GPU with Isaac Gym. The "
        "time is from the first search for modes to the verdict on convergence. Converged means: "
        f"{first.without.convergence.reason}. Settings: 5 training and {found.options.unseen} unseen trajectories of "
        "120 points, box 5 to 200, kT 1/100, finite differences of 1 % (thesis: 0.5 of its unit)."
    )
    header = ("run", "particles", "iterations", "time [s]", "in the simulator [s]", "world-steps", "converged")
    return ReportTable("Table A.1: settings and times", header, rows, note)


def _cost(found: Findings) -> ReportTable:
    rows: list[tuple[object, ...]] = []
    for name, costs in found.costs.items():
        slope, fit = cost.linear_fit(costs)
        sizes = ", ".join(str(c.size) for c in costs)
        times = ", ".join(f"{1000 * c.seconds:.0f}" for c in costs)
        rows.append((name, sizes, times, 1000 * slope, fit, cost.exponent(costs)))
    note = (
        "An iteration is one gradient of all particles. Rollouts grow linearly with the number of segments R, 1 + 4 R "
        "for each particle and trajectory, and each rollout takes time in proportion to its links: time grows with R "
        "faster than linearly, and that is the price of central differences."
    )
    header = ("grows", "sizes", "time [ms]", "slope [ms]", "R^2 of a line", "power")
    return ReportTable("Cost of an iteration", header, rows, note)


def content(found: Findings) -> ReportContent:
    """Return the page."""
    strict, first = found.at(KT), found.pairs[0]
    ratio = _middle(strict, "width_ratio")
    done = first.without.convergence.converged and first.with_prior.convergence.converged
    wide, narrow = (1000 * _width(strict, name) for name in ("without", "with_prior"))
    headline = (
        f"At the thesis's temperature the 95 % interval is {narrow:.2f} mm wide with the inequality prior and "
        f"{wide:.2f} mm without (median factor of a branch: {ratio:.2f}); {ranking(found)}."
    )
    if not done:
        headline = f"The run of table 3.1 did not converge: {_failed(first)}. {headline}"
    status = "good" if done and ratio >= 1.7 and _all_beat(found) else "warning" if done else "bad"
    return ReportContent(
        title="Chapter 3 in simulation", headline=headline, status=status, numbers=_numbers(found),  # type: ignore[arg-type]
        tables=list(tables(found).values()), figures=_figures(found),
        details={**vars(found.options), **{f"seconds, {k}": v for k, v in found.seconds.items()}, **describe()},
        further=[("tables.json", "every table of this page"), ("docs/chapter3.md", "one run, and what it means")],
    )  # fmt: skip


def _all_beat(found: Findings) -> bool:
    return bool(settled(found)) and not any(beaten(found, origin)[1] for origin in baselines.ORIGINS)


def _failed(pair: Pair) -> str:
    return "; ".join(r.convergence.reason for r in (pair.without, pair.with_prior) if not r.convergence.converged)


def _width(pairs: Sequence[Pair], name: str) -> float:
    return median(getattr(p, name).scores.width for p in pairs)


def _numbers(found: Findings) -> list[KeyNumber]:
    strict, weak, first = found.at(KT), found.at(TEMPERATURES[-1]), found.pairs[0]
    outside = max(p.with_prior.scores.outside for p in strict)
    return [
        KeyNumber("Width ratio, kT 1/100", _middle(strict, "width_ratio"), "", "Thesis: 1.73. Why less: table 3.1."),
        KeyNumber(f"Width ratio, kT {TEMPERATURES[-1]:g}", _middle(weak, "width_ratio"), "",
                  "Where the data say so little that the prior matters."),
        KeyNumber("NLL ratio, kT 1/100", _middle(strict, "nll_ratio"), "", "Thesis: 1.35; above 1 is lower with it."),
        KeyNumber("Truth outside, worst branch", 100 * outside, "%", "With the prior; thesis: below 1 %."),
        KeyNumber("Time, NNSVGD", first.with_prior.seconds, "s", "First branch, modes and "
                  f"{found.options.iterations} iterations; thesis: 210 s."),
        KeyNumber("World-steps, NNSVGD", first.with_prior.world_steps, "", "Steps of single worlds for that run; "
                  f"{cost.share_simulating(first.with_prior.seconds, first.with_prior.simulating)}."),
    ]  # fmt: skip


def _figures(found: Findings) -> list[ReportFigure]:
    weak = TEMPERATURES[-1]
    return [
        ReportFigure("figure_3_5.png", _baseline_figure(found), "Figure 3.5: 95 % bands (grey) of every method at the "
                     "full budget about the truth (red) of an unseen trajectory of the first branch, and less the "
                     "truth, each in a scale of its own. All start from the prior (upper half) or about the modes."),
        ReportFigure("figure_3_5_calls.png", _calls_figure(found), "Distance to the posterior and interval width over "
                     "simulator calls, first branch. A narrow interval is good only where the distance is small; "
                     "distances stand only where the reference's R-hat is below 1.05."),
        ReportFigure("figure_3_6.png", _joint_figure(found), "Figure 3.6: springs and dampers without and with the "
                     f"inequality prior, first branch, at kT 1/100 and at kT {weak:g}."),
        ReportFigure("table_3_1_sweep.png", _sweep_figure(found), "What the prior gains over temperature, all "
                     "branches, and by the letter of the thesis, over branches with a 95 % interval."),
        ReportFigure("figure_3_7.png", _study_figure(found.noise, (1, -1), "noise on force and motion"),
                     "Figure 3.7: interval width and points outside over noise, and predicted trajectories."),
        ReportFigure("figure_3_8.png", _study_figure(found.grasp, (1, 2), "grasped at"),
                     "Figure 3.8: trained at 0.9 of the length, predicted elsewhere."),
        ReportFigure("figure_3_9.png", _study_figure(found.stand_ins, (0, 1, 2), "stand-in"),
                     "Figure 3.9: simulated stand-ins for the hardware, each predicted from the other fold."),
        ReportFigure("cost.png", _cost_figure(found), "Time and rollouts of an iteration over particles, trajectories "
                     "and segments R; grey: straight line."),
    ]  # fmt: skip


def _baseline_figure(found: Findings) -> Figure:
    bench, width = found.benches[0], {}
    bands: dict[str, dict[str, tuple[Array, Array]]] = {}
    vertical = DISPLACEMENT.index(2)
    for e in found.entries:
        if e.branch == 0 and e.share == 1.0:
            low, high = bench.predictive(e.theta)
            name = f"{e.method}, {e.origin}"
            ends = (low[0, :, vertical].cpu().numpy(), high[0, :, vertical].cpu().numpy())
            bands.setdefault(e.origin, {})[name] = ends
            width[name] = e.scores.width
    truth = bench.displacement[0, :, vertical].cpu().numpy()
    return figures.baseline_figure(bench.unseen[0].t, truth, bands, width=width)


def _calls_figure(found: Findings) -> Figure:
    curves: dict[str, dict[str, tuple[list[float], list[float], list[float]]]] = {}
    for e in found.entries:
        if e.branch == 0:
            own = curves.setdefault(f"from the {e.origin}", {}).setdefault(e.method, ([], [], []))
            for column, value in zip(own, (e.calls, e.distance, e.scores.width), strict=True):
                column.append(float(value))
    return figures.calls_figure(curves, reference=found.references[0].worst_r_hat)


def _joint_figure(found: Findings) -> Figure:
    bench, rows = found.benches[0], []
    for kt in (TEMPERATURES[0], TEMPERATURES[-1]):
        pair = found.at(kt)[0]
        without, with_prior = (r.theta.exp().cpu().numpy() for r in (pair.without, pair.with_prior))
        rows.append((f"kT {kt:g}", without, with_prior))
    return figures.joint_figure(rows, bench.truth.exp().numpy(), bench.case.segment_name)


def _sweep_figure(found: Findings) -> Figure:
    def by_branch(value: str) -> np.ndarray:
        """Return a value of all problems, shape [branches, temperatures]."""
        return np.array([[getattr(p, value) for p in found.at(kt)] for kt in TEMPERATURES]).T

    without = np.array([[p.without.scores.width for p in found.at(kt)] for kt in TEMPERATURES]).T
    gains: dict[str, list[tuple[float, float, float]]] = {}
    for g in literal.gains(found.letter, found.options.marks):
        gains.setdefault(f"sigma {g.sigma:g}, eta {g.eta:g}", []).append(literal.interval(g.width))
    return figures.sweep_figure(
        TEMPERATURES, by_branch("width_ratio"), by_branch("nll_ratio"), without, found.options.marks, gains
    )


def _study_figure(studies: Sequence[Study], shown: Sequence[int], unit: str) -> Figure:
    return figures.bars_and_bands_figure(
        [s.label for s in studies], np.array([s.prediction.width for s in studies]),
        np.array([s.outside for s in studies]), [(studies[i].label, studies[i].prediction) for i in shown], unit=unit,
    )  # fmt: skip


def _cost_figure(found: Findings) -> Figure:
    def drawn(costs: Sequence[cost.Cost]) -> tuple[Array, Array, Array]:
        """Return sizes, seconds and rollouts of costs, [N] each."""
        return (
            np.array([c.size for c in costs]), np.array([c.seconds for c in costs]),
            np.array([c.rollouts for c in costs]),
        )  # fmt: skip

    return figures.cost_figure({name: drawn(costs) for name, costs in found.costs.items()})
