"""The result of a test: shares with intervals, per place and direction, delays, as JSON and as a page with figures."""

from __future__ import annotations

import json
import shlex
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..reports.page import KeyNumber, ReportContent, ReportFigure, ReportTable, write_report
from . import figures
from .recording import check_labels
from .scores import (
    Detection,
    Interval,
    Told,
    auc,
    detections,
    over_recordings,
    pooled,
    share,
    specificity_at,
    threshold_for,
)

#: Recall at which specificity is told, beside that at the threshold (thesis, figure B.7: 80.4 % and 93.0 %).
RECALL = 0.8
_OUTCOME = "touch.json"


@dataclass(frozen=True)
class Outcome:
    """What a test found. Rows are pooled over recordings, intervals are over recordings.

    Attributes:
        recordings: How many.
        rows: Rows with a known label, and those whose label is certain, of which all that follows is.
        auc: Area under the ROC.
        auc_all: The same with the rows next to a change of the label, which may be wrong there.
        specificity_at_recall: Specificity where recall is at least `RECALL`.
        threshold, specificity, recall, accuracy: At the classifier's threshold.
        confusion: Rows [without contact told so, told contact], [with contact told free, told so].
        places: Recall, rows and stretches by place, then by direction: [kind, name, recall, stretches found, of].
        missed: Stretches of contact that were never told, of how many.
        delay: Median and 90 % quantile of the delay of those that were [s].
        worst: The recordings told worst: name, accuracy.
    """

    recordings: int
    rows: tuple[int, int]
    auc: Interval
    auc_all: Interval
    specificity_at_recall: Interval
    threshold: float
    specificity: Interval
    recall: Interval
    accuracy: Interval
    confusion: tuple[tuple[int, int], tuple[int, int]]
    places: list[tuple[str, str, float, int, int]]
    missed: tuple[int, int]
    delay: tuple[float, float]
    worst: list[tuple[str, float]]


def evaluate(told: Sequence[Told], threshold: float | None, source: str, seed: int = 0) -> Outcome:
    """Compare what was told with the labels.

    Args:
        told: Of recordings that no classifier had seen.
        threshold: Above which a probability says contact; None takes the one with a specificity of 95 %.
        source: What the recordings are called in an error.
        seed: Of the bootstrap.

    Raises:
        InputError: There is no row with contact, or none without.
    """
    check_labels([t.recording for t in told], source)
    chosen = threshold_for(told, 0.95) if threshold is None else threshold
    probability, contact = pooled(told, certain=True)
    said = probability > chosen
    measures: list[Callable[..., float]] = [
        auc,
        lambda p, y: specificity_at(p, y, RECALL),
        lambda p, y: share(p[y == 0] <= chosen),
        lambda p, y: share(p[y == 1] > chosen),
        lambda p, y: share((p > chosen) == y),
    ]
    area, at_recall, specificity, recall, accuracy = over_recordings(told, measures, True, seed)
    found = detections(told, chosen)
    delays = [d.delay for d in found if d.delay is not None]
    quantiles = np.quantile(delays, [0.5, 0.9]) if delays else (np.nan, np.nan)
    confusion = [[int(np.sum((contact == y) & (said == s))) for s in (False, True)] for y in (0, 1)]
    return Outcome(
        recordings=len(told), rows=(len(pooled(told, False)[0]), len(probability)), auc=area,
        auc_all=over_recordings(told, [auc], False, seed)[0], specificity_at_recall=at_recall, threshold=chosen,
        specificity=specificity, recall=recall, accuracy=accuracy,
        confusion=((confusion[0][0], confusion[0][1]), (confusion[1][0], confusion[1][1])),
        places=_by_place(told, found, chosen), missed=(len(found) - len(delays), len(found)),
        delay=(float(quantiles[0]), float(quantiles[1])), worst=_worst(told, chosen),
    )  # fmt: skip


def _by_place(
    told: Sequence[Told], found: Sequence[Detection], threshold: float
) -> list[tuple[str, str, float, int, int]]:  # fmt: skip
    out = []
    for kind in ("link", "direction"):
        for name in sorted({getattr(t.recording, kind) for t in told} - {""}):
            rows = [t.rows(True) for t in told if getattr(t.recording, kind) == name]
            hit = np.concatenate([p[y == 1] > threshold for p, y in rows])
            here = [d for d in found if getattr(d, kind) == name]
            if here:
                out.append((kind, name, share(hit), sum(d.delay is not None for d in here), len(here)))
    return out


def _worst(told: Sequence[Told], threshold: float) -> list[tuple[str, float]]:
    parts = [(t.recording.name, t.rows(True)) for t in told]
    scores = [(name, share((p > threshold) == y)) for name, (p, y) in parts if len(y)]
    return sorted(scores, key=lambda s: s[1])[:5]


def write_outcome(folder: Path, outcome: Outcome, told: Sequence[Told], how: dict[str, Any], title: str) -> None:
    """Write touch.json and report.html with its figures into an existing folder."""
    plain = json.loads(json.dumps(asdict(outcome)), parse_constant=lambda _: None)
    (folder / _OUTCOME).write_text(json.dumps({**plain, "how": how}, indent=1) + "\n")
    write_report(folder, _content(outcome, told, how, title))


def sentence(outcome: Outcome) -> str:
    """Return what came out in one sentence."""
    return (
        f"AUC {outcome.auc}; specificity {100 * outcome.specificity_at_recall.value:.1f} % at a recall of "
        f"{100 * RECALL:.0f} %, on {outcome.recordings} recordings that the classifier had not seen."
    )


def _content(outcome: Outcome, told: Sequence[Told], how: dict[str, Any], title: str) -> ReportContent:
    o = outcome
    return ReportContent(
        title, plain(o), "good" if o.auc.low > 0.9 else "warning" if o.auc.low > 0.7 else "bad", _numbers(o),
        figures=_figures(told, o.threshold), tables=_tables(o), details=how, precisely=sentence(o),
        commands=_commands(how),
    )  # fmt: skip


def plain(o: Outcome) -> str:
    """Return in a sentence for everybody how well touch is told; `sentence` says it in the field's terms."""
    caught, false = 100.0 * o.recall.value, 100.0 * (1.0 - o.specificity.value)
    return (
        f"Of 100 moments of contact {caught:.0f} are felt, of 100 without contact {false:.0f} are taken for one, in "
        f"{o.recordings} recordings that the classifier had not seen."
    )


def _commands(how: dict[str, Any]) -> list[tuple[str, str]]:
    """Return what to do next with the recordings."""
    data = shlex.quote(str(Path(str(how["data"])).resolve()))
    return [
        (f"bough touch train {data} --out model", "trains a classifier on all of them"),
        (
            "bough train reach --set flag=classifier classifier=model/model.npz --out run",
            "lets an arm learn with a classifier as its sense of touch",
        ),
    ]


def _numbers(o: Outcome) -> list[KeyNumber]:
    free, least = "Share of rows without contact that are told so", f"specificity at recall {RECALL:g}"
    return [
        KeyNumber("AUC", str(o.auc), "", "Area under the ROC of rows whose label is certain; 0.5 is chance."),
        KeyNumber("AUC, all rows", str(o.auc_all), "", "With the rows next to a change of the label."),
        KeyNumber(least, str(o.specificity_at_recall), "", f"{free}, where four fifths of the contact are found."),
        KeyNumber("threshold", round(o.threshold, 3), "", "Probability above which contact is said, as below."),
        KeyNumber("specificity", str(o.specificity), "", f"{free}."),
        KeyNumber("recall", str(o.recall), "", "Share of rows with contact that are told so."),
        KeyNumber("accuracy", str(o.accuracy), "", "Share of all rows told right."),
        KeyNumber("delay", f"{o.delay[0]:.2f} (90 % below {o.delay[1]:.2f})", "s",
                  f"From the label to the first row told, median; {o.missed[0]} of {o.missed[1]} contacts never were."),
    ]  # fmt: skip


def _tables(o: Outcome) -> list[ReportTable]:
    rows: list[tuple[object, ...]] = [("free", *o.confusion[0]), ("contact", *o.confusion[1])]
    confusion = ReportTable("Confusion matrix [rows]", ("", "told free", "told contact"), rows, "At the threshold.")
    places = ReportTable(
        "By place and direction", ("", "recall", "contacts found", "of"),
        [(f"{kind} {name}", recall, found, of) for kind, name, recall, found, of in o.places],
        "Recall is of rows; a contact is found if one of its rows is told.",
    )  # fmt: skip
    worst = ReportTable("Recordings told worst", ("recording", "accuracy"), list(o.worst), "Of all recordings.")
    return [confusion, *([places] if o.places else []), worst]


def _figures(told: Sequence[Told], threshold: float) -> list[ReportFigure]:
    return [
        ReportFigure("roc.png", figures.roc_figure(told, threshold),
                     "How many rows with contact are found against how many without are told contact; the interval is "
                     "from recordings drawn again."),
        ReportFigure("spread.png", figures.spread_figure(told, threshold),
                     "Each recording's rows told right: a classifier that holds does so in all, not in the mean."),
        ReportFigure("delay.png", figures.delay_figure(detections(told, threshold)),
                     "Share of contacts that were told within a time."),
        ReportFigure("traces.png", figures.trace_figure(told, threshold),
                     "Torques, label (shaded) and probability of three recordings: told best, in the middle, worst."),
    ]  # fmt: skip
