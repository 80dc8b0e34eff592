"""What a diagnosis leaves in its folder: verdict, figures, report, repaired model and posterior."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..cases.case import BranchCase
from ..reports.page import write_report
from ..systems.model_file import BranchModel, write_model
from .diagnosis import Diagnosis
from .report import VERDICT, content


def write_diagnosis(folder: Path, found: Diagnosis) -> Path:
    """Write ``verdict.json``, the figures and ``report.html`` into an existing folder; return the page's path."""
    (folder / VERDICT).write_text(json.dumps(found.verdict_file(), indent=2, allow_nan=False) + "\n")
    return write_report(folder, content(found))


def write_models(folder: Path, found: Diagnosis) -> None:
    """Write ``model.yaml`` of a branch, and ``posterior.npz`` where there is one, into an existing folder."""
    write_repaired(folder / "model.yaml", found)
    if found.posterior is not None:
        found.posterior.save(folder / "posterior.npz")


def write_repaired(path: Path, found: Diagnosis) -> None:
    """Write the repaired model of a branch; joints have no model file."""
    case = found.case
    if not isinstance(case, BranchCase):
        return
    names, values = case.segment_name, found.best_values
    acting = tuple(replace(a, known={n: i.median for n, i in found.parameters[a.label].items()}) for a in found.effects)
    stiffness, damping = (np.array([values[f"{kind} {n}"] for n in names]) for kind in ("stiffness", "damping"))
    size = np.column_stack([case.length, case.radius])
    write_model(path, BranchModel(case.name, names, stiffness, damping, acting, size))
