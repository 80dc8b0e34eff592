"""Rods of 1 m on one joint, forests of them with effects, and the controls of a page that shows them."""

import numpy as np
import torch
from bough.sim.engine.model import Model
from bough.sim.engine.simulator import Simulator
from bough.sim.trees.tree import Joint, Tree

J, K, D = 2.0, 80.0, 1e-3
W = np.sqrt(K / J)
H = 1e-3  # first order, so that amplitudes are right to W H / 2 = 0.3 %
BEND = 5e-4  # what dry friction bends by before it slips [rad]
LENGTH, RADIUS = 1.0, 0.05
AREA = 2 * RADIUS * LENGTH


def stick(joint=Joint.REVOLUTE, *, stiffness=K, damping=D, mass=1.0, axis=(0.0, 1.0, 0.0)) -> Tree:
    """Make one rod of 1 m along z on a joint at its lower end, of inertia J about it, or of a mass on a slide."""
    return Tree(
        name="stick", link_name=["stick"], parent=[-1], joint=[joint], axis=[axis], position=np.zeros((1, 3)),
        rotation=[[1.0, 0, 0, 0]], mass=[mass], com=np.zeros((1, 3)), inertia=[J * np.eye(3)], stiffness=[stiffness],
        damping=[damping], shape_link=[0], shape_start=np.zeros((1, 3)), shape_end=[[0.0, 0.0, LENGTH]],
        shape_radius=[[RADIUS, RADIUS]],
    )  # fmt: skip


def forked(taper: float) -> tuple[Tree, np.ndarray, np.ndarray]:
    """Make a stem with two branches on hinges; return it, lengths and lower radii [m], of which upper are ``taper``."""
    length, radius = np.array([LENGTH, 0.6, 0.4]), np.array([RADIUS, 0.02, 0.015])
    fork = Tree(
        name="fork", link_name=["stem", "left", "right"], parent=[-1, 0, 0], joint=[Joint.REVOLUTE] * 3,
        axis=[[0.0, 1.0, 0.0]] * 3, position=[[0, 0, 0], [0, 0, LENGTH], [0, 0, LENGTH]],
        rotation=[[1.0, 0, 0, 0]] * 3, mass=[1.0, 0.2, 0.1], com=np.zeros((3, 3)), inertia=[0.05 * np.eye(3)] * 3,
        stiffness=[60.0, 15.0, 9.0], damping=[8.0, 2.0, 1.0], shape_link=[0, 1, 2], shape_start=np.zeros((3, 3)),
        shape_end=np.outer(length, [0.0, 0.0, 1.0]), shape_radius=np.stack([radius, taper * radius], axis=1),
    )  # fmt: skip
    return fork, length, radius


def simulator(trees, names, *, dt=H, gravity=0.0, precision=64, width=None, **values) -> Simulator:
    """Make a simulator with effects; ``values`` are {parameter: one number, or one a world} by effect."""
    out = Simulator(Model(trees, precision=precision, width=width, gravity=(0, 0, -gravity)), dt=dt, effects=names)
    for name, given in values.items():
        for parameter, value in given.items():
            tensor = out.effects[name][parameter]
            column = torch.as_tensor(value, dtype=tensor.dtype)
            tensor.copy_(column[:, None] if column.ndim and tensor.ndim == 2 else column)
    return out


def rod(stiffness: float) -> Tree:
    """Return an upright rod of 1 m on a ball joint, so well damped that it comes to rest within a second."""
    return Tree(
        "rod", ["rod"], [-1], [Joint.SPHERICAL], np.zeros((1, 3)), [[1.0, 0, 0, 0]], mass=[0.3], com=[[0, 0, 0.5]],
        inertia=[np.diag([0.025, 0.025, 1e-4])], stiffness=[stiffness], damping=[0.18 * stiffness], shape_link=[0],
        shape_start=[[0, 0, 0]], shape_end=[[0, 0, 1.0]], shape_radius=[[0.02, 0.015]],
    ).validate()  # fmt: skip


def slider(page, label):
    """Return a control of the page by its label."""
    return next(h for h in page.server.gui._gui_input_handle_from_uuid.values() if h.label == label)
