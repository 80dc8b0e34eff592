"""What an exam leaves in its folder, and what it goes on from."""

import json

import pytest
from bough.learn.exam import hold as module
from bough.learn.hidden import exam_plan
from bough.learn.hidden.joints.plan import joint_plan
from bough.sim.base.errors import InputError


def written(place, plan):
    """Write a result of every case of a plan, as an exam does, and return its file."""
    lines = [json.dumps({"case": k, "spec": module._told(spec)}) for k, spec in enumerate(plan)]
    place.write_text("".join(f"{line}\n" for line in lines))
    return place


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
