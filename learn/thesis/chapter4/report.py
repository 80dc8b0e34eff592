"""What a reproduction of chapter 4 says: tables beside the figures of thesis and author, pictures, what follows."""

from __future__ import annotations

import math
from collections.abc import Mapping
from functools import partial

import numpy as np
from matplotlib.figure import Figure

from ....sim.trees.fractal import grow_fractal
from ....sim.trees.species import grow
from ....sim.trees.tree import Tree
from ...policies.compare import Episodes, by_kind, mean, relative_success
from ...policies.tables import wilson
from ...reports.page import KeyNumber, ReportContent, ReportFigure, ReportTable
from ..common.interval import LEAST_SEEDS, Interval
from . import figures
from .findings import ALL, COLUMNS, FORCE, RUPTURE, STEPS, SUCCESS, Claim, Findings, by_pattern, claims, gentler
from .runs import AUTHOR_MPC, AUTHOR_TOUCH, BEYOND, COMPARED, FORESTS, FRACTAL, MPC, MPC_TREE, PATTERNS, TORQUES, Run

_SHOWN = (SUCCESS, FORCE, RUPTURE, STEPS, "Broken", "Rolling %", "Retracting %", "Slowing %")
_PLANNED = {MPC: "MPC, no tree", MPC_TREE: "MPC, knows the tree"}
NOISES = (0.01, 0.1, 0.25)
"""Noise of the trees' parameters in figure B.8, relative."""


def tables(found: Findings) -> dict[str, ReportTable]:
    """Return every table by the thesis's number."""
    out = {
        "claims": _claims(found),
        "figure_4_4": _policies(found),
        "figure_4_4_forests": _forests(found),
        "figure_B_3_B_6": _ablations(found),
        "figure_B_4": _torques(found),
    }
    return out | ({"figure_B_7": _touch(found)} if found.touch else {})


def scale(found: Findings) -> str:
    """Return at which scale the runs are, in words."""
    ppo = found.config["ppo"]
    return (
        f"{ppo['num_envs']} worlds and {ppo['iterations']} iterations a policy with the preset {found.options.preset} "
        "(the author's: 8192 and 1500)"
    )


# ---- tables --------------------------------------------------------------------------------------------------------


def _claims(found: Findings) -> ReportTable:
    said = claims(found)
    rows: list[tuple[object, ...]] = [(c.text, c.thesis, _cell(c.found, 2), c.verdict) for c in said]
    note = (
        f"Ratios and differences of seed k of one policy and seed k of the other; mean and 95 % interval over seeds "
        f"(Student's t), of ratios geometric and by their logarithms. A claim follows where the whole interval of "
        f"{LEAST_SEEDS} seeds or more is on its side, and "
        "'by less' where the mean does not reach the thesis's figure. The hardest pattern is the one in which PPO "
        f"succeeds least: {found.hardest}. The thesis trained once, or does not say. In ratios one step above 80 N is "
        "counted where there was none. Of the policies past the thesis "
        f"{', '.join(gentler(said)) or 'none'} presses less than PCAP beyond the intervals and succeeds as often."
    )
    return ReportTable("What follows", ("claim", "thesis", "here", "verdict"), rows, note)


def _policies(found: Findings) -> ReportTable:
    rows: list[tuple[object, ...]] = []
    for pattern in (ALL, *found.patterns):
        for policy in COMPARED:
            own = Run(policy)
            cells = (_cell(found.over_seeds(own, c, pattern=pattern)) for c in _SHOWN)
            trials = sum(len(e.target) for e in found.each(own, pattern=pattern))
            rows.append((policy, pattern, trials, _cell(found.relative(policy, pattern)), *cells))
        rows += [_mpc_row(found, name, episodes, pattern) for name, episodes in found.planned.items()]
        if pattern in PATTERNS:
            sr, force, rupture = AUTHOR_MPC[PATTERNS.index(pattern)]
            rest = ("-",) * (len(_SHOWN) - 3)
            rows.append(
                ("author's MPC, its trees", pattern, 60, "-", f"{sr:.1f}", f"{force:.1f}", f"{rupture:.1f}", *rest)
            )
    mpc = ["MPC without the tree"] if MPC in found.planned else []
    oracle = ", ".join([*(run.name for run in found.ensemble), *mpc])
    note = (
        f"Ours: {scale(found)}. Unseen trees, all contacts on, the same worlds for all; mean and 95 % interval over "
        f"the seeds. Relative: of the {int(found.possible().sum())} of {len(found.possible())} worlds that an oracle "
        f"of {oracle} reaches. The thesis gives PPO 69 % and PCAP 59 % on its hardest pattern, relative, PCAP's force "
        "about 3 and its steps above 80 N about 15 times lower, and no other numbers. Broken: joints, '-' where wood "
        "has no strength. What the last three are is in docs/reach.md. Both MPC are ours, tried once, their success "
        f"with Wilson's interval; the thesis's knows no tree. {', '.join(BEYOND)} are not the thesis's."
    )
    header = ("policy", "pattern", "trials", "SR relative %", *_SHOWN)
    return ReportTable("Figures 4.4 (top) and B.1: policies by occlusion pattern", header, rows, note)


def _mpc_row(found: Findings, name: str, episodes: Episodes, pattern: str) -> tuple[object, ...]:
    """Return the row of an MPC; its success has Wilson's interval over the worlds."""
    mask = by_kind(episodes)[pattern]
    own, possible = episodes.of(mask), found.possible()[mask]
    share, count = relative_success(own, possible)
    raw = mean(own, COLUMNS[SUCCESS]) / 100.0
    rest = (_cell(Interval(mean(own, COLUMNS[c]), math.nan, math.nan, 1)) for c in _SHOWN[1:])
    return (_PLANNED[name], pattern, len(own.target), _wilson(share, count), _wilson(raw, len(own.target)), *rest)


def _wilson(share: float, trials: int) -> str:
    if math.isnan(share):
        return "-"
    return "{:.1f} ({:.1f} to {:.1f})".format(*(100.0 * v for v in (share, *wilson(share, trials))))


def forest_success(found: Findings) -> list[list[Interval]]:
    """Return PCAP's success by the forest of the test (rows) and of training (columns)."""
    return [
        [found.over_seeds(Run("pcap", own), SUCCESS, () if own == test else (f"forest={test}",)) for own in FORESTS]
        for test in FORESTS
    ]


def _forests(found: Findings) -> ReportTable:
    cells = forest_success(found)
    rows: list[tuple[object, ...]] = [(name, *map(_cell, row)) for name, row in zip(FORESTS, cells, strict=True)]
    note = (
        "Success of PCAP [%], raw; columns: forest of training, rows: forest of the test. In the thesis Ta's policies "
        "do best, Tc's worst, and Tb's trees are easiest for all; trained among Ta and tested among Tb: 98.3 %."
    )
    return ReportTable("Figure 4.4 (bottom left): forests", ("tested among", *FORESTS), rows, note)


def _ablations(found: Findings) -> ReportTable:
    shown = (SUCCESS, FORCE, RUPTURE)
    kinds = (
        ("PCAP, L-system", Run("pcap"), ()),
        ("PCAP, fractal", Run("pcap", FRACTAL), ()), ("PCAP, fractal", Run("pcap", FRACTAL), ("forest=Ta",)),
        ("PCAP, L-system, beams", Run("pcap", springs="beam"), ()),
    )  # fmt: skip
    rows: list[tuple[object, ...]] = []
    for label, run, changes in kinds:
        where = "as trained" if not changes else "L-system (Ta)"
        seeds = len(found.options.repeats(run))
        rows.append((label, where, seeds, *(_cell(found.over_seeds(run, c, changes)) for c in shown)))
    note = (
        "The thesis shows both as figures without numbers: policies among L-systems succeed more, with less force and "
        "fewer ruptures, than among chapter 3's fractal trees; and with rudimentary springs than with beams."
    )
    return ReportTable("Figures B.3 and B.6: geometry and springs", ("trained", "tested", "seeds", *shown), rows, note)


def _torques(found: Findings) -> ReportTable:
    shown = (SUCCESS, FORCE, RUPTURE)
    rows: list[tuple[object, ...]] = [
        (p, len(found.options.repeats(Run(p))), *(_cell(found.over_seeds(Run(p), c)) for c in shown))
        for p in ("pcap", *TORQUES)
    ]
    note = (
        "All patterns. In the thesis PPO+ has about 2 times PCAP's force and 5 times its ruptures at like success, and "
        "CPO+ is gentler than PPO+ but succeeds less."
    )
    return ReportTable("Figure B.4: raw torques instead of a flag", ("policy", "seeds", *shown), rows, note)


def _touch(found: Findings) -> ReportTable:
    names = ("accuracy", "auc", "specificity", "recall")
    rows: list[tuple[object, ...]] = []
    for kind, author in AUTHOR_TOUCH.items():
        accuracy, area, specificity, recall = author
        rows.append((f"author, {kind}", f"{accuracy} %", area, f"{specificity} %", f"{recall} %"))
        rows.append((f"bough, {kind}", *(_share(found.touch[kind][n], n == "auc") for n in names)))
    note = (
        f"Ours: {found.options.rounds} rounds of simulated motions, four groups of them told by a model of the others, "
        "at the threshold with a specificity of 95 %; 95 % intervals over recordings. The author's: real recordings, "
        "one split. What bough's classifiers do on those is in docs/touch.md."
    )
    header = ("classifier", "accuracy", "AUC", "specificity", "recall")
    return ReportTable("Figure B.7: classifiers of contact", header, rows, note)


def _cell(value: Interval, digits: int = 1) -> str:
    if math.isnan(value.mean):
        return "-"
    if math.isnan(value.low):
        return f"{value.mean:.{digits}f}"
    return f"{value.mean:.{digits}f} ({value.low:.{digits}f} to {value.high:.{digits}f})"


def _share(values: list[float], plain: bool) -> str:
    if plain:
        return "{:.3f} ({:.3f} to {:.3f})".format(*values)
    return "{:.1f} % ({:.1f} to {:.1f})".format(*(100.0 * v for v in values))


# ---- the page ------------------------------------------------------------------------------------------------------


def content(found: Findings) -> ReportContent:
    """Return what the page says."""
    said = claims(found)
    count = sum(c.holds is True for c in said)
    short = sum(c.as_much is False for c in said if c.holds)
    return ReportContent(
        title="Chapter 4 again, in simulation",
        headline=f"{count} of {len(said)} claims follow, {short} of them by less than in the thesis; "
        f"{sum(c.holds is False for c in said)} do not, {sum(c.holds is None for c in said)} cannot be said. "
        f"{scale(found)}.",
        status="good" if count == len(said) else "warning",
        numbers=_numbers(found, said),
        tables=list(tables(found).values()),
        figures=_figures(found),
        details=_details(found),
        further=[
            ("runs/NAME/report.html", "every training run; runs/NAME/evaluation.md: its tests"),
            ("tables.json", "all tables"),
            ("docs/chapter4.md", "what is compared with what, and how far a scale carries"),
        ],
    )


def _numbers(found: Findings, said: list[Claim]) -> list[KeyNumber]:
    hard = found.hardest
    says = "Relative to the oracle, {}, mean over seeds; thesis {} %."
    out = [KeyNumber(f"{p.upper()} succeeds", found.relative(p, hard).mean, "%", says.format(hard, thesis))
           for p, thesis in (("ppo", 69), ("pcap", 59))]  # fmt: skip
    force = said[0].found.mean
    return [
        *out,
        KeyNumber("PPO's force over PCAP's", force, "", f"Mean contact force, {hard}; thesis about 3."),
        KeyNumber("Policies", len(found.minutes), "", f"Trained one after another: {scale(found)}."),
        KeyNumber("Training", sum(found.minutes.values()), "min", "In iterations; worlds and tests come on top."),
    ]  # fmt: skip


def _figures(found: Findings) -> list[ReportFigure]:
    seed, over = found.options.seed, "bars: mean over seeds, lines: 95 % interval."
    steps = {"steps to the target\n[% of the limit]": _by_pattern(found, STEPS)}
    shown = [
        ("4_4", _top(found), f"Figure 4.4, top; {over}"),
        ("4_4_forests", _matrix(found), "Figure 4.4, bottom left: PCAP's success [%]."),
        ("B_1", figures.patterns_figure(steps, {}), f"Figure B.1: time to the target; {over}"),
        ("B_2", figures.trees_figure(_geometries(seed)),
         "Figure B.2: chapter 3's fractal trees, and an L-system's (Tc); the first without noise."),
        ("B_3", _few(found, _geometry), f"Figure B.3: geometry; {over}"),
        ("B_4", _few(found, _with_torques), f"Figure B.4: torques instead of a flag; {over}"),
        ("B_6", _few(found, _springs), f"Figure B.6: springs; {over}"),
        ("B_8", figures.trees_figure(_perturbed(seed)), "Figure B.8: trees Ta by the noise of their parameters."),
    ]  # fmt: skip
    if found.touch:
        roc = figures.roc_figure(found.touch, AUTHOR_TOUCH)
        shown.insert(-1, ("B_7", roc, "Figure B.7: ROC of both classifiers on simulated recordings."))
    return [ReportFigure(f"figure_{name}.png", drawn, caption) for name, drawn, caption in shown]


def _by_pattern(found: Findings, column: str) -> Mapping[str, Mapping[str, Interval]]:
    ours = by_pattern(found, lambda policy, pattern: found.over_seeds(Run(policy), column, pattern=pattern))
    theirs = {
        _PLANNED[name]: {p: Interval(mean(e.of(e.kinds[p]), COLUMNS[column]), math.nan, math.nan, 1)
                         for p in found.patterns}
        for name, e in found.planned.items()
    }  # fmt: skip
    return {**ours, **theirs}


def _top(found: Findings) -> Figure:
    """Draw success (raw, as the author's is), force and ruptures by pattern, and the author's MPC beside them."""
    panels = {
        "success, raw [%]": _by_pattern(found, SUCCESS),
        "mean force [N]": _by_pattern(found, FORCE),
        "steps above 80 N [%]": _by_pattern(found, RUPTURE),
    }
    rows = [AUTHOR_MPC[PATTERNS.index(p)] for p in found.patterns]
    marks = {label: ("author's MPC, its trees", [row[k] for row in rows]) for k, label in enumerate(panels)}
    return figures.patterns_figure(panels, marks)


def _matrix(found: Findings) -> Figure:
    values = np.array([[cell.mean for cell in row] for row in forest_success(found)])
    return figures.forests_figure(values, FORESTS)


_geometry = {"L-system": (Run("pcap"), ()), "fractal": (Run("pcap", FRACTAL), ()),
             "fractal, in Ta": (Run("pcap", FRACTAL), ("forest=Ta",))}  # fmt: skip
_with_torques = {p: (Run(p), ()) for p in ("pcap", *TORQUES)}
_springs = {"rudimentary": (Run("pcap"), ()), "beam": (Run("pcap", springs="beam"), ())}


def _few(found: Findings, rows: Mapping[str, tuple[Run, tuple[str, ...]]]) -> Figure:
    labels = {"success [%]": SUCCESS, "mean force [N]": FORCE, "steps above 80 N [%]": RUPTURE}
    return figures.groups_figure(
        {label: {name: found.over_seeds(run, column, changes) for name, (run, changes) in rows.items()}
         for label, column in labels.items()}
    )  # fmt: skip


def _geometries(seed: int) -> dict[str, list[Tree]]:
    """Return trees of both kinds: the first without noise."""
    noises = (0.0, 0.1, 0.1, 0.1)
    fractal = partial(grow_fractal, 4, children=3, length=0.8, radius=0.02)
    return {
        "fractal": [fractal(noise=n, seed=seed + k) for k, n in enumerate(noises)],
        "L-system Tc": [grow("Tc", 3, noise=n, seed=seed + k) for k, n in enumerate(noises)],
    }


def _perturbed(seed: int) -> dict[str, list[Tree]]:
    return {f"noise {n:g}": [grow("Ta", 3, noise=n, seed=seed + k) for k in range(5)] for n in NOISES}


def _details(found: Findings) -> dict[str, object]:
    o, config = found.options, found.config
    ppo = {name: ", ".join(map(str, v)) if isinstance(v, list) else v for name, v in config["ppo"].items()}
    options = {"preset": o.preset, "test sets": o.sets, "worlds a test set": o.worlds, "seeds": o.seeds,
               "seeds of ablations": o.ablation_seeds, "first seed": o.seed, "rounds of touch": o.rounds,
               "device": o.device}  # fmt: skip
    minutes = {f"training {run.name} [min]": value for run, value in found.minutes.items()}
    seconds = {f"{name}, this time [s]": value for name, value in found.seconds.items()}
    changed = " with changes" if config["source"].get("changed") else ""
    source = f"{config['source'].get('commit', 'not in a repository')}{changed}"
    return {**options, **ppo, **minutes, **seconds, **config["versions"], "source": source, **config["machine"]}
