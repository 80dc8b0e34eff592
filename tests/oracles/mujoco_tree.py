"""Run a `Tree` in C MuJoCo (implicitfast, no contact, no constraint): the oracle of the simulator."""

from __future__ import annotations

import mujoco
import numpy as np
from bough.sim.formats.export_mjcf import to_mjcf
from bough.sim.trees.tree import Joint, Tree
from scipy.spatial.transform import Rotation

OFF = (
    mujoco.mjtDisableBit.mjDSBL_CONTACT
    | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    | mujoco.mjtDisableBit.mjDSBL_AUTORESET
    | mujoco.mjtDisableBit.mjDSBL_WARMSTART
)


def compiled(tree: Tree, dt: float = 1.0 / 240.0, gravity: float = 9.81, xml: str | None = None):
    """Compile a tree numbered depth first: (model, data), so that body i + 1 is link i.

    MJCF has neither rest orientations of ball springs nor pre-loads; they are set in the compiled model and, by `hold`,
    as applied forces.

    Args:
        tree: The tree.
        dt: Step [s].
        gravity: Along -z [m/s^2].
        xml: MJCF to compile instead of the tree's own; it must have the tree's joints in the tree's order.
    """
    ball = (tree.joint == Joint.SPHERICAL)[:, None]
    plain = tree.with_(rest=np.where(ball, [1.0, 0.0, 0.0, 0.0], tree.rest), preload=np.zeros_like(tree.preload))
    model = mujoco.MjModel.from_xml_string(xml or to_mjcf(plain, gravity=gravity, timestep=dt))
    model.opt.timestep = dt
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.disableflags |= int(OFF)
    model.qpos_spring[:] = rows(tree, tree.rest, "coordinates")
    data = mujoco.MjData(model)
    hold(tree, model, data)
    return model, data


def hold(tree: Tree, model, data) -> None:
    """Apply the pre-loads in the present pose."""
    applied = tree.preload.copy()
    for i in np.flatnonzero((tree.joint == Joint.SPHERICAL) & tree.preload.any(axis=1)):
        place = int(model.jnt_qposadr[model.body_jntadr[i + 1]])
        rest, now = (Rotation.from_quat(q, scalar_first=True) for q in (tree.rest[i], data.qpos[place : place + 4]))
        applied[i] = held_torque(tree.preload[i], (rest.inv() * now).as_rotvec())
    data.qfrc_applied[:] = rows(tree, applied, "dofs")


def held_torque(preload, phi) -> np.ndarray:
    """Torque of a ball's pre-load P in the link's axes, the gradient of P.phi, phi the rotation vector from rest.

    With a turn w of the link about its own axes d phi = J^-1 w of the right Jacobian J (Sola, Deray & Atchuthan 2018,
    equation 143), so that the torque is J^-T P.
    """
    angle = max(float(np.linalg.norm(phi)), 1e-12)
    hat = np.cross(np.eye(3), phi / angle)
    jacobian = np.eye(3) - (1 - np.cos(angle)) / angle * hat + (1 - np.sin(angle) / angle) * hat @ hat
    return np.linalg.solve(jacobian.T, preload)


def rows(tree: Tree, values: np.ndarray, size: str) -> np.ndarray:
    """Flatten per-link values [L, C] to one vector: of every link as many as its joint has "dofs" or "coordinates"."""
    counts = np.array([getattr(Joint(int(j)), size) for j in tree.joint])
    return values[np.arange(values.shape[1])[None, :] < counts[:, None]]


def one_step(model, data, qpos, qvel, tree: Tree | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return qpos and qvel one step after the given ones, with the pre-loads of a tree; other applied forces stay."""
    data.qpos[:], data.qvel[:] = qpos, qvel
    if tree is not None:
        hold(tree, model, data)
    mujoco.mj_step(model, data)
    return data.qpos.copy(), data.qvel.copy()


def trajectory(tree: Tree, qpos, dt: float, steps: int, substeps: int = 1) -> np.ndarray | None:
    """Body positions [steps, L, 3] after every ``dt`` from rest at ``qpos``; None where MuJoCo blows up.

    It has blown up when a number is not finite or a joint turns by more than half a turn a step.
    """
    model, data = compiled(tree, dt / substeps)
    data.qpos[:] = qpos
    out = np.empty((steps, tree.num_links, 3))
    for k in range(steps):
        for _ in range(substeps):
            hold(tree, model, data)
            mujoco.mj_step(model, data)
        if not (np.isfinite(data.qpos).all() and np.abs(data.qvel).max() < np.pi / model.opt.timestep):
            return None
        mujoco.mj_kinematics(model, data)
        out[k] = data.xpos[1:]
    return out


def converged(tree: Tree, qpos, dt: float, steps: int, substeps: int = 32) -> np.ndarray | None:
    """Body positions [steps, L, 3] extrapolated to step zero (Richardson) from ``substeps`` and twice as many a dt."""
    coarse = trajectory(tree, qpos, dt, steps, substeps)
    fine = trajectory(tree, qpos, dt, steps, 2 * substeps)
    return None if coarse is None or fine is None else 2.0 * fine - coarse


def equilibrium(tree: Tree, qpos, *, tolerance: float = 1e-10) -> np.ndarray:
    """Body positions [L, 3] of the equilibrium next to ``qpos``, by damped Newton steps on MuJoCo's static forces.

    The Jacobian of the static joint forces is taken by central differences along every degree of freedom.

    Raises:
        RuntimeError: No equilibrium to ``tolerance`` [N m or N] within 60 steps.
    """
    model, data = compiled(tree)
    data.qpos[:] = qpos

    def force(at: np.ndarray) -> np.ndarray:
        data.qpos[:], data.qvel[:] = at, 0.0
        hold(tree, model, data)
        mujoco.mj_forward(model, data)
        return data.qfrc_smooth.copy()

    at, eps = np.array(qpos, dtype=np.float64), 1e-6
    for _ in range(60):
        f = force(at)
        if np.abs(f).max() < tolerance:
            mujoco.mj_kinematics(model, data)
            return data.xpos[1:].copy()
        slope = np.stack([(force(_moved(model, at, i, eps)) - force(_moved(model, at, i, -eps))) / (2 * eps)
                          for i in range(model.nv)], axis=1)  # fmt: skip
        move = -np.linalg.solve(slope, f)
        move *= min(1.0, 0.3 / np.abs(move).max())
        mujoco.mj_integratePos(model, at, move, 1.0)
    raise RuntimeError(f"{tree.name}: no equilibrium, residual {np.abs(f).max():g} N m")


def _moved(model, qpos: np.ndarray, dof: int, amount: float) -> np.ndarray:
    out, move = qpos.copy(), np.zeros(model.nv)
    move[dof] = amount
    mujoco.mj_integratePos(model, out, move, 1.0)
    return out
