"""The page about a training run: a custom task's own metrics, and no praise of nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
from bough.cli.play import _outcome
from bough.learn.policies.train_report import content, learning_figure


class Run:
    """A run folder of a task with three metrics of its own."""

    path = Path("RUN")

    def __init__(self, success: float) -> None:
        own = {"return": 3.0, "success": success, "branches held": 2.5, "height": 0.8, "grip": 7.0}
        row = {"iteration": 0.0, "steps": 100.0, "episodes": 4.0, "reward": 0.1, **own, "value_loss": 0.5}
        self.rows = [row | {"steps": 100.0 * k, "collect_seconds": 1.0, "learn_seconds": 1.0} for k in range(1, 21)]

    def metrics(self) -> list[dict[str, float | None]]:
        """Return a row an iteration."""
        return self.rows

    def config(self) -> dict:
        """Return settings."""
        parts = ("seed", "device", "processes", "started")
        plain = {"task": {"name": "high", "version": 1, "settings": {}}, "ppo": {}, "versions": {}, "machine": {}}
        return plain | {"source": {}} | dict.fromkeys(parts, 0)


def test_own_metrics_are_in_the_report():
    """Draw and print every metric of a custom task under its own name, however many there are."""
    page = content(Run(0.5))
    assert [n.label for n in page.numbers[:5]] == ["Return", "Success", "branches held", "height", "grip"]
    assert [n.value for n in page.numbers[:5]] == pytest.approx([3.0, 50.0, 2.5, 0.8, 7.0])
    labels = [axes.get_ylabel() for axes in learning_figure(Run(0.5).rows).axes]
    assert labels == ["return of an episode", "success [%]", "branches held", "height", "grip"]


@pytest.mark.parametrize(("success", "status"), [(0.0, "warning"), (0.01, "good"), (float("nan"), "warning")])
def test_a_run_that_never_succeeded_is_not_green(success, status):
    """Colour the headline by what came of it: nothing is no reason for green."""
    page = content(Run(success))
    assert page.status == status
    assert success != 0.0 or ("none succeeded" in page.headline and "success 0.0 % in training" in page.precisely)
    assert page.commands[0][0].startswith("bough evaluate /")


def test_a_film_names_a_metric_of_one_s_own():
    """Say up to two more metrics than success, known ones first."""
    said = _outcome({"return": 1.0, "success": 0.0, "grip": 7.0, "force": 3.0})
    assert said == "no success, contact force 3 N, grip 7"
