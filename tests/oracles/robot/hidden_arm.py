"""A Jaco 2 in C MuJoCo whose servos lack something, recorded in free motions: the oracle of an arm's own gap.

Bodies are those of `mujoco_arm`. Servo and friction are MuJoCo's implicit joint dampers, set anew in every step (its
frictionloss is solved without them, and moves light joints); a play is a hinge of its own between motor and link, with
stops, and the link rubs against the base with `LINK_FRICTION`, so that it stays where the
motor leaves it; commands are delayed sample by sample. Noise of torques is that which docs/touch.md tells of a real
Jaco 2, positions are rounded.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass, field, replace
from pathlib import Path

import mujoco
import numpy as np
import yaml
from bough.sim.arms.jaco2 import jaco2
from oracles.mujoco_arm import document

H, EVERY, STATES = 1.0 / 600.0, 10, 60  # step [s]; steps a command lasts, and from one joint state to the next
WHITE = np.array([0.24, 0.41, 0.21, 0.04, 0.04, 0.02])
DRIFT = np.array([0.38, 0.44, 0.29, 0.05, 0.05, 0.08])
MEMORY, ROUNDED = 1.0, 1e-4  # of the drift [s]; of positions [rad]
LINK_FRICTION = 2.0  # of a link that is loose on its motor [N m]


@dataclass(frozen=True)
class Hidden:
    """What is hidden, [6] each: friction [N m], share of the weight, delay [s], play [rad], gain [N m s/rad].

    ``behind`` says whether the torque sensor is behind the gear, where it does not feel the friction. ``lag`` [s],
    ``ripple`` [N m], ``slow`` and ``cable`` [N m/rad] have no name: a first-order lag of the servo, a torque that goes
    round three times with the joint, commands obeyed at a share of their speed, a spring to the start.
    """

    friction: np.ndarray = field(default_factory=lambda: np.zeros(6))
    weight: np.ndarray = field(default_factory=lambda: np.zeros(6))
    delay: np.ndarray = field(default_factory=lambda: np.zeros(6))
    play: np.ndarray = field(default_factory=lambda: np.zeros(6))
    gain: np.ndarray = field(default_factory=lambda: np.full(6, 80.0))
    behind: bool = False
    lag: np.ndarray = field(default_factory=lambda: np.zeros(6))
    ripple: np.ndarray = field(default_factory=lambda: np.zeros(6))
    slow: np.ndarray = field(default_factory=lambda: np.ones(6))
    cable: np.ndarray = field(default_factory=lambda: np.zeros(6))


def at(joint: int, value: float, usual: float = 0.0) -> np.ndarray:
    """Return a number at one joint and the usual one at all others, [6]."""
    out = np.full(6, usual)
    out[joint] = value
    return out


def model_of(hidden: Hidden):
    """Compile the arm with what is hidden; motors are hinges ``*_joint``, plays ``*_play``."""
    arm = jaco2()
    arm = replace(arm, friction=np.zeros(6))
    root = ET.fromstring(document(arm, servo=False))
    for i, name in enumerate(arm.tree.link_name):
        body = next(b for b in root.iter("body") if b.get("name") == name)
        joint = body.find("joint")
        if hidden.play[i] > 0.0:  # a light motor's body carries the link, which is loose on it
            _loosen(root, body, joint, name, hidden.play[i])
    actuators = ET.SubElement(root, "actuator")
    for name in arm.tree.link_name:
        ET.SubElement(actuators, "motor", name=name, joint=f"{name}_joint")
    model = mujoco.MjModel.from_xml_string(ET.tostring(root, encoding="unicode"))
    model.opt.timestep, model.opt.gravity[:] = H, (0.0, 0.0, -9.81)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    return arm, model


def _loosen(root, body, joint, name: str, width: float) -> None:
    parent = next(p for p in root.iter() if body in list(p))
    motor = ET.Element("body", name=f"{name}_motor", **{k: body.get(k) for k in ("pos", "quat") if body.get(k)})
    ET.SubElement(motor, "inertial", pos="0 0 0", mass="0.01", diaginertia="1e-3 1e-3 1e-3")
    motor.append(joint)
    loose = ET.Element("joint", name=f"{name}_play", type="hinge", axis=joint.get("axis"),
                       pos=joint.get("pos", "0 0 0"), limited="true", range=f"{-width / 2} {width / 2}", damping="0.05",
                       solreflimit="0.01 1")  # fmt: skip
    tendon = ET.SubElement(ET.SubElement(root, "tendon"), "fixed", frictionloss=str(LINK_FRICTION))
    for half in ("joint", "play"):
        ET.SubElement(tendon, "joint", joint=f"{name}_{half}", coef="1")
    body.remove(joint)
    body.insert(0, loose)
    for key in ("pos", "quat"):
        body.attrib.pop(key, None)
    parent.insert(list(parent).index(body), motor)
    parent.remove(body)
    motor.append(body)


def recorded(hidden: Hidden, seconds: float, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Return a recording at 10 Hz: time, q, tau without the weight, dq_cmd (the mean since the row before)."""
    arm, model = model_of(hidden)
    names = arm.tree.link_name
    data = mujoco.MjData(model)
    motor = [model.joint(f"{n}_joint").qposadr[0] for n in names]
    turning = [model.joint(f"{n}_joint").dofadr[0] for n in names]
    loose = [model.joint(f"{n}_play").qposadr[0] if hidden.play[i] > 0 else None for i, n in enumerate(names)]
    data.qpos[motor] = arm.home + rng.uniform(-0.5, 0.5, 6)
    start = data.qpos[motor].copy()
    wishes = _wishes(rng, int(seconds / H) // EVERY + 2)
    rows, asked, lagged = [], [], np.zeros(6)
    late = np.rint(hidden.delay / H).astype(int)
    for k in range(int(seconds / H)):
        now = np.array([wishes[max(0, k - late[j]) // EVERY, j] if k >= late[j] else 0.0 for j in range(6)])
        lagged = np.where(hidden.lag > 0, lagged + (now - lagged) * H / np.maximum(hidden.lag, H), now)
        asked.append(wishes[k // EVERY])
        mujoco.mj_step1(model, data)
        carried = (1.0 - hidden.weight) * _weight(model, data, turning)
        beside = hidden.ripple * np.sin(3.0 * data.qpos[motor]) - hidden.cable * (data.qpos[motor] - start)
        rub = hidden.friction / np.maximum(np.abs(data.qvel[turning]), 2e-3)
        model.dof_damping[turning] = hidden.gain + rub
        data.qfrc_applied[turning] = carried + hidden.gain * hidden.slow * lagged + beside
        mujoco.mj_step2(model, data)
        drive = hidden.gain * (hidden.slow * lagged - data.qvel[turning])
        felt = drive - (rub * data.qvel[turning] if hidden.behind else 0.0)
        if k % STATES == 0:
            q = data.qpos[motor] + [0.0 if p is None else data.qpos[p] for p in loose]
            rows.append((q, felt, np.mean(asked, axis=0)))
            asked = []
    q, tau, command = (np.array(c) for c in zip(*rows, strict=True))
    drift = np.zeros_like(tau)
    keep = np.exp(-STATES * H / MEMORY)
    for k in range(1, len(tau)):
        drift[k] = keep * drift[k - 1] + np.sqrt(1 - keep**2) * DRIFT * rng.normal(size=6)
    tau = tau + drift + WHITE * rng.normal(size=tau.shape)
    return {"time_s": np.arange(len(q)) * STATES * H, "q": np.round(q / ROUNDED) * ROUNDED, "tau": tau,
            "dq_cmd": command}  # fmt: skip


def _weight(model, data, turning) -> np.ndarray:
    """Return what carries the arm [N m]: the generalised gravity forces, turned about."""
    saved = data.qvel.copy()
    data.qvel[:] = 0.0
    mujoco.mj_fwdVelocity(model, data)
    out = data.qfrc_bias[turning].copy()
    data.qvel[:] = saved
    mujoco.mj_fwdVelocity(model, data)
    return out


def _wishes(rng: np.random.Generator, count: int) -> np.ndarray:
    """Speeds that a policy might ask for at 60 Hz [rad/s]: smooth, with reversals, about zero in the mean."""
    t = np.arange(count)[:, None] / 60.0
    out = np.zeros((count, 6))
    for _ in range(3):
        size, pace, phase = rng.uniform(0.05, 0.25, 6), rng.uniform(0.08, 0.6, 6), rng.uniform(0, 2 * np.pi, 6)
        out += size * np.sin(2 * np.pi * pace * t + phase)
    return np.clip(out, -0.6, 0.6)


def make_case(folder: Path, hidden: Hidden, seed: int, count: int = 12, seconds: float = 8.0) -> Path:
    """Write a case of free recordings."""
    folder.mkdir(parents=True)
    rng, links = np.random.default_rng(seed), jaco2().tree.link_name
    files = []
    for k in range(count):
        r = recorded(hidden, seconds * rng.uniform(0.7, 1.3), rng)
        names = ["time_s"] + [f"{n}{j + 1}" for n in ("q", "tau", "dq_cmd") for j in range(6)]
        values = np.column_stack([r["time_s"], r["q"], r["tau"], r["dq_cmd"]])
        np.savetxt(folder / f"run_{k}.csv", values, delimiter=",", header=",".join(names), comments="", fmt="%.7g")
        files.append({"file": f"run_{k}.csv", "t_start_s": 100.0 * k})

    def columns(name: str, more: dict) -> list[dict]:
        return [{"joint": n, "column": f"{name}{j + 1}", "scale": 1.0, **more} for j, n in enumerate(links)]

    meta = {
        "format": "joint-gap-case/1", "mechanism": {"arm": "jaco2", "weight": "out"},
        "input": columns("tau", {"hold": "linear"}), "commands": columns("dq_cmd", {}),
        "outputs": columns("q", {"quantity": "position"}), "trajectories": files,
    }  # fmt: skip
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta, sort_keys=False))
    return folder
