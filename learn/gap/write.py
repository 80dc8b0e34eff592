"""What a diagnosis leaves in its folder: verdict, figures, report, repaired model and posterior."""

from __future__ import annotations

import json
from pathlib import Path

from ..reports.page import write_report
from ..systems.model_file import write_model
from .diagnosis import Diagnosis
from .report import VERDICT, content


def write_diagnosis(folder: Path, found: Diagnosis) -> Path:
    """Write ``verdict.json``, the figures and ``report.html`` into an existing folder; return the page's path."""
    (folder / VERDICT).write_text(json.dumps(found.verdict_file(), indent=2, allow_nan=False) + "\n")
    return write_report(folder, content(found))


def write_models(folder: Path, found: Diagnosis) -> None:
    """Write ``model.yaml``, and ``posterior.npz`` where there is one, into an existing folder."""
    if found.model is not None:
        write_model(folder / "model.yaml", found.model)
    if found.posterior is not None:
        found.posterior.save(folder / "posterior.npz")
