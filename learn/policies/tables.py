"""Tables in Markdown and intervals of shares, for what tests of policies say."""

from __future__ import annotations

import math
from collections.abc import Sequence


def wilson(share: float, trials: int, z: float = 1.959964) -> tuple[float, float]:
    """Return Wilson's 95 % interval of a share of independent trials (Wilson 1927)."""
    middle = (share + z * z / (2 * trials)) / (1 + z * z / trials)
    half = z * math.sqrt(share * (1 - share) / trials + z * z / (4 * trials * trials)) / (1 + z * z / trials)
    return max(0.0, middle - half), min(1.0, middle + half)


def lines(cells: Sequence[Sequence[str]]) -> str:
    """Return cells as a table in Markdown, the first row its head, the first column left-aligned."""
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]

    def line(row: Sequence[str]) -> str:
        """Return a row of cells, padded to the columns' widths, between bars."""
        first, *others = zip(row, widths, strict=True)
        return "| " + " | ".join([first[0].ljust(first[1]), *(c.rjust(w) for c, w in others)]) + " |"

    rule = "|" + "|".join([" " + "-" * widths[0] + " ", *(" " + "-" * w + ":" for w in widths[1:])]) + "|"
    return "\n".join([line(cells[0]), rule, *map(line, cells[1:])])


def known(value: float) -> float | None:
    """Return a number as JSON has it: None for NaN."""
    return None if math.isnan(value) else value
