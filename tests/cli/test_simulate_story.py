"""``bough simulate`` from the outside, against C MuJoCo."""

import json
import os
import signal
import subprocess
import sys
import time

import mujoco
import numpy as np
import PIL.Image
import pytest
import yaml
from oracles import json_page
from oracles.branch_case import Branch, simulate
from oracles.random_mjcf import RandomMjcf

PENDULUM = """<mujoco><option gravity="0 0 {gravity}"/><worldbody>
<body name="arm" pos="0 0 2"><joint axis="0 1 0"/><geom type="capsule" fromto="0 0 0 0 0 -1" size=".02" contype="0"
conaffinity="0"/></body></worldbody></mujoco>"""


def by_mujoco(model, qpos, dt, steps):
    """Body frames (positions [T, B, 3], quaternions [T, B, 4]) by C MuJoCo's implicitfast without contacts."""
    model.opt.timestep, model.opt.integrator = dt, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    frames = []
    for k in range(steps + 1):
        if k:
            mujoco.mj_step(model, data)
        mujoco.mj_kinematics(model, data)
        frames.append((data.xpos[1:].copy(), data.xquat[1:].copy()))
    return tuple(np.stack(part) for part in zip(*frames, strict=True))


def bent(model, rng):
    """Start [nq] with every joint turned or slid at random from where the file draws it."""
    qpos = model.qpos0.copy()
    mujoco.mj_integratePos(model, qpos, rng.normal(0.0, 0.3, model.nv), 1.0)
    return qpos


@pytest.mark.parametrize("seed", [1, 4])
def test_a_strange_mjcf_moves_as_in_mujoco(bough, tmp_path, seed):
    """Follow C MuJoCo at the same step to round-off: same integrator where its springs are stable.

    Two bent starts as rows of --qpos; several joints a body, all orientations, slides, refs and frames in the file.
    """
    text = RandomMjcf(seed, 6).text
    (tmp_path / "tree.xml").write_text(text)
    model, rng = mujoco.MjModel.from_xml_string(text), np.random.default_rng(seed)
    rows = np.stack([bent(model, rng) for _ in range(2)])
    np.savetxt("start.txt", rows, fmt="%.17g")
    options = ("--seconds", 0.5, "--dt", 0.0041667, "--qpos", "start.txt", "--ignore", "contacts")
    done = bough("simulate", "tree.xml", *options, "--json", "--out", "out")
    assert done.code == 0, done.err
    found, left = np.load("out/trajectory.npz"), json.loads(done.out)["left_out"]
    assert left == (found["left_out"].tolist() if "left_out" in found else [])
    assert done.err.splitlines() == [f"bough: warning: tree.xml: left out: {line}" for line in left]
    assert all(line.startswith("pairs that could touch") for line in left)
    steps = round(0.5 / 0.0041667)
    np.testing.assert_allclose(found["time"], 0.0041667 * np.arange(steps + 1), rtol=1e-12)
    assert found["body_pos"].shape == (steps + 1, 2, model.nbody - 1, 3)
    names = [model.body(i).name for i in range(1, model.nbody)]
    assert all(a in (b, "") for a, b in zip(names, found["body_name"], strict=True))
    for world, row in enumerate(rows):
        pos, quat = by_mujoco(model, row, 0.0041667, steps)
        np.testing.assert_allclose(found["body_pos"][:, world], pos, atol=1e-9)
        same = np.abs(np.sum(found["body_quat"][:, world] * quat, axis=-1))  # a quaternion's sign is free
        np.testing.assert_allclose(same, 1.0, atol=1e-9)


def test_a_grown_tree_in_many_worlds(inside, forest):
    """Simulate a forest's file: copies without --bend move alike, with it each in its own way, as its seed says."""
    tree = forest / "tree_0001.xml"
    for out, more in (("alike", []), ("bent", ["--bend", 0.1]), ("fewer", ["--bend", 0.1, "--precision", 32])):
        worlds = 3 if out == "fewer" else 5
        done = inside("simulate", tree, "--worlds", worlds, "--seconds", 0.2, *more, "--out", out)
        assert done.code == 0, done.err
        assert done.err == ""
        assert done.out == f"{worlds} worlds of 17 bodies, 0.2 s in 48 steps: {out}/trajectory.npz, trajectory.png\n"
        assert sorted(os.listdir(out)) == ["trajectory.npz", "trajectory.png"]
    alike, bent_, fewer = (np.load(f"{out}/trajectory.npz")["body_pos"] for out in ("alike", "bent", "fewer"))
    assert (alike == alike[:, :1]).all()
    assert np.ptp(bent_[0, :, -1], axis=0).max() > 0.01
    assert fewer.dtype == np.float32
    np.testing.assert_allclose(fewer, bent_[:, :3], atol=1e-5)  # float32 of metres, over 48 steps
    assert np.asarray(PIL.Image.open("bent/trajectory.png")).std() > 5


def test_mjcf_and_urdf_of_one_tree_move_alike(inside, forest):
    """Write and read the same mechanism in both formats: equal to round-off, names included."""
    for suffix in ("xml", "urdf"):
        done = inside("simulate", forest / f"tree_0002.{suffix}", "--seconds", 0.25, "--out", suffix)
        assert done.code == 0, done.err
    a, b = np.load("xml/trajectory.npz"), np.load("urdf/trajectory.npz")
    assert (a["body_name"] == b["body_name"]).all()
    np.testing.assert_allclose(a["body_pos"], b["body_pos"], atol=1e-9)


def test_a_fault_is_replayed(bough, inside, tmp_path):
    """Dump what a frozen world did last, replay it: same link, time and substep, and the way there.

    Gravity of 1e7 m/s^2 turns an upright pendulum: it moves for some steps before it is too fast.
    """
    (tmp_path / "arm.xml").write_text(PENDULUM.format(gravity=-1e7))
    (tmp_path / "start.txt").write_text("0  # hangs still\n3.1415926\n")
    options = ("--qpos", "start.txt", "--seconds", 0.1, "--substeps", 2, "--out", "some", "--dump-faults", "faults")
    done = inside("simulate", "arm.xml", *options)
    assert done.code == 0
    frozen = float(np.load("some/trajectory.npz")["frozen_time"][1])
    assert [p.name for p in (tmp_path / "faults").iterdir()] == ["world_0001.npz"]
    replayed = bough("replay", "faults/world_0001.npz")
    assert replayed.code == 0, replayed.err
    json_page.check("replay", json.loads(inside("replay", "faults/world_0001.npz", "--json").out))
    *table, end = replayed.out.splitlines()
    assert f"world 1 was lost at {frozen:.6g} s" in end and "link arm" in end and "faster than" in end
    assert len(table) > 2 and all(line.split()[-1] == "0" for line in table[1:])
    inside("replay", "nowhere.npz").refused("nowhere.npz", "no such file")
    inside("replay", "arm.xml").refused("arm.xml", "no whole .npz archive of plain arrays")
    (tmp_path / "case").mkdir()
    inside("simulate", "case", "--out", "x", "--dump-faults", "y").refused("--dump-faults", "a tree's file")
    inside("simulate", "arm.xml", "--out", "x", "--dump-faults", "arm.xml").refused("arm.xml", "a file")


def test_substeps_are_smaller_steps(inside, tmp_path):
    """Take 10 steps of 4 substeps: the same as every fourth of 40 steps a quarter as long."""
    (tmp_path / "arm.xml").write_text(PENDULUM.format(gravity=-9.81))
    np.save("start.npy", [0.7])
    for out, dt, substeps in (("coarse", 0.01, 4), ("fine", 0.0025, 1)):
        done = inside("simulate", "arm.xml", "--seconds", 0.1, "--dt", dt, "--substeps", substeps,
                      "--qpos", "start.npy", "--out", out)  # fmt: skip
        assert done.code == 0, done.err
    coarse, fine = (np.load(f"{out}/trajectory.npz")["body_quat"] for out in ("coarse", "fine"))
    np.testing.assert_allclose(coarse, fine[::4], atol=1e-13)


def test_frozen_worlds_are_named(inside, tmp_path):
    """Name world, link and time of what left the bound; exit 3 only where no world is left."""
    (tmp_path / "arm.xml").write_text(PENDULUM.format(gravity=-1e7))
    (tmp_path / "start.txt").write_text("0  # hangs still\n1.0\n")
    some = inside("simulate", "arm.xml", "--qpos", "start.txt", "--seconds", 0.1, "--out", "some")
    assert some.code == 0
    assert some.err.startswith("bough: warning: world 1 was frozen at ") and "link arm" in some.err
    assert len(some.err.splitlines()) == 1 and "1 frozen" in some.out
    frozen = np.load("some/trajectory.npz")["frozen_time"]
    assert np.isnan(frozen[0]) and 0.0 <= frozen[1] < 0.1
    (tmp_path / "start.txt").write_text("1.0")
    none = inside("simulate", "arm.xml", "--qpos", "start.txt", "--seconds", 0.1, "--out", "none")
    assert none.code == 3


def test_a_case_moves_as_the_same_branch_in_mujoco(bough, measured):
    """Replay a case's forces on springs of E pi r^4 / (2 l), E = 0.5 GPa, D = 0.02 s K, like MuJoCo on such a branch.

    Steps of 1 ms and 0.25 ms, both first order: within 2 % of the displacement.
    """
    folder, truth = measured
    done = bough("simulate", folder, "--dt", 0.001, "--out", "out")
    assert done.code == 0, done.err
    assert done.out.startswith("8 worlds of 3 bodies, 2.36 s in 2360 steps: ")
    found = np.load("out/trajectory.npz")["grasp_displacement"][::40].swapaxes(0, 1)
    branch = Branch(**truth["branch"])
    radius = (np.array(branch.radius_base) + branch.radius_tip) / 2
    branch.stiffness = (5e8 * np.pi * radius**4 / (2 * np.array(branch.length))).tolist()
    branch.damping = (0.02 * np.array(branch.stiffness)).tolist()
    meta = yaml.safe_load((folder / "meta.yaml").read_text())
    forces = []
    for item in meta["trajectories"]:
        table = np.loadtxt(folder / item["file"], delimiter=",", skiprows=1)
        forces.append(table[:, 1:4])
    expected, _ = simulate(branch, forces, 25.0, sub=1)
    assert np.abs(expected).max() > 0.05
    error = np.sqrt(np.mean((found - expected) ** 2))
    assert error < 0.02 * np.sqrt(np.mean(expected**2))


def heed_ctrl_c() -> None:
    """Let a program hear Ctrl-C as a terminal does: what a shell runs in the background ignores it, children too."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def test_an_interrupted_command_leaves_nothing(bough, tmp_path):
    """Answer Ctrl-C with exit code 130, one line, and no file."""
    (tmp_path / "arm.xml").write_text(PENDULUM.format(gravity=-9.81))
    command = [sys.executable, "-m", "bough", "simulate", "arm.xml", "--seconds", "10000", "--out", "out/deep"]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, preexec_fn=heed_ctrl_c)
    while not list(tmp_path.glob("**/.bough-*")):
        assert process.poll() is None
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    error = process.communicate(timeout=60)[1]
    assert process.returncode == 130
    assert error.endswith("bough: interrupted; nothing was written\n")
    assert [p.name for p in tmp_path.iterdir()] == ["arm.xml"]
