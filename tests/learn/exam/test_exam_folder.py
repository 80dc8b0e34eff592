"""What an exam leaves in its folder, and what it goes on from."""

import json
from collections import Counter

import pytest
from bough.learn.exam import hold as module
from bough.learn.hidden import exam_plan
from bough.learn.hidden.joints.plan import joint_plan
from bough.sim.base.errors import InputError


def written(place, plan):
    """Write a result of every case of a plan, as an exam does, and return its file."""
    place.write_text("".join(json.dumps(result(k, spec)) + "\n" for k, spec in enumerate(plan)))
    return place


def result(number, spec):
    """Return what an exam writes of a case, as far as it is looked at."""
    return {"case": number, "kind": spec.kind, "noise": 0.03, "spec": module._told(spec), "truth": {}, "verdict": {}}


def test_a_line_cut_off_is_taken_away(tmp_path):
    """An exam that was killed while it wrote goes on after the last whole line, which is left as it was."""
    plan = exam_plan(4, 3)
    place = written(tmp_path / "results.jsonl", plan[:2])
    whole = place.read_text()
    place.write_text(whole + whole[:40])
    assert [d["case"] for d in module.done_before(place, plan)] == [0, 1]
    assert place.read_text() == whole


def test_a_shorter_exam_takes_its_own_cases(tmp_path):
    """Cases beyond those asked for are left out, not refused."""
    place = written(tmp_path / "results.jsonl", exam_plan(4, 3))
    assert [d["case"] for d in module.done_before(place, exam_plan(2, 3))] == [0, 1]


FIRST = exam_plan(1, 3)[0]


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ("{", "line 2: found text that is not JSON"),
        ("", "line 2: found text that is not JSON"),
        (json.dumps(result(1, FIRST))[:40], "line 2: found text that is not JSON"),
        ("[" * 100_000, "line 2: found JSON that is nested too deeply|line 2: found text that is not JSON"),
        ("9" * 5000, "line 2: found a number of too many digits"),
        ("[1]", "line 2: found JSON without fields"),
        ("null", "line 2: found JSON without fields"),
        ("{}", "line 2: case: found no such key"),
        (json.dumps({**result(0, FIRST), "case": -1}), "line 2: case: found -1; allowed: greater than or equal to 0"),
        (json.dumps({**result(0, FIRST), "case": "0"}), "line 2: case: found '0'; allowed: a valid integer"),
        (json.dumps({**result(0, FIRST), "case": 0.5}), "line 2: case: found 0.5"),
        (json.dumps({**result(0, FIRST), "spec": None}), "line 2: spec: found null"),
        *((json.dumps({k: v for k, v in result(0, FIRST).items() if k != key}), f"line 2: {key}: found no such key")
          for key in ("kind", "noise", "spec", "truth", "verdict")),
    ],
)  # fmt: skip
def test_lines_that_are_no_results_are_refused(tmp_path, line, words):
    """Name the line, and leave the file as it is, its last line cut off or not."""
    plan = exam_plan(3, 3)
    place = written(tmp_path / "results.jsonl", plan[:1])
    for end in ("", '{"case": 2, "ki'):
        place.write_text(place.read_text().splitlines()[0] + f"\n{line}\n{json.dumps(result(2, plan[2]))}\n" + end)
        before = place.read_bytes()
        with pytest.raises(InputError, match=rf"results\.jsonl: ({words})") as error:
            module.done_before(place, plan)
        assert "\n" not in str(error.value) and place.read_bytes() == before


def counting(kind, reads):
    """Return a kind of case that notes whenever it is asked what sort of case it is."""

    class Counted(kind):
        def __getattribute__(self, name):
            if name == "kind":
                reads.append(self)
            return super().__getattribute__(name)

    return Counted


@pytest.mark.parametrize(
    ("make", "where"),
    [(exam_plan, "bough.learn.hidden.exam.Spec"), (joint_plan, "bough.learn.hidden.joints.plan.JointCaseSpec")],
)
def test_a_long_plan_begins_with_the_short_one_and_looks_at_no_case_twice(monkeypatch, make, where):
    """Let single effects go round all names; count cases while they are made, so that time grows with their number."""
    short, reads = make(50, 7), []
    monkeypatch.setattr(where, counting(type(short[0]), reads))
    plan = make(800, 7)
    assert len(reads) <= len(plan)
    assert [s.options for s in plan[:50]] == [s.options for s in short]
    named = Counter(str(s.options.get("effects") or s.options.get("laws")) for s in plan if s.kind == "single")
    assert max(named.values()) - min(named.values()) <= 1


@pytest.mark.parametrize(
    "other",
    [exam_plan(2, 4), exam_plan(2, 3, noise=0.01), exam_plan(2, 3, hard=True), joint_plan(2, 3)],
    ids=["seed", "noise", "hard", "joints"],
)
def test_cases_of_another_exam_are_refused(tmp_path, other):
    """Results of two exams in one folder would be graded as one."""
    place = written(tmp_path / "results.jsonl", exam_plan(2, 3))
    with pytest.raises(InputError, match="case 0 of another exam"):
        module.done_before(place, other)
