"""The strict loader of measured cases: what it accepts, and the one line it gives for everything else."""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest
from bough.learn.cases.case import BRANCH_COLUMNS, BranchCase, JointCase, load_case
from bough.learn.cases.clock import Clock, check_clock, timed
from bough.learn.cases.columns import read_columns
from bough.sim.base.errors import InputError
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.case_files import (
    JOINT_COLUMNS,
    RATE,
    SAMPLES,
    branch_meta,
    joint_meta,
    table,
    write_branch,
    write_joint,
)
from oracles.oscillator import write_case

DATA = Path(__file__).resolve().parents[4] / "shared" / "data"


def line(folder: Path) -> str:
    """Return the one line that loading a folder ends in."""
    with pytest.raises(InputError) as caught:
        load_case(folder)
    text = str(caught.value)
    assert "\n" not in text and str(folder) in text and "; allowed: " in text
    return text


def set_at(meta: dict, path: tuple, value: object) -> dict:
    node = meta
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    return meta


def test_branch_case_is_read(tmp_path: Path) -> None:
    """Numbers, units and masks of a branch case are those in its files, indices counted from 0."""
    rows = table(BRANCH_COLUMNS)
    case = load_case(write_branch(tmp_path / "c", first=rows))
    assert isinstance(case, BranchCase) and case.name == "c" and case.dt == 0.04 and case.warnings == ()
    first, second = case.trajectories
    expected = np.array(rows[1:], dtype=float)
    np.testing.assert_array_equal(np.hstack([first.force, first.displacement, first.velocity]), expected[:, 1:])
    np.testing.assert_allclose(first.t, expected[:, 0], atol=1e-12)
    assert first.replicate_of is None and second.replicate_of == 0 and second.t_start == 20.0
    # 0 to 0.2 s are samples 0 to 5, 1.0 to 1.56 s samples 25 to 39.
    np.testing.assert_array_equal(np.flatnonzero(first.no_contact), [*range(6), *range(25, 40)])
    np.testing.assert_allclose(case.azimuth, np.radians([10.0, 40.0]))
    assert case.grasp_segment == 1 and case.grasp_distance == 0.4


def test_joint_case_is_read(tmp_path: Path) -> None:
    """Rows are cut, columns scaled, other columns (even text) ignored, the split counted from 0."""
    rows = table(JOINT_COLUMNS)
    for row in rows[1:]:
        row[1] = "ok"
    case = load_case(write_joint(tmp_path / "c", first=rows))
    assert isinstance(case, JointCase) and case.train == (0,) and case.test == (1,) and abs(case.dt - 0.04) < 1e-12
    first = case.trajectories[0]
    torque, angle = (np.array([float(row[i]) for row in rows[3:31]]) for i in (2, 3))
    np.testing.assert_allclose(first.effort[:, 0], 1e-3 * torque, rtol=1e-12)
    np.testing.assert_allclose(first.output[:, 0], np.radians(angle), rtol=1e-8)
    assert first.t[0] == 0.0 and len(first.t) == 28
    assert case.joints[0].inertia is None and case.joints[0].gravity_torque.amplitude is None


@pytest.mark.skipif(not DATA.is_dir(), reason="measured data folder shared/data is not there")
def test_given_cases_load() -> None:
    """Every case folder handed to the project loads; spot values are as in the files."""
    for folder in sorted((DATA / "practice").iterdir()):
        case = load_case(folder)
        assert len(case.trajectories) == 8 and case.trajectories[6].replicate_of == 0
    pendulum, box = load_case(DATA / "pendulum"), load_case(DATA / "silverbox")
    assert [len(t.t) for t in pendulum.trajectories] == [4400] * 3 and abs(pendulum.dt - 1e-3) < 1e-9
    assert box.train == (0,) and box.test == (1,) and box.joints[0].type == "prismatic"
    assert abs(1 / box.dt - 610.35) < 0.01  # the sampling rate its authors state, 1e7 / 2^14 Hz


def test_exponent_numbers_and_empty_last_window(tmp_path: Path) -> None:
    """1e-3 without a dot is a number; a window from after the end to the end is empty (the practice cases have it)."""
    meta = branch_meta()
    meta["trajectories"][0]["no_contact"] = [[0.0, 0.2], [1.7, 1.56]]
    folder = write_branch(tmp_path / "c", meta)
    text = (folder / "meta.yaml").read_text().replace("trunk_pivot_below_base_m: 1.0", "trunk_pivot_below_base_m: 1e-3")
    (folder / "meta.yaml").write_text(text)
    case = load_case(folder)
    assert case.trunk_pivot_below_base == 1e-3 and case.trajectories[0].no_contact.sum() == 6


BRANCH_ERRORS = {
    "zero length": (("segments", 1, "length_m"), 0.0, ["entry 2 length_m", "greater than 0"]),
    "negative radius": (("segments", 0, "radius_tip_m"), -0.01, ["entry 1 radius_tip_m", "greater than 0"]),
    "millimetres": (("segments", 0, "length_m"), 500.0, ["length_m", "found 500.0", "50", "metres"]),
    "thick": (("segments", 0, "radius_base_m"), 15.0, ["radius_base_m", "less than the length"]),
    "negative mass": (("segments", 0, "mass_kg"), -1.0, ["mass_kg", "found -1.0", "greater than 0"]),
    "grams": (("segments", 0, "mass_kg"), 400.0, ["mass_kg", "400 kg", "factor of ten"]),
    "elevation": (("segments", 0, "elevation_deg"), 91.0, ["elevation_deg", "less than or equal to 90"]),
    "density": (("density_kgpm3",), 0.8, ["density_kgpm3", "50", "kg/m^3"]),
    "gravity": (("gravity_mps2",), -9.81, ["gravity_mps2", "greater than or equal to 0"]),
    "rate": (("sample_rate_hz",), 0.0, ["sample_rate_hz", "greater than 0"]),
    "other rate": (("sample_rate_hz",), 50.0, ["a.csv", "25 Hz", "sample_rate_hz", "50 Hz"]),
    "samples": (("n_samples",), 39, ["a.csv", "40 rows", "39"]),
    "text": (("gravity_mps2",), "9.81", ["gravity_mps2", "'9.81'", "number"]),
    "truth value": (("gravity_mps2",), True, ["gravity_mps2", "True", "number"]),
    "not finite": (("gravity_mps2",), float("nan"), ["gravity_mps2", "nan", "finite"]),
    "short vector": (("base_position_m",), [0.0, 0.0], ["base_position_m", "3 items"]),
    "grasp": (("grasp", "segment"), "twig", ["grasp segment", "'twig'", "parent, child"]),
    "grasp by number": (("grasp", "segment"), 1, ["grasp segment", "'1'", "parent, child"]),
    "beyond": (("grasp", "distance_from_lower_end_m"), 0.6, ["distance_from_lower_end_m", "0.6", "0 to 0.5"]),
    "same name": (("segments", 1, "name"), "parent", ["entry 2 name", "second time"]),
    "itself": (("trajectories", 1, "replicate_of"), 2, ["entry 2 replicate_of", "itself"]),
    "no such": (("trajectories", 1, "replicate_of"), 3, ["entry 2 replicate_of", "1 to 2"]),
    "zero": (("trajectories", 1, "replicate_of"), 0, ["entry 2 replicate_of", "greater than or equal to 1"]),
    "reversed": (("trajectories", 0, "no_contact"), [[0.5, 0.2]], ["no_contact entry 1", "[0.5, 0.2]"]),
    "outside": (("trajectories", 0, "no_contact"), [[0.5, 9.0]], ["no_contact entry 1", "0 to 1.56 s"]),
    "twice": (("trajectories", 1, "file"), "a.csv", ["entry 2 file", "a.csv a second time"]),
    "elsewhere": (("trajectories", 1, "file"), "../b.csv", ["entry 2 file", "inside the case folder"]),
    "missing file": (("trajectories", 1, "file"), "c.csv", ["c.csv", "no such file"]),
    "order": (("trajectories", 1, "t_start_s"), 1.0, ["entry 2 t_start_s", "one after the other"]),
    "format": (("format",), "branch-gap-case/2", ["'branch-gap-case/2'", "branch-gap-case/1 or joint-gap-case/1"]),
    "unknown key": (("segments", 0, "lenght_m"), 0.5, ["lenght_m", "'length_m'"]),
    "none": (("trajectories",), [], ["trajectories", "at least 1 item"]),
}  # fmt: skip


@pytest.mark.parametrize("name", BRANCH_ERRORS)
def test_branch_meta_is_refused(tmp_path: Path, name: str) -> None:
    """Every branch statement that cannot be gives one line with file, place, finding and what is allowed."""
    path, value, parts = BRANCH_ERRORS[name]
    text = line(write_branch(tmp_path / "c", set_at(branch_meta(), path, value)))
    assert all(part in text for part in parts), text


def test_missing_key_and_line_number(tmp_path: Path) -> None:
    """A missing key is named; an offending value comes with its line in the file."""
    meta = branch_meta()
    del meta["segments"][1]["mass_kg"]
    assert "segments entry 2 mass_kg: found no such key; allowed: this key, in kilograms" in line(
        write_branch(tmp_path / "c", meta)
    )
    folder = write_branch(tmp_path / "d", set_at(branch_meta(), ("gravity_mps2",), 99.0))
    number = 1 + (folder / "meta.yaml").read_text().splitlines().index("gravity_mps2: 99.0")
    assert f"meta.yaml: line {number}, gravity_mps2: found 99.0" in line(folder)


MECHANISM = ("mechanism", "joints", 0)
JOINT_ERRORS = {
    "both": (("mechanism", "mjcf"), "arm.xml", ["mechanism", "both joints and mjcf", "exactly one"]),
    "neither": (("mechanism",), {}, ["mechanism", "neither", "exactly one"]),
    "mjcf": (("mechanism",), {"mjcf": "arm.xml"}, ["arm.xml", "no such file"]),
    "input joint": (("input", "joint"), "swng", ["input joint", "'swng'", "'swing'"]),
    "output joint": (("outputs", 0, "joint"), "elbow", ["outputs entry 1 joint", "'elbow'", "swing"]),
    "quantity": (("outputs", 0, "quantity"), "angle", ["quantity", "'angle'", "'position'", "'acceleration'"]),
    "type": ((*MECHANISM, "type"), "ball", ["type", "'ball'", "'revolute' or 'prismatic'"]),
    "hold": (("input", "hold"), "cubic", ["input hold", "'linear' or 'zero_order'"]),
    "scale": (("outputs", 0, "scale"), 0.0, ["outputs entry 1 scale", "other than zero"]),
    "infinite scale": (("input", "scale"), float("inf"), ["input scale", "finite"]),
    "column": (("outputs", 0, "column"), "angle_rad", ["a.csv", "no column angle_rad", "'angle_deg'"]),
    "overlap": (("split", "test"), [1, 2], ["split", "trajectory 1 in train and in test"]),
    "split": (("split", "test"), [3], ["split test entry 1", "trajectory 3", "1 to 2"]),
    "rows": (("trajectories", 0, "rows"), [2, 41], ["a.csv", "rows", "[2, 41]", "40 rows"]),
    "reversed": (("trajectories", 0, "rows"), [9, 2], ["entry 1 rows", "start < stop"]),
    "few": (("trajectories", 0, "rows"), [2, 4], ["a.csv", "2 rows", "at least 3"]),
    "free": (("input",), None, ["inertia", "null on a joint that nothing drives"]),
    "weight": ((*MECHANISM, "type"), "prismatic", ["gravity_torque", "revolute joints only"]),
    "mjcf elsewhere": (("mechanism",), {"mjcf": "../arm.xml"}, ["mechanism mjcf", "'../arm.xml'", "inside the case"]),
    "mjcf from root": (("mechanism",), {"mjcf": "/etc/passwd"}, ["mechanism mjcf", "'/etc/passwd'", "inside the case"]),
    "samples": (("resample_hz",), 1e6, ["a.csv", "samples at resample_hz 1e+06", "GiB"]),
    "hardly moves": (("outputs", 0, "scale"), 1e-300, ["a.csv", "column angle_deg", "in all", "1e-15 or more"]),
    "vast": (("outputs", 0, "scale"), 1e300, ["a.csv", "column angle_deg", "e+29", "up to 1e+15"]),
    "vast input": (("input", "scale"), 1e300, ["a.csv", "column torque_mNm", "e+29", "up to 1e+15"]),
    "leak": (("trajectories", 1), {"file": "a.csv", "t_start_s": 9.0, "rows": [20, 40]}, ["a.csv a second time"]),
}  # fmt: skip


@pytest.mark.parametrize("name", JOINT_ERRORS)
def test_joint_meta_is_refused(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every joint statement that cannot be gives one line with file, place, finding and what is allowed."""
    monkeypatch.setattr("bough.sim.base.host.memory_bytes", lambda: 2**20)  # what a short recording cannot ask for
    path, value, parts = JOINT_ERRORS[name]
    text = line(write_joint(tmp_path / "c", set_at(joint_meta(), path, value)))
    assert all(part in text for part in parts), text


@pytest.mark.parametrize("mechanism", [True, False])
def test_links_out_of_the_case_are_refused(tmp_path: Path, mechanism: bool) -> None:
    """A mechanism or a recording that a link fetches from elsewhere is refused; a link inside the folder is read."""
    (tmp_path / "secret").write_text("root:x:0:0")
    name, place = ("arm.xml", ("mechanism",)) if mechanism else ("c.csv", ("trajectories", 0, "file"))
    folder = write_joint(tmp_path / "c", set_at(joint_meta(), place, {"mjcf": name} if mechanism else name))
    (folder / name).symlink_to("../secret")
    text = line(folder)
    assert "inside the case folder" in text and ":x:" not in text
    if not mechanism:
        (folder / name).unlink()
        (folder / name).symlink_to("a.csv")
        load_case(folder)


def test_mjcf_joint_names(tmp_path: Path) -> None:
    """With an MJCF mechanism, inputs and outputs name its joints; text that is no XML is refused with its line."""
    folder = write_joint(tmp_path / "c", set_at(joint_meta(), ("mechanism",), {"mjcf": "arm.xml"}))
    xml = '<mujoco><worldbody><body><joint name="{}"/><geom size="1"/></body></worldbody></mujoco>'
    (folder / "arm.xml").write_text(xml.format("swing"))
    assert load_case(folder).mjcf == folder / "arm.xml"
    (folder / "arm.xml").write_text(xml.format("elbow"))
    assert "'swing'" in line(folder)
    (folder / "arm.xml").write_text("<mujoco>\n<body>")
    assert "arm.xml: line 2" in line(folder)


def damaged(rows: list[list[str]], kind: str) -> list[list[str]]:
    """Spoil a table: what happens to real logs."""
    if kind == "missing column":
        return [row[:5] + row[6:] for row in rows]
    if kind == "extra column":
        return [[*row, "1"] if i else [*row, "temperature"] for i, row in enumerate(rows)]
    if kind == "renamed column":
        rows[0][5] = "y_mm"
    if kind in ("nan", "inf", "", "oops"):
        rows[7][3] = kind
    if kind == "short row":
        rows[7] = rows[7][:-1]
    if kind == "blank row":
        rows[7] = [""]
    if kind == "lost row":
        del rows[7]
        rows.append([f"{SAMPLES / RATE:.7g}", *rows[1][1:]])
    if kind == "backwards":
        rows[7][0], rows[8][0] = rows[8][0], rows[7][0]
    if kind == "jitter":
        rows[7][0] = f"{6 / RATE + 0.005:.7g}"
    if kind == "force in mN":
        rows[7][1] = "2e5"
    if kind == "displacement in mm":
        rows[7][6] = "-35.2"
    if kind == "two rows":
        return rows[:3]
    return rows


FILE_ERRORS = {
    "missing column": ["no column y_m", "t_s,fx_N,fy_N"],
    "extra column": ["line 1", "'temperature'", "t_s,fx_N,fy_N"],
    "renamed column": ["line 1", "'y_mm'", "'y_m'"],
    "nan": ["row 8, column fz_N", "'nan'", "finite"],
    "inf": ["row 8, column fz_N", "'inf'", "finite"],
    "": ["row 8, column fz_N", "an empty cell"],
    "oops": ["row 8, column fz_N", "'oops'"],
    "short row": ["row 8", "9 cells", "10 cells"],
    "blank row": ["row 8", "an empty row"],
    "lost row": ["row 8, column t_s", "a step of 0.08 s", "0.04 s"],
    "backwards": ["row 9, column t_s", "0.24 s after 0.28 s", "increase"],
    "jitter": ["row 8, column t_s", "a step of 0.045 s", "0.04 s"],
    "force in mN": ["row 8, column fx_N", "200000", "N"],
    "displacement in mm": ["row 8, column z_m", "-35.2", "twice the branch's length"],
    "two rows": ["2 rows", "at least 3"],
}


@pytest.mark.parametrize("kind", FILE_ERRORS)
def test_damaged_file_is_refused(tmp_path: Path, kind: str) -> None:
    """Every damage to a CSV is named with its line as an editor counts it and its column."""
    text = line(write_branch(tmp_path / "c", first=damaged(table(BRANCH_COLUMNS), kind)))
    assert "a.csv" in text and all(part in text for part in FILE_ERRORS[kind]), text


@pytest.mark.parametrize("first", [1, 4, 7], ids=["force", "displacement", "velocity"])
@pytest.mark.parametrize(
    ("factor", "words"), [(1e-300, "in all"), (1e-14, "in all"), (1e30, "up to 1e+15"), (1e300, "up to 1e+15")]
)
def test_branches_that_single_precision_cannot_square(tmp_path: Path, first: int, factor: float, words: str) -> None:
    """Refuse a quantity of a branch, all its axes or none of them within what can be computed with; name a column."""
    rows = table(BRANCH_COLUMNS)
    names = rows[0][first : first + 3]
    spoilt = [[*r[:first], *(repr(float(x) * factor) for x in r[first : first + 3]), *r[first + 3 :]] for r in rows[1:]]
    text = line(write_branch(tmp_path / "c", first=[rows[0], *spoilt]))
    if first < 7 and factor > 1.0:
        words = "in size"  # the bound on what is believed comes first
    assert "a.csv" in text and words in text and any(f"column {name}" in text for name in names), text


@pytest.mark.parametrize("first", [1, 4, 7], ids=["force", "displacement", "velocity"])
@pytest.mark.parametrize("factor", [0.0, 1e-18], ids=["zero", "rounding"])
def test_an_axis_along_which_nothing_happens_is_no_fault(tmp_path: Path, first: int, factor: float) -> None:
    """Load a branch that is still along one axis, to the bit or to rounding, and one of zeros alone."""
    rows = table(BRANCH_COLUMNS)
    still = [[*r[:first], repr(float(r[first]) * factor), *r[first + 1 :]] for r in rows[1:]]
    load_case(write_branch(tmp_path / "axis", first=[rows[0], *still]))
    none = [[*r[:first], *("0" for _ in range(3)), *r[first + 3 :]] for r in rows[1:]]
    load_case(write_branch(tmp_path / "none", first=[rows[0], *none]))


def test_planar_case_with_sideways_motion(tmp_path: Path) -> None:
    """A planar case has zeros in its y columns."""
    assert "row 2, column fy_N" in line(write_branch(tmp_path / "c", set_at(branch_meta(), ("planar",), True)))


def test_odd_mass_is_a_warning(tmp_path: Path) -> None:
    """A mass four times that of bare wood is possible (leaves, fruit): a warning, no error."""
    case = load_case(write_branch(tmp_path / "c", set_at(branch_meta(), ("segments", 0, "mass_kg"), 1.6)))
    assert len(case.warnings) == 1 and "1.6 kg" in case.warnings[0]


def test_folder_errors(tmp_path: Path) -> None:
    """A folder that is missing, empty, a file, without meta.yaml, or with a broken one gives one line."""
    assert "no such folder" in line(tmp_path / "nowhere")
    (tmp_path / "empty").mkdir()
    assert "meta.yaml: found an empty folder" in line(tmp_path / "empty")
    (tmp_path / "file").write_text("x")
    assert "found a file" in line(tmp_path / "file")
    folder = write_branch(tmp_path / "c")
    (folder / "meta.yaml").rename(folder / "meta.yml")
    assert "meta.yml" in line(folder)
    for text, part in (("a: [1,\n b: {", "line 2"), ("", "an empty file"), ("- 1", "a list"), ("a: 1\na: 2", "twice"),
                       ("{a: 1}", "no such key")):  # fmt: skip
        (folder / "meta.yaml").write_text(text)
        assert part in line(folder)
    (folder / "meta.yaml").write_bytes(b"\xff\xff")
    assert "UTF-8" in line(folder)


def test_folder_without_permission() -> None:
    """A folder that may not be read gives one line; tried as an ordinary user, since root may read everything."""
    root = Path(tempfile.mkdtemp(prefix="bough-test-"))
    root.chmod(0o755)
    folder = write_branch(root / "c")
    folder.chmod(0)
    user = os.geteuid()
    try:
        if user == 0:
            os.seteuid(65534)
        text = line(folder)
    finally:
        if user == 0:
            os.seteuid(user)
        folder.chmod(0o755)
        shutil.rmtree(root)
    assert "permission" in text


@settings(max_examples=60, deadline=None)
@given(
    rate=st.floats(0.5, 5000),
    start=st.floats(-100, 1000),
    samples=st.integers(3, 60),
    decimals=st.integers(2, 9),
)
def test_rounded_uniform_clocks_pass(rate: float, start: float, samples: int, decimals: int) -> None:
    """A uniform clock passes however its decimals are rounded, if the rounding is well below the step."""
    if 10.0**-decimals > 0.15 / rate:
        decimals = int(np.ceil(np.log10(rate / 0.15)))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.csv"
        times = [f"{start + i / rate:.{decimals}f}" for i in range(samples)]
        path.write_text("\n".join(["t_s,x", *(f"{t},0" for t in times)]))
        step = check_clock(timed(read_columns(path, ("t_s", "x"), exact=True), Clock(("t_s",))), rate)
    assert abs(step - 1 / rate) <= 1.01 * 10.0**-decimals / (samples - 1) + 1e-12 * abs(start)


@settings(max_examples=60, deadline=None)
@given(lost=st.integers(1, 38), decimals=st.integers(2, 7), row=st.integers(1, 39))
def test_lost_and_shifted_samples_are_found(lost: int, decimals: int, row: int) -> None:
    """A lost row, or one stamped late by a third of the step, is found wherever it is; the file names the row."""
    clean = [i / RATE for i in range(SAMPLES)]
    late = [*clean[:row], clean[row] + 0.34 / RATE, *clean[row + 1 :]]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.csv"
        for times, at in ((clean[:lost] + clean[lost + 1 :], lost + 2), (late, row + 2)):
            path.write_text("\n".join(["t_s,x", *(f"{t:.{decimals}f},0" for t in times)]))
            with pytest.raises(InputError, match=rf"row {at}, column t_s: found a step"):
                check_clock(timed(read_columns(path, ("t_s", "x"), exact=True), Clock(("t_s",))))


@settings(max_examples=80, deadline=None)
@given(data=st.data())
def test_random_damage_never_escapes(data: st.DataObject) -> None:
    """Whatever is put in place of a key's value, the outcome is a case or one `InputError` line."""
    junk = st.one_of(
        st.none(),
        st.booleans(),
        st.integers(-5, 5),
        st.floats(),
        st.text(max_size=5),
        st.lists(st.floats(), max_size=3),
        st.dictionaries(st.text(max_size=3), st.integers(), max_size=2),
    )
    make, save = data.draw(st.sampled_from([(branch_meta, write_branch), (joint_meta, write_joint)]))
    meta = make()
    node: object = meta
    path: list = []
    while isinstance(node, (dict, list)) and node and (not path or data.draw(st.booleans())):
        key = data.draw(st.sampled_from(sorted(node)) if isinstance(node, dict) else st.integers(0, len(node) - 1))
        path.append(key)
        node = node[key]
    set_at(meta, tuple(path), data.draw(junk))
    with tempfile.TemporaryDirectory() as folder:
        try:
            load_case(save(Path(folder) / "c", meta))
        except InputError as e:
            assert "\n" not in str(e) and folder in str(e)


def test_two_clocks_of_a_joint_say_how_to_join_them(tmp_path: Path) -> None:
    """Refuse recordings at 200 and 200.8 Hz with what mends it, and read them with it."""
    folder = write_case(tmp_path / "case", [(0.5, 0.0), (-0.2, 1.0)])
    rows = np.loadtxt(folder / "run_2.csv", delimiter=",", skiprows=1)
    rows[:, 0] *= 0.996
    np.savetxt(folder / "run_2.csv", rows, fmt="%.9g", delimiter=",", header="time_s,angle_rad", comments="")
    with pytest.raises(InputError, match=r"run_2.csv.*0.00498 s.*other trajectories, or resample_hz: 200 in meta.yaml"):
        load_case(folder)
    (folder / "meta.yaml").write_text((folder / "meta.yaml").read_text() + "resample_hz: 200\n")
    assert load_case(folder).dt == 0.005
