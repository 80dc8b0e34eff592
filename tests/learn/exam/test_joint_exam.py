"""Verdicts on joints with hidden laws, as an exam holds them; what once got a wrong name keeps its case."""

import numpy as np
import pytest
from bough.learn.exam.grades import WANTED_JOINTS, as_text, grades
from bough.learn.exam.hold import sit
from bough.learn.hidden.joints.plan import JointCaseSpec


def verdict_of(kind, rig, *laws, seed):
    """Return the verdict on a case of an exam."""
    return sit((0, JointCaseSpec(kind, rig, laws, seed)), lambda count: None)["verdict"]


def test_a_spring_behind_a_diode_has_no_name():
    """Call unknown what an oscillator does behind a diode; it was a set beside a drag, 0.9 of the excess explained."""
    found = verdict_of("outside", "spring", "diode", seed=637476264)
    assert found["verdict"] == "unknown" and found["effects"] == [], found["sentence"]


def test_a_loop_that_the_widest_recording_shows_is_learnt():
    """Name the loop, or a set, that one recording alone shows: it was held out, and the verdict unknown."""
    found = verdict_of("single", "sprung", "stops", seed=307728282)
    assert {e["name"] for e in found["effects"]} <= {"hysteresis_boucwen", "plastic_set"} and found["effects"]
    assert found["gap"]["repaired"] < found["gap"]["base"]


@pytest.mark.parametrize("seed", [11, 13])
def test_a_loop_measured_by_torques_is_one_effect(seed):
    """Name the loop of elastic sliders, or a set, which is one of them; and nothing that another filter takes back."""
    found = verdict_of("single", "sprung", "stops", seed=seed)
    names = [e["name"] for e in found["effects"]]
    assert names in (["hysteresis_boucwen"], ["plastic_set"]), found["sentence"]
    assert found["fit"]["method"] == "torque"


def test_an_axis_without_an_effect_is_left_alone():
    """Say none of an axis on a controller, whose accelerations are noisier than its torques: 53 times the variance."""
    assert verdict_of("null", "axis", seed=68636792)["verdict"] == "none"


def result(kind, hidden, named, low=0.5, high=1.5):
    """Return one line of results: what was hidden, with a parameter of one, and an interval about the named one."""
    effects = [{"name": n, "joint": 0, "law": "any", "params": {"torque_Nm": 1.0}} for n in hidden]
    truth = {"null": not hidden, "effects": effects, "equivalents": {}, "visible_gap": 0.1}
    parameter = {"torque_Nm": {"low": low, "median": 1.0, "high": high}}
    verdict = {"verdict": "effects" if named else "none", "alternatives": {},
               "effects": [{"name": n, "joint": 0, "parameters": parameter} for n in named],
               "gap": {"base": 4.0, "repaired": 1.0, "noise_floor": 1.0}}  # fmt: skip
    return {"kind": kind, "noise": 0.01, "truth": truth, "verdict": verdict}


def test_intervals_of_right_names_are_counted():
    """Count the intervals that hold the truth, of rightly named effects alone; print them with the issue's bound."""
    table = grades([
        result("single", ["dry_friction"], ["dry_friction"]),
        result("single", ["dry_friction"], ["dry_friction"], low=1.2),
        result("single", ["dry_friction"], ["backlash"], low=1.2),
        result("null", [], []),
    ], WANTED_JOINTS)  # fmt: skip
    name = WANTED_JOINTS[-1][0]
    assert table[name] == (0.5, 2) and table["right name first, visible single effects"] == (pytest.approx(2 / 3), 3)
    text = as_text(table, None, WANTED_JOINTS)
    assert f"| {name} | >= 90 % | 50 % | 2 |" in text and "| measured joints | wanted |" in text
    assert np.all([row.count("|") == 5 for row in text.splitlines()])
