"""What the JSON files of a run folder may hold: checked once, for all who read them, without torch."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from ...sim.base.errors import InputError, shortened
from ...sim.base.json_file import read_object

FORMAT, CHECKPOINT_FORMAT = "bough-run/1", "bough-checkpoint/1"
Count = Annotated[int, Field(ge=1)]
NotNegative = Annotated[int, Field(ge=0)]


class Kept(BaseModel):
    """Fields that are needed; others are let be."""

    model_config = ConfigDict(strict=True, extra="allow")


class TaskRecord(Kept):
    """The task of a run."""

    name: str
    version: int
    settings: dict[str, Any]


class RunRecord(Kept):
    """The keys of ``config.json`` that a run is gone on with; others tell people where it came from."""

    format: Literal["bough-run/1"]
    task: TaskRecord
    ppo: dict[str, Any]
    seed: NotNegative
    device: str
    processes: Count
    versions: dict[str, str]


class Manifest(Kept):
    """The keys of a checkpoint's ``manifest.json``."""

    format: Literal["bough-checkpoint/1"]
    task: str
    version: int
    iteration: NotNegative
    processes: Count


Record = TypeVar("Record", bound=Kept)


def read_record(file: Path, kind: type[Record], allowed: str) -> Record:
    """Read a JSON file of a run folder.

    Raises:
        InputError: It is missing or no JSON, or a key is missing, of another type or out of bounds.
    """
    found = read_object(file, allowed)
    if found.get("format") != (expected := kind.model_fields["format"].annotation.__args__[0]):  # type: ignore[union-attr]
        raise InputError(file, "format", shortened(found.get("format")), expected)
    return validated(TypeAdapter(kind), found, file)


def validated(
    adapter: TypeAdapter[Any], values: Any, source: object, within: str = "", allowed: str = "what bough train wrote"
) -> Any:
    """Return values as the adapter's type; numbers must be numbers, text text.

    Args:
        adapter: The type.
        values: The values, as JSON has them.
        source: The file that they are from.
        within: Where in it they are; the whole file if empty.
        allowed: What they should be, where one is missing.

    Raises:
        InputError: Names the first key that is missing, of another type or out of bounds.
    """
    try:
        return adapter.validate_json(json.dumps(values), strict=True)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        place = ": ".join(filter(None, (within, ".".join(str(key) for key in first["loc"]))))
        if first["type"] == "missing":
            raise InputError(str(source), place, "no such key", allowed) from None
        raise InputError(
            str(source), place, shortened(first["input"]), first["msg"].removeprefix("Input should be ")
        ) from None
