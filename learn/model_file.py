"""``model.yaml``: a branch's springs and dampers, and the effects that it was found to have.

    format: branch-model/1
    name: branch_7
    segments:
      - {name: parent, stiffness_Nmprad: 74.2, damping_Nmsprad: 1.31}
      - {name: child, stiffness_Nmprad: 15.1, damping_Nmsprad: 0.27}
    effects:
      - {name: dry_friction, joint: 1, parameters: {torque_Nm: 0.21}}

Geometry, masses and gravity are those of the case that it is used with; ``segments`` must have its names, base first.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import yaml
from pydantic import Field

from ..sim.effects import Setting, effect_of
from ..sim.errors import InputError
from ..sim.tree import Array
from .acting import Acting, ActingSet
from .case import BranchCase
from .case_schema import MetaFile, NotNegative, Positive, Strict, validated

FORMAT = "branch-model/1"


class SegmentModel(Strict):
    """Spring and damper at the lower end of a segment."""

    name: str
    stiffness_Nmprad: Positive  # noqa: N815
    damping_Nmsprad: NotNegative  # noqa: N815


class EffectModel(Strict):
    """An effect with all its parameters; ``joint`` counts from the base, null where it is not at a joint."""

    name: str
    joint: Annotated[int, Field(ge=0)] | None = None
    parameters: dict[str, float]


class ModelMeta(Strict):
    """The keys of ``model.yaml``."""

    format: Literal["branch-model/1"]
    name: str
    segments: Annotated[list[SegmentModel], Field(min_length=1)]
    effects: tuple[EffectModel, ...] = Field(default=(), strict=False)


@dataclass(frozen=True)
class BranchModel:
    """A branch's springs, dampers and effects.

    Attributes:
        name: Of the branch.
        segment_name: Names of the segments, base first, length R.
        stiffness: Springs [N m/rad], shape [R].
        damping: Dampers [N m s/rad], shape [R].
        effects: Effects; all their parameters are known.
    """

    name: str
    segment_name: tuple[str, ...]
    stiffness: Array
    damping: Array
    effects: tuple[Acting, ...] = ()


def read_model(path: str | Path) -> BranchModel:
    """Read a ``model.yaml``.

    Raises:
        InputError: The file is missing or no YAML, has unknown or missing keys or values that cannot be, names an
            unknown effect, or leaves out one of an effect's parameters.
    """
    file = MetaFile(Path(path), FORMAT)
    meta = validated(file, ModelMeta)
    acting = []
    for i, item in enumerate(meta.effects):
        law = effect_of(item.name, str(path)).law("branch")
        for spec in law.parameters:
            if spec.name not in item.parameters:
                here: list[str | int] = ["effects", i, "parameters"]
                raise file.error(here, f"no {spec.name}", ", ".join(p.name for p in law.parameters))
        acting.append(Acting(item.name, item.joint, dict(item.parameters)))
    model = BranchModel(meta.name, tuple(s.name for s in meta.segments),
                        np.array([s.stiffness_Nmprad for s in meta.segments]),
                        np.array([s.damping_Nmsprad for s in meta.segments]), tuple(acting))  # fmt: skip
    ActingSet(acting, "branch", [Setting()] * len(model.stiffness), str(path))
    return model


def write_model(path: str | Path, model: BranchModel) -> None:
    """Write a ``model.yaml``; numbers keep all their digits."""
    segments = [
        {"name": n, "stiffness_Nmprad": float(k), "damping_Nmsprad": float(d)}
        for n, k, d in zip(model.segment_name, model.stiffness, model.damping, strict=True)
    ]
    acting = [{"name": a.name, "joint": a.joint, "parameters": {k: float(v) for k, v in a.known.items()}}
              for a in model.effects]  # fmt: skip
    content = {"format": FORMAT, "name": model.name, "segments": segments, "effects": acting}
    Path(path).write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def check_fits(model: BranchModel, case: BranchCase, source: str | Path) -> None:
    """Raise `InputError` where a model's segments are not the case's."""
    if model.segment_name != case.segment_name:
        found = f"{', '.join(model.segment_name)}"
        raise InputError(source, "segments", found, f"the case's, base first: {', '.join(case.segment_name)}")
