"""YAML files that are read strictly: every key known, every number a number, faults named by line and key.

A file's keys are a `Strict` model; `YamlFile` holds the text with its line numbers, `validated` turns it into the model
or raises one `InputError` that says where, what was found and what is allowed.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, TypeVar

import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails, PydanticCustomError

from .errors import InputError, shortened
from .files import read_text

Location = Sequence[str | int]
Length = Annotated[float, Field(gt=0, le=50)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]

_UNITS = {
    "_mps2": "m/s^2", "_kgpm3": "kg/m^3", "_hz": "Hz", "_deg": "degrees", "_kg": "kilograms", "_m": "metres",
    "_s": "seconds",
}  # fmt: skip


class Strict(BaseModel):
    """Refuse unknown keys, non-finite numbers and silent conversions (``"3"`` is no number, ``true`` neither)."""

    model_config = ConfigDict(extra="forbid", strict=True, frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, data: Any) -> Any:
        for key in data if isinstance(data, dict) else ():
            if key not in cls.model_fields:
                raise PydanticCustomError("unknown_key", "{text}", {"key": str(key), "text": nearest(key, cls)})
        return data


Checked = TypeVar("Checked", bound=Strict)


def nearest(name: object, names: type[BaseModel] | Sequence[str]) -> str:
    """Return ``'x', or another of a, b, c`` where x is the allowed name nearest to ``name``."""
    allowed = list(names) if isinstance(names, Sequence) else list(names.model_fields)
    close = difflib.get_close_matches(str(name), allowed, n=1)
    listed = ", ".join(allowed)
    return f"'{close[0]}' (all: {listed})" if close else f"one of {listed}"


class YamlFile:
    """The text of a YAML file, its YAML tree for line numbers and its content.

    Args:
        path: The file.
        allowed: Formats that its first key may name.

    Attributes:
        path: The file.
        content: Its top-level mapping.

    Raises:
        InputError: The file is missing, unreadable, not YAML, no mapping or has a key twice.
    """

    def __init__(self, path: Path, allowed: str) -> None:
        self.path = path
        text = read_text(path)
        try:
            self._root = yaml.compose(text, Loader=_Loader)
            self.content = yaml.load(text, Loader=_Loader)
        except yaml.MarkedYAMLError as e:
            mark = e.problem_mark
            place = f"line {mark.line + 1}, column {mark.column + 1}" if mark else ""
            raise InputError(path, place, e.problem or "text that is not YAML", "valid YAML, each key once") from None
        except (yaml.YAMLError, ValueError, RecursionError) as e:
            raise InputError(path, "", str(e).splitlines()[0], "valid YAML") from None
        if not isinstance(self.content, dict):
            found = "an empty file" if self.content is None else f"a {type(self.content).__name__}"
            raise InputError(path, "", found, f"a mapping that starts with format: {allowed}")

    def error(self, location: Location, found: str, allowed: str) -> InputError:
        """Return an `InputError` for a key, with its line in the file; entries of lists are counted from 1."""
        names = [f"entry {key + 1}" if isinstance(key, int) else str(key) for key in self._present(location)]
        line = self._line(location)
        return InputError(self.path, ", ".join(([f"line {line}"] if line else []) + [" ".join(names)]), found, allowed)

    def _present(self, location: Location) -> list[str | int]:
        """Leave out entries of lists that the file does not write as a list."""
        out: list[str | int] = []
        node: Any = self._root
        for key in location:
            if isinstance(key, int) and isinstance(node, yaml.MappingNode):
                continue
            out.append(key)
            if isinstance(node, yaml.SequenceNode) and isinstance(key, int):
                node = node.value[key] if key < len(node.value) else None
            elif isinstance(node, yaml.MappingNode):
                node = next((v for k, v in node.value if k.value == key), None)
        return out

    def _line(self, location: Location) -> int:
        """Line (from 1) of the deepest node on the way to ``location``."""
        node: Any = self._root
        for key in location:
            if isinstance(node, yaml.SequenceNode) and isinstance(key, int) and key < len(node.value):
                node = node.value[key]
            elif isinstance(node, yaml.MappingNode):
                node = next((v for k, v in node.value if k.value == key), node)
        return int(node.start_mark.line) + 1


def validated(file: YamlFile, model: type[Checked]) -> Checked:
    """Return a file's content as a model.

    Raises:
        InputError: A key is missing, unknown, of the wrong type or out of bounds.
    """
    try:
        return model.model_validate(file.content)
    except ValidationError as e:
        raise _explain(file, e.errors(include_url=False)[0]) from None


def _explain(file: YamlFile, error: ErrorDetails) -> InputError:
    """Turn pydantic's first complaint into one line."""
    location, context = list(error["loc"]), error.get("ctx", {})
    if error["type"] == "unknown_key":
        return file.error([*location, context["key"]], "a key that this format does not have", error["msg"])
    if error["type"] == "missing":
        return file.error(location, "no such key", f"this key{_unit(location)}")
    found = context["found"] if "found" in context else shortened(error["input"])
    allowed = re.sub(r"^Input should be (a valid )?|^\w+ should have ", "", error["msg"])
    return file.error(location, found, allowed + _unit(location))


def _unit(location: Location) -> str:
    name = next((key for key in reversed(location) if isinstance(key, str)), "")
    return next((f", in {unit}" for suffix, unit in _UNITS.items() if name.endswith(suffix)), "")


class _Loader(yaml.SafeLoader):
    """YAML with each key once and plain, integers of 64 bits, and 1e-3 read as a number, as YAML 1.2 does."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        """Return a mapping; raise where a key is given twice or is no plain value."""
        seen: set[str] = set()
        for key, _ in node.value if isinstance(node, yaml.MappingNode) else ():
            if not isinstance(key, yaml.ScalarNode):
                found = f"a {'list' if isinstance(key, yaml.SequenceNode) else 'mapping'} as a key"
                raise yaml.constructor.ConstructorError(None, None, found, key.start_mark)
            if key.value in seen:
                raise yaml.constructor.ConstructorError(None, None, f"the key '{key.value}' twice", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)

    def construct_yaml_int(self, node: yaml.ScalarNode) -> int:
        """Return an integer; raise where it does not fit 64 bits or is too long to be read."""
        written = str(self.construct_scalar(node))
        if len(written) > _DIGITS or abs(value := int(super().construct_yaml_int(node))) >= 2**63:
            found = f"an integer of {len(written)} characters"
            raise yaml.constructor.ConstructorError(None, None, found, node.start_mark)
        return value


#: Characters of an integer, signs, points and a prefix included: 64 binary digits in groups of four.
_DIGITS = 100
_Loader.add_constructor("tag:yaml.org,2002:int", _Loader.construct_yaml_int)
_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)
