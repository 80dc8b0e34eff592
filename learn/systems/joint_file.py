"""``model.yaml`` of joints that are measured directly: what a case left unknown of them, and the effects found.

    format: joint-model/1
    name: pendulum
    fit: replay
    joints:
      - {name: swing, type: revolute}
    parameters:
      - {name: gravity torque swing, value: 54.1, unit: N m}
      - {name: damping swing, value: 0.012, unit: N m s/rad}
    effects:
      - name: dry_friction
        joint: 0
        parameters: {torque_Nm: 0.21, bend_rad: 0.0005}
        units: {torque_Nm: N m, bend_rad: rad}

What is known of the mechanism stands in the case. ``fit`` says whether the model was fitted to the motion that the
efforts cause or to the efforts that the motion needs (``torque``; ``filter_hz`` is the cut-off of the filter then). A
joint that slides has N for N m and m for rad, whatever the name of an effect's parameter says; ``units`` says so, and
may be left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from ...sim.base.strict_yaml import Positive, Strict, YamlFile, nearest, validated
from ...sim.base.types import Array
from ...sim.effects import effect_of
from ...sim.wood.branch_file import EffectModel, check_effects, check_format
from ..cases.case import JointCase
from .acting import Acting, unit_at
from .choose import system_of
from .system import Parameter

FORMAT = "joint-model/1"


class AxisModel(Strict):
    """One joint."""

    name: str
    type: Literal["revolute", "prismatic"]


class ValueModel(Strict):
    """The value of one unknown of the case, by the name that a posterior gives it."""

    name: str
    value: float
    unit: str


class JointEffectModel(EffectModel):
    """An effect with its parameters and their units."""

    units: dict[str, str] = Field(default_factory=dict)


class JointFile(Strict):
    """The keys of the file."""

    format: Literal["joint-model/1"]
    name: str
    fit: Literal["replay", "torque"]
    filter_hz: Positive | None = None
    joints: Annotated[list[AxisModel], Field(min_length=1)]
    parameters: list[ValueModel]
    effects: tuple[JointEffectModel, ...] = Field(default=(), strict=False)
    claimed: bool = True


@dataclass(frozen=True)
class JointModel:
    """What a case left unknown of its joints, and effects.

    Attributes:
        name: Of the case.
        fit: What it was fitted to, as in `JointSetup`.
        joints: Name and type of every joint.
        names: Of the unknowns, in the order of the case's system, length n.
        units: Of the unknowns.
        values: Of the unknowns in SI units, shape [n].
        effects: Effects; all their parameters are known.
        claimed: Whether the effects are claimed; else they are the nearest ones of a diagnosis.
        filter_hz: Cut-off of the filter of a torque fit [Hz]; None takes the case's.
    """

    name: str
    fit: Literal["replay", "torque"]
    joints: tuple[tuple[str, Literal["revolute", "prismatic"]], ...]
    names: tuple[str, ...]
    units: tuple[str, ...]
    values: Array
    effects: tuple[Acting, ...] = ()
    claimed: bool = True
    filter_hz: float | None = None

    def as_fitted(self, case: JointCase) -> JointCase:
        """Return the case as the model was fitted to it: to the motion, or to efforts through the same filter."""
        return replace(case, fit=self.fit, filter_hz=self.filter_hz or case.filter_hz)

    def content(self) -> dict[str, Any]:
        """Return what ``model.yaml`` holds."""
        rows = zip(self.names, self.values, self.units, strict=True)
        return {
            "format": FORMAT, "name": self.name, "fit": self.fit,
            **({"filter_hz": self.filter_hz} if self.filter_hz else {}),
            "joints": [{"name": n, "type": t} for n, t in self.joints],
            "parameters": [{"name": n, "value": float(v), "unit": u} for n, v, u in rows],
            "effects": [self._effect(a) for a in self.effects],
        }  # fmt: skip

    def _effect(self, a: Acting) -> dict[str, Any]:
        slides = a.joint is not None and self.joints[a.joint][1] == "prismatic"
        units = {p.name: unit_at(p.unit, slides) for p in effect_of(a.name).law("joint").parameters}
        known = {k: float(v) for k, v in a.known.items()}
        return {"name": a.name, "joint": a.joint, "parameters": known, "units": {k: units[k] for k in known}}


def joint_model_of(path: str | Path, case: JointCase) -> JointModel:
    """Read the model of a case of joints.

    Raises:
        InputError: The file is faulty, its joints, unknowns or units are not those of the case, or an effect is unknown
            or acts where it cannot.
    """
    file = YamlFile(Path(path), FORMAT)
    check_format(file, FORMAT, "the model of joints")
    meta = validated(file, JointFile)
    joints = tuple((j.name, j.type) for j in meta.joints)
    own = tuple((j.name, j.type) for j in case.joints)
    if joints != own:
        raise file.error(["joints"], _listed(joints), f"the case's, in its order: {_listed(own)}")
    check_effects(file, meta.effects, "joint", len(joints))
    _check_units(file, meta)
    system = system_of(case)
    return JointModel(
        meta.name, meta.fit, joints, tuple(p.name for p in system.parameters), tuple(p.unit for p in system.parameters),
        _values(file, meta, system.parameters),
        tuple(Acting(e.name, e.joint, dict(e.parameters)) for e in meta.effects), meta.claimed,
        meta.filter_hz,
    )  # fmt: skip


def _listed(joints: tuple[tuple[str, str], ...]) -> str:
    return ", ".join(f"{name} ({kind})" for name, kind in joints)


def _check_units(file: YamlFile, meta: JointFile) -> None:
    for i, item in enumerate(meta.effects):
        specs = {p.name: p.unit for p in effect_of(item.name).law("joint").parameters}
        slides = item.joint is not None and meta.joints[item.joint].type == "prismatic"
        for name, unit in item.units.items():
            here: list[str | int] = ["effects", i, "units", name]
            if name not in specs:
                raise file.error(here, f"'{name}'", nearest(name, list(specs)))
            if unit != unit_at(specs[name], slides):
                raise file.error(here, unit, unit_at(specs[name], slides))


def _values(file: YamlFile, meta: JointFile, unknowns: Sequence[Parameter]) -> Array:
    """Return the values of the case's unknowns, in their order."""
    known = {p.name: p for p in unknowns}
    given: dict[str, float] = {}
    for i, item in enumerate(meta.parameters):
        here: list[str | int] = ["parameters", i]
        if item.name not in known:
            raise file.error([*here, "name"], repr(item.name), nearest(item.name, list(known)))
        if item.name in given:
            raise file.error([*here, "name"], f"{item.name} a second time", "each unknown once")
        if item.unit != known[item.name].unit:
            raise file.error([*here, "unit"], item.unit, known[item.name].unit)
        if known[item.name].scale == "log" and item.value <= 0.0:
            raise file.error([*here, "value"], f"{item.value:g}", f"a number above 0, in {item.unit}")
        given[item.name] = item.value
    missing = [name for name in known if name not in given]
    if missing:
        raise file.error(["parameters"], f"no {missing[0]}", f"all that the case leaves unknown: {', '.join(known)}")
    return np.array([given[name] for name in known])
