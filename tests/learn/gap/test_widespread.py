"""One law at many joints of an arm whose torques were measured; MuJoCo's inverse dynamics makes the recordings."""

import mujoco
import numpy as np
import pytest
import yaml
from bough.learn.cases.case import load_case
from bough.learn.gap.consistent import sentence
from bough.learn.gap.diagnose import find_missing
from bough.learn.gap.diagnosis import Settings
from bough.learn.gap.run import Run
from bough.learn.runs.threads import one_thread

#: Axes of a pan, two lifts and a roll, each above the one before it.
AXES = ("0 0 1", "0 1 0", "0 1 0", "0 0 1")
DAMPING = (0.5, 0.8, 0.4, 0.1)


def arm():
    """Return an arm of four joints as MJCF, with dampers of half of what they are: they are learnt."""
    links, ends = "", ""
    for k, axis in enumerate(AXES):
        links += (f'<body name="l{k}" pos="0 0 {0.0 if k == 0 else 0.3}"><joint name="j{k}" type="hinge" axis="{axis}"'
                  f' damping="{0.5 * DAMPING[k]}"/><inertial pos="0.02 0 0.15" mass="{3.0 / (k + 1)}"'
                  ' diaginertia="0.03 0.03 0.01"/>')  # fmt: skip
        ends += "</body>"
    return f'<mujoco><option gravity="0 0 -9.81"/><worldbody>{links}{ends}</worldbody></mujoco>'


def write(folder, torque):
    """Write a case of three recordings in which the joints also take ``torque(k, q, v)``."""
    folder.mkdir()
    (folder / "arm.xml").write_text(arm())
    model = mujoco.MjModel.from_xml_string(arm())
    model.dof_damping[:] = DAMPING
    data, rng, t = mujoco.MjData(model), np.random.default_rng(0), np.arange(1000) / 100.0
    for r in range(3):
        w = 2.0 * np.pi * rng.uniform(0.1, 0.4, (4, 3, 1))
        a, phase = rng.uniform(0.1, 0.4, (4, 3, 1)), rng.uniform(0.0, 6.28, (4, 3, 1))
        q, v = (a * np.sin(w * t + phase)).sum(1), (a * w * np.cos(w * t + phase)).sum(1)
        b = -(a * w**2 * np.sin(w * t + phase)).sum(1)
        needed = np.empty((1000, 4))
        for n in range(1000):
            data.qpos[:], data.qvel[:], data.qacc[:] = q[:, n], v[:, n], b[:, n]
            mujoco.mj_inverse(model, data)
            needed[n] = data.qfrc_inverse
        needed += np.stack([torque(k, q[k], v[k]) for k in range(4)], 1)
        seen = np.concatenate([q.T + 2e-5 * rng.standard_normal(q.T.shape),
                               needed + 0.02 * rng.standard_normal(needed.shape)], 1)  # fmt: skip
        names = ",".join(["t", *(f"q{k}" for k in range(4)), *(f"u{k}" for k in range(4))])
        np.savetxt(folder / f"run_{r}.csv", np.column_stack([t, seen]), delimiter=",", header=names, comments="",
                   fmt="%.9g")  # fmt: skip
    (folder / "meta.yaml").write_text(yaml.safe_dump({
        "format": "joint-gap-case/1", "time_column": "t", "mechanism": {"mjcf": "arm.xml", "unknown": ["damping"]},
        "input": [{"joint": f"j{k}", "column": f"u{k}", "scale": 1.0, "hold": "linear"} for k in range(4)],
        "outputs": [{"joint": f"j{k}", "quantity": "position", "column": f"q{k}", "scale": 1.0} for k in range(4)],
        "trajectories": [{"file": f"run_{r}.csv", "t_start_s": 20.0 * r} for r in range(3)],
    }))  # fmt: skip
    return load_case(folder)


def diagnosed(case):
    """Return the diagnosis of a case by two laws."""
    with one_thread():
        return find_missing(case, Run(Settings(("dry_friction", "quadratic_drag"), particles=0)))


def test_friction_of_most_gears_is_one_name(tmp_path):
    """Name friction at the three joints that rub, though two effects are the most that are named, with its size.

    A tenth of the size is twice what the filter's rounding of a jump of 5e-3 rad/s takes from it here.
    """
    size = (1.2, 2.0, 0.0, 0.4)
    case = write(tmp_path / "case", lambda k, q, v: size[k] * np.tanh(v / 5e-3))
    found = diagnosed(case)
    assert found.verdict == "effects", found.sentence
    assert {(a.name, a.joint) for a in found.effects} == {("dry_friction", k) for k in (0, 1, 3)}
    for label, own in found.parameters.items():
        assert own["torque_Nm"].median == pytest.approx(size[int(label[-1])], rel=0.1)
    names = [joint.name for joint in case.joints]
    assert f"dry_friction at joints 0 ({names[0]}), 1 ({names[1]}) and 3 ({names[3]})" in sentence(found)
    assert found.gap.repaired < 0.2 * found.gap.base


def test_cogging_of_every_gear_is_no_friction(tmp_path):
    """Leave torques that depend on the angle alone without a name, at whichever joints they act."""
    size = (1.2, 2.0, 0.8, 0.4)
    found = diagnosed(write(tmp_path / "case", lambda k, q, v: size[k] * np.sin(9.0 * q)))
    assert found.verdict == "unknown", found.sentence
