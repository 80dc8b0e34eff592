"""Torque-measured arms: case folders of a driven two-link arm simulated by C MuJoCo."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import yaml

RATE = 500.0
#: Shoulder and elbow of the arm that is simulated, and of the file that the case is given: some numbers are wrong.
TRUE = {"mass": (0.52, 0.63), "com": (0.18, 0.21), "inertia": (0.012, 0.005), "damping": (0.06, 0.09), "length": 0.2}
GIVEN = {"mass": (0.52, 0.63), "com": (0.10, 0.12), "inertia": (0.003, 0.003), "damping": (0.01, 0.01), "length": 0.2}


def arm_xml(v: dict) -> str:
    """Return the MJCF of a double pendulum in the x-z plane, hanging at zero, with its numbers."""
    upper, lower = (
        f'<joint name="{name}" damping="{v["damping"][i]}"/><inertial pos="0 0 {-v["com"][i]}" mass="{v["mass"][i]}" '
        f'diaginertia="{v["inertia"][i]} {v["inertia"][i]} 2e-4"/>'
        for i, name in enumerate(("shoulder", "elbow"))
    )
    return (
        '<mujoco model="arm"><compiler angle="radian"/><default><joint axis="0 -1 0" armature="0.002"/></default>'
        f'<worldbody><body name="upper">{upper}<body name="lower" pos="0 0 {-v["length"]}">{lower}</body></body>'
        "</worldbody></mujoco>"
    )


def arm_meta(files: list[str], unknown: list[str], hold: str = "linear") -> dict:
    """Return the ``meta.yaml`` of an arm that is measured in position and torque at both joints."""
    joints = {"shoulder": 1, "elbow": 2}
    return {
        "format": "joint-gap-case/1", "name": "arm", "filter_hz": 15.0,
        "mechanism": {"mjcf": "arm.xml", "unknown": unknown},
        "input": [{"joint": j, "column": f"torque{k}_Nm", "scale": 1.0, "hold": hold} for j, k in joints.items()],
        "outputs": [{"joint": j, "quantity": "position", "column": f"q{k}_rad", "scale": 1.0}
                    for j, k in joints.items()],
        "trajectories": [{"file": f, "t_start_s": 20.0 * i} for i, f in enumerate(files)],
    }  # fmt: skip


def simulate(seed: int, seconds: float = 6.0, hold: str = "linear") -> np.ndarray:
    """Return rows t, q1, q2, v1, v2, torque1, torque2 of the true arm, tracking random sums of sines.

    With ``hold`` ``zero_order`` the controller acts once a sample, else at every one of the 16 steps between samples.
    """
    rng, fine = np.random.default_rng(seed), 16
    model = mujoco.MjModel.from_xml_string(arm_xml(TRUE))
    model.opt.timestep, model.opt.integrator = 1.0 / (RATE * fine), mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    data = mujoco.MjData(model)
    frequency, phase = rng.uniform(0.2, 1.6, (5, 2)), rng.uniform(0, 2 * np.pi, (5, 2))
    rows = np.empty((round(seconds * RATE), 7))
    for step in range(len(rows) * fine):
        if step % fine == 0 or hold == "linear":
            want = 0.6 * np.sin(2 * np.pi * frequency * data.time + phase).sum(0)
            data.qfrc_applied[:] = [8.0, 5.0] * (want - data.qpos) - [0.5, 0.3] * data.qvel
        if step % fine == 0:
            rows[step // fine] = step / fine / RATE, *data.qpos, *data.qvel, *data.qfrc_applied
        mujoco.mj_step(model, data)
    return rows


def write_arm(
    folder: Path, *, unknown: list[str], seeds: tuple[int, ...] = (0, 1), noise: float = 0.0, hold: str = "linear"
) -> Path:
    """Write a case of the arm with white noise: ``noise`` [rad] on positions and 20 times as much [N m] on torques."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(99)
    (folder / "arm.xml").write_text(arm_xml(GIVEN))
    files = [f"run_{seed}.csv" for seed in seeds]
    for seed, file in zip(seeds, files, strict=True):
        rows = simulate(seed, hold=hold)[:, [0, 1, 2, 5, 6]]
        rows[:, 1:3] += noise * rng.normal(size=(len(rows), 2))
        rows[:, 3:] += 20 * noise * rng.normal(size=(len(rows), 2))
        text = "\n".join(",".join(f"{x:.9g}" for x in row) for row in rows)
        (folder / file).write_text(f"time_s,q1_rad,q2_rad,torque1_Nm,torque2_Nm\n{text}\n")
    (folder / "meta.yaml").write_text(yaml.safe_dump(arm_meta(files, unknown, hold), sort_keys=False))
    return folder
