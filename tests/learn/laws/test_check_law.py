"""The checks of a law: bough's own pass, each fault is told, the command and a package as a user has them."""

import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import warp as wp
from bough.kernels.effects.held import held
from bough.kernels.lanes.algebra import mul
from bough.kernels.lanes.real import real
from bough.learn.laws import check_law, checks, law_from
from bough.learn.laws.bench import SETTING, ask_joint, ask_link, closed_path, values_in
from bough.learn.laws.recovery import recover
from bough.learn.laws.simulated import case_for
from bough.sim.base.errors import InputError
from bough.sim.effects import effect_of, effects, registry
from oracles import json_page

LAW = '''
"""A damper that grows with the angle."""

from typing import Any

import warp as wp

from bough.kernels.lanes.algebra import add, div, dot, mul, sub
from bough.kernels.lanes.real import real, where_neg
from bough.sim.effects import Effect, EffectParameter, Law, register


@wp.func
def bent_damping(j: Any, p: Any, r: Any):
    return type(r)(r.torque, r.memory, real(0.0, p.a), p.a * dot(j.angle, j.angle))


register(
    Effect(
        name="bent_damping",
        summary="a damper d |phi|^2 that grows with the angle",
        source="this test",
        signature="large swings decay faster, but slow ones too",
        mistaken_for=("quadratic_drag",),
        probe="slow and fast pushes to the same deflection",
        joint=Law(
            "joint",
            (
                EffectParameter(
                    "damping_Nmsprad3",
                    "N m s/rad^3",
                    lambda s: 0.01 * s.torque / s.rate / s.angle**2,
                    lambda s: 10.0 * s.torque / s.rate / s.angle**2,
                    scale="log",
                ),
            ),
            bent_damping,
        ),
    )
)
'''
RETURNED = "type(r)(r.torque, r.memory, real(0.0, p.a), p.a * dot(j.angle, j.angle))"
#: A change of the law's text, the check that must tell it, and a word of what it says.
FAULTS = {
    "gives": (RETURNED, "type(r)(j.rate * p.a, r.memory, real(0.0, p.a), real(0.0, p.a))", "energy", "gives energy"),
    "explicit": (RETURNED, "type(r)(j.rate * (real(0.0, p.a) - p.a), r.memory, real(0.0, p.a), real(0.0, p.a))",
                 "derivatives", "stable down to"),
    "steep": (RETURNED, "type(r)(j.angle * (real(0.0, p.a) - p.a), r.memory, real(0.0, p.a), real(0.0, p.a))",
              "derivatives", "with the angle"),
    "never off": (RETURNED, "type(r)(r.torque, r.memory, real(0.0, p.a), p.a + real(0.1, p.a))",
                  "neutral", "answers 0.1"),
    "does nothing": (RETURNED, "type(r)(r.torque, r.memory, real(0.0, p.a), p.a - p.a)", "recovery", "changes nothing"),
    "other unit": ('"damping_Nmsprad3",\n                    "N m s/rad^3"',
                   '"damping_Nmprad3",\n                    "N m/rad^3"', "units", "no such"),
    "other law": (RETURNED, "type(r)(r.torque, r.memory, real(0.0, p.a), p.a * dot(j.rate, j.rate))", "units",
                  "off by"),
    "jump": (RETURNED, "type(r)(r.torque, r.memory, real(0.0, p.a), where_neg(dot(j.angle, j.angle) - real(0.002, p.a),"
             " real(0.0, p.a), p.a))", "continuity", "jumps by"),
    "unit": ('"damping_Nmsprad3"', '"damping"', "parameters", "does not end with the unit"),
    "box": ("0.01 * s.torque", "0.0 * s.torque", "parameters", "logarithm"),
    "rival": ('("quadratic_drag",)', '("friction",)', "row", "friction"),
}  # fmt: skip


@pytest.fixture
def own(monkeypatch):
    """Forget after the test what it registers."""
    monkeypatch.setattr(registry, "_ROWS", dict(registry._ROWS))


def written(text=LAW, name="bent"):
    """Write a law into the present folder and return its path."""
    path = Path(f"{name}.py").absolute()
    path.write_text(text)
    return path


@pytest.mark.parametrize("effect", effects(), ids=lambda e: e.name)
def test_own_laws_keep_what_is_asked_of_others(effect):
    """Find nothing missing in rows, boxes, energy and derivatives; the rest has tests of its own."""
    found = [checks._row(effect)]
    for form in ("branch", "joint"):
        law = getattr(effect, form)
        if law is not None:
            found.append(checks._boxes(law, form))
            if law.kind in ("joint", "link"):
                found += [checks._units(law, form), checks._continuity(law, form), checks._energy(law, form)]
            found += [checks._derivatives(law, form)] if law.kind == "joint" else []
            if law.kind in ("joint", "link"):
                assert checks._answer_when_neutral(law, 3) == 0.0
    assert [f for f in found if f.verdict != "ok"] == []


def test_the_path_is_closed_and_its_rates_are_its_slopes():
    """Begin and end at rest at zero; rates equal finite differences to second order of the step."""
    where, rate = closed_path(0.3, 3)
    assert np.abs(where[[0, -1]]).max() < 1e-15 and np.abs(rate[[0, -1]]).max() < 1e-12
    step = 2.0 / (len(where) - 1)
    np.testing.assert_allclose((where[2:] - where[:-2]) / (2 * step), rate[1:-1], atol=1e-5)
    assert np.abs(where - where[::-1]).max() > 0.1 and np.abs(where + where[::-1]).max() > 0.1


def test_answers_are_those_of_the_equations():
    """Ask Duffing's spring, drag at a joint and wind at a link; numpy has the same to 64 bit round-off."""
    where, rate = closed_path(SETTING.angle, 1, 50)
    (kappa,) = values_in(effect_of("cubic_stiffness").joint)
    cubic = ask_joint(effect_of("cubic_stiffness").joint, [kappa], where[None], rate[None])
    np.testing.assert_allclose(cubic.torque[0], -kappa * SETTING.stiffness * where**3, rtol=1e-12, atol=1e-15)
    (c,) = values_in(effect_of("quadratic_drag").joint)
    drag = ask_joint(effect_of("quadratic_drag").joint, [c], where[None], rate[None])
    np.testing.assert_allclose(drag.damping[0], c * np.abs(rate[:, 0]), rtol=1e-12)
    wind = ask_link(effect_of("steady_wind").branch, [3.0, -4.0, 5.0, 0.0], rate[None])
    np.testing.assert_allclose(wind[0], np.tile([3.0, -4.0, 5.0], (50, 1)) * SETTING.area, rtol=1e-12)


def test_a_good_law_lacks_nothing(own):
    """Recover it, and find every check passed."""
    found = list(check_law(law_from(written())))
    assert {f.check for f in found} == {
        "row",
        "parameters",
        "units",
        "continuity",
        "energy",
        "derivatives",
        "neutral",
        "recovery",
    }
    assert [f for f in found if f.verdict != "ok"] == []


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_told(own, fault):
    """Name the check that fails and what is wrong."""
    old, new, check, word = FAULTS[fault]
    assert old in LAW
    effect = law_from(written(LAW.replace(old, new), fault.replace(" ", "_")))
    law = effect.joint
    if check in ("neutral", "recovery"):
        case = case_for("joint", Path("case"))
        found = [checks._neutral(effect, "joint", case) if check == "neutral" else
                 checks.Finding(check, "joint", *recover(effect, "joint", case))]  # fmt: skip
    else:
        found = {"row": lambda: [checks._row(effect)], "parameters": lambda: [checks._boxes(law, "joint")],
                 "units": lambda: [checks._units(law, "joint")],
                 "continuity": lambda: [checks._continuity(law, "joint")],
                 "energy": lambda: [checks._energy(law, "joint")],
                 "derivatives": lambda: [checks._derivatives(law, "joint")]}[check]()  # fmt: skip
    assert [f.verdict for f in found] != ["ok"] and word in found[0].text, found


@pytest.mark.parametrize(
    "text, words",
    [("x = 1\n", "none"), ("import nothing_of_this_name\n", "line 1"), (LAW.replace("0.01", "(0.01"), "line"),
     (LAW.replace('name="bent_damping"', 'name="Bent"'), "lower-case"),
     (LAW.replace('name="bent_damping"', 'name="tip_mass"'), "second time")],
)  # fmt: skip
def test_no_law_is_refused(own, text, words):
    """Say in one line what the file lacks."""
    with pytest.raises(InputError, match=words):
        law_from(written(text, "faulty"))


def test_the_command_as_a_user_types_it():
    """Print what is missing and end with 3, in the words of the checks; refuse what is no file with 2."""

    def run(*given):
        return subprocess.run(
            [sys.executable, "-m", "bough", "check-law", *given], capture_output=True, text=True, check=False
        )

    bad = run(str(written(LAW.replace(*FAULTS["rival"][:2]))))
    assert bad.returncode == 3, bad.stderr
    assert bad.stdout.startswith("missing  row") and "ok       recovery" in bad.stdout
    assert bad.stdout.endswith("bent_damping: 1 missing\n")
    told = run(str(written(LAW.replace(*FAULTS["rival"][:2]))), "--json")
    json_page.check("check-law", json.loads(told.stdout))
    gone = run("nothing.py")
    assert gone.returncode == 2 and gone.stderr == (
        "bough: bough check-law: nothing.py: found no such file; allowed: a Python file\n"
    )


def test_a_package_adds_its_law(tmp_path):
    """Know the effect of an installed package in every command; leave a broken package out with a line."""
    (tmp_path / "someones_law.py").write_text(LAW)
    for name, module in (("someones", "someones_law"), ("broken", "no_such_module")):
        info = tmp_path / f"{name}-1.0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
        (info / "entry_points.txt").write_text(f"[bough_effects]\nbent = {module}\n")
    path = os.pathsep.join([str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])])
    body = '<body><joint type="ball"/><geom type="capsule" fromto="0 0 0 0 0 1" size="0.01"/></body>'
    (tmp_path / "x.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
    command = [sys.executable, "-m", "bough", "simulate", "x.xml", "--effect", "nothing:a=1", "--out", "o"]
    environment = {**os.environ, "PYTHONPATH": path}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path, check=False)
    assert done.returncode == 2
    assert "bough: warning: broken 1.0: effect bent is left out: ModuleNotFoundError" in done.stderr
    assert "bent_damping" in done.stderr.splitlines()[-1]


@wp.func
def a_third(j: Any, p: Any, r: Any):
    """Says that it holds all, with a memory that gives a third."""
    right = held(r, p.a, p.b)
    return type(r)(r.torque, mul(right.memory, real(1.0 / 3.0, p.a)), right.stiffness, right.damping)


def test_a_law_that_holds_less_than_it_says_is_told(monkeypatch, tmp_path):
    """Friction that begins a third as bent as the spring is: the branch falls back by itself."""
    friction = effect_of("dry_friction")
    given = replace(friction, branch=replace(friction.branch, holds=a_third))
    monkeypatch.setattr(registry, "_ROWS", {**registry._ROWS, "dry_friction": given})
    case = case_for("branch", tmp_path / "case")
    values = {"torque_Nm": SETTING.torque, "bend_rad": 10.0 * SETTING.angle}
    monkeypatch.setattr(checks, "values_in", lambda law: [values.get(p.name, p.neutral) for p in law.parameters])
    assert checks._holding(given, case).verdict == "missing"
    monkeypatch.setattr(registry, "_ROWS", {**registry._ROWS, "dry_friction": friction})
    assert checks._holding(friction, case).verdict == "ok"
