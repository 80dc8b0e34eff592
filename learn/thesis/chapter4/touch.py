"""Figure B.7: both classifiers of contact on simulated recordings, each recording told by a model without it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, get_args

import numpy as np
from pydantic import TypeAdapter

from ....sim.base.json_file import read_object
from ...runs.folder import replace_text
from ...runs.schema import validated
from ...touch.crossval import FOLDS, left_out
from ...touch.evaluation import evaluate
from ...touch.model import Kind
from ...touch.read import read_recordings
from ...touch.record import Settings, record
from ...touch.scores import pooled, roc

RECORDINGS, OUTCOME = "recordings", "outcome.json"
KINDS: tuple[Kind, ...] = get_args(Kind)
_OUTCOME = "what bough reproduce wrote (without the file it is made again)"
_TOLD = TypeAdapter(dict[str, dict[str, Any]])
_GRID = np.linspace(0.0, 1.0, 101)


def told(folder: Path, rounds: int, seed: int, advance: Callable[[int], None]) -> dict[str, dict[str, Any]]:
    """Return what the classifiers came to, by kind, or read it if it is there; recordings are kept in ``folder``.

    Args:
        folder: Where recordings and outcome are kept.
        rounds: Rounds of motions (`learn.touch.record.Settings`).
        seed: Of motions and classifiers.
        advance: Called with the steps done: rounds, then models.

    Returns:
        By kind ``accuracy``, ``auc``, ``specificity``, ``recall`` and ``specificity at a recall of 80 %``, each as
        value, low, high, and ``curve``: the ROC's false positive rates and recalls.
    """
    about = {"rounds": rounds, "seed": seed}
    kept = folder / OUTCOME
    found = read_object(kept, _OUTCOME) if kept.exists() else {}
    if found.get("about") != about:
        folder.mkdir(parents=True, exist_ok=True)
        record(folder / RECORDINGS, Settings(rounds=rounds, seed=seed), advance)
        kinds = {kind: _told_by(kind, folder, seed, advance) for kind in KINDS}
        found = {"about": about, "kinds": kinds}
        replace_text(kept, json.dumps(found, indent=1) + "\n")
    else:
        advance(rounds + FOLDS * len(KINDS))
    out: dict[str, dict[str, Any]] = validated(_TOLD, found.get("kinds"), kept, "kinds", _OUTCOME)
    return out


def _told_by(kind: Kind, folder: Path, seed: int, advance: Callable[[int], None]) -> dict[str, Any]:
    recordings = read_recordings(folder / RECORDINGS)
    rows = left_out(recordings, kind, seed, str(folder), folds=FOLDS, progress=advance)
    outcome = evaluate(rows, None, str(folder), seed)
    measures = {"accuracy": outcome.accuracy, "auc": outcome.auc, "specificity": outcome.specificity,
                "recall": outcome.recall, "specificity at a recall of 80 %": outcome.specificity_at_recall}  # fmt: skip
    wrong, right, _ = roc(*pooled(rows, certain=True))
    curve = {"curve": [_GRID.tolist(), np.interp(_GRID, wrong, right).tolist()]}
    return {name: [v.value, v.low, v.high] for name, v in measures.items()} | curve
