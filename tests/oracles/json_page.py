"""What ``docs/json.md`` says of a command's JSON, held against what the command printed."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PAGE = Path(__file__).resolve().parents[2] / "docs" / "json.md"
#: JSON types by the page's words; bool is no number here, an integer is one.
TYPES = {"text": (str,), "integer": (int,), "number": (int, float), "bool": (bool,), "null": (type(None),)}


def tables() -> dict[str, dict[str, str]]:
    """Return the page's types by key, by command: ``{"forest": {"trees[].links": "integer"}}``."""
    found: dict[str, dict[str, str]] = {}
    for command, text in re.findall(r"^### bough ([a-z -]+)\n(.*?)(?=^##|\Z)", PAGE.read_text(), re.M | re.DOTALL):
        rows = re.findall(r"^\| (`[^|]+`|others) \| ([a-z ]+\??) \|", text, re.M)
        found[command] = {key: kind for keys, kind in rows for key in re.findall(r"`([^`]+)`", keys) or ["others"]}
        same = re.search(r"The same as `bough ([a-z -]+)`", text)
        found[command] |= found[same[1]] if same else {}
    return found


def check(command: str, result: Any) -> None:
    """Assert that a result has the keys of the page, of its types, and no others unless the page says so."""
    told = tables()[command]
    seen: dict[str, list[Any]] = {}
    for path, value in _paths(result, set(told)):
        seen.setdefault(path, []).append(value)
    loose = tuple(key.removesuffix("{}") for key, kind in told.items() if kind == "any")
    for path in seen:
        inside = path.startswith(tuple(f"{key}{mark}" for key in loose for mark in ".[{"))
        assert path in told or inside or "others" in told, (
            f"bough {command} prints {path}, which the page does not tell"
        )
    for key, kind in told.items():
        if kind != "any":
            allowed = {t for word in kind.rstrip("?").split(" or ") for t in TYPES[word]}
            assert all(type(v) in allowed for v in seen.get(key, [])), f"bough {command}: {key} is {seen[key][:3]}"
        needed = kind[-1] != "?" and key != "others" and not re.search(r"[\[{]", key)
        assert key in seen or not needed, f"bough {command} prints no {key}"


def _paths(value: Any, told: set[str], path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the path of every leaf as the page writes it, with the leaf."""
    if path in told and not any(key.startswith((f"{path}.", f"{path}[", f"{path}{{")) for key in told):
        yield path, value
    elif isinstance(value, list):
        for entry in value:
            yield from _paths(entry, told, f"{path}[]")
    elif isinstance(value, dict):
        names_are_data = any(key.startswith(f"{path}{{}}") for key in told)
        for key, entry in value.items():
            yield from _paths(entry, told, f"{path}{{}}" if names_are_data else f"{path}.{key}" if path else key)
    else:
        yield path, value
