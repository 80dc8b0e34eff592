"""JSON files that bough wrote, which may hold anything by the time they are read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from .errors import InputError
from .files import read_text


def read_object(file: Path, allowed: str) -> dict[str, Any]:
    """Return the fields of a JSON file.

    Raises:
        InputError: It is missing or unreadable, or what `object_of` refuses.
    """
    return object_of(read_text(file), file, allowed)


def object_of(text: str, file: Path, allowed: str, line: int = 0) -> dict[str, Any]:
    """Return the fields of a JSON text.

    Args:
        text: The text.
        file: Where it is from.
        allowed: What that file should be, as an error says it.
        line: The one line of the file that it is; 0 where it is the whole file.

    Raises:
        InputError: It is no JSON, nested too deeply or without fields, or a number has too many digits.
    """
    place = f"line {line}" if line else ""
    try:
        found = json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(file, place or f"line {error.lineno}", "text that is not JSON", allowed) from None
    except RecursionError:
        raise InputError(file, place, "JSON that is nested too deeply", allowed) from None
    except ValueError:
        raise InputError(file, place, "a number of too many digits", allowed) from None
    if not isinstance(found, dict):
        raise InputError(file, place, "JSON without fields", allowed)
    return found
