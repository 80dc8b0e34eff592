"""``bough hide --hard`` and ``bough exam --hard`` from the outside."""

import json
from dataclasses import asdict
from pathlib import Path

import pytest
import yaml
from bough.learn.hidden import exam_plan

SMALL = ("--segments", 1, "--samples", 60)


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_hard_case_is_written(bough):
    """Write a case that is harder in two ways, and say in the answer in which, and which form its law has."""
    options = ("--effects", "dry_friction", "--hard", "geometry", "probes", "--rate", 50, *SMALL, "--seed", 3)
    done = bough("hide", *options, "--out", "case")
    assert done.code == 0 and done.out.startswith("dry_friction, "), done.err
    answer = json.loads(Path("case_answer.json").read_text())
    assert answer["hard"] == ["geometry", "probes"] and answer["effects"][0]["form"] == "plain"
    meta = yaml.safe_load(Path("case/meta.yaml").read_text())
    assert {r["profile"] for r in meta["trajectories"]} >= {"circle", "chirp"} and meta["sample_rate_hz"] == 50.0


@pytest.mark.parametrize("options", [("--hard", "wood"), ("--outside", "dropouts")])
def test_what_cannot_be_hidden_is_refused(bough, options):
    """Refuse a kind that there is not, and an effect that is held back; write nothing."""
    done = bough("hide", *options, *SMALL, "--out", "case")
    assert done.code == 2 and not list(Path().iterdir())


def test_hard_exam_is_held(bough):
    """Hold one case of the held-back exam; a hard exam goes on where its only case was held, and opens nothing.

    The case hides nothing, so that no form that is held back is opened here.
    """
    exam = ("exam", "--cases", 1, "--seed", 57, "--jobs", 1)
    done = bough(*exam, "--held-back", "--out", "held")
    assert done.code == 0 and "false alarm on null" in done.out, done.err
    assert "opens the forms that are held back" in done.err
    (result,) = map(json.loads, Path("held/results.jsonl").read_text().splitlines())
    assert result["truth"]["null"] and result["truth"]["measurement_gap"] > 0.0
    (spec,) = exam_plan(1, 57, noise=0.03, hard=True)
    result["spec"] = asdict(spec)
    Path("hard").mkdir()
    Path("hard/results.jsonl").write_text(json.dumps(result) + "\n")
    done = bough(*exam, "--hard", "--out", "hard")
    assert done.code == 0 and "false alarm on null" in done.out, done.err
    assert "opens the forms that are held back" not in done.err
