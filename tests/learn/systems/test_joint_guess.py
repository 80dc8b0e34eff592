"""Starts of searches from least squares on derivatives, against oscillators in closed form."""

import numpy as np
import torch
import yaml
from bough.learn.cases.case import load_case
from bough.learn.replay.recording import recordings
from bough.learn.replay.rollout import Rollout
from bough.learn.systems.choose import system_of
from bough.learn.systems.joint_guess import guess_joint
from oracles.oscillator import write_case

RUNS = [(0.5, 0.0), (-0.2, 1.0)]


def test_free_decay_gives_spring_and_damper(tmp_path):
    """Find K = 80 and D = 1.5 of J = 2: 200 samples a period, so derivatives are good to a percent."""
    case = load_case(write_case(tmp_path / "case", RUNS))
    found = guess_joint(case, case.joints[0])
    assert set(found) == {"stiffness", "damping"}
    np.testing.assert_allclose([found["stiffness"], found["damping"]], [80.0, 1.5], rtol=0.01)


def driven_case(folder, *, mass, damping, stiffness, offset, dt=1 / 600):
    """Write a case of a driven oscillator with nothing known, its motion from an exact discretisation."""
    from scipy.signal import lsim

    folder.mkdir()
    fine = np.arange(20 * 3000) * dt / 20  # tones, not lines between their samples
    rng = np.random.default_rng(0)
    tones = rng.uniform(5.0, 60.0, 12)
    force = sum(np.sin(2 * np.pi * f * fine + p) for f, p in zip(tones, rng.uniform(0, 6.3, 12), strict=True))
    _, q, _ = lsim(([1.0], [mass, damping, stiffness]), force + offset, fine)
    t, force, q = fine[::20], force[::20], q[::20]
    for k, part in enumerate((slice(0, 1500), slice(1500, 3000))):
        table = np.column_stack([t[part] - t[part][0], force[part], q[part]])
        np.savetxt(folder / f"run_{k}.csv", table, delimiter=",", header="time_s,force_N,q_m", comments="")
    joint = {"name": "mass", "type": "prismatic", "inertia": None, "stiffness": None, "damping": None}
    meta = {
        "format": "joint-gap-case/1", "mechanism": {"joints": [joint]},
        "input": {"joint": "mass", "column": "force_N", "scale": 1.0, "hold": "linear"},
        "outputs": [{"joint": "mass", "quantity": "position", "column": "q_m", "scale": 1.0}],
        "trajectories": [{"file": f"run_{k}.csv", "t_start_s": 10.0 * k} for k in range(2)], "noise_nominal": None,
    }  # fmt: skip
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta))
    return load_case(folder)


def test_unknown_inertia_far_from_any_default(tmp_path):
    """Come within a third of everything at ten samples a period, twelve e-folds from one kilogram."""
    truth = {"inertia": 6e-6, "damping": 2.4e-4, "stiffness": 1.1}
    case = driven_case(tmp_path / "case", mass=6e-6, damping=2.4e-4, stiffness=1.1, offset=0.0)
    found = guess_joint(case, case.joints[0])
    for name, value in truth.items():
        assert abs(np.log(found[name] / value)) < 0.33, (name, found)
    system = system_of(case)
    assert [p.name for p in system.parameters] == ["inertia mass", "stiffness mass", "damping mass", "offset mass"]
    assert all(p.low < v < p.high for p, v in zip(system.parameters, (6e-6, 1.1, 2.4e-4, 0.0), strict=True))
    # a period of 14.7 ms turns by at most 0.1 rad a step, so a step is at most a 63rd of it
    assert system.substep <= 2 * np.pi * np.sqrt(6e-6 / 1.1) / 50


def test_replay_keeps_time(tmp_path):
    """Replay a driven oscillator at the truth: coordinates, rates and forces are those of one moment, a sample's.

    A step h turns the free oscillation by w h = 0.09 rad. Half a step late or early, coordinates would err by w h / 2,
    4.5 %; leapfrog errs by (w h)^2 / 24 in frequency, a hundredth of that, and shows more of it where a tone is near
    the resonance only. A tenth is allowed.
    """
    case = driven_case(tmp_path / "case", mass=6e-6, damping=2.4e-5, stiffness=1.1, offset=0.0)
    recording = recordings(case)[:1]
    rollout = Rollout(case, recording, 1)
    values = torch.tensor([[6e-6, 1.1, 2.4e-5, 0.0]], dtype=torch.float64)
    out = rollout(values, torch.zeros(1, 1, 1, 2, dtype=torch.float64))[0, 0, :, 0].double().numpy()
    left = np.sqrt(np.mean((out - recording[0].output[:, 0]) ** 2)) / recording[0].output.std()
    assert left < 0.1 * 0.5 * np.sqrt(1.1 / 6e-6) * case.dt / rollout.substeps


def pendulum_case(folder, amplitude, zero_angle):
    """Write a free pendulum, A = 12 N m, D = 0.3, hanging at 2.5 rad of its encoder, by scipy; two swings."""
    from scipy.integrate import solve_ivp

    folder.mkdir()
    t = np.arange(300) * 0.01
    for k, start in enumerate((0.8, -0.5)):
        q = solve_ivp(lambda _, y: [y[1], -12.0 * np.sin(y[0] - 2.5) - 0.3 * y[1]], (0, 3), [2.5 + start, 0.0],
                      t_eval=t, rtol=1e-10, atol=1e-10).y[0]  # fmt: skip
        np.savetxt(folder / f"{k}.csv", np.column_stack([t, q]), delimiter=",", header="time_s,q", comments="")
    joint = {"name": "swing", "type": "revolute", "inertia": 1.0, "stiffness": 0.0, "damping": None,
             "gravity_torque": {"amplitude": amplitude, "zero_angle": zero_angle}}  # fmt: skip
    meta = {"format": "joint-gap-case/1", "mechanism": {"joints": [joint]}, "input": None,
            "outputs": [{"joint": "swing", "quantity": "position", "column": "q", "scale": 1.0}],
            "trajectories": [{"file": f"{k}.csv", "t_start_s": 10.0 * k} for k in range(2)]}  # fmt: skip
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta))
    return load_case(folder)


def test_unknown_zero_angle(tmp_path):
    """Guess size and direction of gravity's torque together, and swing alike whichever of the two is unknown."""
    start, motions = torch.tensor([[[[3.3, 0.0]]]], dtype=torch.float64), []
    for amplitude, zero in ((12.0, 2.5), (None, 2.5), (12.0, None), (None, None)):
        case = pendulum_case(tmp_path / f"{amplitude}_{zero}", amplitude, zero)
        system = system_of(case)
        known = {"damping swing": 0.3, "gravity torque swing": 12.0, "zero angle swing": 2.5}
        values = torch.tensor([[known[p.name] for p in system.parameters]], dtype=torch.float64)
        assert len(system.parameters) == 1 + (amplitude is None) + (zero is None)
        motions.append(Rollout(case, recordings(case)[:1], 1)(values, start)[0, 0, :, 0].numpy())
        if zero is None:
            found = guess_joint(case, case.joints[0])
            np.testing.assert_allclose([found["gravity"], found["zero"]], [12.0, 2.5], rtol=0.01)
            box = next(p for p in system.parameters if p.name == "zero angle swing")
            assert box.high - box.low > 6.28 and box.low < 2.5 < box.high
    # single precision along 300 steps; the way in which the mass hangs differs
    for motion in motions[1:]:
        np.testing.assert_allclose(motion, motions[0], atol=2e-4)
    assert np.ptp(motions[0]) > 1.0
