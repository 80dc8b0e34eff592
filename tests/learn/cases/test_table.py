"""CSV files as other programs write them: read to the same numbers, or refused in words that mend them."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from bough.learn.cases.case import BRANCH_COLUMNS, DERIVATIVE_NOISE, BranchCase, JointCase, derivative, load_case
from bough.learn.cases.columns import read_columns
from bough.learn.cases.noise import estimate_noise
from bough.sim.base.errors import InputError
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.case_files import JOINT_COLUMNS, branch_meta, joint_meta, table, write_branch, write_joint


def joint_case(folder: Path, rows: list[list[str]], encode, meta: dict | None = None) -> Path:
    """Write a joint case whose first file is what ``encode`` makes of rows of cells."""
    write_joint(folder, meta)
    made = encode(rows)
    (folder / "a.csv").write_bytes(made if isinstance(made, bytes) else made.encode())
    return folder


def lines(rows, separator=","):
    return "".join(separator.join(row) + "\n" for row in rows)


def with_commas(rows):
    return [rows[0], *([cell.replace(".", ",") for cell in row] for row in rows[1:])]


WAYS = {
    "commas": lambda rows: lines(rows),
    "semicolons": lambda rows: lines(rows, ";"),
    "semicolons and decimal commas": lambda rows: lines(with_commas(rows), ";"),
    "tabs and decimal commas": lambda rows: lines(with_commas(rows), "\t"),
    "blanks, as NumPy writes": lambda rows: "# " + lines(rows, " "),
    "quotes": lambda rows: lines([[f'"{cell}"' for cell in row] for row in rows]),
    "quotes and decimal commas": lambda rows: lines([[f'"{cell}"' for cell in row] for row in with_commas(rows)]),
    "byte-order mark": lambda rows: ("\ufeff" + lines(rows)).encode("utf-8"),
    "UTF-16, as Excel's Unicode text": lambda rows: lines(rows, "\t").encode("utf-16"),
    "lines of Windows": lambda rows: lines(rows).replace("\n", "\r\n"),
    "comments before the header": lambda rows: "# rig 3, 5 May\n# left arm\n\n" + lines(rows),
    "Excel's separator line": lambda rows: "sep=;\n" + lines(rows, ";"),
}


@pytest.mark.parametrize("way", WAYS)
def test_every_dialect_gives_the_same_numbers(tmp_path: Path, way: str) -> None:
    """Read the numbers that were written, to the bit, whatever program wrote the file."""
    rows = table(JOINT_COLUMNS)
    for row in rows[1:]:
        row[1] = "ok"
    case = load_case(joint_case(tmp_path / "c", rows, WAYS[way]))
    assert isinstance(case, JointCase)
    wanted = np.array([[float(row[2]), float(row[3])] for row in rows[3:31]])
    np.testing.assert_array_equal(case.trajectories[0].effort[:, 0], wanted[:, 0] * 1e-3)
    np.testing.assert_array_equal(case.trajectories[0].output[:, 0], wanted[:, 1] * 0.0174532925)


@settings(max_examples=150, deadline=None)
@given(
    way=st.sampled_from(sorted(WAYS)), at=st.floats(0, 1), junk=st.text(alphabet='0;,\t" #.-e\n\x00é\x1f', max_size=4)
)
def test_damaged_text_never_escapes(way: str, at: float, junk: str) -> None:
    """Whatever is put between two characters of a file, the outcome is columns or one `InputError` line."""
    made = WAYS[way](table(JOINT_COLUMNS))
    text = made.decode("utf-16" if "UTF-16" in way else "utf-8") if isinstance(made, bytes) else made
    place = int(at * min(len(text), 400))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.csv"
        path.write_text(text[:place] + junk + text[place:], "utf-8")
        try:
            values = read_columns(path, ("time_s", "angle_deg"), exact=False).values
        except InputError as error:
            assert "\n" not in str(error)
        else:
            assert np.isfinite(values).all() and values.shape[1] == 2


def times(rows, change):
    """Put other times into rows: ``change`` gets the sample's number."""
    return [rows[0], *([change(i), *row[1:]] for i, row in enumerate(rows[1:]))]


@pytest.mark.parametrize(
    ("header", "change", "scale"),
    [
        ("timestamp", lambda i: str(1700000000000 + 40 * i), 1e-3),
        ("timestamp", lambda i: str(1700000000123456789 + 40_000_000 * i), 1e-9),
        ("time_ms", lambda i: f"{40.0 * i:.3f}", 1e-3),
        ("ticks", lambda i: str(7 + 4 * i), 0.01),
    ],
)
def test_clocks_in_other_units(tmp_path: Path, header: str, change, scale: float) -> None:
    """Read a clock by its name and unit; without the unit, refuse it in a line that says which one it may be."""
    rows = times([[header, *JOINT_COLUMNS[1:]], *table(JOINT_COLUMNS)[1:]], change)
    meta = joint_meta() | {"time_column": header}
    meta["trajectories"] = [{"file": "a.csv", "t_start_s": 0.0}]
    del meta["split"]
    folder = joint_case(tmp_path / "c", rows, lines, meta | {"time_scale": scale})
    assert load_case(folder).dt == pytest.approx(0.04, rel=1e-6)  # 4 x 256 ns: doubles near 1.7e18
    folder = joint_case(tmp_path / "d", rows, lines, meta)
    with pytest.raises(InputError, match=r"allowed: seconds, or the unit in meta.yaml: time_scale: 1e-0\d") as caught:
        load_case(folder)
    assert f"column {header}" in str(caught.value)


def test_seconds_and_nanoseconds_as_ros_stamps_them(tmp_path: Path) -> None:
    """Add a column of nanoseconds to one of seconds, across a change of the second."""
    header = ["stamp.sec", "stamp.nanosec", *JOINT_COLUMNS[1:]]
    rows = [header]
    for i, row in enumerate(table(JOINT_COLUMNS)[1:]):
        total = 1_700_000_000_900_000_000 + 40_000_000 * i
        rows.append([str(total // 10**9), str(total % 10**9), *row[1:]])
    meta = joint_meta() | {"time_column": header[:2]}
    meta["trajectories"] = [{"file": "a.csv", "t_start_s": 0.0}]
    del meta["split"]
    assert load_case(joint_case(tmp_path / "c", rows, lines, meta)).dt == pytest.approx(0.04, rel=1e-12)
    with pytest.raises(InputError, match=r"time_scale: found a scale beside two columns"):
        load_case(joint_case(tmp_path / "d", rows, lines, meta | {"time_scale": 1e-3}))


def shifted(rows, start, by):
    return [row if i < start or i == 0 else [f"{float(row[0]) + by:.7g}", *row[1:]] for i, row in enumerate(rows)]


def emptied(rows, start, column):
    return [row if i < start else [*row[:column], "", *row[column + 1 :]] for i, row in enumerate(rows)]


REFUSED = {
    "gap": (lambda r: lines(shifted(r, 21, 0.8)),
            ["row 22, column time_s", "a gap in the clock", "rows: [0, 20] and rows: [20, 40]"]),
    "clock set back": (lambda r: lines(shifted(r, 21, -0.4)), ["row 22", "after", "rows: [0, 20]"]),
    "one time twice": (lambda r: lines([*r[:8], r[7], *r[9:]]), ["row 9", "twice", "the repeated row left out"]),
    "times too coarse": (lambda r: lines(times(r, lambda i: f"{i / 25:.1f}")), ["row 3", "twice", "more decimals"]),
    "a column that ends": (lambda r: lines(emptied(r, 31, 3)), ["row 32, column angle_deg", "rows: [0, 30]"]),
    "rows that end": (lambda r: lines(r[:31] + [row[:3] for row in r[31:]]), ["row 32", "3 cells", "rows: [0, 30]"]),
    "a hole": (lambda r: lines(emptied(r, 7, 3)[:8] + r[8:]), ["row 8, column angle_deg", "the same times"]),
    "a line of units": (lambda r: lines([r[0], ["s", "-", "mNm", "deg"], *r[1:]]), ["row 2", "'s'", "rows: [1, 41]"]),
    "dates": (lambda r: lines(times(r, lambda i: f"2026-05-01 12:00:{i:02d}")), ["row 2, column time_s", "no date"]),
    "decimal commas between commas": (lambda r: lines(with_commas(r)), ["cells", "semicolons between the cells"]),
    "points and commas": (lambda r: lines([*with_commas(r[:9]), *r[9:]], ";"), ["decimal points or decimal commas"]),
    "no header": (lambda r: lines(r[1:]), ["header", "numbers", "time_s,torque_mNm,angle_deg"]),
    "another clock": (lambda r: lines([["timestamp", *r[0][1:]], *r[1:]]), ["time_s", "time_column", "'timestamp'"]),
    "Latin letters": (lambda r: lines(r).replace("remark", "Bemärkung").encode("latin-1"), ["UTF-8"]),
}  # fmt: skip


@pytest.mark.parametrize("kind", REFUSED)
def test_what_is_refused_says_how_to_mend_it(tmp_path: Path, kind: str) -> None:
    """Name file, place and finding, and what to write so that it is read, in one line."""
    encode, words = REFUSED[kind]
    meta = joint_meta()
    meta["trajectories"][0].pop("rows")
    rows = [[*row[:1], "ok", *row[2:]] if i else row for i, row in enumerate(table(JOINT_COLUMNS))]
    folder = joint_case(tmp_path / "c", rows, encode, meta)
    with pytest.raises(InputError) as caught:
        load_case(folder)
    text = str(caught.value)
    assert "\n" not in text and "a.csv" in text and all(word in text for word in words), text


def test_the_cut_that_a_gap_asks_for_is_read(tmp_path: Path) -> None:
    """Read one file as two recordings by the rows that the refusal names."""
    meta = joint_meta()
    meta["trajectories"] = [{"file": "a.csv", "t_start_s": 0.0, "rows": [0, 20]},
                            {"file": "a.csv", "t_start_s": 1.6, "rows": [20, 40]}]  # fmt: skip
    rows = shifted(table(JOINT_COLUMNS), 21, 0.8)
    case = load_case(joint_case(tmp_path / "c", rows, lines, meta))
    np.testing.assert_allclose(case.trajectories[1].effort[:, 0], [float(r[2]) * 1e-3 for r in rows[21:]])


def branch_rows(rows, names):
    """Return columns of a branch's rows by name, others left out."""
    return [[row[BRANCH_COLUMNS.index(name)] for name in names] for row in rows]


def test_a_branch_by_other_names(tmp_path: Path) -> None:
    """Find renamed columns among others, absolute positions in millimetres, cut rows and a jittery clock."""
    rows = table(BRANCH_COLUMNS)
    names = ["clock", "fx_N", "Fy", "fz_N", "tcp_x", "tcp_y", "tcp_z", "vx_mps", "vy_mps", "vz_mps", "grip"]
    late = [0.0 if i % 3 else 0.003 for i in range(40)]
    made = [names, *([f"{i / 25.0 + late[i]:.6f}", *row[1:4], *(f"{1e3 * float(v) + 400:.9g}" for v in row[4:7]),
                      *row[7:], "1"] for i, row in enumerate(rows[1:]))]  # fmt: skip
    made = [made[0], ["-1.0", *made[1][1:]], *made[1:]]  # a row before the recording
    meta = branch_meta() | {"time_column": "clock", "resample_hz": 25.0}
    meta["columns"] = {"fy_N": "Fy"}
    meta["columns"] |= {f"{a}_m": {"column": f"tcp_{a}", "scale": 1e-3, "offset": "start"} for a in "xyz"}
    meta["trajectories"] = [meta["trajectories"][0] | {"rows": [1, 41]}]
    meta["trajectories"][0]["no_contact"] = [[0.003, 0.203]]
    folder = write_branch(tmp_path / "c", meta, made)
    case = load_case(folder)
    assert isinstance(case, BranchCase) and case.velocity_measured
    x = np.array([[float(v) for v in row[1:]] for row in rows[1:]])
    clock = np.array([i / 25.0 + late[i] for i in range(40)])
    grid = clock[0] + np.arange(40) / 25.0
    wanted = np.stack([np.interp(grid, clock, c) for c in x.T], -1)
    np.testing.assert_allclose(case.trajectories[0].force, wanted[:, :3], atol=1e-12)
    moved = wanted[:, 3:6] - wanted[:6, 3:6].mean(0)  # 0.003 to 0.203 s are samples 0 to 5 of the grid
    np.testing.assert_allclose(case.trajectories[0].displacement, moved, atol=1e-9)


def test_a_branch_without_velocities(tmp_path: Path) -> None:
    """Differentiate the displacement, say so, and know the noise that this gives."""
    rows = branch_rows(table(BRANCH_COLUMNS), BRANCH_COLUMNS[:7])
    folder = write_branch(tmp_path / "c", None, rows)
    (folder / "b.csv").write_text(lines(branch_rows(table(BRANCH_COLUMNS, 1), BRANCH_COLUMNS[:7])))
    case = load_case(folder)
    assert not case.velocity_measured and any("no file has velocities" in line for line in case.warnings)
    x = case.trajectories[0].displacement
    np.testing.assert_allclose(case.trajectories[0].velocity, derivative(x, 0.04))
    noise = estimate_noise(case)
    # the table is white noise of 0.01, 80 samples: its standard error is 8 %, the derivative's larger
    measured = np.concatenate([t.velocity[2:-2] for t in case.trajectories]).std(0)
    np.testing.assert_allclose(noise.velocity, measured, rtol=0.4)
    np.testing.assert_allclose(noise.velocity, DERIVATIVE_NOISE / 0.04 * noise.displacement)
    (folder / "b.csv").write_text(lines(table(BRANCH_COLUMNS, 1)))
    with pytest.raises(InputError, match=r"a\.csv.*no velocities, which b\.csv has; allowed: all files"):
        load_case(folder)


def test_derivative_is_exact_for_quartics() -> None:
    """Differentiate t^4 exactly inside, and a parabola everywhere; noise grows as stated."""
    t = np.linspace(0.0, 1.0, 30)[:, None]
    dt = float(t[1, 0])
    np.testing.assert_allclose(derivative(t**4, dt)[2:-2], 4 * t[2:-2] ** 3, atol=1e-12)
    np.testing.assert_allclose(derivative(t**2, dt), 2 * t, atol=1e-12)
    noise = derivative(np.random.default_rng(0).normal(size=(200_000, 1)), 0.5)
    assert float(noise.std()) == pytest.approx(DERIVATIVE_NOISE / 0.5, rel=0.01)  # standard error 0.2 %


BRANCH_META = {
    "unknown quantity": ({"columns": {"fx": "force"}}, ["columns fx", "'fx_N'"]),
    "no scale": ({"columns": {"fx_N": {"column": "fx_N", "scale": 0.0}}}, ["columns fx_N scale", "other than zero"]),
    "two rates": ({"resample_hz": 50.0}, ["resample_hz", "sample_rate_hz, 25"]),
    "milliseconds": ({"sample_rate_hz": 25000.0}, ["a sample every 0.04 s", "time_scale: 1e-03"]),
    "too long": ({"n_samples": 30}, ["40 rows", "rows: [0, 30]"]),
}


@pytest.mark.parametrize("kind", BRANCH_META)
def test_what_a_branch_says_wrongly_of_its_columns(tmp_path: Path, kind: str) -> None:
    """Refuse keys of columns and clock that cannot be, and say what would do."""
    change, words = BRANCH_META[kind]
    with pytest.raises(InputError) as caught:
        load_case(write_branch(tmp_path / "c", branch_meta() | change))
    assert all(word in str(caught.value) for word in words), str(caught.value)
