"""``bough new-case`` from the outside: measured tables as people have them, with what only they know as flags."""

from __future__ import annotations

import json
import os
import pty
import re
import subprocess
import sys
from pathlib import Path

import bough.learn.recordings
import numpy as np
import pytest
import yaml
from bough.cli.robots.recordings import ImportCase, NewCase, flag_helps
from bough.learn.cases.case import load_case
from oracles import json_page
from oracles.branch_case import make_branch_case

STIFFNESS, LEVER = 40.0, 0.8  # N m/rad, m


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def by_hand(meta: dict, folder: Path) -> tuple[list[str], list[str]]:
    """Write a branch's recordings as a lab's Excel does, in ms, grams-force and millimetres; return files and flags."""
    files = []
    for i, item in enumerate(meta["trajectories"]):
        rows = np.loadtxt(folder / item["file"], delimiter=",", skiprows=1)
        rows = rows * [1e3, *[1 / 9.80665e-3] * 3, *[1e3] * 6]
        head = "\ufeffZeit [ms];fx (gf);fy (gf);fz (gf);Weg x [mm];Weg y [mm];Weg z [mm];vx;vy;vz;Bemerkung"
        lines = [";".join(f"{v:.12g}".replace(".", ",") for v in row) + ";ok" for row in rows]
        Path(f"lauf_{i}.csv").write_text("\n".join([head, *lines]) + "\n", "utf-8")
        files.append(f"lauf_{i}.csv")
    s = meta["segments"]
    below = sum(x["length_m"] for x in s[: [x["name"] for x in s].index(meta["grasp"]["segment"])])
    quiet = [f"{i + 1}:{a}:{b}" for i, t in enumerate(meta["trajectories"]) for a, b in t["no_contact"]]
    flags = {
        "length": [f"{x['length_m'] * 1e3:.12g}mm" for x in s],
        "diameter": [f"{2e3 * x[k]:.12g}mm" for x in s for k in ("radius_base_m", "radius_tip_m")],
        "mass": [f"{x['mass_kg'] * 1e3:.12g}g" for x in s], "density": [meta["density_kgpm3"]],
        "rises": [x["elevation_deg"] for x in s], "azimuth": [x["azimuth_deg"] for x in s],
        "at": [f"{(below + meta['grasp']['distance_from_lower_end_m']) * 100:.12g}cm"], "position-zero": ["0"],
        "velocity": ["vx", "vy", "vz"], "velocity-unit": ["mm/s"], "noise": [meta["noise_nominal"]],
        "starts": [t["t_start_s"] for t in meta["trajectories"]], "no-contact": quiet,
        "repeats": [f"{i + 1}:{t['replicate_of']}" for i, t in enumerate(meta["trajectories"]) if t["replicate_of"]],
    }  # fmt: skip
    return files, [str(x) for name, values in flags.items() for x in (f"--{name}", *values)]


def test_a_hidden_case_comes_back_from_a_users_tables(inside, tmp_path):
    """Make a case again from its tables in other units; find the same arrays, geometry and repetitions."""
    make_branch_case(tmp_path / "true", 3, segments=2, samples=40, noise=0.02, rate=25.0)
    files, flags = by_hand(yaml.safe_load((tmp_path / "true" / "meta.yaml").read_text()), tmp_path / "true")
    done = inside("new-case", *files, *flags, "--out", "again")
    assert done.code == 0, done.err
    assert "time: column Zeit [ms] [ms]" in done.out and "force: fx (gf), fy (gf), fz (gf) [gf]" in done.out
    a, b = load_case("true"), load_case("again")
    close = {"rtol": 1e-9, "atol": 1e-12}  # twelve digits were printed twice
    for name in ("length", "radius", "mass", "elevation", "azimuth", "density", "dt", "grasp_distance", "gravity"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), **close)
    assert (a.grasp_segment, a.noise_nominal, a.planar) == (b.grasp_segment, b.noise_nominal, b.planar)
    for s, t in zip(a.trajectories, b.trajectories, strict=True):
        for name in ("t", "force", "displacement", "velocity", "t_start"):
            np.testing.assert_allclose(getattr(s, name), getattr(t, name), **close)
        assert s.replicate_of == t.replicate_of and (s.no_contact == t.no_contact).all()
    assert "world frame" in Path("again/assumptions.txt").read_text()


def pulled(angle: float = 90.0, stiffness: float = STIFFNESS) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time [s], force [N] and displacement [m] along a fixed line of a rigid rod on a spring, by plane geometry."""
    t = np.arange(200) / 20
    theta = 0.25 * np.sin(0.4 * t) ** 2
    line = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
    tip = LEVER * np.stack([np.cos(theta), np.sin(theta)], axis=-1)
    across = tip[:, 0] * line[1] - tip[:, 1] * line[0]  # torque of a unit force along the line about the base
    return t, stiffness * theta / across, (tip - tip[0]) @ line


def table(force: np.ndarray, motion: np.ndarray, header: str = "time [s],Kraft [N],Weg [mm]", t=None) -> str:
    """Write a gauge's table; return its name."""
    t = np.arange(len(force)) / 20 if t is None else t
    np.savetxt("pull.csv", np.stack([t, force, motion], axis=-1), "%.9g", ",", header=header, comments="",
               encoding="utf-8")  # fmt: skip
    return "pull.csv"


@pytest.mark.parametrize("angle", [90.0, 60.0])
def test_a_gauge_and_a_tape_measure(bough, inside, angle):
    """Turn force and displacement along a line into the torque and angle of the spring at the base."""
    _, force, motion = pulled(angle)
    name = table(force / 4.4482216152605, motion * 1e3, "t,load (lbf),travel/mm")
    run = bough if angle == 90.0 else inside  # once as a process of its own
    done = run("new-case", name, "--at", "80cm", "--pull-angle", angle, "--length", "1.2", "--diameter", "30mm",
                 "20mm", "--mass", "550g", "--out", "case")  # fmt: skip
    assert done.code == 0 and done.err == "", done.err
    assert "force: load (lbf) [lbf]" in done.out and "position: travel/mm [mm]" in done.out
    case = load_case("case")
    (run,) = case.trajectories
    # nine digits were printed, and theta = phi - acos(...) loses some of them for small angles
    np.testing.assert_allclose(run.effort[:, 0], STIFFNESS * run.output[:, 0], rtol=1e-6, atol=1e-6)
    # a cone cut off, r(x) = 15 mm - x / 240: integrals of r^2 x^2 and r^2 by a computer algebra system, as a ratio
    x = np.polynomial.Polynomial([0.0, 1.0])
    area = (0.015 - x / 240) ** 2
    whole, second = area.integ()(1.2), (area * x**2).integ()(1.2)
    assert case.joints[0].inertia == pytest.approx(0.55 * second / whole, rel=1e-6)
    assert case.joints[0].stiffness is None and case.joints[0].type == "revolute"


def test_without_a_lever_it_is_a_mass_on_a_spring(inside):
    """Take a scale's kilograms as its weight, a clock with jitter onto a grid, rows of one trial, and say so."""
    t, _, motion = pulled()
    t = t + 0.004 * np.sin(7 * t)
    rows = [f"{trial},{a:.6f},{b:.9f},{c:.9f}" for trial in (1, 2)
            for a, b, c in zip(t, 50 * motion / 9.80665, motion * 100 + 3, strict=True)]  # fmt: skip
    Path("pull.csv").write_text("trial,time,scale,tape\n-,s,kg,cm\n" + "\n".join(rows) + "\n")
    done = inside("new-case", "pull.csv", "--only", "trial=2", "--force", "scale", "--out", "case", "--json")
    assert done.code == 0, done.err
    json_page.check("new-case", json.loads(done.out))
    assert "grid of 20 Hz" in done.out and "mass on a spring" in done.out and "scale [kg]" in done.out
    run = load_case("case").trajectories[0]
    # between samples of the jittered clock: the second difference of the motion over eight
    slack = 50 * np.abs(np.diff(motion, 2)).max() / 8
    np.testing.assert_allclose(run.effort[:, 0], 50 * run.output[:, 0], atol=slack)


def test_a_testing_machine(inside):
    """Read a table below lines of a machine, in quotes, with a line of units below the header."""
    t, force, motion = pulled()
    rows = [
        f'"{a:.3f}";"{1e3 * b:.6f}";"{c / 1e3:.9f}"'.replace(".", ",") for a, b, c in zip(t, motion, force, strict=True)
    ]
    head = ['"Specimen";"branch, 3"', "", '"Operator";"me"', '"Time";"Extension";"Load"', '"(s)";"(mm)";"(kN)"']
    Path("pull.csv").write_text("\n".join([*head, *rows]) + "\n")
    done = inside("new-case", "pull.csv", "--at", "80cm", "--out", "case")
    assert done.code == 0 and "header: line 4" in done.out and "force: Load [kN]" in done.out, done.err
    run = load_case("case").trajectories[0]
    np.testing.assert_allclose(run.effort[:, 0], STIFFNESS * run.output[:, 0], rtol=1e-5, atol=1e-4)
    inside("new-case", "pull.csv", "--header", 99999, "--out", "two").refused("--header", "the lines of the file")


ARM = """<mujoco><compiler angle="radian"/><worldbody><body name="upper"><joint name="shoulder" axis="0 1 0"/>
<inertial pos="0 0 -0.2" mass="0.5" diaginertia="0.01 0.01 0.001"/><body name="lower" pos="0 0 -0.3">
<joint name="elbow" axis="0 1 0"/><inertial pos="0 0 -0.2" mass="0.4" diaginertia="0.01 0.01 0.001"/></body></body>
</worldbody></mujoco>"""


def test_joints_of_a_mechanism(inside):
    """Take torques and angles of two joints in degrees and N mm into a case of an MJCF file; refuse one too many.

    Torques called t1 and t2 are no clocks once they are named.
    """
    rng = np.random.default_rng(0)
    t, q, tau = np.arange(100) / 50, rng.normal(size=(100, 2)), rng.normal(size=(100, 2))
    np.savetxt("arm.csv", np.column_stack([t, tau * 1e3, np.degrees(q)]), "%.12g", ",", comments="",
               header="t_s,t1 [Nmm],t2 [Nmm],q1 [deg],q2 [deg]")  # fmt: skip
    Path("arm.xml").write_text(ARM)
    columns = ("--torque", "t1 [Nmm]", "t2 [Nmm]", "--angle", "q1 [deg]", "q2 [deg]")
    inside("new-case", "arm.csv", *columns, "--out", "case").refused("--mjcf", "2 angles without a mechanism")
    done = inside("new-case", "arm.csv", *columns, "--mjcf", "arm.xml", "--unknown", "damping", "com", "--out", "case")
    assert done.code == 0 and "joints shoulder, elbow of arm.xml" in done.out, done.err
    case = load_case("case")
    assert case.unknown == ("damping", "com") and case.fit == "torque"
    np.testing.assert_allclose(case.trajectories[0].output, q, rtol=1e-10)
    np.testing.assert_allclose(case.trajectories[0].effort, tau, rtol=1e-10)
    one = ("--torque", "t1 [Nmm]", "--angle", "q1 [deg]", "--mjcf", "arm.xml", "--time", "t_s")
    inside("new-case", "arm.csv", *one, "--out", "two").refused("--mjcf", "2 joints (shoulder, elbow) for 1 columns")


def test_a_torque_and_a_lever(inside):
    """Turn a displacement into an angle and leave a measured torque as it is."""
    t, force, motion = pulled()
    theta = np.arcsin(motion / LEVER)
    np.savetxt("pull.csv", np.stack([t, STIFFNESS * theta, motion], axis=-1), "%.9g", ",", header="t_s,tau_Nm,x_m",
               comments="")  # fmt: skip
    done = inside("new-case", "pull.csv", "--at", "0.8", "--out", "case")
    run = load_case("case").trajectories[0]
    assert done.code == 0 and force.max() > 0
    np.testing.assert_allclose(run.effort[:, 0], STIFFNESS * run.output[:, 0], rtol=1e-6, atol=1e-6)


def test_a_pendulum_let_go(inside):
    """Make a free swing a pendulum with unknown gravity torque; several ranges of one file are several recordings."""
    t = np.arange(300) / 100
    Path("swing.csv").write_text("t_s,winkel_deg\n" + "\n".join(f"{a:.2f},{50 * np.cos(9 * a):.4f}" for a in t) + "\n")
    done = inside("new-case", "swing.csv", "--free", "--hangs", "--rows", "0:150", "150:300", "--out", "case")
    assert done.code == 0, done.err
    case = load_case("case")
    assert len(case.trajectories) == 2 and not case.inputs and case.joints[0].gravity_torque.amplitude is None
    np.testing.assert_allclose(case.trajectories[1].output[0, 0], np.radians(50 * np.cos(13.5)), atol=1e-6)


_, FORCE, MOTION = pulled()
HEAD = "time [s],Kraft [N],Weg [mm]"


@pytest.mark.parametrize(
    ("header", "scale", "flags", "words"),
    [
        ("time [s],a,Weg [mm]", 1e3, (), ("--force: ", "no column whose name says that it is the force")),
        ("time [s],F1 N,Weg [mm]", 1e3, ("--force", "F2"), ("no column 'F2' of --force",)),
        ("u,Kraft [N],Weg [mm]", 1e3, (), ("--time: ", "--rate HZ")),
        (",Kraft [N],Weg [mm]", 1e3, (), ("--time: ", "one of (a column without a name), Kraft [N]")),
        ("time [s],Kraft [N],q", 1e3, ("--force", "q", "Kraft [N]"), ("--force: ", "2 columns beside 1")),
        ("time [s],Kraft [N],Weg", 1e3, (), ("--position-unit", "[m], which is the unit only because", "such as mm")),
        ("time [s],Kraft [N],Winkel", 57.3e1, ("--at", "80cm"), ("--position-unit", "turns", "deg for degrees")),
        ("time [s],Kraft [N],angle [deg]", 57.3, (), ("--at: ", "without a lever")),
        (HEAD, 1e3, ("--position-unit", "mile"), ("--position-unit", "'mile'", "m, cm, mm")),
        (HEAD, -1e3, (), ("--flip: ", "against the motion", "--flip force")),
        (HEAD, 1e3, ("--at", "10cm"), ("--at: ", "a distance that lets it turn so far")),
        (HEAD, 1e3, ("--at", "far"), ("--at: ", "'far'", "24mm")),
        (HEAD, 1e3, ("--rows", "9:3"), ("--rows: ", "A:B")),
        (HEAD, 1e3, ("--only", "trial=1"), ("--only: ", "COLUMN=TEXT")),
        (HEAD, 1e3, ("--at", "80cm", "--length", "1", "--diameter", "24"), ("--diameter: ", "24mm")),
        (HEAD, 1e3, ("--at", "80cm", "--length", "1", "--diameter", "24mm", "--mass", "400"), ("--mass: ", "350g")),
        (HEAD, 1e3, ("--at", "80cm", "--length", "1", "--diameter", "12mm", "--force-unit", "kN"),
         ("as a clamped beam", "a unit is wrong", "--force-unit")),
        (HEAD, 1e3, ("--time-unit", "min", "--rows", "0:9", "--rate", "0"), ("--rate", "above 0")),
        ("time_ms,Kraft [N],Weg [mm]", 1e3, ("--time-unit", "ns"), ("--time-unit: ", "a sample every")),
        (HEAD, 1e3, ("--free", "--force", "Kraft [N]"), ("--free", "one of them")),
        (HEAD, 1e3, ("--time", "time [s]", "--rate", "2"), ("--rate", "one of them")),
        (HEAD, 1e3, ("--inertia", "-1"), ("--inertia", "above zero")),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_with_the_flag_that_mends_it(inside, header, scale, flags, words):
    """Refuse what is missing, ambiguous or in the wrong unit in one line, with nothing written."""
    name = table(FORCE, scale * MOTION, header)
    inside("new-case", name, *flags, "--out", "case").refused(*words)
    assert not Path("case").exists()


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        (np.arange(200) * 50.0, ("--time-unit ms", "--time-unit s if these are seconds")),
        (np.arange(200) / 20 + np.where(np.arange(200) > 99, 5.0, 0.0), ("a gap in the clock", "--rows 0:100")),
        (np.tile(np.arange(100) / 20, 2), ("cut where the clock jumps back", "--rows 0:100")),
    ],
)
def test_clocks_are_mended_by_flags(inside, stamps, words):
    """Say in flags, not in keys of meta.yaml, what mends a clock."""
    inside("new-case", table(FORCE, 1e3 * MOTION, "time,Kraft [N],Weg [mm]", stamps), "--out", "case").refused(*words)


def test_slow_readings_are_doubted_but_made(inside):
    """Keep a clock that says seconds, even one reading in a minute, and ask whether it means milliseconds."""
    done = inside("new-case", table(FORCE, 1e3 * MOTION, t=60.0 * np.arange(200)), "--out", "case")
    assert done.code == 0 and "milliseconds are --time-unit ms" in done.err
    assert load_case("case").dt == pytest.approx(60.0)


def pulls(friction: float) -> list[str]:
    """Write three pulls of a rod on a spring with Coulomb friction, by a soft hand along a line, in lbf and inches."""
    rng, inertia, names = np.random.default_rng(1), 0.55 * 1.2**2 / 3, []
    for j, sign in enumerate((1.0, -1.0, 1.0)):
        theta, rate, rows, dt = 0.0, 0.0, [], 2e-4
        for i in range(round(12 / dt)):
            way = sign * 0.18 * np.interp(i * dt, [0.5, 4, 5, 8, 9, 10.5, 12], [0, 1, 1, 0.3, 0.3, -0.2, -0.2])
            force = 800 * (way - LEVER * np.sin(theta)) - 5 * LEVER * np.cos(theta) * rate
            torque = force * LEVER * np.cos(theta) - STIFFNESS * theta - 0.8 * rate - friction * np.tanh(rate / 1e-3)
            if i % 200 == 0:
                rows.append((i * dt, force, LEVER * np.sin(theta)))
            rate += dt * torque / inertia
            theta += dt * rate
        seen = np.array(rows) + rng.normal(0.0, 1.0, (len(rows), 3)) * [0.0, 0.15, 4e-4]
        names.append(f"pull_{j}.csv")
        np.savetxt(names[-1], seen / [1.0, 4.4482216152605, 0.0254], "%.5f", ",", header="t,Load (lbf),Travel (in)",
                   comments="")  # fmt: skip
    return names


def test_a_gauge_and_a_tape_measure_have_a_verdict(bough):
    """Name the friction at the base of a pulled rod in two commands."""
    made = bough("new-case", *pulls(2.0), "--at", "80cm", "--length", "1.2", "--diameter", "30mm", "--mass", "550g",
                 "--out", "case")  # fmt: skip
    assert made.code == 0 and "Next: bough diagnose case --out verdict" in made.out, made.err
    assert bough("diagnose", "case", "--out", "verdict").code == 0
    verdict = json.loads(Path("verdict/verdict.json").read_text())
    assert [e["name"] for e in verdict["effects"]] == ["dry_friction"]
    low, high = (verdict["effects"][0]["parameters"]["torque_Nm"][k] for k in ("low", "high"))
    assert 0.5 * low < 2.0 < 1.5 * high  # the soft hand swings at 7 Hz; lines between 25 samples a second lose a part
    assert Path("verdict/report.html").exists()


def test_branch_in_space_needs_its_shape(inside):
    """Name the flags of a branch's geometry one after the other."""
    t = np.arange(200) / 20
    rows = np.stack([t, FORCE, 0 * t, MOTION * 1e3, 0.01 * MOTION], axis=-1)
    np.savetxt("pull.csv", rows, "%.9g", ",", header="t_s,fx_N,fz_N,x_mm,z_mm", comments="")
    flags: list[str] = []
    for name, values in (("length", ["1m"]), ("diameter", ["24mm"]), ("rises", ["60"]), ("at", ["0.8"])):
        inside("new-case", "pull.csv", *flags, "--out", "case").refused(f"--{name}: ")
        flags += [f"--{name}", *values]
    done = inside("new-case", "pull.csv", *flags, "--out", "case")
    assert done.code == 0 and "one recording cannot support a verdict" in done.err
    case = load_case("case")
    assert case.planar and not case.velocity_measured
    inside("new-case", "pull.csv", *flags[:-1], "2", "--out", "two").refused("--at: ", "on a branch of 1 m")


def test_questions_on_a_terminal(bough):
    """Ask on a terminal alone; answer ``?`` with the flag's own help, and ask again after a wrong answer."""
    name = table(FORCE, 1e3 * MOTION, "a,b,c")
    main, side = pty.openpty()
    command = [sys.executable, "-m", "bough", "new-case", name, "--out", "case"]
    process = subprocess.Popen(command, stdin=side, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    os.write(main, ("\n".join(["?", "nothing", "a", "c", "mm", "b", "", "80cm"]) + "\n").encode())
    out, err = process.communicate(timeout=60)
    os.close(main), os.close(side)
    assert process.returncode == 0, err
    assert "Column of the clock." in err and "no column 'nothing' of --time" in err
    assert "force: b [N]" in out and "position: c [mm]" in out and "one joint at the base" in out
    asked = {line.split(";")[0] for line in err.split("(")[1:] if line.startswith("--")}
    assert asked == {"--time", "--position", "--position-unit", "--force", "--force-unit", "--at"}
    helped = bough("new-case", "--help").out
    assert all(f"{flag} " in helped for flag in asked)
    np.testing.assert_allclose(load_case("case").trajectories[0].effort[0, 0], 0.0, atol=1e-9)


@pytest.mark.parametrize(
    ("command", "files"),
    [
        (NewCase, ("branch", "choose", "given", "mechanism", "new_case", "plausible", "shape", "tables")),
        (ImportCase, ("bag_force", "branch", "import_case", "shape")),
    ],
)
def test_every_flag_that_is_named_has_help(command, files):
    """Find each flag that a question, a refusal or a note names in the help of the command that says it."""
    room = Path(bough.learn.recordings.__file__).parent
    named = {flag for file in files for flag in re.findall(r"--[a-z][a-z-]+", (room / f"{file}.py").read_text())}
    assert {"--at", "--rises", "--length"} <= named <= set(flag_helps(command)), named - set(flag_helps(command))
