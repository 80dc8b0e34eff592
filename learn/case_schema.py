"""The keys of a case folder's ``meta.yaml``, both forms, as strict pydantic models.

`read_meta` turns the file into a model or raises one `InputError` naming the line, the key, what was found and what
is allowed. The format is described in ``docs``: ``branch-gap-case/1`` and ``joint-gap-case/1``.
"""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import yaml
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails, PydanticCustomError

from ..sim.errors import InputError
from ..sim.files import read_text

BRANCH_FORMAT, JOINT_FORMAT = "branch-gap-case/1", "joint-gap-case/1"

Location = Sequence[str | int]
Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Length = Annotated[float, Field(gt=0, le=50)]
Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
Ordinal = Annotated[int, Field(ge=1)]

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


class SegmentMeta(Strict):
    """One segment of a branch: solid, straight, tapered; angles of its axis in the rest pose."""

    name: str = Field(min_length=1)
    length_m: Length
    radius_base_m: Positive
    radius_tip_m: Positive
    elevation_deg: float = Field(ge=-90, le=90)
    azimuth_deg: float = Field(ge=-360, le=360)
    mass_kg: float = Field(gt=0, le=1e4)


class GraspMeta(Strict):
    """Where the gripper holds the branch."""

    segment: str
    distance_from_lower_end_m: NotNegative


class BranchTrajectoryMeta(Strict):
    """One recording on the branch; ``replicate_of`` counts from 1, ``grasp`` stands in for the case's own."""

    file: str = Field(min_length=1)
    profile: str = ""
    direction: Vector | None = None
    t_start_s: float
    replicate_of: Ordinal | None = None
    no_contact: list[Annotated[list[float], Field(min_length=2, max_length=2)]] = []
    grasp: GraspMeta | None = None


class BranchMeta(Strict):
    """``branch-gap-case/1``: a branch probed at a grasp point."""

    format: Literal["branch-gap-case/1"]
    name: str | None = None
    sample_rate_hz: float = Field(gt=0, le=1e6)
    n_samples: int = Field(ge=3)
    gravity_mps2: float = Field(ge=0, le=30)
    planar: bool = False
    density_kgpm3: float = Field(ge=50, le=2500)
    base_position_m: Vector
    trunk_pivot_below_base_m: NotNegative | None = None
    segments: list[SegmentMeta] = Field(min_length=1)
    fork_angles_deg: list[float] | None = None
    grasp: GraspMeta
    noise_nominal: Annotated[float, Field(ge=0, lt=1)] | None = None
    trajectories: list[BranchTrajectoryMeta] = Field(min_length=1)
    conventions: str | None = None


class GravityTorqueMeta(Strict):
    """Gravity torque amplitude * sin(q - zero_angle) [N m, rad]; null amplitude = infer."""

    amplitude: Positive | None
    zero_angle: float = 0.0


class JointSpecMeta(Strict):
    """One joint; null = infer. Revolute: kg m^2, N m/rad, N m s/rad; prismatic: kg, N/m, N s/m."""

    name: str = Field(min_length=1)
    type: Literal["revolute", "prismatic"]
    inertia: Positive | None
    stiffness: NotNegative | None
    damping: NotNegative | None
    gravity_torque: GravityTorqueMeta | None = None


class MechanismMeta(Strict):
    """Either a list of joints or an MJCF file beside ``meta.yaml`` and what is unknown of it."""

    joints: Annotated[list[JointSpecMeta], Field(min_length=1)] | None = None
    mjcf: str | None = None
    unknown: Annotated[list[str], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _one_of_two(self) -> MechanismMeta:
        if (self.joints is None) == (self.mjcf is None):
            found = "neither joints nor mjcf" if self.joints is None else "both joints and mjcf"
            raise PydanticCustomError("mechanism", "exactly one of joints, mjcf", {"found": found})
        if self.joints is not None and self.unknown is not None:
            found = "unknown beside joints"
            raise PydanticCustomError("mechanism", "null in a joint's own keys, unknown beside mjcf", {"found": found})
        return self


class InputMeta(Strict):
    """The column that drives a joint: generalised force = scale * column."""

    joint: str
    column: str = Field(min_length=1)
    scale: float
    hold: Literal["linear", "zero_order"]


def _listed(value: object) -> object:
    """Put the mapping of a single input into a list."""
    return [value] if isinstance(value, dict) else value


class OutputMeta(Strict):
    """A measured column: quantity of a joint = scale * column [rad or m, per second, per second squared]."""

    joint: str
    quantity: Literal["position", "velocity", "acceleration"]
    column: str = Field(min_length=1)
    scale: float


class JointTrajectoryMeta(Strict):
    """One recording of the joints; ``rows`` is the half-open range of data rows used, counted from 0."""

    file: str = Field(min_length=1)
    t_start_s: float
    rows: Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=2, max_length=2)] | None = None
    replicate_of: Ordinal | None = None


class SplitMeta(Strict):
    """Trajectories to learn from and to test on, counted from 1."""

    train: list[Ordinal] = Field(min_length=1)
    test: list[Ordinal] = Field(min_length=1)


class JointMeta(Strict):
    """``joint-gap-case/1``: joints measured directly."""

    format: Literal["joint-gap-case/1"]
    name: str | None = None
    time_column: str = Field(default="time_s", min_length=1)
    resample_hz: Annotated[float, Field(gt=0, le=1e6)] | None = None
    mechanism: MechanismMeta
    input: Annotated[Annotated[list[InputMeta], Field(min_length=1)] | None, BeforeValidator(_listed)]
    outputs: list[OutputMeta] = Field(min_length=1)
    fit: Literal["replay", "torque"] | None = None
    filter_hz: Positive | None = None
    trajectories: list[JointTrajectoryMeta] = Field(min_length=1)
    split: SplitMeta | None = None
    noise_nominal: Annotated[float, Field(ge=0, lt=1)] | None = None
    conventions: str | None = None


class MetaFile:
    """The text of a ``meta.yaml`` or another YAML file, its YAML tree for line numbers and its content.

    Attributes:
        path: The file.
        content: Its top-level mapping.

    Raises:
        InputError: The file is missing, unreadable, not YAML, no mapping or has a key twice.
    """

    def __init__(self, path: Path, allowed: str = f"{BRANCH_FORMAT} or {JOINT_FORMAT}") -> None:
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


def read_meta(path: Path) -> tuple[BranchMeta | JointMeta, MetaFile]:
    """Read and check a ``meta.yaml``.

    Raises:
        InputError: See `MetaFile`; a key is missing, unknown, of the wrong type or out of bounds.
    """
    file = MetaFile(path)
    tag = file.content.get("format")
    models: dict[object, type[BranchMeta | JointMeta]] = {BRANCH_FORMAT: BranchMeta, JOINT_FORMAT: JointMeta}
    if not isinstance(tag, str) or tag not in models:
        found = "no such key" if tag is None else repr(tag)
        raise file.error(["format"], found, f"{BRANCH_FORMAT} or {JOINT_FORMAT}")
    return validated(file, models[tag]), file


def validated(file: MetaFile, model: type[Checked]) -> Checked:
    """Return a file's content as a model.

    Raises:
        InputError: A key is missing, unknown, of the wrong type or out of bounds.
    """
    try:
        return model.model_validate(file.content)
    except ValidationError as e:
        raise _explain(file, e.errors(include_url=False)[0]) from None


def _explain(file: MetaFile, error: ErrorDetails) -> InputError:
    """Turn pydantic's first complaint into one line."""
    location, context = list(error["loc"]), error.get("ctx", {})
    if error["type"] == "unknown_key":
        return file.error([*location, context["key"]], "a key that this format does not have", error["msg"])
    if error["type"] == "missing":
        return file.error(location, "no such key", f"this key{_unit(location)}")
    found = context["found"] if "found" in context else _short(error["input"])
    allowed = re.sub(r"^Input should be (a valid )?|^\w+ should have ", "", error["msg"])
    return file.error(location, found, allowed + _unit(location))


def _unit(location: Location) -> str:
    name = next((key for key in reversed(location) if isinstance(key, str)), "")
    return next((f", in {unit}" for suffix, unit in _UNITS.items() if name.endswith(suffix)), "")


def _short(value: object) -> str:
    text = "null" if value is None else repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


class _Loader(yaml.SafeLoader):
    """YAML with each key once and with 1e-3 read as a number, as YAML 1.2 does."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[str] = set()
        for key, _ in node.value:
            if key.value in seen:
                raise yaml.constructor.ConstructorError(None, None, f"the key '{key.value}' twice", key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float", re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"), list("-+0123456789")
)
