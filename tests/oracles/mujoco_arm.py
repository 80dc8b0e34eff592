"""Run an `Arm` among branches in C MuJoCo: the oracle of the arm simulator.

Arm and branches are written to one MJCF document by the package's own exporter (which `test_export` compares with the
trees it came from); servo, limits and contacts are added here.
"""

from __future__ import annotations

import xml.etree.ElementTree as ET

import mujoco
import numpy as np
from bough.sim.arms.arm import Arm
from bough.sim.formats.export_mjcf import numbers, to_mjcf
from bough.sim.trees.tree import Tree

DT = 1.0 / 240.0


def document(
    arm: Arm, tree: Tree | None = None, *, friction: float = 0.5, time_constant: float = 0.02, servo: bool = True
) -> str:
    """MJCF of an arm and, beside it, of branches that only the arm touches.

    Args:
        arm: The arm. Its servos are velocity actuators; what carries the weight counts towards the torque limit.
        tree: The branches.
        friction: Coulomb's coefficient.
        time_constant: Of the contacts' restoring motion [s] (MuJoCo's ``solref``), critically damped.
        servo: Whether there are servos and weight compensation at all.
    """
    root = ET.fromstring(to_mjcf(arm.tree))
    world = root.find("worldbody")
    for i, name in enumerate(arm.tree.link_name):
        _arm_link(world, arm, i, name, servo)
    if servo:
        actuators = ET.SubElement(root, "actuator")
        for i, name in enumerate(arm.tree.link_name):
            ET.SubElement(actuators, "velocity", name=name, joint=f"{name}_joint", kv=repr(float(arm.gain[i])))
    for geom in world.iter("geom"):
        geom.set("contype", "1")
    if tree is not None:
        for body in list(ET.fromstring(to_mjcf(tree)).find("worldbody")):
            for geom in body.iter("geom"):
                geom.set("conaffinity", "1")
            world.append(body)
    for geom in world.iter("geom"):
        geom.set("friction", numbers([friction, 0.005, 0.0001]))
        geom.set("solref", numbers([time_constant, 1.0]))
    return ET.tostring(root, encoding="unicode")


def _arm_link(world: ET.Element, arm: Arm, i: int, name: str, servo: bool) -> None:
    body = next(b for b in world.iter("body") if b.get("name") == name)
    joint = body.find("joint")
    joint.set("frictionloss", repr(float(arm.friction[i])))
    joint.set("solreffriction", "0.002 1")
    if servo:
        body.set("gravcomp", "1")
        joint.set("actuatorgravcomp", "true")
        joint.set("actuatorfrcrange", numbers([-arm.torque_limit[i], arm.torque_limit[i]]))


def compiled(
    arm: Arm, tree: Tree | None = None, *, dt: float = DT, gravity: float = 9.81, contact: bool = True, **options
):
    """Compile: (model, data) at the arm's home and the branches' rest.

    Args:
        arm: The arm.
        tree: The branches.
        dt: Step [s].
        gravity: Along -z [m/s^2].
        contact: Whether anything touches.
        options: As for `document`.
    """
    model = mujoco.MjModel.from_xml_string(document(arm, tree, **options))
    model.opt.timestep, model.opt.gravity[:] = dt, (0.0, 0.0, -gravity)
    model.opt.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
    model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    if not contact:
        model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    data = mujoco.MjData(model)
    data.qpos[: arm.num_dofs] = arm.home
    mujoco.mj_forward(model, data)
    return model, data


def contact_forces(model, data) -> tuple[np.ndarray, np.ndarray]:
    """Net force of all contacts on what carries the second geom, world axes [N], shape [3]; and penetrations [m]."""
    total, depth, force = np.zeros(3), np.zeros(data.ncon), np.zeros(6)
    for k in range(data.ncon):
        mujoco.mj_contactForce(model, data, k, force)
        total += data.contact[k].frame.reshape(3, 3).T @ force[:3]
        depth[k] = -data.contact[k].dist
    return total, depth
