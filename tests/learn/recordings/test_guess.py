"""Names of columns as loggers, testing machines and people write them."""

import pytest
from bough.learn.recordings.guess import columns_like, meaning
from bough.learn.recordings.units import measure
from bough.sim.base.errors import InputError


@pytest.mark.parametrize(
    ("name", "kind", "axis", "unit"),
    [
        ("t", "time", "", None), ("Time (s)", "time", "", "s"), ("time_ms", "time", "", "ms"),
        ("Zeit [ms]", "time", "", "ms"), ("elapsed/s", "time", "", "s"), ("header.stamp", "time", "", None),
        ("timestamp_ns", "time", "", "ns"), ("F_N", "force", "", "N"), ("Kraft in kN", "force", "", "kN"),
        ("Load (lbf)", "force", "", "lbf"), ("wrench.force.x", "force", "x", None), ("fz_N", "force", "z", "N"),
        ("pull_kgf", "force", "", "kgf"), ("reading_N", "force", "", "N"), ("push_mm", "position", "", "mm"),
        ("tcp.z", "position", "z", None), ("x_m", "position", "x", "m"), ("Weg [mm]", "position", "", "mm"),
        ("Extension (in)", "position", "", "in"), ("vx_mps", "velocity", "x", "m/s"),
        ("Winkel [°]", "angle", "", "deg"), ("angle1_rad", "angle", "", "rad"),
        ("motor_torque_Nm", "torque", "", "Nm"), ("tau1 [Nmm]", "torque", "", "Nmm"),
    ],
)  # fmt: skip
def test_what_a_name_says(name, kind, axis, unit):
    """Find quantity, axis and unit; a pull in kgf is a force, whatever else a pull may be."""
    found = meaning(name)
    assert found is not None and (found.kind, found.axis, found.unit) == (kind, axis, unit)


@pytest.mark.parametrize(
    "name", ["height_mm", "diameter_mm", "trial", "tree_id", "Bemerkung", "temp_C", "dq_cmd1_rad_s"]
)
def test_what_is_no_measurement_of_a_pull(name):
    """Leave columns alone that describe the specimen, count rows or command."""
    assert meaning(name) is None


def test_axes_belong_together():
    """Take three axes as one quantity, and two quantities of one kind as two."""
    header = ("t", "fx_N", "fy_N", "fz_N", "x", "y", "z", "force_total_N")
    assert columns_like(header, "force") == [("force_total_N",), ("fx_N", "fy_N", "fz_N")]
    assert columns_like(header, "position") == [("x", "y", "z")]


def test_numbers_with_units():
    """Read what a tape measure, a caliper and a scale say; bare angles are degrees; refuse what is no number."""
    said = [("1,2", "position"), ("24mm", "position"), ("12 in", "position"), ("350g", "mass"), ("90", "angle"),
            ("0.5rad", "angle")]  # fmt: skip
    found = [measure(text, kind, "", "--flag") for text, kind in said]
    assert found == pytest.approx([1.2, 0.024, 0.3048, 0.35, 1.5707963267948966, 0.5])
    for text in ("", "mm", "1.2.3", "24 mile", "24kg"):
        with pytest.raises(InputError, match="--flag"):
            measure(text, "position", "", "--flag")
