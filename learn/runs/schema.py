"""What the JSON files of a run folder may hold: checked once, for all who read them, without torch."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from ...sim.base.errors import InputError, shortened
from ...sim.base.files import read_text

FORMAT, CHECKPOINT_FORMAT = "bough-run/1", "bough-checkpoint/1"
Count = Annotated[int, Field(ge=1)]
NotNegative = Annotated[int, Field(ge=0)]


class _Kept(BaseModel):
    model_config = ConfigDict(strict=True, extra="allow")


class TaskRecord(_Kept):
    """The task of a run."""

    name: str
    version: int
    settings: dict[str, Any]


class RunRecord(_Kept):
    """The keys of ``config.json`` that a run is gone on with; others tell people where it came from."""

    format: Literal["bough-run/1"]
    task: TaskRecord
    ppo: dict[str, Any]
    seed: NotNegative
    device: str
    processes: Count
    versions: dict[str, str]


class Manifest(_Kept):
    """The keys of a checkpoint's ``manifest.json``."""

    format: Literal["bough-checkpoint/1"]
    task: str
    version: int
    iteration: NotNegative
    processes: Count


Record = TypeVar("Record", bound=_Kept)


def read_record(file: Path, kind: type[Record], allowed: str) -> Record:
    """Read a JSON file of a run folder.

    Raises:
        InputError: It is missing or no JSON, or a key is missing, of another type or out of bounds.
    """
    try:
        found = json.loads(read_text(file))
    except json.JSONDecodeError as error:
        raise InputError(file, f"line {error.lineno}", "text that is not JSON", allowed) from None
    except RecursionError:
        raise InputError(file, "", "JSON that is nested too deeply", allowed) from None
    if not isinstance(found, dict):
        raise InputError(file, "", "JSON without fields", allowed)
    if found.get("format") != (expected := kind.model_fields["format"].annotation.__args__[0]):  # type: ignore[union-attr]
        raise InputError(file, "format", shortened(found.get("format")), expected)
    return validated(TypeAdapter(kind), found, file)


def validated(adapter: TypeAdapter[Any], values: Any, source: object) -> Any:
    """Return values as the adapter's type; numbers must be numbers, text text.

    Raises:
        InputError: Names the first key that is missing, of another type or out of bounds.
    """
    try:
        return adapter.validate_json(json.dumps(values), strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ".".join(str(key) for key in first["loc"])
        if first["type"] == "missing":
            raise InputError(str(source), place, "no such key", "what bough train wrote") from None
        raise InputError(
            str(source), place, shortened(first["input"]), first["msg"].removeprefix("Input should be ")
        ) from None
