"""``model.yaml``: a branch's springs and dampers, and the effects that it was found to have.

    format: branch-model/1
    name: branch_7
    segments:
      - {name: parent, stiffness_Nmprad: 74.2, damping_Nmsprad: 1.31,
         length_m: 0.5, radius_base_m: 0.014, radius_tip_m: 0.012}
      - {name: child, stiffness_Nmprad: 15.1, damping_Nmsprad: 0.27,
         length_m: 0.4, radius_base_m: 0.010, radius_tip_m: 0.008}
    effects:
      - {name: dry_friction, joint: 1, parameters: {torque_Nm: 0.21}}

Segments stand base first. The last three keys of a segment may be left out, of all segments alike. ``claimed: false``
says that the effects are the nearest ones that a diagnosis found, which it does not claim; the springs are fitted
beside them and go with them. ``held_out: [traj_01.csv]`` names the recordings of its case that the model was not fitted
to, where they are not those that a case holds out by itself. ``courses: [{file: traj_01.csv, x: [...], y: [...]}]`` are
the courses of gusts that were read off the recordings: pressure over its rms at every sample, from 3 s before the first
on.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from ..base.strict_yaml import Length, NotNegative, Positive, Strict, YamlFile, nearest, validated
from ..effects import Law, effect_of, effects
from ..effects.registry import Form

FORMAT = "branch-model/1"
GEOMETRY = ("length_m", "radius_base_m", "radius_tip_m")
_WHOLE: dict[Form, str] = {"branch": "branch", "joint": "mechanism"}


class SegmentModel(Strict):
    """Spring and damper at the lower end of a segment, and its size: solid, straight, tapered."""

    name: str
    stiffness_Nmprad: Positive  # noqa: N815
    damping_Nmsprad: NotNegative  # noqa: N815
    length_m: Length | None = None
    radius_base_m: Positive | None = None
    radius_tip_m: Positive | None = None

    @property
    def size(self) -> tuple[float, float, float] | None:
        """Length, radius of the lower and of the upper end [m], None where the file does not say."""
        if self.length_m is None or self.radius_base_m is None or self.radius_tip_m is None:
            return None
        return self.length_m, self.radius_base_m, self.radius_tip_m


class EffectModel(Strict):
    """An effect with its parameters; ``joint`` counts from the base, null where it is not at a joint."""

    name: str
    joint: Annotated[int, Field(ge=0)] | None = None
    parameters: dict[str, float]

    @property
    def label(self) -> str:
        """Name and joint, such as ``dry_friction@1``."""
        return self.name if self.joint is None else f"{self.name}@{self.joint}"


class CourseModel(Strict):
    """Pressure of gusts over its rms, along x and y, in one recording."""

    file: str
    x: Annotated[list[float], Field(min_length=1)]
    y: Annotated[list[float], Field(min_length=1)]


class BranchFile(Strict):
    """The keys of ``model.yaml``."""

    format: Literal["branch-model/1"]
    name: str
    segments: Annotated[list[SegmentModel], Field(min_length=1)]
    effects: tuple[EffectModel, ...] = Field(default=(), strict=False)
    claimed: bool = True
    held_out: tuple[str, ...] | None = Field(default=None, min_length=1, strict=False)
    courses: tuple[CourseModel, ...] = Field(default=(), strict=False)

    @property
    def sizes(self) -> list[tuple[float, float, float]] | None:
        """Length and radii of every segment [m], None where the file does not say."""
        found = [s.size for s in self.segments if s.size is not None]
        return found if len(found) == len(self.segments) else None


def read_branch_file(path: str | Path) -> BranchFile:
    """Read a ``model.yaml``.

    Raises:
        InputError: The file is missing or no YAML, has unknown or missing keys or values that cannot be, gives the size
            of a segment in part or of some segments only, names an unknown effect, puts it where it cannot act, or
            leaves out one of its parameters that is not optional.
    """
    file = YamlFile(Path(path), FORMAT)
    check_format(file, FORMAT, "the model of a branch")
    meta = validated(file, BranchFile)
    for i in range(len(meta.segments)):
        _check_segment(file, meta.segments, i)
    check_effects(file, meta.effects, "branch", len(meta.segments))
    _check_courses(file, meta)
    return meta


def _check_courses(file: YamlFile, meta: BranchFile) -> None:
    """Raise `InputError` for courses of unequal lengths, two of one recording, or none where an effect needs them."""
    for i, own in enumerate(meta.courses):
        if len(own.x) != len(own.y):
            raise file.error(["courses", i], f"{len(own.x)} values of x, {len(own.y)} of y", "as many of each")
        if own.file in [other.file for other in meta.courses[:i]]:
            raise file.error(["courses", i, "file"], f"{own.file} a second time", "each recording once")
    for i, effect in enumerate(meta.effects):
        law = effect_of(effect.name).law("branch")
        needed = [p.name for p in law.parameters if p.read_off and effect.parameters[p.name] != p.neutral]
        if needed and not meta.courses:
            here: list[str | int] = ["effects", i, "parameters", needed[0]]
            raise file.error(here, f"{effect.parameters[needed[0]]:g} without courses", "0, or courses to follow")


def check_format(file: YamlFile, wanted: str, what: str) -> None:
    """Raise `InputError` for a file that says to be of another format, before its keys are read by this one."""
    found = file.content.get("format")
    if isinstance(found, str) and found != wanted:
        raise file.error(["format"], found, f"{wanted}, {what}")


def _check_segment(file: YamlFile, segments: Sequence[SegmentModel], i: int) -> None:
    here: list[str | int] = ["segments", i]
    s, any_size = segments[i], any(getattr(s, key) is not None for s in segments for key in GEOMETRY)
    if s.name in [other.name for other in segments[:i]]:
        raise file.error([*here, "name"], f"{s.name} a second time", "unique names")
    if not any_size:
        return
    missing = [key for key in GEOMETRY if getattr(s, key) is None]
    if missing:
        raise file.error(here, f"no {missing[0]}", f"{', '.join(GEOMETRY)} of every segment, or of none")
    for key in GEOMETRY[1:]:
        if getattr(s, key) >= s.length_m:
            found = f"{getattr(s, key):g} in a segment of {s.length_m:g} m"
            raise file.error([*here, key], found, "less than the length, in metres")


def check_effects(file: YamlFile, found: Sequence[EffectModel], form: Form, joints: int) -> None:
    """Check the effects of a model with so many joints, and set the parameters that are left out to neutral.

    Raises:
        InputError: An effect is unknown, acts where it cannot or a second time, or has a parameter that it does not
            have, none of one that it needs, or one below zero that is positive.
    """
    for i in range(len(found)):
        _check_effect(file, found, i, form, joints)


def _check_effect(file: YamlFile, found: Sequence[EffectModel], i: int, form: Form, joints: int) -> None:
    here: list[str | int] = ["effects", i]
    item = found[i]
    names = [e.name for e in effects() if getattr(e, form) is not None]
    if item.name not in names:
        raise file.error([*here, "name"], repr(item.name), nearest(item.name, names))
    law = effect_of(item.name).law(form)
    if law.per_joint and (item.joint is None or item.joint >= joints):
        what = "no joint" if item.joint is None else str(item.joint)
        raise file.error([*here, "joint"], what, f"a joint, 0 to {joints - 1}")
    if not law.per_joint and item.joint is not None:
        raise file.error([*here, "joint"], str(item.joint), f"no joint: it acts on the whole {_WHOLE[form]}")
    if item.label in [other.label for other in found[:i]]:
        raise file.error(here, f"{item.label} a second time", "each effect once at a joint")
    _check_parameters(file, [*here, "parameters"], item, law)


def _check_parameters(file: YamlFile, here: list[str | int], item: EffectModel, law: Law) -> None:
    names = [p.name for p in law.parameters]
    for name in item.parameters:
        if name not in names:
            raise file.error([*here, name], f"'{name}', which {item.name} does not have", nearest(name, names))
    for spec in law.parameters:
        if spec.optional:
            item.parameters.setdefault(spec.name, spec.neutral)
        if spec.name not in item.parameters:
            raise file.error(here, f"no {spec.name}", ", ".join(names))
        if spec.scale == "log" and item.parameters[spec.name] < 0.0:
            raise file.error([*here, spec.name], f"{item.parameters[spec.name]:g}", f"0 or more, in {spec.unit}")
