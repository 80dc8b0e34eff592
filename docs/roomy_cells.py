"""A hook of mkdocs: cells with sentences get room, so that no column is one word wide."""

from __future__ import annotations

import re
from typing import Any

_CELL = re.compile(r"<td>(.*?)</td>", re.DOTALL)
_LONG = 80  # characters that are a sentence


def on_page_content(content: str, **_: Any) -> str:
    """Return a page's HTML with a least width for every table cell that holds a sentence."""
    return _CELL.sub(_roomy, content)


def _roomy(cell: re.Match[str]) -> str:
    text = re.sub(r"<[^>]*>", "", cell[1])
    return f'<td style="min-width: 20em">{cell[1]}</td>' if len(text) > _LONG else cell[0]
