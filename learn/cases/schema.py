"""The keys of a case folder's ``meta.yaml``, both forms, as strict pydantic models.

`read_meta` turns the file into a model or raises one `InputError` naming the line, the key, what was found and what
is allowed. The format is described in ``docs``: ``branch-gap-case/1`` and ``joint-gap-case/1``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from ...sim.base.strict_yaml import Length, NotNegative, Positive, Strict, YamlFile, validated

BRANCH_FORMAT, JOINT_FORMAT = "branch-gap-case/1", "joint-gap-case/1"

Vector = Annotated[list[float], Field(min_length=3, max_length=3)]
Ordinal = Annotated[int, Field(ge=1)]


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

    segment: Annotated[str, BeforeValidator(str)]  # a number is refused beside the names that there are
    distance_from_lower_end_m: NotNegative


class ColumnMeta(Strict):
    """Where a quantity stands in a file: scale * (column - offset); offset ``start``: what it reads before contact."""

    column: str = Field(min_length=1)
    scale: float = 1.0
    offset: float | Literal["start"] = 0.0


#: A column's name, or a pair of names: seconds and nanoseconds.
TimeColumn = Annotated[str, Field(min_length=1)] | Annotated[list[str], Field(min_length=2, max_length=2)]
Rows = Annotated[list[Annotated[int, Field(ge=0)]], Field(min_length=2, max_length=2)]


class BranchTrajectoryMeta(Strict):
    """One recording on the branch; ``replicate_of`` counts from 1, ``grasp`` stands in for the case's own."""

    file: str = Field(min_length=1)
    rows: Rows | None = None
    profile: str = ""
    direction: Vector | None = None
    t_start_s: float
    replicate_of: Ordinal | None = None
    no_contact: list[Annotated[list[float], Field(min_length=2, max_length=2)]] = Field(default_factory=list)
    grasp: GraspMeta | None = None


class BranchMeta(Strict):
    """``branch-gap-case/1``: a branch probed at a grasp point."""

    format: Literal["branch-gap-case/1"]
    name: str | None = None
    sample_rate_hz: float = Field(gt=0, le=1e6)
    n_samples: int = Field(ge=3)
    time_column: TimeColumn = "t_s"
    time_scale: Positive | None = None
    resample_hz: Annotated[float, Field(gt=0, le=1e6)] | None = None
    columns: dict[str, str | ColumnMeta] = Field(default_factory=dict)
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
    """Gravity torque amplitude * sin(q - zero_angle) [N m, rad]; null = infer."""

    amplitude: Positive | None
    zero_angle: float | None = 0.0


class JointSpecMeta(Strict):
    """One joint; null = infer. Revolute: kg m^2, N m/rad, N m s/rad; prismatic: kg, N/m, N s/m."""

    name: str = Field(min_length=1)
    type: Literal["revolute", "prismatic"]
    inertia: Positive | None
    stiffness: NotNegative | None
    damping: NotNegative | None
    gravity_torque: GravityTorqueMeta | None = None


class MechanismMeta(Strict):
    """A list of joints, an MJCF file beside ``meta.yaml`` and what is unknown of it, or a known arm by its name.

    ``weight`` says of an arm whether its torques hold the arm's own weight (``in``) or not (``out``).
    """

    arm: str | None = None
    weight: Literal["in", "out"] | None = None
    joints: Annotated[list[JointSpecMeta], Field(min_length=1)] | None = None
    mjcf: str | None = None
    unknown: Annotated[list[str], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _one_of_two(self) -> MechanismMeta:
        if self.arm is not None:
            self._of_arm()
            return self
        if self.weight is not None:
            raise PydanticCustomError("mechanism", "weight beside arm only", {"found": "weight without arm"})
        if (self.joints is None) == (self.mjcf is None):
            found = "neither joints nor mjcf" if self.joints is None else "both joints and mjcf"
            raise PydanticCustomError("mechanism", "exactly one of joints, mjcf", {"found": found})
        if self.joints is not None and self.unknown is not None:
            found = "unknown beside joints"
            raise PydanticCustomError("mechanism", "null in a joint's own keys, unknown beside mjcf", {"found": found})
        return self

    def _of_arm(self) -> None:
        beside = [k for k in ("joints", "mjcf", "unknown") if getattr(self, k) is not None]
        if beside:
            found = f"{beside[0]} beside arm"
            raise PydanticCustomError("mechanism", "arm alone, with weight: in or out", {"found": found})
        if self.weight is None:
            found = "arm without weight"
            allowed = "weight: out where the driver takes the arm's weight out of the torques, in where they hold it"
            raise PydanticCustomError("mechanism", allowed, {"found": found})


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
    """A measured column: quantity = scale * (column - offset) [rad or m, per second, per second squared]."""

    joint: str
    quantity: Literal["position", "velocity", "acceleration"]
    column: str = Field(min_length=1)
    scale: float
    offset: float = 0.0


class CommandMeta(Strict):
    """The column of a joint's commanded speed, scale * column [rad/s]: the mean since the row before."""

    joint: str
    column: str = Field(min_length=1)
    scale: float


class JointTrajectoryMeta(Strict):
    """One recording of the joints; ``rows`` is the half-open range of data rows used, counted from 0."""

    file: str = Field(min_length=1)
    t_start_s: float
    rows: Rows | None = None
    replicate_of: Ordinal | None = None


class SplitMeta(Strict):
    """Trajectories to learn from and to test on, counted from 1."""

    train: list[Ordinal] = Field(min_length=1)
    test: list[Ordinal] = Field(min_length=1)


class JointMeta(Strict):
    """``joint-gap-case/1``: joints measured directly."""

    format: Literal["joint-gap-case/1"]
    name: str | None = None
    time_column: TimeColumn = "time_s"
    time_scale: Positive | None = None
    resample_hz: Annotated[float, Field(gt=0, le=1e6)] | None = None
    mechanism: MechanismMeta
    input: Annotated[Annotated[list[InputMeta], Field(min_length=1)] | None, BeforeValidator(_listed)]
    commands: Annotated[list[CommandMeta], Field(min_length=1)] | None = None
    outputs: list[OutputMeta] = Field(min_length=1)
    fit: Literal["replay", "torque"] | None = None
    filter_hz: Positive | None = None
    trajectories: list[JointTrajectoryMeta] = Field(min_length=1)
    split: SplitMeta | None = None
    noise_nominal: Annotated[float, Field(ge=0, lt=1)] | None = None
    conventions: str | None = None


def read_meta(path: Path) -> tuple[BranchMeta | JointMeta, YamlFile]:
    """Read and check a ``meta.yaml``.

    Raises:
        InputError: See `YamlFile`; a key is missing, unknown, of the wrong type or out of bounds.
    """
    file = YamlFile(path, f"{BRANCH_FORMAT} or {JOINT_FORMAT}")
    tag = file.content.get("format")
    models: dict[object, type[BranchMeta | JointMeta]] = {BRANCH_FORMAT: BranchMeta, JOINT_FORMAT: JointMeta}
    if not isinstance(tag, str) or tag not in models:
        found = "no such key" if tag is None else repr(tag)
        raise file.error(["format"], found, f"{BRANCH_FORMAT} or {JOINT_FORMAT}")
    return validated(file, models[tag]), file
