"""A model as it stands in ``model.yaml``, for the case that it is used with: of a branch, or of joints (`joint_file`).

Of a branch, masses and gravity are the case's; so is the geometry, and a file that states another one does not fit.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ...sim.wood.branch_file import FORMAT, GEOMETRY, read_branch_file
from ..cases.case import BranchCase, JointCase
from .acting import Acting
from .joint_file import JointModel, joint_model_of

#: Lengths and radii that differ by less than this share are the same: a file may have been written with fewer digits.
SAME = 1e-4


@dataclass(frozen=True)
class BranchModel:
    """A branch's springs, dampers and effects.

    Attributes:
        name: Of the branch.
        segment_name: Names of the segments, base first, length R.
        stiffness: Springs [N m/rad], shape [R].
        damping: Dampers [N m s/rad], shape [R].
        effects: Effects; all their parameters are known.
        size: Length, radius of the lower and of the upper end of every segment [m], shape [R, 3]; None if not known.
        claimed: Whether the effects are claimed; else they are the nearest ones of a diagnosis.
        held_out: Files of the recordings that the model was not fitted to; None for those that a case holds out by
            itself.
        courses: Courses of gusts by the recording's file, see `replay.recording.Recording`.
    """

    name: str
    segment_name: tuple[str, ...]
    stiffness: Array
    damping: Array
    effects: tuple[Acting, ...] = ()
    size: Array | None = None
    claimed: bool = True
    held_out: tuple[str, ...] | None = None
    courses: Mapping[str, Array] = field(default_factory=dict)

    @property
    def values(self) -> Array:
        """Springs, then dampers: the values of `BranchSystem`'s own parameters, shape [2 R]."""
        return np.concatenate([self.stiffness, self.damping])


Model = BranchModel | JointModel


def read_model(path: str | Path) -> BranchModel:
    """Read a ``model.yaml``.

    Raises:
        InputError: See `sim.wood.branch_file.read_branch_file`.
    """
    file = read_branch_file(path)
    return BranchModel(
        file.name,
        tuple(s.name for s in file.segments),
        np.array([s.stiffness_Nmprad for s in file.segments]),
        np.array([s.damping_Nmsprad for s in file.segments]),
        tuple(Acting(e.name, e.joint, dict(e.parameters)) for e in file.effects),
        None if file.sizes is None else np.array(file.sizes),
        file.claimed,
        file.held_out,
        {c.file: np.column_stack([c.x, c.y]) for c in file.courses},
    )


def write_model(path: str | Path, model: Model) -> None:
    """Write the ``model.yaml`` of a branch or of joints; numbers keep all their digits."""
    content = model.content() if isinstance(model, JointModel) else _content(model)
    if not model.claimed:
        content["claimed"] = False
    Path(path).write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")


def _content(model: BranchModel) -> dict[str, Any]:
    segments = [
        {"name": n, "stiffness_Nmprad": float(k), "damping_Nmsprad": float(d)}
        for n, k, d in zip(model.segment_name, model.stiffness, model.damping, strict=True)
    ]
    if model.size is not None:
        for segment, row in zip(segments, model.size, strict=True):
            segment.update(zip(GEOMETRY, map(float, row), strict=True))
    acting = [{"name": a.name, "joint": a.joint, "parameters": {k: float(v) for k, v in a.known.items()}}
              for a in model.effects]  # fmt: skip
    content = {"format": FORMAT, "name": model.name, "segments": segments, "effects": acting}
    if model.held_out is not None:
        content["held_out"] = list(model.held_out)
    if model.courses:
        content["courses"] = [{"file": k, **{a: _Row(c) for a, c in zip("xy", own.T.tolist(), strict=True)}}
                              for k, own in model.courses.items()]  # fmt: skip
    return content


class _Row(list[float]):
    """Numbers that are written one beside the other."""


def _on_lines(dumper: yaml.SafeDumper, row: _Row) -> yaml.Node:
    return dumper.represent_sequence("tag:yaml.org,2002:seq", row, flow_style=True)


yaml.SafeDumper.add_representer(_Row, _on_lines)


def model_of(path: str | Path, case: BranchCase | JointCase) -> Model:
    """Read the model of a case.

    Raises:
        InputError: The file is faulty, of the other form of case, or another branch's or mechanism's.
    """
    if isinstance(case, JointCase):
        return joint_model_of(path, case)
    model = read_model(path)
    check_fits(model, case, path)
    return model


def check_fits(model: BranchModel, case: BranchCase, source: str | Path) -> None:
    """Raise `InputError` where a model is not the case's: other names, lengths or radii, or courses of other length."""
    if model.segment_name != case.segment_name:
        found = f"{', '.join(model.segment_name)}"
        raise InputError(source, "segments", found, f"the case's, base first: {', '.join(case.segment_name)}")
    _check_courses(model, case, source)
    if model.size is None:
        return
    own = np.column_stack([case.length, case.radius])
    other = np.argwhere(~np.isclose(model.size, own, rtol=SAME, atol=0.0))
    if len(other):
        i, c = other[0].tolist()
        place, found = f"segments, {model.segment_name[i]} {GEOMETRY[c]}", f"{model.size[i, c]:g}"
        raise InputError(source, place, found, f"the case's, {own[i, c]:g}")


def blown_by(model: Model, case: BranchCase | JointCase) -> BranchCase | JointCase:
    """Return a case with the courses of gusts that a model has for its recordings."""
    if not isinstance(model, BranchModel) or not isinstance(case, BranchCase):
        return case
    blown = (replace(t, course=model.courses.get(t.file)) for t in case.trajectories)
    return replace(case, trajectories=tuple(blown))


def _check_courses(model: BranchModel, case: BranchCase, source: str | Path) -> None:
    """Raise `InputError` for courses of some recordings only, or that are not as long as these."""
    if not model.courses:
        return
    for t in case.trajectories:
        length = case.lead + len(t.t)
        found = len(model.courses.get(t.file, ()))
        if found != length:
            raise InputError(source, f"courses, {t.file}", f"{found} values", f"{length}")
