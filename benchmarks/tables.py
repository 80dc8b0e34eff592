"""The tables of README and docs, made from the newest result of each benchmark.

A block stands between ``<!-- bench:NAME -->`` and ``<!-- /bench:NAME -->``; `BLOCKS` says what makes it. Everything in
it is written by ``python benchmarks/run.py --write``; what a machine cannot say about it stands outside.
"""

from __future__ import annotations

import math
import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path

from bough.sim.base.errors import InputError
from declared import BENCHMARKS, named
from history import Last, Run, last, runs
from measuring import ROOT, Figure, Verdict

_BLOCK = re.compile(r"(<!-- bench:([a-z_]+) -->\n).*?(<!-- /bench:\2 -->)", re.DOTALL)


# ---- words -----------------------------------------------------------------------------------------------------------


def lines(rows: Iterable[Sequence[object]]) -> str:
    """Make a table in Markdown, its head first."""
    head, *body = [[str(cell) for cell in row] for row in rows]
    return "\n".join("| " + " | ".join(row) + " |" for row in [head, ["---"] * len(head), *body])


def paragraph(text: str) -> str:
    """Wrap a paragraph as the pages are."""
    return textwrap.fill(" ".join(text.split()), 120, break_long_words=False, break_on_hyphens=False)


def origin(name: str, found: Last, *packages: str) -> str:
    """Say where, with which versions and when it was measured, and with which options where they are not the usual."""
    machine, versions = found.run.machine, found.run.versions
    titles = {"warp": "Warp", "mujoco": "MuJoCo", "torch": "torch", "newton": "Newton"}
    usual = [a for a in named(name).arguments if a not in ("--out", "{out}")]
    words = [
        machine.gpu or machine.cpu if named(name).device == "gpu" else machine.cpu,
        f"{machine.cores} core{'s' * (machine.cores > 1)}" if machine.cores else "",
        f"{machine.lanes} lanes" if machine.lanes else "",
        *(f"{titles[p]} {versions[p]}" for p in packages if p in versions),
        f"`{' '.join(found.result.arguments)}`" if found.result.arguments != usual else "",
        found.run.date[:10],
    ]
    return ", ".join(word for word in words if word)


def times(ratio: float) -> str:
    """Print a ratio: two figures below ten, whole numbers above."""
    return f"{ratio:.1f}" if ratio < 10 else f"{ratio:,.0f}"


def percent(share: float | None) -> str:
    """Print a share in percent, with one decimal; nothing for None."""
    return "" if share is None else f"{100 * share:.1f} %"


def _table(found: Last, cases: Sequence[str], cell: Callable[[Figure], str], columns: Sequence[str]) -> list[list[str]]:
    """Make rows of cells, a row a case and a column a quantity; nothing where there is no figure."""
    figures = {(f.case, f.what): f for f in found.result.figures}
    return [[cell(figures[c, w]) if (c, w) in figures else "" for w in columns] for c in cases]


# ---- the blocks ------------------------------------------------------------------------------------------------------


def tree(found: Last) -> str:
    """Write speed beside C MuJoCo, ratios in brackets, then threads and memory."""
    cases = found.cases("C MuJoCo")
    columns = [w for w in ("C MuJoCo", "one world per thread", "8 lanes", "16 lanes") if found.cases(w)]
    cells = _table(found, cases, _speed, columns)
    rows = [[_trees(found, c), *row] for c, row in zip(cases, cells, strict=True)]
    head = f"""Thousand world-steps per second on one core, every world with parameters of its own, dt = 1/240 s,
        medians of interleaved runs ({origin("tree", found, "warp", "mujoco")}); the ratio to C MuJoCo in brackets:"""
    gain = [f"Two threads give {found.get(case, 'gain').value:.2f} times one." for case in found.cases("gain")]
    memory = [f"State, parameters and scratch of {batch} take {found.get(batch, 'memory').value:.0f} MiB."
              for batch in found.cases("memory")]  # fmt: skip
    text = [paragraph(head), lines([["ball-jointed trees", *columns], *rows]), paragraph(" ".join(gain + memory))]
    return "\n\n".join(text)


def _speed(f: Figure) -> str:
    return f"{f.value / 1e3:,.0f}" + (f" ({times(f.ratio)})" if f.ratio else "")


def _trees(found: Last, case: str) -> str:
    if case.endswith(" links"):
        return f"{case}, {3 * int(case.split()[0])} dof"
    topologies, worlds = (found.get(case, what).value for what in ("topologies", "worlds"))
    return f"{case}, {topologies:.0f} topologies in {worlds:.0f} worlds"


def contact(found: Last) -> str:
    """Write speed and depth beside C MuJoCo's."""
    cases = found.cases("speed")
    rows = [[found.get(c, n) for n in ("speed", "mean depth", "99 % of depths")] for c in cases]
    body = [
        [case if "MuJoCo" in case else f"bough, {case}", f"{speed.value / 1e3:.1f}", f"{speed.ratio or 1:.1f}",
         f"{mean.value:.3g}, {most.value:.3g}"]
        for case, (speed, mean, most) in zip(cases, rows, strict=True)
    ]  # fmt: skip
    deep = [row[1].value / rows[-1][1].value for row in rows[:2]]
    near = found.get(cases[-1], "contacts near").value
    head = f"""Arm and 40-link tree, {near:.1f} contacts near on average, one core, medians of interleaved runs
        ({origin("contact", found, "warp", "mujoco")}); MuJoCo with Newton's solver and implicitfast on the same
        model, with its own contacts (time constant 20 ms) and the stiffest that the step allows (two steps):"""
    tail = f"""Depths are those of each step's deepest contact: MuJoCo's are {deep[0]:.0f} and {deep[1]:.0f} times as
        deep."""
    table = lines([["engine", "k world-steps/s", "ratio", "depth, mean and 99 % (mm)"], *body])
    return "\n\n".join([paragraph(head), table, paragraph(tail)])


#: What the stages of perception are called in the table; older records do not have all of them.
_STAGES = {
    "sampling": "drawing three clouds", "true occlusion": "occlusion, without noise",
    "true margin": "safety margin, without noise", "noise": "noise", "embedding": "four embeddings",
    "occlusion": "occlusion", "nearest": "5 nearest branch points", "margin": "safety margin",
    "scores": "writing scores", "all": "all",
}  # fmt: skip


def perception(found: Last) -> str:
    """Write the time of each stage beside torch's."""
    timed = found.cases("time")
    figures = [(title, found.get(stage, "time")) for stage, title in _STAGES.items() if stage in timed]
    body = [[title, _us(f.value), _us(f.peer), _whole(f.ratio)] for title, f in figures]
    learnt = found.get("embedding, PointNet++", "time")
    body.append(["PointNet++ (sampling left out), four clouds", "", _us(learnt.peer), _whole(learnt.ratio)])
    worlds, occlusion = (found.get("worlds", what).value for what in ("number", "mean occlusion"))
    head = f"""Microseconds per world and step on one core, 512 points per cloud, noise on, {worlds:.0f} random
        worlds (mean occlusion {occlusion:.2f}), medians of interleaved runs; one torch thread does the same on the same
        points ({origin("perception", found, "warp", "torch")}):"""
    return paragraph(head) + "\n\n" + lines([["", "bough", "torch", "ratio"], *body])


def _us(value: float | None) -> str:
    if value is None:
        return ""
    return f"{value:.2f}" if value < 1 else f"{value:.1f}" if value < 10 else f"{value:,.0f}"


def _whole(ratio: float | None) -> str:
    return "" if ratio is None else f"{ratio:,.0f}"


def scale(found: Last) -> str:
    """Write a line a number of worlds."""
    names = ("links", "built", "memory of the process", "policy steps", "world-steps", "perception",
             "perception of the task's step")  # fmt: skip
    cases = found.cases("built")
    body = []
    for case in cases:
        n, built, memory, policy, world, part, of_step = (found.get(case, name).value for name in names)
        body.append([case.split()[0], f"{n:.0f}", f"{built:.1f}", f"{memory:.2f}", f"{policy:,.0f}", f"{world:,.0f}",
                     f"{100 * part:.0f} %", f"{100 * of_step:.0f} %"])  # fmt: skip
    head = ["worlds", "links", "built in [s]", "memory of the process [GiB]", "policy steps/s", "world-steps/s",
            "perception", "of the task's step"]  # fmt: skip
    off = math.ceil(100 * found.get("all sizes", "furthest from their median speed").value)
    tail = f"{origin('scale', found, 'warp', 'torch')}. All speeds are within {off} % of their median."
    return lines([head, *body]) + "\n\n" + paragraph(tail)


def identification(found: Last) -> str:
    """Write a line a case and the medians."""
    body = []
    for case in found.cases("held-out error"):
        error, covered, seconds = (found.get(case, what) for what in ("held-out error", "covered", "time"))
        about = [case, ""]
        if case != "median":
            about = [f"{found.get(case, what).value:.0f}" for what in ("segments", "noise")]
        numbers = [x for f in (error, covered, seconds) for x in (f.value, f.peer)]
        body.append([*about, *("" if x is None else f"{x:.3g}" for x in numbers)])
    head = ["R", "noise [%]", "rms bough [mm]", "rms sysid [mm]", "covers bough [%]", "covers sysid [%]", "bough [s]",
            "sysid [s]"]  # fmt: skip
    return lines([head, *body]) + "\n\n" + paragraph(f"{origin('identification', found, 'warp', 'mujoco')}.")


#: Rows of the table of ranks: quantity, title, how it is printed.
_RANKS: tuple[tuple[str, str, Callable[[float], str]], ...] = (
    ("p_rank_ks", "ranks, Kolmogorov-Smirnov p", "{:.2f}".format),
    ("p_rank_chi2", "ranks, chi-square p (16 bins)", "{:.2f}".format),
    ("p_normal_ks", "normal scores, Kolmogorov-Smirnov p", "{:.2f}".format),
    ("z_deviation", "deviation of (truth − mean) / deviation", "{:.2f}".format),
    ("inside_95", "inside the 95 % interval", percent),
)


def ranks(found: Last) -> str:
    """Write the tests of every parameter's ranks."""
    cases = found.cases("p_rank_ks")
    body = [[title, *(show(found.get(c, key).value) for c in cases)] for key, title, show in _RANKS]
    table = lines([["", *(c.split()[1] for c in cases)], *body])
    return table + "\n\n" + paragraph(f"{origin('calibration', found)}.")


def joints(found: Last) -> str:
    """Write the shares of every joint's intervals that hold the truth, by number of segments."""
    figures = {f.what: f.value for f in found.result.figures if f.case == "stiffness inside its 95 % interval"}
    body = [[r, *(percent(figures.get(f"{r} segments, joint {k}")) for k in (1, 2, 3))] for r in (1, 2, 3)]
    return lines([["segments", "joint 1", "joint 2", "joint 3"], *body])


def studies(found: Last) -> str:
    """Write the coverage of held-out displacement in the other three studies."""
    widths = {(f.case, f.what): f.value for f in found.result.figures if f.what.startswith("relative width")}
    body = []
    for f in [f for f in found.result.figures if f.what.startswith("covered")]:
        width = widths.get((f.case, f.what.replace("covered", "relative width")))
        low, high = map(percent, f.range or (None, None))
        body.append([f.case, _level(f), percent(f.value), low, high, "" if width is None else f"{width:.2f}"])
    head = ["study", "at", "covered", "lowest branch", "highest", "relative width of the interval"]
    error = found.get("other simulator", "median error of K at 3 % noise").value
    tail = f"The median error of K on the other simulator's branches at 3 % noise is {percent(error)}."
    return lines([head, *body]) + "\n\n" + tail


def _level(f: Figure) -> str:
    """Say what a coverage is of: ``covered, 0.03 noise`` is at 3 % noise."""
    level = re.sub(r"^covered,? ?(at )?", "", f.what)
    if f.case == "noise of the force" or level.endswith(" noise"):
        return f"{100 * float(level.split()[0]):g} % noise"
    if level.endswith(" segments"):
        return level.replace("1 segments", "1 segment")
    return f"{level} of the last segment" if level else "all"


def cost(found: Last) -> str:
    """Write the time of an identification over everything that was varied."""
    body = []
    for what in found.cases("power"):
        cases = [c for c in found.cases("time") if c.split()[1] == what]
        body.append([what, ", ".join(c.split()[0] for c in cases),
                     ", ".join(f"{found.get(c, 'time').value:.1f}" for c in cases),
                     f"{found.get(what, 'power').value:.2f}"])  # fmt: skip
    table = lines([["varied", "sizes", "time of an identification [s]", "power that time grows with"], *body])
    return table + "\n\n" + paragraph(f"{origin('identification_cost', found)}.")


#: What makes each block that is about one benchmark: its name, and the function.
def cameras(found: Last) -> str:
    """Write a line for each number of cameras, with and without leaves, beside a second draw of the kernel."""
    names = {"reach": "reach [mm]", "off": "off [mm]", "whole": "whole cloud", "near": "near the line",
             "occlusion": "occlusion", "occlusion bias": "its bias"}  # fmt: skip
    body = []
    for case in found.cases("reach"):
        row = [case]
        for what in names:
            figure = None if what == "off" and case.startswith("kernel") else found.get(case, what)
            low, high = (0.0, 0.0) if figure is None or figure.range is None else figure.range
            between = f"({low:.0f} to {high:.0f})" if high >= 20 else f"({low:.2g} to {high:.2g})"
            row.append("" if figure is None else f"{figure.value:.3g} {between}")
        body.append(row)
    trace, segment = (found.get("processor time of a picture", what).value for what in ("trace", "segment"))
    where = origin("cameras", found, "warp")
    tail = f"""{where}. In brackets 95 % intervals of the mean over scenes. A picture of 424 x 240 pixels took
        {trace:.0f} ms of processor time to trace, masks and points of it {segment:.0f} ms."""
    return lines([["", *names.values()], *body]) + "\n\n" + paragraph(tail)


def gpu(found: Last) -> str:
    """Write the speed of trees on a GPU, and what a policy step of the arm's task takes."""
    body = [[case, f"{found.get(case, 'speed').value / 1e6:.1f}"] for case in found.cases("speed")]
    worlds, step, physics, sensing = (
        found.get("arm, shares", what).value for what in ("worlds", "step_s", "physics_share", "perception_share")
    )
    embedding = 1e3 * found.get("arm, embedding", "four_embeddings_s").value
    tail = f"""A policy step of `powerline` with {worlds:.0f} worlds in which no episode ends took {1e3 * step:.1f} ms,
        physics alone (four steps) {100 * physics:.0f} % of that and perception alone {100 * sensing:.0f} %; the four
        embeddings of 512 points in 1024 worlds {embedding:.2f} ms (the thesis: 1.2).
        {origin("gpu", found, "warp", "torch")}."""
    return lines([["ball-jointed trees", "million world-steps/s"], *body]) + "\n\n" + paragraph(tail)


BLOCKS: dict[str, tuple[str, Callable[[Last], str]]] = {
    "tree": ("tree", tree), "contact": ("contact", contact), "perception": ("perception", perception),
    "scale": ("scale", scale), "identification": ("identification", identification), "ranks": ("calibration", ranks),
    "joints": ("calibration", joints), "studies": ("calibration", studies), "cost": ("identification_cost", cost),
    "cameras": ("cameras", cameras), "gpu": ("gpu", gpu),
}  # fmt: skip


def declaration() -> str:
    """Write what is declared."""
    body = [[f"`{b.name}`", b.measures, b.peer or "", f"{b.minutes:g}", b.device] for b in BENCHMARKS]
    return lines([["name", "measures", "beside", "minutes", "on"], *body])


def _found(verdict: Verdict | None) -> str:
    if verdict is None:
        return ""
    number = f"{verdict.found:,.0f}" if verdict.found >= 100 else f"{verdict.found:.3g}"
    return number + ("" if verdict.met else " (missed)")


def bounds(every: Sequence[Run]) -> str:
    """Write every bound, what was last found (nothing where it does not apply), where and when."""
    body = []
    for b in BENCHMARKS:
        found = last(b.name, every)
        verdicts = {(v.case, v.what, v.of): v for v in found.result.verdicts} if found else {}
        rows = [[x.text(), _found(verdicts.get((x.case, x.what, x.of)))] for x in b.bounds]
        first, *others = rows or [[f"none: {b.unbound}", ""]]
        body.append([f"`{b.name}`", *first, origin(b.name, found) if found else "not run yet"])
        body += [["", *row, ""] for row in others]
    return lines([["benchmark", "bound", "found", "where and when"], *body])


# ---- pages -----------------------------------------------------------------------------------------------------------


def block(name: str, every: Sequence[Run]) -> str:
    """Make the text of a block.

    Raises:
        InputError: Nothing makes a block of that name, or its benchmark was never run.
    """
    if name in ("declared", "bounds"):
        return declaration() if name == "declared" else bounds(every)
    if name not in BLOCKS:
        raise InputError(
            "a page", f"bench:{name}", "a block that nothing makes", f"declared, bounds, {', '.join(BLOCKS)}"
        )
    benchmark, make = BLOCKS[name]
    found = last(benchmark, every)
    if found is None:
        raise InputError("benchmarks/history", benchmark, "no result", "at least one run of it")
    return make(found)


def pages() -> list[Path]:
    """List the pages that may hold blocks."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def names_in(text: str) -> list[str]:
    """List the blocks of a page."""
    return [name for _, name, _ in _BLOCK.findall(text)]


def renewed(text: str, every: Sequence[Run]) -> str:
    """Return a page's text with every block made anew."""
    return _BLOCK.sub(lambda m: f"{m[1]}{block(m[2], every)}\n{m[3]}", text)


def write() -> int:
    """Write the blocks of all pages anew; print which pages changed."""
    every = runs()
    texts = {page: renewed(page.read_text(encoding="utf-8"), every) for page in pages()}
    for page, text in texts.items():
        if text != page.read_text(encoding="utf-8"):
            page.write_text(text, encoding="utf-8")
            print(f"wrote {page.relative_to(ROOT)}")
    return 0
