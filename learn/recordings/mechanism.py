"""A joint case of several joints, whose mechanism is an MJCF file: a robot's or a rig's own recordings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...sim.base.errors import InputError, shortened
from ...sim.base.types import Array
from ...sim.formats.import_mjcf import load_mjcf
from ...sim.trees.tree import Joint
from .branch import Motions
from .folder import Content, rate_of, starts_of
from .given import SOURCE, Given, repeats_of
from .questions import Asker

_SCALAR = (Joint.REVOLUTE, Joint.PRISMATIC)


def mechanism_content(measured: Motions, driven: bool, path: Path, given: Given, ask: Asker) -> Content:
    """Return a joint case of the joints of an MJCF file, in the order of the columns.

    Args:
        measured: Angles and torques, a column for each joint.
        driven: Whether torques were measured.
        path: The MJCF file, which is copied into the case.
        given: What was said.
        ask: Who keeps notes.

    Raises:
        InputError: The file cannot be read, or has another number of joints than there are columns.
    """
    names = _joint_names(path)
    columns = measured.motion[0].shape[1]
    if len(names) != columns:
        found = f"{len(names)} joints ({', '.join(names)}) for {columns} columns of --angle"
        raise InputError(path, "--mjcf", found, "a column for each joint, in the file's order")
    unknown = list(given.unknown) or ["damping"]
    order, learnt = ", ".join(names), ", ".join(unknown)
    ask.notes.append(f"mechanism: joints {order} of {path.name}, in this order; unknown: {learnt} (--unknown); angles "
                     "are the file's coordinates")  # fmt: skip
    efforts, angles = ([f"{what}_{name}" for name in names] for what in ("torque_Nm", "angle_rad"))
    rate = rate_of(measured.step)
    tables: list[tuple[Sequence[str], Array]] = []
    for f, x in zip(measured.effort, measured.motion, strict=True):
        t = np.arange(len(x))[:, None] / rate
        tables.append((("t_s", *efforts, *angles), np.hstack([t, f, x])) if driven else
                      (("t_s", *angles), np.hstack([t, x])))  # fmt: skip
    meta = _meta(
        names, efforts if driven else [], angles, unknown, path.name, given, [len(t) / rate for _, t in tables]
    )
    return Content(meta, tables, (path,))


def _joint_names(path: Path) -> list[str]:
    mechanism = load_mjcf(path)
    links = [i for i, kind in enumerate(mechanism.tree.joint) if kind != Joint.FIXED]
    names = [mechanism.joint_name[i] or f"joint{i}" for i in links]
    for i, name in zip(links, names, strict=True):
        if Joint(mechanism.tree.joint[i]) not in _SCALAR:
            raise InputError(
                path, mechanism.joint_place[i], f"a ball joint, {shortened(name)}", "hinge or slide joints"
            )
    return names


def _meta(
    names: list[str], efforts: list[str], angles: list[str], unknown: list[str], file: str, given: Given,
    lengths: list[float],
) -> dict[str, Any]:  # fmt: skip
    repeats = repeats_of(given.repeats, len(lengths))
    driven = [{"joint": name, "column": column, "scale": 1.0, "hold": "linear"}
              for name, column in zip(names, efforts, strict=False)]  # fmt: skip
    meta: dict[str, Any] = {
        "format": "joint-gap-case/1", "name": given.name, "time_column": "t_s", "time_scale": 1.0,
        "mechanism": {"mjcf": file, "unknown": unknown}, "input": driven or None,
        "outputs": [{"joint": name, "quantity": "position", "column": column, "scale": 1.0}
                    for name, column in zip(names, angles, strict=True)],
        "trajectories": [{"file": f"traj_{i + 1:02d}.csv", "t_start_s": start, "replicate_of": repeats.get(i + 1)}
                         for i, start in enumerate(starts_of(given.starts, lengths))],
        "noise_nominal": given.noise,
    }  # fmt: skip
    return {key: value for key, value in meta.items() if key != "name" or value}


def check_mjcf(path: Path, angle: bool) -> None:
    """Refuse an MJCF file that is not there, or without angles.

    Raises:
        InputError: So it is.
    """
    if not angle:
        raise InputError(SOURCE, "--mjcf", "no --angle", "the columns of the joints' angles, and --torque or --free")
    if not path.is_file():
        raise InputError(path, "--mjcf", "no such file", "an MJCF file of the joints")
