"""Mechanisms from MJCF files held against measured efforts: against C MuJoCo, closed forms and a real arm."""

from pathlib import Path

import mujoco
import numpy as np
import pytest
import torch
import yaml
from bough.learn.cases.case import load_case
from bough.learn.replay.equation_error import (
    EquationError,
    low_pass,
    recordings_of,
    simulation_of,
    thinned,
    torque_noise,
    torque_recordings,
)
from bough.learn.replay.recording import Recording
from bough.learn.replay.rollout import Rollout
from bough.learn.systems.system import values_of
from bough.sim.base.errors import InputError
from oracles.arm_case import TRUE, arm_meta, arm_xml, simulate, write_arm
from oracles.double_pendulum import DFKI, write_dfki

PERIOD = 34  # samples of a period of 15 Hz at 500 Hz, which recordings lose at either end
EVERY = ["damping", "stiffness", "armature", "preload", "mass", "com", "inertia", "length"]


def gauss_newton(case, recordings, iterations: int = 25) -> tuple[dict[str, float], np.ndarray]:
    """Fit all parameters, channels weighted by their misfit; return them by name and the rms misfit per channel."""
    parameters = EquationError(case, recordings, 1).system.parameters
    n, h = len(parameters), 0.01
    model = EquationError(case, recordings, 2 * n + 1)
    offsets = torch.cat([torch.zeros(1, n), h * torch.eye(n), -h * torch.eye(n)]).double()
    u = torch.tensor([p.start for p in parameters], dtype=torch.float64)
    measured = torch.stack([torch.as_tensor(r.output) for r in recordings])
    for _ in range(iterations):
        out = model(values_of(parameters, u + offsets)).double()
        residual = measured - out[0]
        weight = 1.0 / residual.square().mean((0, 1)).sqrt()
        rows = ((out[1 : n + 1] - out[n + 1 :]) / (2 * h) * weight).flatten(1)
        normal = rows @ rows.T
        step = torch.linalg.solve(normal + 1e-6 * normal.trace() * torch.eye(n), rows @ (residual * weight).flatten())
        u = u + step.clamp(-0.7, 0.7)
    names = [p.name for p in parameters]
    return dict(zip(names, values_of(parameters, u).tolist(), strict=True)), (1.0 / weight).numpy()


# ---- parameters of a mechanism --------------------------------------------------------------------------------------


def trolley_xml(v: dict[str, float]) -> str:
    """Write a pendulum of two links on a trolley from parameter values by name; joints sit off their body frames."""

    def joint(name: str, kind: str, axis: str, pos: str) -> str:
        numbers = {"damping": 0.1, "stiffness": 2.0, "armature": 0.01} | {
            k.split()[0]: x for k, x in v.items() if k.endswith(f" {name}")
        }
        own = " ".join(f'{k}="{numbers[k]}"' for k in ("damping", "stiffness", "armature"))
        return f'<joint name="{name}" type="{kind}" axis="{axis}" pos="{pos}" springref="0.3" {own}/>'

    def inertial(name: str, anchor: np.ndarray, along: float, across: float, inertia: float) -> str:
        # the second link's zero direction is its -z, across is axis x along = (0 -1 0) x (0 0 -1) = (1 0 0)
        pos = anchor + np.array([v.get(f"com across {name}", across), 0.02, -v.get(f"com along {name}", along)])
        i = v.get(f"inertia {name}", inertia)
        return (
            f'<inertial pos="{pos[0]} {pos[1]} {pos[2]}" mass="{v.get(f"mass {name}", 0.4)}" '
            f'diaginertia="{i} {i} {i}"/>'
        )

    second = -v.get("length elbow", 0.35)
    return f"""<mujoco model="trolley"><compiler angle="radian"/><option gravity="0.5 0 -9"/><worldbody>
    <body name="trolley">{joint("track", "slide", "1 0 0", "0 0 0")}
      <inertial pos="0 0 0" mass="{v.get("mass track", 1.5)}" diaginertia="0.01 0.01 0.01"/>
      <body name="upper" pos="0 0 0.1">{joint("shoulder", "hinge", "0 -1 0", "0 0 -0.05")}
        {inertial("shoulder", np.array([0, 0, -0.05]), 0.15, 0.0, 0.003)}
        <body name="lower" pos="0 0 {second - 0.05}">{joint("elbow", "hinge", "0 -1 0", "0 0 0")}
          {inertial("elbow", np.zeros(3), 0.12, 0.0, 0.002)}</body></body></body></worldbody></mujoco>"""


def trolley_case(folder: Path, unknown: list[str]) -> Path:
    """Write a case of the trolley with a random motion; efforts are noise, which nothing is fitted to."""
    folder.mkdir(parents=True)
    (folder / "arm.xml").write_text(trolley_xml({}))
    rng, names = np.random.default_rng(3), ("track", "shoulder", "elbow")
    rows = np.column_stack([np.arange(100) / 100.0, rng.normal(size=(100, 6))])
    header = ["time_s", *(f"q_{n}" for n in names), *(f"e_{n}" for n in names)]
    np.savetxt(folder / "a.csv", rows, delimiter=",", header=",".join(header), comments="", fmt="%.9g")
    meta = {
        "format": "joint-gap-case/1", "mechanism": {"mjcf": "arm.xml", "unknown": unknown},
        "input": [{"joint": n, "column": f"e_{n}", "scale": 1.0, "hold": "linear"} for n in names],
        "outputs": [{"joint": n, "quantity": "position", "column": f"q_{n}", "scale": 1.0} for n in names],
        "trajectories": [{"file": "a.csv", "t_start_s": 0.0}],
    }  # fmt: skip
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta))
    return folder


def test_every_parameter_means_what_mujoco_makes_of_it(tmp_path):
    """Write random values of all unknowns into the worlds and into MJCF text: the same efforts along a motion."""
    case = load_case(trolley_case(tmp_path / "c", EVERY))
    rng = np.random.default_rng(1)
    motion = rng.normal(size=(5, 9)) * np.tile([0.5, 2.0, 10.0], 3)
    recording = Recording(np.arange(5) * case.dt, motion, np.zeros((5, 3)), np.zeros((0, 2)), np.zeros(5, dtype=bool))
    model = EquationError(case, [recording], 3)
    parameters = model.system.parameters
    # no com or inertia of the slide, no length of the joints that the world and the trolley carry
    assert len(parameters) == 4 * 3 + 3 + 2 * 2 + 2 + 2
    sets = np.array([[p.typical * rng.uniform(0.6, 1.6) if p.scale == "log" else rng.normal(0.0, 0.1)
                      for p in parameters] for _ in range(3)])  # fmt: skip
    ours = model(torch.tensor(sets)).numpy()[:, 0]
    for values, found in zip(sets, ours, strict=True):
        named = dict(zip([p.name for p in parameters], values, strict=True))
        oracle = mujoco.MjModel.from_xml_string(trolley_xml({k: x for k, x in named.items() if "preload" not in k}))
        data = mujoco.MjData(oracle)
        for k in range(5):
            data.qpos[:], data.qvel[:], data.qacc[:] = motion[k].reshape(3, 3).T
            mujoco.mj_inverse(oracle, data)
            want = data.qfrc_inverse - [named[f"preload {n}"] for n in ("track", "shoulder", "elbow")]
            # float32: a few of its 2^-24 of the largest term
            np.testing.assert_allclose(found[k], want, rtol=0, atol=2e-6 * np.abs(want).max())


def test_unknowns_may_be_single_joints(tmp_path):
    """Take one joint's quantity where it is named with the joint, and say what a joint cannot have."""
    system = EquationError(*_whole(trolley_case(tmp_path / "a", ["damping elbow", "mass"]))).system
    assert [p.name for p in system.parameters] == ["mass track", "mass shoulder", "damping elbow", "mass elbow"]
    for k, text in enumerate(("com track", "length track")):
        with pytest.raises(InputError, match=f"mechanism.unknown: found '{text}'"):
            EquationError(*_whole(trolley_case(tmp_path / f"b{k}", [text])))


def _whole(folder: Path) -> tuple:
    case = load_case(folder)
    return case, torque_recordings(case), 1


# ---- motion from measurements ---------------------------------------------------------------------------------------


def test_filter_and_derivatives_in_closed_form(tmp_path):
    """Differentiate a filtered sine: gain 1 / (1 + (tan(pi f h) / tan(pi fc h))^4) there and back, no phase."""
    case = load_case(write_arm(tmp_path / "arm", unknown=["damping"]))
    f, fc, h = 4.0, 15.0, case.dt
    t = np.arange(1500) * h
    gain = 1.0 / (1.0 + (np.tan(np.pi * f * h) / np.tan(np.pi * fc * h)) ** 4)
    middle = slice(300, 1200)
    np.testing.assert_allclose(low_pass(np.sin(2 * np.pi * f * t)[:, None], h, fc)[middle, 0],
                               gain * np.sin(2 * np.pi * f * t)[middle], atol=1e-6)  # fmt: skip
    meta = yaml.safe_load((case.folder / "meta.yaml").read_text())
    rows = np.column_stack([t, np.sin(2 * np.pi * f * t), np.cos(2 * np.pi * f * t), t, t])
    for item in meta["trajectories"]:
        np.savetxt(case.folder / item["file"], rows, delimiter=",", fmt="%.12g", comments="",
                   header="time_s,q1_rad,q2_rad,torque1_Nm,torque2_Nm")  # fmt: skip
    recording = torque_recordings(load_case(case.folder))[0]
    np.testing.assert_allclose(recording.t, t[PERIOD:-PERIOD], atol=1e-9)
    found = recording.input[300 - PERIOD : 1200 - PERIOD]
    w, phase = 2 * np.pi * f, 2 * np.pi * f * t[middle]
    want = [np.sin(phase), w * np.cos(phase), -(w**2) * np.sin(phase)]
    want += [np.cos(phase), -w * np.sin(phase), -(w**2) * np.cos(phase)]
    # a quintic spline's second derivative is off by (w h)^4 / 720 of itself, 1e-8, and the filter's ends by 1e-6
    np.testing.assert_allclose(found, gain * np.array(want).T, atol=2e-6 * w**2)


def test_the_quietest_column_gives_the_rate(tmp_path):
    """Take rate and acceleration from a velocity column where it is quieter than the differentiated position."""
    folder = tmp_path / "arm"
    folder.mkdir()
    (folder / "arm.xml").write_text(arm_xml(TRUE))
    meta, true = arm_meta(["a.csv"], ["damping"]), simulate(4)
    meta["outputs"] += [{"joint": j, "quantity": "velocity", "column": f"v{k}", "scale": 1.0}
                        for j, k in (("shoulder", 1), ("elbow", 2))]  # fmt: skip
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta))
    rng, error = np.random.default_rng(0), []
    cutoff = 2 * np.pi * 15.0
    for quiet in (1, 2):
        # the shoulder's velocity is quiet and its position loud, then the other way round
        rows = true.copy()
        rows[:, quiet] += 1e-2 * rng.normal(size=len(rows))
        rows[:, 5 - quiet + 0] += 1e-2 * cutoff * 10 * rng.normal(size=len(rows))
        np.savetxt(folder / "a.csv", rows, delimiter=",", fmt="%.9g", comments="",
                   header="time_s,q1_rad,q2_rad,v1,v2,torque1_Nm,torque2_Nm")  # fmt: skip
        found = torque_recordings(load_case(folder))[0].input
        error.append(np.abs(found[:, [1, 4]] - low_pass(true[:, 3:5], 1 / 500.0, 15.0)[PERIOD:-PERIOD]).max(0))
    # the loud column would leave some 1e-2 w / sqrt(3) sqrt(15 / 250) = 0.13 rad/s at the least, three times that as a
    # maximum; MuJoCo's semi-implicit positions and velocities belong together to half a step, 0.06 ms x 400 rad/s^2
    assert np.max(error) < 0.05


def test_noise_of_filtered_efforts(tmp_path):
    """State the scatter that the filter leaves of white noise, to the 3 % that 6000 samples tell."""
    case = load_case(write_arm(tmp_path / "arm", unknown=["damping"], noise=2e-3))
    rng = np.random.default_rng(5)
    scatter = low_pass(20 * 2e-3 * rng.normal(size=(200_000, 2)), case.dt, case.filter_hz).std(0)
    np.testing.assert_allclose(torque_noise(case).sigma, scatter, rtol=0.06)
    assert torque_noise(case).channel == ("torque1_Nm", "torque2_Nm")


def test_thinned_samples_are_nearly_independent(tmp_path):
    """Keep two samples a period of the cut-off: white noise through the filter has little correlation left."""
    case = load_case(write_arm(tmp_path / "arm", unknown=["damping"]))
    noise = low_pass(np.random.default_rng(6).normal(size=(100_000, 1)), case.dt, case.filter_hz)
    count = len(noise)
    recording = Recording(np.arange(count) * case.dt, noise, noise, np.zeros((0, 2)), np.zeros(count, dtype=bool))
    thin = thinned(case, recording)
    assert len(thin.t) == -(-count // 16) and thin.t[1] == 16 * case.dt
    x = thin.output[:, 0]
    assert abs(np.corrcoef(x[1:], x[:-1])[0, 1]) < 0.2 < np.corrcoef(noise[1:, 0], noise[:-1, 0])[0, 1]


# ---- fits -----------------------------------------------------------------------------------------------------------


def base_parameters(v: dict[str, float]) -> np.ndarray:
    """Return what the efforts of the arm depend on (Khalil & Dombre 2002): inertias, coupling, weights, dampers.

    I1 + m2 l^2, I2, m2 c2 l, m1 c1 + m2 l, m2 c2, d1, d2, with I the inertias about the joints.
    """
    m1, m2 = TRUE["mass"]
    c1, c2 = v["com along shoulder"], v["com along elbow"]
    l2 = v.get("length elbow", TRUE["length"])
    i1, i2 = v["inertia shoulder"] + m1 * c1**2, v["inertia elbow"] + m2 * c2**2
    return np.array([i1 + m2 * l2**2, i2, m2 * c2 * l2, m1 * c1 + m2 * l2, m2 * c2, v["damping shoulder"],
                     v["damping elbow"]])  # fmt: skip


def truth() -> dict[str, float]:
    """Return the simulated arm's numbers by the names of the parameters."""
    names, keys = ("shoulder", "elbow"), {"inertia": "inertia", "damping": "damping", "com": "com along"}
    return {f"{text} {j}": TRUE[key][i] for key, text in keys.items() for i, j in enumerate(names)}


@pytest.mark.parametrize("hold", ["linear", "zero_order"])
@pytest.mark.parametrize("extra", [[], ["length"]])
def test_torque_fit_recovers_an_arm(tmp_path, extra, hold):
    """Find dampers and base parameters of an arm simulated by MuJoCo from noisy angles and torques."""
    unknown = ["damping", "com", "inertia", *extra]
    case = load_case(write_arm(tmp_path / "arm", unknown=unknown, noise=5e-4, hold=hold))
    assert case.fit == "torque" and simulation_of(case) is EquationError
    recordings = recordings_of(case)
    found, _ = gauss_newton(case, recordings)
    # 6000 samples that count as 375 a channel, noise 0.3 % of the torques: 2 % are four deviations of the least known
    np.testing.assert_allclose(base_parameters(found), base_parameters(truth()), rtol=0.02)
    assert np.abs([found["com across shoulder"], found["com across elbow"]]).max() < 1e-3


def test_torque_fit_explains_what_the_filter_lets_through(tmp_path):
    """Explain noise-free torques to 0.5 % once the cut-off is far above the motion, parameters to 1 %."""
    folder = write_arm(tmp_path / "arm", unknown=["damping", "com", "inertia"])
    case = load_case(changed(folder, ("filter_hz",), 30.0))
    recordings = recordings_of(case)
    found, misfit = gauss_newton(case, recordings)
    assert (misfit < 0.005 * recordings[0].output.std(0)).all()
    np.testing.assert_allclose(base_parameters(found), base_parameters(truth()), rtol=0.01)


def test_efforts_need_no_start_and_count_samples(tmp_path):
    """Behave as a `Rollout`: pad the sets, give equal sets equal channels, leave zeros past a recording's end."""
    case = load_case(write_arm(tmp_path / "arm", unknown=["damping"]))
    first, second = torque_recordings(case)
    assert len(first.t) == 3000 - 2 * PERIOD
    short = Recording(second.t[:70], second.input[:70], second.output[:70], second.start, second.contact[:70])
    model = EquationError(case, [first, short], 3)
    out = model(torch.tensor([[0.1, 0.2], [0.2, 0.1], [0.1, 0.2]], dtype=torch.float64)).double()
    assert isinstance(model, Rollout) and model.num_locals == 0 and out.shape == (3, 2, len(first.t), 2)
    assert (out[0] == out[2]).all() and not (out[0] == out[1]).any(-1)[0].any() and (out[:, 1, 70:] == 0).all()
    # effort = ... + d qd: dampers act on their own joint only
    rate = torch.as_tensor(first.input[:, [1, 4]])
    torch.testing.assert_close((out[1] - out[0])[0], rate * torch.tensor([0.1, -0.1]), rtol=0, atol=2e-5)
    assert model.world_steps % (len(first.t) + 70) == 0 and model.world_steps >= 3 * (len(first.t) + 70)


# ---- replay -------------------------------------------------------------------------------------------------------


def test_replayed_pendulum_is_that_of_the_joints_form(tmp_path):
    """Swing the same pendulum from an MJCF file and from ``mechanism.joints``: equal motion for equal parameters.

    Steps of both are the same; they round differently, in float32, along 300 steps.
    """
    t = np.arange(150) * 0.01
    outputs = [{"joint": "swing", "quantity": q, "column": q, "scale": 1.0} for q in ("position", "velocity")]
    rows = np.column_stack([t, np.cos(3 * t), -3 * np.sin(3 * t)])
    joint = {"name": "swing", "type": "revolute", "inertia": 0.3, "stiffness": 0.0, "damping": None,
             "gravity_torque": {"amplitude": 2.0 * 9.81 * 0.25, "zero_angle": 0.4}}  # fmt: skip
    c, s = 0.25 * np.cos(0.4), 0.25 * np.sin(0.4)
    central = 0.3 - 2.0 * 0.25**2
    # the body frame lies apart from the joint, behind a fixed one; an angle of 0.4 about +y turns its arm to -z
    arm = f"""<mujoco><compiler angle="radian"/><worldbody><body name="frame"><geom size="0.1"/>
      <body name="bob" pos="1 2 3"><joint name="swing" axis="0 1 0" pos="0.1 0 0.2" damping="7"/>
      <inertial pos="{0.1 + s} 0 {0.2 - c}" mass="2" diaginertia="{central} {central} {central}"/></body></body>
      </worldbody></mujoco>"""
    found = []
    for name, mechanism in (("joints", {"joints": [joint]}), ("mjcf", {"mjcf": "arm.xml", "unknown": ["damping"]})):
        (tmp_path / name).mkdir()
        (tmp_path / name / "arm.xml").write_text(arm)
        np.savetxt(tmp_path / name / "a.csv", rows, delimiter=",", comments="", header="time_s,position,velocity")
        meta = {"format": "joint-gap-case/1", "mechanism": mechanism, "input": None, "outputs": outputs,
                "trajectories": [{"file": "a.csv", "t_start_s": 0.0}]}  # fmt: skip
        (tmp_path / name / "meta.yaml").write_text(yaml.safe_dump(meta))
        case = load_case(tmp_path / name)
        assert case.fit == "replay"
        rollout = simulation_of(case)(case, recordings_of(case), 2)
        found.append(rollout(torch.tensor([[0.05], [0.4]], dtype=torch.float64)).numpy())
    assert np.ptp(found[0][..., 0]) > 1.0
    np.testing.assert_allclose(found[1], found[0], atol=2e-4)


def test_replayed_arm_is_mujoco_s(tmp_path):
    """Drive both joints with the torques that MuJoCo recorded, held as it held them: the same motion for a second.

    Both take first-order steps, of 1 ms here and of 0.125 ms there: their motion differs by h/2 x acceleration x t.
    """
    folder = write_arm(tmp_path / "arm", unknown=["damping"], seeds=(3,), hold="zero_order")
    meta = yaml.safe_load((folder / "meta.yaml").read_text())
    meta.pop("filter_hz")
    meta["trajectories"][0]["rows"] = [500, 1000]
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta | {"fit": "replay"}))
    (folder / "arm.xml").write_text(arm_xml(TRUE))
    case, true = load_case(folder), simulate(3, hold="zero_order")[500:1000]
    rollout = simulation_of(case)(case, recordings_of(case), 1)
    start = torch.tensor(np.stack([true[0, 1:3], true[0, 3:5]], -1))[None, None]
    out = rollout(torch.tensor([TRUE["damping"]], dtype=torch.float64), start)[0, 0].numpy()
    assert np.abs(out - true[:, 1:3]).max() < 0.03 * np.ptp(true[:, 1:3])


# ---- a real arm -----------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not DFKI.is_dir(), reason="measured data folder shared/data is not there")
def test_real_double_pendulum(tmp_path):
    """Leave no more of the measured torques than published for a viscous model, 0.223 and 0.146 N m, on all samples."""
    names = ["com", "inertia", "length"]
    rigid, viscous = (load_case(write_dfki(tmp_path / k, u)) for k, u in (("r", names), ("v", ["damping", *names])))
    recordings = torque_recordings(viscous)
    assert len(recordings[0].t) == 2999 - 2 * PERIOD
    _, without = gauss_newton(rigid, recordings, 40)
    found, misfit = gauss_newton(viscous, recordings, 40)
    assert misfit[0] <= 0.223 and misfit[1] <= 0.146
    assert (without > misfit + 0.03).all()
    # a damper holds back: more than the published 0.001, since dry friction has no other place to go in this model
    assert 0.01 < found["damping shoulder"] < 0.1 and 0.01 < found["damping elbow"] < 0.1


# ---- what a case may say --------------------------------------------------------------------------------------------

ERRORS = {
    "quantity": (("mechanism", "unknown", 0), "dampng", ["mechanism unknown entry 1", "'dampng'", "'damping'"]),
    "joint": (("mechanism", "unknown", 0), "damping elbw", ["unknown entry 1", "'damping elbw'", "'elbow'"]),
    "twice": (("input", 1, "joint"), "shoulder", ["input entry 2 joint", "shoulder a second time", "one input"]),
    "no input": (("input",), [], ["input", "at least 1 item"]),
    "hold": (("input", 1, "hold"), "cubic", ["input entry 2 hold", "'linear' or 'zero_order'"]),
    "fast": (("filter_hz",), 250.0, ["filter_hz", "250", "below half the sampling rate"]),
    "zero": (("filter_hz",), 0.0, ["filter_hz", "greater than 0"]),
    "replay": (("fit",), "replay", ["filter_hz", "where fit is replay", "fit: torque only"]),
    "fit": (("fit",), "effort", ["fit", "'replay' or 'torque'"]),
    "unknown": (("mechanism",), {"joints": [{"name": "shoulder", "type": "revolute", "inertia": 1.0, "stiffness": 0.0,
                "damping": None}], "unknown": ["damping"]}, ["mechanism", "unknown beside joints"]),
}  # fmt: skip


def changed(folder: Path, path: tuple, value: object) -> Path:
    """Change one entry of a case's ``meta.yaml``."""
    meta = yaml.safe_load((folder / "meta.yaml").read_text())
    node = meta
    for key in path[:-1]:
        node = node[key]
    node[path[-1]] = value
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta))
    return folder


@pytest.fixture(scope="module")
def arm(tmp_path_factory) -> Path:
    """Write a case of the arm with one recording, for tests to copy."""
    return write_arm(tmp_path_factory.mktemp("arm") / "arm", unknown=["damping"], seeds=(0,))


def copied(arm: Path, folder: Path) -> Path:
    """Copy a case folder."""
    folder.mkdir()
    for item in arm.iterdir():
        (folder / item.name).write_text(item.read_text())
    return folder


@pytest.mark.parametrize("name", ERRORS)
def test_statements_that_cannot_be(arm, tmp_path, name):
    """Refuse each with its key, finding and what is allowed, in one line."""
    path, value, parts = ERRORS[name]
    with pytest.raises(InputError) as caught:
        load_case(changed(copied(arm, tmp_path / "c"), path, value))
    text = str(caught.value)
    assert all(part in text for part in parts) and "\n" not in text, text


def test_torque_fit_needs_everything_measured(arm, tmp_path):
    """Fall back to replay where a joint is not driven, and refuse ``fit: torque`` there."""
    meta = yaml.safe_load((arm / "meta.yaml").read_text())
    folder = changed(copied(arm, tmp_path / "c"), ("input",), meta["input"][:1])
    with pytest.raises(InputError, match="filter_hz: found 15 where fit is replay"):
        load_case(folder)
    changed(folder, ("fit",), "torque")
    with pytest.raises(InputError, match="fit: found torque without input of elbow"):
        load_case(folder)
    meta.pop("filter_hz")
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta | {"input": meta["input"][0]}))
    case = load_case(folder)
    assert case.fit == "replay" and simulation_of(case) is Rollout and case.trajectories[0].effort.shape[1] == 1


def test_short_recordings_are_refused(arm, tmp_path):
    """Name the file that leaves nothing between the ends where filters err."""
    case = load_case(changed(copied(arm, tmp_path / "c"), ("trajectories", 0, "rows"), [0, 101]))
    with pytest.raises(InputError, match=r"run_0\.csv: found 101 samples; allowed: 102 or more, three periods"):
        torque_recordings(case)


def test_ball_joints_are_refused(arm, tmp_path):
    """Name the element of a joint that has no one coordinate."""
    folder = copied(arm, tmp_path / "c")
    text = (folder / "arm.xml").read_text().replace('<joint name="elbow"', '<joint type="ball" name="elbow"')
    (folder / "arm.xml").write_text(text)
    with pytest.raises(InputError, match="found a ball joint in a measured mechanism"):
        load_case(folder)


def test_jitter_is_resampled_only_where_stated(arm, tmp_path):
    """Refuse an uneven clock, and interpolate it on a stated grid; refuse a gap all the same."""
    folder = copied(arm, tmp_path / "c")
    rows = np.loadtxt(folder / "run_0.csv", delimiter=",", skiprows=1)
    rows[:, 0] = np.round(rows[:, 0] + np.random.default_rng(0).uniform(0.0, 1e-3, len(rows)), 6)
    header = (folder / "run_0.csv").read_text().splitlines()[0]
    np.savetxt(folder / "run_0.csv", rows, delimiter=",", fmt="%.9g", header=header, comments="")
    with pytest.raises(InputError, match="or resample_hz"):
        load_case(folder)
    case = load_case(changed(folder, ("resample_hz",), 400.0))
    trajectory = case.trajectories[0]
    assert case.dt == pytest.approx(1 / 400.0, rel=1e-9)
    grid = rows[0, 0] + np.arange(len(trajectory.t)) / 400.0
    assert grid[-1] <= rows[-1, 0] < grid[-1] + 1 / 400.0
    np.testing.assert_allclose(trajectory.output[:, 1], np.interp(grid, rows[:, 0], rows[:, 2]), atol=1e-12)
    np.testing.assert_allclose(trajectory.effort[:, 0], np.interp(grid, rows[:, 0], rows[:, 3]), atol=1e-12)
    np.savetxt(folder / "run_0.csv", np.delete(rows, slice(50, 60), 0), delimiter=",", fmt="%.9g", header=header,
               comments="")  # fmt: skip
    with pytest.raises(InputError, match=r"run_0\.csv: row 52, column time_s: found a step of 0\.02"):
        load_case(folder)
