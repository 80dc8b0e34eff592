"""Small cases that a law is tried on: a stick that is pushed and let go, and a hinge that is driven."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ...sim.base.types import Array
from ...sim.effects.registry import Form
from ..cases.case import BranchCase, JointCase, load_case
from ..replay.simulated_case import Experiment, random_branch, write_simulated_case

#: Spring [N m/rad] and damper [N m s/rad] of either case.
SPRING, DAMPER = 30.0, 0.3
_INERTIA = 0.3


def case_for(form: Form, folder: Path) -> BranchCase | JointCase:
    """Write and load a case of one joint: four recordings, 110 samples at 50 Hz."""
    return _stick(folder) if form == "branch" else _hinge(folder)


def _stick(folder: Path) -> BranchCase:
    truth = {"stiffness": np.array([SPRING]), "damping": np.array([DAMPER])}
    branch = random_branch(np.random.default_rng(1), 1)
    return write_simulated_case(folder, branch, truth, Experiment(noise=0.0), trajectories=4, seed=2)


def _hinge(folder: Path) -> JointCase:
    """Drive a hinge on a spring by four torques, slow and fast, small and large; no law is in its motion."""
    folder.mkdir(parents=True)
    t = np.arange(110) / 50.0
    runs = []
    for k, (size, rate) in enumerate([(4.0, 0.7), (8.0, 1.1), (3.0, 2.3), (8.0, 0.4)]):
        torque = size * np.where(t < 1.5, np.sin(2 * np.pi * rate * t), 0.0)
        rows = np.column_stack([t, torque, *_swung(torque)])
        np.savetxt(folder / f"run_{k}.csv", rows, delimiter=",", header="time_s,torque,angle,rate", comments="")
        runs.append({"file": f"run_{k}.csv", "t_start_s": 10.0 * k, "replicate_of": None})
    (folder / "meta.yaml").write_text(yaml.safe_dump(_meta(runs)))
    case = load_case(folder)
    assert isinstance(case, JointCase)
    return case


def _swung(torque: Array) -> tuple[Array, Array]:
    """Angle and rate of the hinge by a semi-implicit step of 0.2 ms, torque held; priors are scaled by them."""
    angle, rate, out = 0.0, 0.0, []
    for u in torque:
        out.append((angle, rate))
        for _ in range(100):
            rate += 2e-4 * (u - SPRING * angle - DAMPER * rate) / _INERTIA
            angle += 2e-4 * rate
    angles, rates = np.array(out).T
    return angles, rates


def _meta(runs: list[dict[str, Any]]) -> dict[str, Any]:
    joint = {"name": "hinge", "type": "revolute", "inertia": _INERTIA, "stiffness": None, "damping": None}
    outputs = [
        {"joint": "hinge", "quantity": q, "column": c, "scale": 1.0}
        for q, c in (("position", "angle"), ("velocity", "rate"))
    ]
    given = {"joint": "hinge", "column": "torque", "scale": 1.0, "hold": "linear"}
    return {"format": "joint-gap-case/1", "name": "hinge", "mechanism": {"joints": [joint]}, "input": given,
            "outputs": outputs, "trajectories": runs, "noise_nominal": None}  # fmt: skip
