"""A hook of mkdocs: formulas become MathML, which browsers set by themselves, without a script and offline."""

from __future__ import annotations

import html
import re
from typing import Any

from latex2mathml.converter import convert

_FORMULA = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.DOTALL)


def on_page_content(content: str, **_: Any) -> str:
    """Return a page's HTML with what `pymdownx.arithmatex` has marked as TeX written as MathML."""
    return _FORMULA.sub(_set, content)


def _set(found: re.Match[str]) -> str:
    """Return a formula as MathML; one on a line of its own scrolls by itself where the page is narrower."""
    text = html.unescape(found[3])
    if found[2] == "(":
        return convert(text, display="inline")
    return f'<div style="overflow-x: auto">{convert(text, display="block")}</div>'
