"""One self-contained HTML page with the results of a run, its figures beside it."""

from __future__ import annotations

import base64
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import jinja2
import numpy as np
from matplotlib.figure import Figure

from .figures import WIDTH, png
from .motion import ReportMotion

REPORT, TEMPLATES = "report.html", Path(__file__).parent / "templates"


@dataclass(frozen=True)
class KeyNumber:
    """One key number of a report.

    Attributes:
        label: Its name.
        value: The number, or text.
        unit: Its unit, may be empty.
        explanation: One sentence on how to read it.
    """

    label: str
    value: float | str
    unit: str
    explanation: str

    @property
    def shown(self) -> str:
        """The number with its unit; a dash where there is none (NaN)."""
        if isinstance(self.value, float) and math.isnan(self.value):
            return "-"
        return f"{number(self.value)} {self.unit}".strip()


@dataclass(frozen=True)
class ParameterRow:
    """One inferred parameter: median and 95 % interval in ``unit``."""

    name: str
    median: float
    low: float
    high: float
    unit: str

    @property
    def digits(self) -> int:
        """Significant digits that tell the ends of the interval apart, at least three."""
        width, size = self.high - self.low, max(abs(self.low), abs(self.high))
        if not (math.isfinite(width) and width > 0 and size > 0):
            return 3
        return max(3, min(9, 2 + math.floor(math.log10(size)) - math.floor(math.log10(width))))


@dataclass(frozen=True)
class ReportFigure:
    """A figure: name of its PNG file, the drawing (or PNG bytes), what it shows, what follows from it (or nothing)."""

    file: str
    image: Figure | bytes
    caption: str
    conclusion: str = ""


@dataclass(frozen=True)
class ReportTable:
    """A plain table: its title, header, rows as wide as the header, and a note on how to read it (may be empty)."""

    title: str
    header: tuple[str, ...]
    rows: list[tuple[object, ...]]
    note: str = ""

    def __post_init__(self) -> None:
        for i, row in enumerate(self.rows):
            if len(row) != len(self.header):
                raise ValueError(f"table {self.title!r}, row {i}: {len(row)} cells under {len(self.header)} headings")


@dataclass(frozen=True)
class ReportContent:
    """Content of a report.

    Attributes:
        title: What was done to what.
        headline: The verdict in one sentence.
        status: ``good``, ``warning`` or ``bad``; colours the headline.
        numbers: Key numbers.
        precisely: The verdict again in the field's terms, below the headline; may be empty.
        commands: Commands to go on with and what each does, with a button that copies it.
        motion: What plays on the page; may be None.
        exact: Key numbers that are shown only when asked for.
        folded: Whether parameters and tables are shown only when asked for, too.
        parameters: Inferred parameters; the table is left out if there are none.
        caveat: What to know before the parameters' intervals are used, below their table; may be empty.
        figures: Figures in reading order.
        details: How it was computed: settings, versions, seeds, machine.
        further: Further reading: pairs of a file, command or page and what it holds.
        tables: Plain tables before the figures, each a section of its own.
    """

    title: str
    headline: str
    status: Literal["good", "warning", "bad"]
    numbers: list[KeyNumber]
    parameters: list[ParameterRow] = field(default_factory=list)
    caveat: str = ""
    figures: list[ReportFigure] = field(default_factory=list)
    details: dict[str, object] = field(default_factory=dict)
    further: list[tuple[str, str]] = field(default_factory=list)
    tables: list[ReportTable] = field(default_factory=list)
    precisely: str = ""
    commands: list[tuple[str, str]] = field(default_factory=list)
    motion: ReportMotion | None = None
    folded: bool = False
    exact: list[KeyNumber] = field(default_factory=list)


def write_report(folder: str | Path, content: ReportContent) -> Path:
    """Write ``report.html`` and the figures' PNG files into an existing folder; return the page's path.

    All text is escaped; the page loads nothing from elsewhere.

    Raises:
        ValueError: A figure's file name is no plain ``.png`` name.
    """
    out = Path(folder)
    images = []
    for item in content.figures:
        if Path(item.file).name != item.file or not item.file.endswith(".png"):
            raise ValueError(f"figure file {item.file!r}: a plain name that ends in .png is needed")
        data = item.image if isinstance(item.image, bytes) else png(item.image)
        (out / item.file).write_bytes(data)
        share = 1.0 if isinstance(item.image, bytes) else min(1.0, item.image.get_figwidth() / WIDTH)
        images.append((item, base64.b64encode(data).decode("ascii"), round(100.0 * share)))
    page = out / REPORT
    page.write_text(_rendered(content, images), encoding="utf-8")
    return page


def number(value: object, digits: int = 3) -> str:
    """Format a number with ``digits`` significant digits, without an exponent if it can be avoided."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
        return str(value)
    value = int(value) if isinstance(value, (int, np.integer)) else float(value)
    if not math.isfinite(value):
        return "not finite"
    if value == 0 or 1e-4 <= abs(value) < 1e6:
        if isinstance(value, int):
            return str(value)
        places = digits - 1 - math.floor(math.log10(abs(value))) if value else 0
        return f"{value:.{max(places, 0)}f}"
    mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
    return f"{mantissa} × 10^{int(exponent)}"


def _rendered(content: ReportContent, images: list[tuple[ReportFigure, str, int]]) -> str:
    """Return the page as text; its script is a file of its own, without data."""
    environment = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES), autoescape=True, undefined=jinja2.StrictUndefined,
        trim_blocks=True, lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["number"] = number
    script = (TEMPLATES / "report.js").read_text(encoding="utf-8")
    return environment.get_template("report.html.j2").render(content=content, images=images, script=script)
