"""Recordings of other programs, as a user has them: read by what meta.yaml says of them, or refused with what mends."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from oracles.branch_case import make_branch_case
from scipy.integrate import solve_ivp

AMPLITUDE, DAMPING, ZERO, NOISE = 30.0, 0.4, 1.2, 0.1  # N m, N m s, rad, degrees
PENDULUM = {
    "format": "joint-gap-case/1",
    "mechanism": {"joints": [{"name": "swing", "type": "revolute", "inertia": 1.0, "stiffness": 0.0, "damping": None,
                              "gravity_torque": {"amplitude": None, "zero_angle": None}}]},
    "input": None,
    "outputs": [{"joint": "swing", "quantity": "position", "column": "Winkel [°]", "scale": 0.0174532925}],
    "trajectories": [{"file": f"lauf_{k}.csv", "t_start_s": 20.0 * k} for k in range(2)],
}  # fmt: skip


def swings() -> list[np.ndarray]:
    """Angles of a free pendulum as an encoder whose zero is nowhere in particular reads them [degrees]."""
    rng, t = np.random.default_rng(0), np.arange(250) / 100
    out = []
    for start in (0.9, -0.6):
        q = solve_ivp(lambda _, y: [y[1], -AMPLITUDE * np.sin(y[0] - ZERO) - DAMPING * y[1]], (0, 2.5),
                      [ZERO + start, 0.0], t_eval=t, rtol=1e-9, atol=1e-9).y[0]  # fmt: skip
        out.append(np.degrees(q) + rng.normal(0.0, NOISE, len(t)))
    return out


def excel(folder: Path, meta: dict, stamps) -> Path:
    """Write what a German Excel saves: a byte-order mark, semicolons, decimal commas, a column of remarks."""
    folder.mkdir()
    for k, angle in enumerate(swings()):
        rows = [f"{stamp};{a:.4f};ok".replace(".", ",") for stamp, a in zip(stamps, angle, strict=True)]
        (folder / f"lauf_{k}.csv").write_text("\ufeffZeit;Winkel [°];Bemerkung\n" + "\n".join(rows) + "\n", "utf-8")
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta, allow_unicode=True), "utf-8")
    return folder


NANOSECONDS = [str(1_700_000_000_000_000_000 + 10_000_000 * i) for i in range(250)]


def test_a_pendulum_out_of_excel_with_an_unknown_zero(inside, tmp_path):
    """Identify from semicolons, decimal commas and stamps in nanoseconds; find where the pendulum hangs."""
    folder = excel(tmp_path / "case", PENDULUM | {"time_column": "Zeit", "time_scale": 1e-9}, NANOSECONDS)
    done = inside("identify", folder, "--particles", 24, "--out", tmp_path / "out")
    assert done.code == 0, done.out + done.err
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    found = {name.removesuffix(" swing"): row["median"] for name, row in report["parameters"].items()}
    # 250 samples of 0.1 degrees on swings of 50: a few parts in 10^4 by noise, and as much by the simulator's step
    assert found["zero angle"] == pytest.approx(ZERO, abs=2e-3)
    assert found["gravity torque"] == pytest.approx(AMPLITUDE, rel=5e-3)
    assert found["damping"] == pytest.approx(DAMPING, rel=2e-2)
    assert report["coverage_95"] > 0.9


GAP = [f"{0.01 * i + (2.0 if i >= 100 else 0.0):.2f}" for i in range(250)]


@pytest.mark.parametrize(
    ("keys", "stamps", "words"),
    [
        ({}, NANOSECONDS, ("lauf_0.csv", "no column time_s", "time_column", "one of Zeit")),
        ({"time_column": "Zeit"}, NANOSECONDS, ("column Zeit", "nanoseconds since 1970", "time_scale: 1e-09")),
        ({"time_column": "Zeit"}, [str(10 * i) for i in range(250)], ("steps of 10", "time_scale: 1e-03")),
        ({"time_column": "Zeit"}, GAP, ("row 102, column Zeit", "a gap in the clock", "rows: [0, 100]")),
        ({"time_column": "Zeit"}, [*GAP[:9], GAP[8], *GAP[10:]], ("row 11", "0.08 s twice", "left out")),
        ({"time_column": "Zeit"}, [*GAP[:60], *GAP[:190]], ("row 62", "0 s after 0.59 s", "rows: [0, 60]")),
    ],
)  # fmt: skip
def test_clocks_that_need_a_word(inside, tmp_path, keys, stamps, words):
    """Refuse an unknown clock, unit, gap, repetition and jump in one line that says what to write."""
    folder = excel(tmp_path / "case", PENDULUM | keys, stamps)
    inside("identify", folder, "--out", tmp_path / "out").refused(*words)
    assert not (tmp_path / "out").exists()


def by_robot(source: Path, folder: Path) -> Path:
    """Write a branch's recordings as a robot logs them: ROS stamps, positions in millimetres, no velocities."""
    folder.mkdir()
    meta = yaml.safe_load((source / "meta.yaml").read_text())
    meta["time_column"] = ["stamp.sec", "stamp.nanosec"]
    meta["columns"] = {f"f{a}_N": f"wrench.{a}" for a in "xyz"}
    meta["columns"] |= {f"{a}_m": {"column": f"tcp.{a}", "scale": 1e-3, "offset": "start"} for a in "xyz"}
    header = [*meta["time_column"], "state", *(f"wrench.{a}" for a in "xyz"), *(f"tcp.{a}" for a in "xyz")]
    for item in meta["trajectories"]:
        rows = ["\t".join(header)]
        for row in np.loadtxt(source / item["file"], delimiter=",", skiprows=1):
            stamp = divmod(1_700_000_000_900_000_000 + round(row[0] * 1e9), 10**9)
            place = 1e3 * row[4:7] + [412.5, -83.1, 640.2]
            rows.append("\t".join([*map(str, stamp), "hold", *(f"{v:.9g}" for v in (*row[1:4], *place))]))
        (folder / item["file"]).write_text("\n".join(rows) + "\n")
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta, sort_keys=False))
    return folder


@pytest.fixture(scope="module")
def rod(tmp_path_factory):
    """Folder of a branch of one segment made by MuJoCo, and the truth behind it."""
    folder = tmp_path_factory.mktemp("rod") / "case"
    return folder, make_branch_case(folder, 3, segments=1, samples=60, noise=0.0, rate=25.0)


def test_a_branch_out_of_a_robot_log(inside, rod, tmp_path):
    """Learn a spring from ROS stamps, absolute millimetres and no velocities; say that these are derivatives."""
    folder = by_robot(rod[0], tmp_path / "case")
    done = inside("identify", folder, "--particles", 16, "--out", tmp_path / "out")
    assert done.code in (0, 3), done.out + done.err
    assert "no file has velocities" in done.out + done.err
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    truth = rod[1]
    learnt = [report["parameters"][f"stiffness {name}"]["median"] for name in truth["branch"]["names"]]
    # as with velocities (test_identify_story): wood that bends makes springs a few percent soft
    np.testing.assert_allclose(learnt, truth["K"], rtol=0.12)


def test_a_branch_log_without_its_key(inside, rod, tmp_path):
    """Name the first foreign column and the keys that would read it."""
    folder = by_robot(rod[0], tmp_path / "case")
    meta = yaml.safe_load((folder / "meta.yaml").read_text())
    del meta["columns"], meta["time_column"]
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta))
    inside("identify", folder, "--out", tmp_path / "out").refused("traj_01.csv", "stamp.sec", "columns and time_column")
