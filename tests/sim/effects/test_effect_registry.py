"""The registry of effects: what it lists, what it refuses, and the page that shows it."""

import re
from dataclasses import replace
from pathlib import Path

import pytest
from bough.sim.base.errors import InputError
from bough.sim.effects import Setting, effect_of, effects, register

NAMES = [
    "cubic_stiffness",
    "bilinear_stiffness",
    "dry_friction",
    "hysteresis_boucwen",
    "quadratic_drag",
    "viscoelastic_sls",
    "tip_mass",
    "base_compliance",
    "backlash",
    "plastic_set",
    "partial_rupture",
    "grasp_slip",
    "force_bias",
    "force_scale",
    "time_delay",
    "steady_wind",
    "wind_gust",
    "gravity_comp_error",
    "anisotropic_stiffness",
    "bending_torsion_coupling",
]
AT_JOINTS = [
    "dry_friction",
    "cubic_stiffness",
    "quadratic_drag",
    "hysteresis_boucwen",
    "bilinear_stiffness",
    "viscoelastic_sls",
    "backlash",
    "plastic_set",
    "time_delay",
    "force_bias",
    "force_scale",
]
PAGE = (Path(__file__).resolve().parents[3] / "docs" / "effects.md").read_text()


def test_every_name_of_the_format_is_there():
    """Hold all names of the case format, those for measured joints in that form too."""
    assert sorted(e.name for e in effects()) == sorted(NAMES)
    assert sorted(e.name for e in effects() if e.joint is not None) == sorted(AT_JOINTS)
    assert all(e.branch is not None for e in effects())


@pytest.mark.parametrize("effect", effects(), ids=lambda e: e.name)
def test_rows_are_whole(effect):
    """Give boxes in order around the typical value, and rivals that exist."""
    setting = Setting(
        torque=3.0, angle=0.4, rate=2.0, force=8.0, speed=1.5, area=0.03, mass=0.9, duration=2.0, end=80.0
    )
    for law in (x for x in (effect.branch, effect.joint) if x is not None):
        for p in law.parameters:
            low, high, typical = (b(setting) if callable(b) else b for b in (p.low, p.high, p.typical))
            assert low < high and (p.scale == "linear" or low > 0.0)
            assert typical is None or low <= typical <= high
            assert p.scale == "log" or low <= p.neutral <= high or p.unit in ("s", "Hz")
    assert set(effect.mistaken_for) <= set(NAMES) - {effect.name} and effect.mistaken_for
    assert effect.source and effect.signature and effect.probe


def test_faulty_rows_are_refused():
    """Name the effect and what is wrong with it in one line."""
    row = effect_of("dry_friction")
    p = row.branch.parameters[0]
    for faulty, words in (
        (row, "a second time"),
        (replace(row, name="Dry friction"), "lower-case"),
        (replace(row, name="other", branch=None, joint=None), "no law"),
        (replace(row, name="other", branch=replace(row.branch, parameters=())), "1 to 10"),
        (replace(row, name="other", branch=replace(row.branch, parameters=(p, p))), "different names"),
        (replace(row, name="other", branch=replace(row.branch, law=None)), "a law with its kind"),
        (replace(row, name="other", branch=replace(row.branch, strengths=("size",))), r"strengths \['size'\]"),
        (
            replace(row, name="other", branch=replace(row.branch, kind="link", holds=row.branch.law)),
            "holds with kind link",
        ),
    ):
        with pytest.raises(InputError, match=words):
            register(faulty)
    with pytest.raises(InputError, match="'friction'; allowed: one of cubic_stiffness, bilinear_stiffness"):
        effect_of("friction")


def test_page_lists_the_registry():
    """Show every row's law, parameters, rivals and probe, and no other row."""
    rows = re.findall(r"^\| ([a-z_]+) \| (.+?) \| (`.+?`) \| (.+?) \| (.+?) \| (.+?) \|$", PAGE, re.MULTILINE)
    assert [r[0] for r in rows] == [e.name for e in effects()]
    for (_, law, parameters, _, rivals, probe), e in zip(rows, effects(), strict=True):
        assert law.replace("\\|", "|") == f"{e.summary} ({e.source})" and probe == e.probe
        of_joints = () if e.joint is None else e.joint.parameters
        names = dict.fromkeys(p.name for p in (*e.branch.parameters, *of_joints))
        assert re.findall(r"`(\w+)`", parameters) == list(names)
        assert rivals.split(", ") == list(e.mistaken_for)
