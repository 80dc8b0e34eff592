"""What all benchmarks share: figures and their bounds, rows measured in turn, and the record of a run.

Needs only the standard library, Warp and bough, since `gpu.py` runs where there is little else. Importing it puts
``tests/`` on the path, where the oracles are.
"""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar

import declared

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "tests"))

T = TypeVar("T")
#: Distributions whose versions a record names, by the name it gives them.
PACKAGES = {"warp": "warp-lang", "mujoco": "mujoco", "torch": "torch", "newton": "newton", "numpy": "numpy"}
MEASURED = "measured by benchmarks/run.py"


class InvalidRunError(RuntimeError):
    """A measurement that must not be reported."""


@dataclass(frozen=True)
class Figure:
    """One number that was measured.

    Attributes:
        case: What it was measured on ("40 links").
        what: Which quantity, or whose ("16 lanes").
        value: The number; the median where there were several rounds.
        unit: Its unit, empty for counts and shares.
        range: Least and greatest over the rounds.
        peer: The peer's number in the same unit.
        ratio: How many times better than the peer's, median over the rounds: above one, bough is better.
        ratio_range: Least and greatest over the rounds.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012 (read by history.py)

    case: str
    what: str
    value: float
    unit: str = ""
    range: tuple[float, float] | None = None
    peer: float | None = None
    ratio: float | None = None
    ratio_range: tuple[float, float] | None = None


@dataclass(frozen=True)
class Verdict:
    """Whether a bound is met: the number that was found (the figure's value or ratio), and what it must keep to."""

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012

    case: str
    what: str
    of: str
    found: float
    met: bool
    least: float | None = None
    most: float | None = None

    def line(self) -> str:
        """Say it in one line."""
        limits = [f">= {self.least:g}"] if self.least is not None else []
        limits += [f"<= {self.most:g}"] if self.most is not None else []
        name = f"{self.case}, {self.what}" + (", ratio" if self.of == "ratio" else "")
        return f"{'pass' if self.met else 'FAIL'}  {name:58s} {self.found:10.4g}  {' and '.join(limits)}"


@dataclass(frozen=True)
class Result:
    """What one benchmark gave.

    Attributes:
        arguments: The options it was run with.
        seconds: Wall time it took; None where a page does not say.
        load: Load average when it began, that of a benchmark just before it included.
        figures: What was measured.
        verdicts: The bounds, as they were declared then.
    """

    __pydantic_config__ = {"extra": "forbid", "allow_inf_nan": False}  # noqa: RUF012

    arguments: list[str]
    seconds: float | None
    load: float | None
    figures: list[Figure]
    verdicts: list[Verdict]


# ---- bounds ----------------------------------------------------------------------------------------------------------


def judge(figures: Sequence[Figure], bounds: Sequence[declared.Bound], lanes: int, cores: int) -> list[Verdict]:
    """Hold figures against the bounds that apply to a machine of so many lanes and cores.

    Raises:
        InvalidRunError: A bound names a figure that was not measured, a figure is not finite, or two have one name.
    """
    found = {(f.case, f.what): f for f in figures}
    unsound = [k for k, f in found.items() if not math.isfinite(f.value) or not math.isfinite(f.ratio or 0.0)]
    if unsound or len(found) < len(figures):
        raise InvalidRunError(f"figures that are not finite: {unsound}" if unsound else "two figures of one name")
    verdicts = []
    for b in bounds:
        if b.lanes not in (None, lanes) or b.cores > cores:
            continue
        if (b.case, b.what) not in found:
            raise InvalidRunError(f"a bound without its figure: {b.case}, {b.what}")
        number = float(getattr(found[b.case, b.what], b.of))
        met = (b.least is None or number >= b.least) and (b.most is None or number <= b.most)
        verdicts.append(Verdict(b.case, b.what, b.of, number, bool(met), b.least, b.most))
    return verdicts


# ---- measuring -------------------------------------------------------------------------------------------------------


def in_turn(rows: Sequence[Callable[[], T]], rounds: int) -> list[list[T]]:
    """Measure rows one after the other, ``rounds`` times over; return what each gave, row by row."""
    found: list[list[T]] = [[] for _ in rows]
    for _ in range(rounds):
        for row, values in zip(rows, found, strict=True):
            values.append(row())
    return found


def ratios(values: Sequence[float], base: Sequence[float]) -> list[float]:
    """Ratios of two rows that were measured in turn, round by round."""
    return [a / b for a, b in zip(values, base, strict=True)]


def beside(case: str, what: str, values: Sequence[float], unit: str, base: Sequence[float] | None = None) -> Figure:
    """Make the figure of a row's rounds, beside those of the peer; more is better."""
    figure = Figure(case, what, statistics.median(values), unit, (min(values), max(values)))
    if base is None:
        return figure
    over = ratios(values, base)
    return replace(
        figure, peer=statistics.median(base), ratio=statistics.median(over), ratio_range=(min(over), max(over))
    )


def quick_and_seed(doc: str, quick: str) -> argparse.ArgumentParser:
    """Make the parser of a benchmark with two options: ``--quick``, whose help is given, and ``--seed``."""
    parser = parser_of(doc)
    parser.add_argument("--quick", action="store_true", help=quick)
    parser.add_argument("--seed", type=int, default=0, help="seed of all that is random")
    return parser


def parser_of(doc: str) -> argparse.ArgumentParser:
    """Make a parser that shows a module's docstring as it is."""
    return argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)


# ---- the record ------------------------------------------------------------------------------------------------------


def machine() -> dict[str, Any]:
    """Describe the machine: processor, cores this process may use, lanes, GPUs, system."""
    import warp as wp
    from bough.sim.base import host

    look = host.describe()
    gpus = [d.name for d in wp.get_cuda_devices()]
    return {"cpu": look["cpu"], "cores": host.num_cores(), "lanes": host.simd_width(),
            "gpu": ", ".join(gpus) or None, "system": look["system"]}  # fmt: skip


def versions() -> dict[str, str]:
    """Return the versions of Python, of bough and of what it was measured with."""
    from bough.version import __version__

    found = {"python": platform.python_version(), "bough": __version__}
    for name, distribution in PACKAGES.items():
        try:
            found[name] = version(distribution)
        except PackageNotFoundError:
            continue
    return found


def commit() -> tuple[str | None, bool | None]:
    """Return the commit of this checkout, and whether the code differs from it; None where git does not tell."""
    code = [".", ":!benchmarks/history", ":!docs", ":!*.md"]  # pages and results change no figure
    try:
        head = _git("rev-parse", "HEAD").strip()
        return head, bool(_git("status", "--porcelain", "--", *code).strip())
    except (OSError, subprocess.CalledProcessError):
        return None, None


def _git(*words: str) -> str:
    done = subprocess.run(["git", "-C", str(ROOT), *words], check=True, capture_output=True, text=True)
    return done.stdout


def heading() -> dict[str, Any]:
    """Return what a record says of the run itself: source, date (UTC), machine, versions, commit."""
    head, dirty = commit()
    now = datetime.now(timezone.utc).strftime("%Y-%m-%dT%H:%MZ")
    return {"source": MEASURED, "date": now, "machine": machine(), "versions": versions(), "commit": head,
            "dirty": dirty}  # fmt: skip


def write_json(path: Path, content: Any) -> None:
    """Write a JSON file whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    beside = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        beside.write_text(json.dumps(content, indent=1, allow_nan=False, default=float) + "\n", encoding="utf-8")
        os.replace(beside, path)
    finally:
        beside.unlink(missing_ok=True)


def main(
    parser: argparse.ArgumentParser,
    measured: Callable[[argparse.Namespace], list[Figure]],
    name: Callable[[argparse.Namespace], str] | str,
) -> int:
    """Run a benchmark as a program: measure, print its verdicts, write its record; return the exit code.

    Args:
        parser: Its options.
        measured: Measures and prints; raises `InvalidRunError` for a run that must not be reported.
        name: Its name in `declared`, where that depends on options a function of them.

    Returns:
        1 if the run is invalid, stopped, or a bound is missed.
    """
    parser.add_argument("--record", type=Path, help="write machine, versions, date and figures to this JSON file")
    options = parser.parse_args()
    from bough.sim.base.console import start_warp

    start_warp()
    key = name if isinstance(name, str) else name(options)
    head, load, begun = heading(), os.getloadavg()[0], time.perf_counter()
    look = head["machine"]
    print(f"{look['cpu']}, {look['cores']} cores, {look['lanes']} lanes; " + _listed(head["versions"]), flush=True)
    try:
        figures = measured(options)
        verdicts = judge(figures, declared.named(key).bounds, look["lanes"], look["cores"])
    except (InvalidRunError, KeyboardInterrupt) as error:
        print(f"invalid run: {error}" if str(error) else "stopped", file=sys.stderr)
        return 1
    seconds = round(time.perf_counter() - begun, 1)
    if options.record:
        words = sys.argv[1:]
        for file in ("--record", "--out", "--rows"):
            words = _without(words, file)
        result = Result(words, seconds, round(load, 2), figures, verdicts)
        write_json(options.record, {**head, "results": {key: asdict(result)}})
    print("\n".join(["", "Bounds", *(f"  {v.line()}" for v in verdicts)]) if verdicts else "\nNo bound is declared.")
    return 0 if all(v.met for v in verdicts) else 1


def _listed(found: dict[str, str]) -> str:
    return ", ".join(f"{name} {number}" for name, number in found.items())


def _without(words: Sequence[str], option: str) -> list[str]:
    """Leave out an option and its value, in both of the forms that argparse takes."""
    out, skip = [], False
    for word in words:
        if not skip and word != option and not word.startswith(f"{option}="):
            out.append(word)
        skip = word == option
    return out
