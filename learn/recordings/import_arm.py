"""A case of an arm from ROS bags of free motions: joint states, torques where there are any, commanded speeds."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
import yaml

from ...sim.arms.arm import Arm
from ...sim.arms.statics import statics
from ...sim.base.errors import InputError
from ...sim.base.files import output_folder
from ...sim.base.types import Array
from ..cases.arm import ArmCase, load_arm_case
from ..cases.clock import GAP
from .bag import Stream, read_bag
from .folder import APART, ASSUMPTIONS

Weight = Literal["in", "out"]


def import_arm(
    bags: Sequence[Path], out: Path, arm: Arm, called: str, weight: Weight | None
) -> tuple[ArmCase, list[str]]:
    """Write the case of an arm, read it back, and return it and what was assumed.

    Args:
        bags: A recording each.
        out: Folder to write.
        arm: The arm; its joints are those of the joint states, in their order.
        called: Its name in the registry of arms.
        weight: Whether efforts hold the arm's weight; by which leaves less of them if None.

    Raises:
        InputError: A bag cannot be read, has no joint states of this arm or a gap in them; efforts or commands are in
            some bags only, or in none.
    """
    parts = [_recording(path, arm) for path in bags]
    for index, what in ((1, "efforts"), (2, "commanded speeds")):
        having = [p[index] is not None for p in parts]
        if any(having) and not all(having):
            path = bags[having.index(False)]
            raise InputError(
                path, "", f"no {what}, which {bags[having.index(True)].name} has", f"bags with {what} or without"
            )
    first = parts[0]
    if first[1] is None and first[2] is None:
        raise InputError(bags[0], "", "neither efforts nor commanded speeds", "joint states with efforts, or commands")
    rate = float(np.round(1.0 / np.median(np.concatenate([np.diff(p[0][:, 0]) for p in parts]))))
    notes = [f"the grid is {rate:g} Hz, linear between joint states; a command is the mean since the row before",
             "commands and joint states are on one clock, that of their arrival in the bag"]  # fmt: skip
    if first[1] is not None and weight is None:
        weight, note = _guessed(arm, parts)
        notes.append(note)
    with output_folder(out) as work:
        names = [_write(work / f"run_{k + 1}.csv", part, max(rate, 1e-3)) for k, part in enumerate(parts)]
        meta = _meta(called, arm.tree.link_name, weight or "out", names, first[1] is not None, first[2] is not None)
        (work / "meta.yaml").write_text(yaml.safe_dump(meta, sort_keys=False), encoding="utf-8")
        head = f"Made by bough import-arm of {', '.join(p.name for p in bags)}."
        (work / ASSUMPTIONS).write_text("\n".join([head, *(f"- {n}" for n in notes)]) + "\n", encoding="utf-8")
        load_arm_case(work)
    return load_arm_case(out), notes


Part = tuple[Array, Array | None, tuple[Array, Array] | None]


def _recording(path: Path, arm: Arm) -> Part:
    """Return times and positions [T, 1 + D], efforts [T, D], and times and values of commands."""
    bag = read_bag(path)
    states = [s for s in bag.of("joints") if len(s.names) == arm.num_dofs]
    if not states:
        found = ", ".join(f"{s.name} ({len(s.names)} joints)" for s in bag.of("joints")) or "no joint states"
        raise InputError(path, "", found, f"joint states with positions of {arm.num_dofs} joints")
    state = max(states, key=lambda s: len(s.time))
    time, position, effort = state.arrays()
    steps = np.diff(time)
    if steps.max() >= GAP * np.median(steps):
        raise InputError(path, state.name, f"a gap of {steps.max():.3g} s", f"steps of {np.median(steps):.3g} s")
    late = float(np.mean(np.array(state.arrived) - np.array(state.time)))
    commands = [c for s in bag.of("command") if (c := _commands(s, arm.num_dofs, late)) is not None]
    known = np.isfinite(effort).all() and effort.any()
    return np.column_stack([time, position]), effort if known else None, commands[0] if commands else None


def _commands(stream: Stream, joints: int, late: float) -> tuple[Array, Array] | None:
    """Return times on the joint states' clock and commanded speeds [K, D]; None where they are of fewer joints."""
    if len(stream.values[0]) < joints:
        return None
    order = np.argsort(stream.arrived, kind="stable")
    return np.array(stream.arrived)[order] - late, np.array(stream.values)[order][:, :joints]


def _guessed(arm: Arm, parts: Sequence[Part]) -> tuple[Weight, str]:
    """Return whether efforts hold the weight, by which leaves less of them, and what to say of it."""
    efforts = np.concatenate([e for _, e, _ in parts if e is not None])
    weight = statics(arm, np.concatenate([p[:, 1:] for p, _, _ in parts]))[0]
    bare, held = (float(np.sqrt((e**2).mean())) for e in (efforts, efforts - weight))
    taken: Weight = "in" if held < bare else "out"
    return taken, f"weight: {taken}: efforts have {bare:.2f} N m rms as they are, {held:.2f} less the arm's weight"


def _write(path: Path, part: Part, rate: float) -> str:
    """Write a recording's CSV file; return its name."""
    (states, effort, command), d = part, part[0].shape[1] - 1
    time = states[:, 0]
    grid = time[0] + np.arange(int((time[-1] - time[0]) * rate + 1e-9) + 1) / rate
    columns = {"time_s": grid - time[0]}
    position = np.unwrap(states[:, 1:], axis=0)
    for j in range(d):
        columns[f"q{j + 1}_rad"] = np.interp(grid, time, position[:, j])
        if effort is not None:
            columns[f"tau{j + 1}_Nm"] = np.interp(grid, time, effort[:, j])
        if command is not None:
            columns[f"dq_cmd{j + 1}_rad_s"] = _since(grid, command[0], command[1][:, j], 1.0 / rate)
    np.savetxt(path, np.column_stack(list(columns.values())), fmt="%.12g", delimiter=",", header=",".join(columns),
               comments="")  # fmt: skip
    return path.name


def _since(grid: Array, time: Array, values: Array, step: float) -> Array:
    """Return means over the step before every time of a grid, of what holds from one command until the next."""
    path = np.concatenate([[0.0], np.cumsum(values[:-1] * np.diff(time))])

    def at(t: Array) -> Array:
        """Return the integral over time of what is held, up to times t [s]."""
        out: Array = np.interp(t, time, path) + np.maximum(t - time[-1], 0.0) * values[-1]
        return out

    out: Array = (at(grid) - at(grid - step)) / step
    return out


def _meta(
    called: str, joints: list[str], weight: Weight, files: list[str], torques: bool, commands: bool
) -> dict[str, Any]:
    def of(form: str, more: dict[str, Any]) -> list[dict[str, Any]]:
        """Return one entry a joint, its column named by ``form`` and its number from 1 on."""
        return [{"joint": n, "column": form.format(j + 1), "scale": 1.0, **more} for j, n in enumerate(joints)]

    measured = of("tau{}_Nm", {"hold": "linear"}) if torques else None
    asked = {"commands": of("dq_cmd{}_rad_s", {})} if commands else {}
    return {
        "format": "joint-gap-case/1", "mechanism": {"arm": called, "weight": weight}, "input": measured, **asked,
        "outputs": of("q{}_rad", {"quantity": "position"}),
        "trajectories": [{"file": name, "t_start_s": APART * 60 * k} for k, name in enumerate(files)],
    }  # fmt: skip
