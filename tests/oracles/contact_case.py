"""Scenes of an arm among branches: posts, sliders, a 40-link tree that it sweeps through, and what one reads off."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from bough.sim.arms.arm import Arm, forward_kinematics
from bough.sim.arms.arrays import arm_capsules
from bough.sim.arms.jaco2 import jaco2
from bough.sim.arms.simulator import ArmSimulator, Contacts
from bough.sim.trees.tree import Joint, Tree, capsule_inertia
from scipy.spatial.transform import Rotation

DT = 1.0 / 240.0
#: The arm stretched out: upper arm and forearm in one line that rises at 20 degrees, over the negative x axis.
STRETCHED = np.deg2rad([0.0, 250.0, 180.0, 0.0, 180.0, 180.0])
#: Springs of the ternary tree by level [N m/rad]; its dampers are a tenth of them.
STIFFNESS = np.array([120.0, 40.0, 14.0, 5.0])
#: One choice of laws beside contact, with values, for all tests: a kernel of contact takes 10 s to compile.
LAWS = {
    "cubic_stiffness": {"cubic_radm2": 2.0},
    "dry_friction": {"torque_Nm": 0.4},
    "plastic_set": {"share": 0.5, "yield_rad": 0.03, "isotropic": 0.4},
    "quadratic_drag": {"coefficient_kgpm3": 2.0},
    "tip_mass": {"mass_kg": 0.05},
    "wind_gust": {"sine_x_Pa": 40.0, "cosine_y_Pa": 20.0, "frequency_Hz": 0.7},
}


def give(effects, values=LAWS):
    """Write the same values into all worlds."""
    for name, parameters in values.items():
        for parameter, value in parameters.items():
            effects.fill(name, parameter, value)


def free_arm(**changes: float) -> Arm:
    """Return the Jaco 2 with the given numbers in all joints, unlimited in position."""
    arm = jaco2()
    limits = {"lower": np.full(6, -np.inf), "upper": np.full(6, np.inf)}
    return replace(arm, **limits, **{name: np.full(6, value) for name, value in changes.items()})


def turn_of(direction) -> np.ndarray:
    """Shortest turn from z to a direction, as a quaternion w, x, y, z."""
    d = np.asarray(direction, np.float64) / np.linalg.norm(direction)
    w = np.sqrt(max((1.0 + d[2]) / 2.0, 0.0))
    return np.array([0.0, 1.0, 0.0, 0.0]) if w < 1e-9 else np.array([w, -d[1] / (2 * w), d[0] / (2 * w), 0.0])


def post(
    at, *, direction=(0.0, 0.0, 1.0), length: float = 0.4, radius: float = 0.01, stiffness: float = 100.0,
    damping: float = 5.0, mass: float = 0.2, joint: Joint = Joint.SPHERICAL, axis=(0.0, 1.0, 0.0),
) -> Tree:  # fmt: skip
    """Make one capsule link that stands at a point [m] on a sprung joint and points along ``direction``.

    ``axis``, of a hinge or a slide, is given in the link's own frame, whose z axis lies along the capsule.
    """
    across, along = capsule_inertia(mass, radius, length)
    return Tree(
        name="post", link_name=["post"], parent=[-1], joint=[joint], position=[at], rotation=[turn_of(direction)],
        mass=[mass], com=[[0.0, 0.0, length / 2]], inertia=[np.diag([across, across, along])], stiffness=[stiffness],
        damping=[damping], axis=[axis], shape_link=[0], shape_start=np.zeros((1, 3)),
        shape_end=[[0.0, 0.0, length]], shape_radius=[[radius, radius]],
    )  # fmt: skip


def slider(at, *, half: float = 0.05, radius: float = 0.01, mass: float = 0.2) -> Tree:
    """Make a capsule along y that slides freely along x and z, without turning: a body on an incline."""
    across, along = capsule_inertia(mass, radius, 2 * half)
    return Tree(
        name="slider", link_name=["lift", "slide"], parent=[-1, 0], joint=[Joint.PRISMATIC] * 2,
        position=[at, [0.0, 0.0, 0.0]], rotation=[[1.0, 0, 0, 0]] * 2, mass=[1e-4, mass], com=np.zeros((2, 3)),
        inertia=[np.eye(3) * 1e-6, np.diag([across, along, across])], stiffness=[0.0] * 2, damping=[0.0] * 2,
        axis=[[0.0, 0, 1.0], [1.0, 0, 0]], shape_link=[1], shape_start=[[0.0, -half, 0.0]],
        shape_end=[[0.0, half, 0.0]], shape_radius=[[radius, radius]],
    )  # fmt: skip


def ternary(rng: np.random.Generator, *, order: int = 3, root=(-0.5, 0.55, -0.1), scale: float = 0.6) -> Tree:
    """Make a ternary tree of capsules on ball joints with masses and springs varied by 10 %: order 3 has 40 links.

    It stands beside the stretched arm, which sweeps through its crown when joint 1 turns.
    """
    parent, level, side, todo = [], [], [], [(-1, 0, 0)]
    while todo:
        above, depth, k = todo.pop()
        parent.append(above)
        level.append(depth)
        side.append(k)
        if depth < order:
            todo += [(len(parent) - 1, depth + 1, k) for k in range(3)]
    parent, level, side = (np.array(v) for v in (parent, level, side))
    n = len(parent)
    vary = rng.uniform(0.9, 1.1, (4, n))
    length, radius = scale * 0.6 * 0.7**level * vary[0], scale * 0.03 * 0.6**level * vary[1]
    mass, stiffness = 700.0 * np.pi * radius**2 * length * vary[2], STIFFNESS[level] * vary[3]
    moments = np.array([(a, a, b) for a, b in map(capsule_inertia, mass, radius, length)])
    about, tilt = 2 * np.pi * side / 3, np.where(level > 0, np.radians(35.0), 0.0)
    w, s = np.cos(tilt / 2), np.sin(tilt / 2)
    ends = np.outer(length, [0.0, 0.0, 1.0])
    return Tree(
        name="ternary", link_name=[f"link{i}" for i in range(n)], parent=parent, joint=np.full(n, Joint.SPHERICAL),
        position=np.where((parent >= 0)[:, None], ends[parent], root),
        rotation=np.stack([w, s * np.cos(about), s * np.sin(about), np.zeros(n)], axis=1), mass=mass, com=ends / 2,
        inertia=moments[:, :, None] * np.eye(3), stiffness=stiffness, damping=stiffness / 10.0, level=level,
        shape_link=np.arange(n), shape_start=np.zeros((n, 3)), shape_end=ends,
        shape_radius=np.stack([radius, radius], axis=1),
    )  # fmt: skip


def simulator(trees, arm: Arm | None = None, *, q=STRETCHED, width: int = 1, contacts: dict | None = None, **options):
    """Make a simulator on one thread whose arms start at ``q``, [dof] or [worlds, dof]."""
    arm = jaco2() if arm is None else arm
    sim = ArmSimulator(trees, arm, contacts=Contacts(**(contacts or {})), width=width, threads=1, **options)
    sim.start_q.copy_(torch.as_tensor(np.asarray(q), dtype=torch.float32))
    sim.reset()
    return sim


def drive(sim, seconds: float, target, read=lambda sim: sim.q[0].numpy().copy(), substeps: int = 1) -> np.ndarray:
    """Step under ``target(t)``, [dof] or [worlds, dof], and return what ``read`` finds every 1/240 s."""
    out = []
    for k in range(round(seconds / DT)):
        sim.target.copy_(torch.as_tensor(np.asarray(target(k * DT)), dtype=torch.float32))
        sim.step(substeps)
        out.append(read(sim))
    assert sim.faults() == []
    assert int(sim.overflow.sum()) == 0
    return np.array(out)


def contacts_of(sim: ArmSimulator, world: int = 0) -> np.ndarray:
    """Contacts of a world in the last substep, a structured array of `kernels.contact.law.Contact`."""
    return sim._touch.record.numpy()[world, : int(sim._touch.count[world])]


def point_jacobian(arm: Arm, q: np.ndarray, link: int, point: np.ndarray) -> np.ndarray:
    """Velocity of a world point carried by a link per unit joint rate, shape [3, dof], from the host's kinematics."""
    points, turns, _ = forward_kinematics(arm, q)
    axes = np.stack([_rotate(turns[j], arm.tree.axis[j]) for j in range(arm.num_dofs)])
    columns = np.cross(axes, point - points)
    columns[link + 1 :] = 0.0
    return columns.T


def _rotate(q: np.ndarray, v: np.ndarray) -> np.ndarray:
    w, u = q[0], q[1:]
    return v + 2.0 * np.cross(u, np.cross(u, v) + w * v)


def pushed_posts(count: int, seed: int = 1):
    """Return posts beside links 2 to 6 of differently bent arms: (trees, q [count, 6], arm), in the way of joint 1."""
    rng, arm = np.random.default_rng(seed), free_arm(friction=0.0)
    link = np.r_[-1, arm.tree.shape_link]
    radius = np.r_[arm.base_radius, arm.tree.shape_radius.mean(axis=1)]
    trees, poses = [], []
    for i in range(count):
        q, c = STRETCHED + rng.uniform(-0.5, 0.5, 6), (2, 3, 4, 3, 2, 3)[i % 6]
        start, end = arm_capsules(arm, q)
        u = (end[c] - start[c]) / np.linalg.norm(end[c] - start[c])
        middle = start[c] + rng.uniform(0.4, 0.8) * (end[c] - start[c])
        way = point_jacobian(arm, q, int(link[c]), middle)[:, 0]
        way -= u * (way @ u)
        way /= np.linalg.norm(way)
        lean = np.cross(u, way) * np.cos(0.4) + rng.uniform(-0.3, 0.3) * u
        lean = lean * np.sign(lean[2]) / np.linalg.norm(lean)
        at = middle + way * (radius[c] + 0.014) - 0.3 * lean
        stiffness = (30.0, 100.0, 300.0)[i % 3]
        trees.append(post(at, direction=lean, stiffness=stiffness, length=0.5, mass=0.1, damping=10.0))
        poses.append(q)
    return trees, np.array(poses), arm


def pushes(sim: ArmSimulator, trees: list[Tree]):
    """Yield world, contacts, turn and contact moment about the joint (world axes) of every post that is touched."""
    for w, tree in enumerate(trees):
        found = [c for c in contacts_of(sim, w) if c["force"].any()]
        if found:
            frame = Rotation.from_quat(np.roll(tree.rotation[0], -1))
            turn = frame.apply(Rotation.from_quat(np.roll(sim.state.qpos()[w], -1)).as_rotvec())
            yield w, found, turn, sum(np.cross(c["point"] - tree.position[0], c["force"]) for c in found)


def roughness(force: np.ndarray, found: list[np.ndarray]) -> tuple[float, float, int]:
    """Share of a force's mean that is noise from step to step, where the same contacts last.

    The rms of the second difference over sqrt(6), by which white noise of that rms would show there, over the mean;
    of steps whose pairs have been the same for three steps and whose normals turn by less than 0.03 rad a step.

    Args:
        force: Norm of the net force [N], shape [steps].
        found: Contacts that acted in every step (`contacts_of`), in a lasting order.

    Returns:
        The share, the mean force [N] in these steps, and how many there are.
    """
    pairs = [list(zip(c["capsule"], c["body"], strict=True)) for c in found]

    def lasts(k: int) -> bool:
        if not pairs[k] or any(pairs[j] != pairs[k] for j in (k - 3, k - 2, k - 1, k + 1)):
            return False
        return all((found[j]["normal"] * found[k]["normal"]).sum(axis=1).min() > np.cos(0.03) for j in (k - 1, k + 1))

    use = np.array([k for k in range(3, len(force) - 1) if lasts(k)])
    second = force[use + 1] - 2.0 * force[use] + force[use - 1]
    mean = float(np.mean(force[use]))
    return float(np.sqrt(np.mean(second**2) / 6.0)) / mean, mean, len(use)


def busy(worlds: int, seed: int = 0, *, contacts: dict | None = None, **options):
    """Make worlds of different trees of 13 and 40 links, arms at random poses among them, line and ground."""
    rng = np.random.default_rng(seed)
    trees, q = [], []
    for _ in range(worlds):
        angle, far = rng.uniform(0, 2 * np.pi), rng.uniform(0.4, 0.6)
        root = (far * np.cos(angle), far * np.sin(angle), -0.1)
        trees.append(ternary(rng, order=int(rng.integers(2, 4)), root=root))
        towards = np.pi - angle + rng.choice([-0.6, 0.6])
        q.append(np.r_[towards, rng.uniform(3.9, 4.6), rng.uniform(2.6, 3.6), rng.uniform(-3, 3, 3)])
    sim = simulator(trees, q=np.array(q), contacts={"ground": -0.3, "capacity": 64} | (contacts or {}), **options)
    sim.line_start.copy_(torch.tensor([0.45, -1.0, 0.6]))
    sim.line_end.copy_(torch.tensor([0.45, 1.0, 0.7]))
    sim.line_mask.copy_(torch.arange(worlds) % 2)
    return sim


def act(sim, steps: int, seed: int = 1, hold: int = 24, look=lambda sim: None, chunk: int = 1) -> list:
    """Step under random actions, new ones every ``hold`` steps; return what ``look`` finds after every ``chunk``."""
    rng, out = np.random.default_rng(seed), []
    for _ in range(steps // hold):
        sim.target.copy_(torch.as_tensor(rng.uniform(-1, 1, tuple(sim.target.shape)) * sim.arm.velocity_limit))
        for _ in range(hold // chunk):
            sim.step(chunk)
            out.append(look(sim))
    return out


def bits(sim) -> list[np.ndarray]:
    """All that a step leaves behind, in the order of worlds."""
    found = [sim.q, sim.qd, sim.torque, sim.arm_force, sim.branch_force, sim.depth, sim.end_position]
    return [v.numpy().copy() for v in found] + [np.concatenate(sim.state.qpos()), np.concatenate(sim.state.qvel())]


def same(a: list[np.ndarray], b: list[np.ndarray]) -> None:
    for x, y in zip(a, b, strict=True):
        np.testing.assert_array_equal(x, y)
