"""Files that an interrupted reproduction has left, spoilt: one line, nothing trained or tested on top of them."""

import json

import pytest
from bough.learn.runs.folder import RunFolder
from bough.learn.tasks.registry import known_tasks
from bough.learn.thesis.chapter4 import runs as chapter4
from bough.learn.thesis.chapter4 import touch
from bough.learn.thesis.chapter5 import runs as chapter5
from bough.learn.thesis.common.kept import kept_rows
from bough.sim.base.errors import InputError

HOW = {"sets": 1, "worlds": 5, "seed": 0, "device": "cpu"}
ABOUT = {"task": "any", "iteration": 2, **HOW}


def read_4(folder):
    """Go on with a run of chapter 4."""
    options = chapter4.Options("cpu", "cpu", sets=1, worlds=5)
    chapter4.tested(RunFolder(folder), options, chapter4.Run("pcap"), (), known_tasks(), print)


def read_5(folder):
    """Go on with a run of chapter 5."""
    run = chapter5.TABLE_5_2[0].run
    chapter5.outcome(RunFolder(folder), chapter5.Options(sets=1, worlds=5), run, known_tasks(), print)


def about_4():
    """Return how chapter 4 tests."""
    options = chapter4.Options("cpu", "cpu", sets=1, worlds=5)
    return {"task": chapter4.TASK, "iteration": options.ppo(known_tasks()).iterations, **HOW}


def about_5():
    """Return how chapter 5 tests."""
    return {"task": chapter5.TASK, "iteration": chapter5.Options(sets=1, worlds=5).ppo.iterations, **HOW}


READERS = {
    "any": (lambda folder: kept_rows(folder / "evaluation.json", ABOUT, ["zero"]), lambda: ABOUT),
    "chapter 4": (read_4, about_4),
    "chapter 5": (read_5, about_5),
}
BROKEN = [
    ("{", "line 1: found text that is not JSON"),
    ('{\n"a": 1,\n}', "line 3: found text that is not JSON"),
    ("", "line 1: found text that is not JSON"),
    ("[1]", "found JSON without fields"),
    ("9" * 5000, "found a number of too many digits"),
    ("[" * 100_000, "found JSON that is nested too deeply|line 1: found text that is not JSON"),
]


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(("text", "words"), BROKEN)
def test_evaluations_that_are_no_json(tmp_path, reader, text, words):
    """Name the file and its line."""
    (tmp_path / "evaluation.json").write_text(text)
    with pytest.raises(InputError, match=rf"evaluation\.json: ({words})"):
        READERS[reader][0](tmp_path)
    assert (tmp_path / "evaluation.json").read_text() == text


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize(
    ("rows", "words"),
    [
        (..., "rows: found no such key"),
        (3, "rows: found 3; allowed: a valid"),
        ([3], r"rows\.0: found 3"),
        ([{}], r"rows\.0\.policy: found no such key"),
        ([{"policy": 1}], r"rows\.0\.policy: found 1"),
    ],
)
def test_evaluations_without_rows(tmp_path, reader, rows, words):
    """Name the field of an evaluation that was made as it is to be."""
    read, about = READERS[reader]
    found = {**about(), "rows": rows}
    (tmp_path / "evaluation.json").write_text(json.dumps({k: v for k, v in found.items() if v is not ...}))
    with pytest.raises(InputError, match=rf"evaluation\.json: {words}"):
        read(tmp_path)


@pytest.mark.parametrize("column", [..., 3, {"mean": 1.0}, {"sets": 3}, {"sets": []}])
def test_evaluations_without_numbers(tmp_path, column):
    """Name the file whose columns are not those of the table, all but an empty one."""
    row = {"policy": "trained", "Train Rew": 1.0, "Trials": 5}
    row |= {name: {"sets": [1.0]} for name in chapter5.COLUMNS} | {chapter5.COLUMNS[-1]: column}
    row = {k: v for k, v in row.items() if v is not ...}
    (tmp_path / "evaluation.json").write_text(json.dumps({**about_5(), "rows": [row]}))
    with pytest.raises(InputError, match=r"evaluation\.json: rows: found numbers that do not fit"):
        read_5(tmp_path)


def test_evaluations_of_another_kind_are_made_again(tmp_path):
    """Return the rows of what was asked for, nothing of other settings, other policies or no file."""
    file = tmp_path / "evaluation.json"
    assert kept_rows(file, ABOUT, []) is None
    file.write_text(json.dumps({**ABOUT, "rows": [{"policy": "trained"}, {"policy": "zero"}]}))
    assert [row["policy"] for row in kept_rows(file, ABOUT, ["zero"])] == ["trained", "zero"]
    assert kept_rows(file, {**ABOUT, "seed": 1}, ["zero"]) is None and kept_rows(file, ABOUT, []) is None


@pytest.mark.parametrize(("text", "words"), [*BROKEN, ('{"about": {"rounds": 2, "seed": 0}}', "kinds: found null")])
def test_classifiers_kept_that_are_none(tmp_path, text, words):
    """Name the file of what the classifiers came to."""
    (tmp_path / touch.OUTCOME).write_text(text)
    with pytest.raises(InputError, match=rf"outcome\.json: ({words})"):
        touch.told(tmp_path, 2, 0, print)
