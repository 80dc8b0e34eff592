"""The diagnosis of an arm on disk: verdict.json, model.yaml, figures and report.html."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from matplotlib.figure import Figure

from ...sim.arms.servo import ArmFile
from ...version import __version__
from ..reports.figures import FAINT, MEASURED, MODEL, NOISE, WIDTH, styled
from ..reports.page import KeyNumber, ParameterRow, ReportContent, ReportFigure, ReportTable, write_report
from .channels import UNITS, Kind
from .diagnose import ArmDiagnosis
from .effects import PARAMETERS
from .search import Channel

#: Names that the simulator's servos do not have: `sim.arms.servo` leaves them out of what it gives them.
NOT_SIMULATED = ("backlash", "servo_lag", "speed_scale")


def write_arm_diagnosis(folder: Path, found: ArmDiagnosis) -> None:
    """Write verdict.json, model.yaml, report.html and its figures into an existing folder."""
    (folder / "verdict.json").write_text(json.dumps(verdict_file(found), indent=1) + "\n", encoding="utf-8")
    write_arm_file(folder / "model.yaml", found.model())
    write_report(folder, _content(found))


def write_arm_file(path: Path, model: ArmFile) -> None:
    """Write the ``model.yaml`` of an arm; numbers keep all their digits."""
    path.write_text(yaml.safe_dump(model.model_dump(), sort_keys=False), encoding="utf-8")


def verdict_file(found: ArmDiagnosis) -> dict[str, Any]:
    """Return what ``verdict.json`` holds: the keys of other diagnoses, and every channel."""
    channels = found.channels
    effects = [
        {"name": n.name, "joint": c.joint, "of": c.kind, "p": n.p,
         "parameters": {PARAMETERS[n.name][0]: {"median": n.value, "low": n.low, "high": n.high, "unit": n.unit}}}
        for c, n in found.claimed
    ]  # fmt: skip
    return {
        "case": found.case.name, "verdict": found.verdict, "effects": effects,
        "alternatives": {f"{n.name}@{c.joint} of {c.kind}": list(n.alternatives)
                         for c, n in found.claimed if n.alternatives},
        "nearest": _nearest(channels) if found.verdict == "unknown" else None,
        "gap": {k: gap(channels, k) for k in UNITS if any(c.kind == k for c in channels)},
        "p_null": min((c.p for c in channels), default=None), "next_experiment": next_experiment(found),
        "sentence": sentence(found), "remarks": remarks(found), "channels": [_plain(found, c) for c in channels],
    }  # fmt: skip


def gap(channels: Sequence[Channel], kind: Kind) -> dict[str, Any]:
    """Return the rms left of blocks not seen, over all joints, before and after, and the white noise."""
    mine = [c for c in channels if c.kind == kind]

    def rms(key: str) -> float:
        """Return the rms over the channels' joints of one of their numbers."""
        return float(np.sqrt(np.mean([getattr(c, key) ** 2 for c in mine])))

    return {"base": rms("base"), "repaired": rms("repaired"), "noise_floor": rms("floor"), "unit": UNITS[kind],
            "held_out": True, "motion": rms("signal")}  # fmt: skip


def _plain(found: ArmDiagnosis, c: Channel) -> dict[str, Any]:
    return {
        "joint": c.joint, "name": found.case.joints[c.joint], "of": c.kind, "unit": UNITS[c.kind], "rows": c.rows,
        "rms": c.signal, "base": c.base, "repaired": c.repaired, "noise_floor": c.floor, "memory_s": c.memory,
        "unnamed": c.unnamed, "claimed": [n.name for n in c.named] if c.claimed else [],
        "not_claimed": [] if c.claimed else [n.name for n in c.named], "nearest": c.nearest,
    }  # fmt: skip


def _nearest(channels: Sequence[Channel]) -> str | None:
    """Return the name that comes nearest in the channel where most is left without one."""
    odd = [c for c in channels if c.named or c.nearest]
    if not odd:
        return None
    most = max(odd, key=lambda c: c.unnamed)
    return most.named[0].name if most.named else most.nearest


def sentence(found: ArmDiagnosis) -> str:
    """Return the verdict in one sentence, and what is left."""
    if found.unusable:
        return f"Unknown: {found.unusable}."
    if found.verdict == "none":
        return "None: the arm's servos lack nothing that these recordings can show."
    if found.verdict == "unknown":
        nearest = _nearest(found.channels)
        near = f" (nearest: {nearest})" if nearest else ""
        return f"Unknown: something is left that none of the names explains{near}: {_left(found)}."
    parts: dict[str, list[str]] = {}
    for c, n in found.claimed:
        at = f"joint {c.joint + 1} ({n.value:.3g}{' ' + n.unit if n.unit else ''})"
        parts.setdefault(f"{n.name} in the {c.kind}", []).append(at)
    text = "; ".join(f"{name} of {', '.join(joints)}" for name, joints in parts.items())
    left = _left(found)
    return f"Missing: {text}." + (f" Left without a name: {left}." if left else "")


def _left(found: ArmDiagnosis) -> str:
    return ", ".join(f"the {c.kind} of joint {c.joint + 1}" for c in found.channels if c.unnamed > 0.0 or not c.claimed)


def remarks(found: ArmDiagnosis) -> list[str]:
    """Return what is to be known with the verdict, a sentence each."""
    out = []
    if any(c.kind == "speed" and n.name == "dry_friction" for c, n in found.claimed):
        out.append("Friction found in speeds is the speed that is lost, times the servo's gain: with another gain it "
                   "is another friction and the same motion.")  # fmt: skip
    away = sorted({n.name for _, n in found.claimed} & set(NOT_SIMULATED))
    if away:
        out.append(f"The simulator's servos have no {', '.join(away)}: they are not among what training is given.")
    slow = [c.joint + 1 for c in found.channels if c.kind == "torque" and c.repaired > 2.0 * c.floor]
    if slow:
        out.append(f"Torques of joints {', '.join(map(str, slow))} err by more than twice their white noise: their "
                   "sensors drift, or something is missing that moves too little to be told from it.")  # fmt: skip
    return out


def next_experiment(found: ArmDiagnosis) -> str:
    """Return what to record next."""
    if found.unusable:
        return "Record more free motion: every joint to and fro, slowly and fast, in many poses."
    if found.verdict == "unknown":
        return "Move the joints that are named here one at a time, to and fro over their whole range, at two speeds."
    if not any(c.kind == "speed" for c in found.channels):
        return "Record the commanded speeds too: they show delay, backlash, and friction that the torques do not."
    return "Record the same motions again on another day, and diagnose these with the new model."


def _content(found: ArmDiagnosis) -> ReportContent:
    statuses: dict[str, Any] = {"none": "good", "effects": "good", "unknown": "warning"}
    numbers = []
    for kind in UNITS:
        if any(c.kind == kind for c in found.channels):
            g = gap(found.channels, kind)
            text = f"Rms over all joints, of what the fit had not seen; white noise {g['noise_floor']:.3g}."
            numbers += [KeyNumber(f"{kind} left by the base model", g["base"], UNITS[kind], text),
                        KeyNumber(f"{kind} left by the repaired model", g["repaired"], UNITS[kind], text)]  # fmt: skip
    parameters = [ParameterRow(f"{n.name}, {found.case.joints[c.joint]} ({c.kind})", n.value, n.low, n.high, n.unit)
                  for c, n in found.claimed]  # fmt: skip
    return ReportContent(
        f"What the servos of {found.case.name} lack", sentence(found), statuses[found.verdict], numbers,
        precisely=" ".join(remarks(found)), parameters=parameters, figures=_figures(found), tables=_tables(found),
        commands=[("bough train reach --arm-model model.yaml --out RUN", "trains with these servos")],
        details={"bough": __version__, "arm": found.case.arm_name, "recordings": len(found.case.trajectories),
                 "blocks": found.rows.blocks if len(found.rows.start) else 0, "next": next_experiment(found)},
    )  # fmt: skip


def _tables(found: ArmDiagnosis) -> list[ReportTable]:
    rows: list[tuple[object, ...]] = [
        (f"{c.kind} {found.case.joints[c.joint]} [{UNITS[c.kind]}]", c.signal, c.base, c.repaired, c.floor,
         ", ".join(n.name for n in c.named) + ("" if c.claimed else " (not claimed)") if c.named else "-",
         f"{100 * c.unnamed:.0f} %" if c.unnamed else "-", c.memory)
        for c in found.channels
    ]  # fmt: skip
    head = ("channel", "rms", "base", "repaired", "white noise", "named", "without a name", "memory [s]")
    note = ("Errors of blocks of motion that the fit had not seen. Without a name: share of the base model's squared "
            "error that poses, speeds and earlier commands explain beside what is named.")  # fmt: skip
    return [ReportTable("Channels", head, rows, note)] if rows else []


def _figures(found: ArmDiagnosis) -> list[ReportFigure]:
    if not found.channels:
        return []
    text = ("Rms error of every channel as a share of its rms, on motion that the fit had not seen: base model, "
            "repaired model, white noise.")  # fmt: skip
    return [ReportFigure("channels.png", _bars(found), text)]


@styled
def _bars(found: ArmDiagnosis) -> Figure:
    kinds = [k for k in UNITS if any(c.kind == k for c in found.channels)]
    figure = Figure(figsize=(WIDTH, 2.6 * len(kinds)), layout="constrained")
    for ax, kind in zip(figure.subplots(len(kinds), 1, squeeze=False)[:, 0], kinds, strict=True):
        mine = [c for c in found.channels if c.kind == kind]
        at = np.arange(len(mine))
        for shift, key, colour, label in ((-0.2, "base", FAINT, "base"), (0.2, "repaired", MODEL, "repaired")):
            ax.bar(at + shift, [getattr(c, key) / c.signal if c.signal else 0.0 for c in mine], 0.38, color=colour,
                   label=label)  # fmt: skip
        ax.plot(at, [c.floor / c.signal if c.signal else 0.0 for c in mine], "_", color=NOISE, markersize=28,
                markeredgewidth=2, label="white noise")  # fmt: skip
        ax.set_xticks(at, [found.case.joints[c.joint] for c in mine])
        ax.set_ylabel(f"{kind}: share of its rms")
        ax.axhline(1.0, color=MEASURED, linewidth=0.6)
    figure.legend(*figure.axes[0].get_legend_handles_labels(), loc="outside upper center", ncols=3)
    return figure
