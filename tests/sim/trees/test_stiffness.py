"""Stiffness models against their formulas; loads at rest against MuJoCo and the gradient of the energy."""

import mujoco
import numpy as np
import pytest
from bough.sim.base.errors import InputError
from bough.sim.base.rotation import quat_rotate
from bough.sim.formats.export_mjcf import to_mjcf
from bough.sim.trees.pose import coordinate_start, pose, zero_qpos
from bough.sim.trees.species import grow
from bough.sim.trees.stiffness import beam, hold_rest_pose, rudimentary, toppling_stiffness
from bough.sim.trees.tree import Joint, Tree
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.random_tree import random_tree
from scipy.spatial.transform import Rotation

ALL = (Joint.FIXED, Joint.REVOLUTE, Joint.SPHERICAL, Joint.PRISMATIC)


def capsule(radius: tuple[float, float], length: float, joint: Joint = Joint.SPHERICAL) -> Tree:
    return Tree(
        name="stick", link_name=["a"], parent=[-1], joint=[joint], position=[[0, 0, 0]], rotation=[[1, 0, 0, 0]],
        mass=[1.0], com=[[0, 0, length / 2]], inertia=[np.eye(3)], stiffness=[7.0], damping=[0.3], shape_link=[0],
        shape_start=[[0, 0, 0]], shape_end=[[0, 0, length]], shape_radius=[radius],
    )  # fmt: skip


def test_beam_by_hand() -> None:
    """Check 3e9 pi 0.01^4 / (2 * 0.5) = 94.25 N m/rad, a taper's mean radius, and joints that do not bend."""
    tree = beam(capsule((0.01, 0.01), 0.5))
    assert tree.stiffness[0] == pytest.approx(94.24777960769379) and tree.damping[0] == pytest.approx(9.424777960769379)
    assert beam(capsule((0.012, 0.008), 0.5), young=6e9).stiffness[0] == pytest.approx(2 * 94.24777960769379)
    for joint in (Joint.PRISMATIC, Joint.FIXED):
        kept = beam(capsule((0.01, 0.01), 0.5, joint))
        assert (kept.stiffness[0], kept.damping[0]) == (7.0, 0.3)


def test_rudimentary_falls_with_the_level() -> None:
    """Check 120, 40, 13.3 and the lower bound 5 at levels 0 to 3, K_d a tenth, without noise."""
    tree = rudimentary(grow("Ta", 3), sigma=0.0)
    for level, stiffness in enumerate([120.0, 40.0, 40.0 / 3.0, 5.0]):
        assert tree.stiffness[tree.level == level] == pytest.approx(stiffness)
    assert tree.damping == pytest.approx(tree.stiffness / 10)


def test_rudimentary_noise() -> None:
    """Check mean, spread and lower bound of the noise over the 1458 twigs of a tree of order 6, in standard errors."""
    grown = grow("Ta", 6)
    tree = rudimentary(grown, upper=100.0, decay=0.8, lower=30.0, sigma=1.5, rng=3)
    values = tree.stiffness[grown.level == 5]
    assert abs(values.mean() - 100 * 0.8**5) < 5 * 1.5 / np.sqrt(values.size)
    assert abs(values.std() / 1.5 - 1) < 5 / np.sqrt(2 * values.size)
    clipped = rudimentary(grown, upper=100.0, decay=0.5, lower=30.0, sigma=1.5, rng=3).stiffness[grown.level == 6]
    assert clipped.min() == 30.0 and np.mean(clipped > 30.0) == 0.0  # 100 / 64 never reaches 30
    assert np.array_equal(
        rudimentary(grown, rng=4).stiffness, rudimentary(grown, rng=np.random.default_rng(4)).stiffness
    )


@pytest.mark.parametrize(("species", "order"), [("Ta", 2), ("Tc", 3), ("Td", 4)])
@pytest.mark.parametrize("model", ["rudimentary", "beam"])
def test_grown_trees_stand_up(species: str, order: int, model: str) -> None:
    """Check with MuJoCo that the springs of grown trees hold their weight: they come to rest near their height."""
    tree = grow(species, order, seed=1, stiffness=model)
    data = mujoco.MjData(mujoco.MjModel.from_xml_string(to_mjcf(tree)))
    # Only the equilibrium matters: much damping takes the sway out, the implicit integrator allows long steps.
    data.model.opt.timestep = 0.02
    data.model.dof_damping[:] *= 10
    mujoco.mj_forward(data.model, data)
    top = data.xpos[:, 2].max()
    for _ in range(1500):
        mujoco.mj_step(data.model, data)
    assert np.abs(data.qvel).max() < 1e-3
    assert data.xpos[:, 2].max() > 0.9 * top


def test_toppling_stiffness_by_hand() -> None:
    """Check m g l / 2 for a stick, and that two sticks on end add up at the lower joint."""
    stick = capsule((0.01, 0.01), 0.5)
    assert toppling_stiffness(stick) == pytest.approx([9.81 * 0.25])
    pair = Tree(
        name="pair", link_name=["a", "b"], parent=[-1, 0], joint=[2, 2], position=[[0, 0, 0], [0, 0, 0.5]],
        rotation=[[1, 0, 0, 0]] * 2, mass=[1, 2], com=[[0, 0, 0.25]] * 2, inertia=[np.eye(3)] * 2, stiffness=[0, 0],
        damping=[0, 0],
    )  # fmt: skip
    assert toppling_stiffness(pair, gravity=10.0) == pytest.approx([10 * (0.25 + 2 * 0.75), 10 * 2 * 0.25])


def test_heavy_trees_get_stiffer() -> None:
    """Check that the default upper bound leaves every joint at least twice its toppling stiffness."""
    tree = rudimentary(grow("Ta", 4), sigma=0.0)
    assert np.all(tree.stiffness >= 2 * toppling_stiffness(tree) * (1 - 1e-12))
    assert tree.stiffness.max() > 120


def mjcf(tree: Tree) -> str:
    """Write a tree for MuJoCo, in the order of its links; written here so that the exporter is not trusted."""
    kind = {Joint.REVOLUTE: "hinge", Joint.SPHERICAL: "ball", Joint.PRISMATIC: "slide"}

    def numbers(values) -> str:
        return " ".join(repr(float(v)) for v in np.ravel(values))

    def body(i: int) -> str:
        tensor = tree.inertia[i][[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        joint = ""
        if tree.joint[i] != Joint.FIXED:
            rest = "" if tree.joint[i] == Joint.SPHERICAL else f'springref="{tree.rest[i, 0]:.17g}"'
            joint = (
                f'<joint type="{kind[Joint(tree.joint[i])]}" pos="{numbers(tree.anchor[i])}" {rest} '
                f'axis="{numbers(tree.axis[i])}" stiffness="{tree.stiffness[i]:.17g}"/>'
            )
        inside = "".join(body(c) for c in tree.children()[i])
        return (
            f'<body pos="{numbers(tree.position[i])}" quat="{numbers(tree.rotation[i])}">{joint}<inertial mass='
            f'"{tree.mass[i]:.17g}" pos="{numbers(tree.com[i])}" fullinertia="{numbers(tensor)}"/>{inside}</body>'
        )

    roots = "".join(body(i) for i in range(tree.num_links) if tree.parent[i] < 0)
    return (
        f'<mujoco><compiler angle="radian" balanceinertia="true"/><option gravity="0 0 -9.81"/><worldbody>{roots}'
        "</worldbody></mujoco>"
    )


def in_dof_order(tree: Tree) -> np.ndarray:
    return np.concatenate([tree.preload[i, : Joint(j).dofs] for i, j in enumerate(tree.joint)])


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 2**32), st.integers(1, 25))
def test_preload_is_mujocos_bias(seed: int, links: int) -> None:
    """Check preload against MuJoCo's bias force at rest minus its spring force, for all kinds of joints."""
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, links, joints=ALL, bent_rest=True)
    data = mujoco.MjData(mujoco.MjModel.from_xml_string(mjcf(tree)))
    mujoco.mj_forward(data.model, data)
    wanted = data.qfrc_bias - data.qfrc_passive
    scale = 1e-9 * max(1.0, np.abs(wanted).max(initial=0.0))
    assert in_dof_order(hold_rest_pose(tree)) == pytest.approx(wanted, abs=scale)


def energy(tree: Tree, qpos: np.ndarray, gravity: float) -> float:
    position, rotation = pose(tree, qpos)
    total = gravity * tree.mass @ (position + quat_rotate(rotation, tree.com))[:, 2]
    for i, start in enumerate(coordinate_start(tree)):
        if tree.joint[i] == Joint.SPHERICAL:
            turn = Rotation.from_quat(np.roll(qpos[start : start + 4], -1))
            phi = (Rotation.from_quat(np.roll(tree.rest[i], -1)).inv() * turn).as_rotvec()
        elif tree.joint[i] == Joint.FIXED:
            continue
        else:
            phi = np.array([qpos[start] - tree.rest[i, 0], 0.0, 0.0])
        total += 0.5 * tree.stiffness[i] * phi @ phi - tree.preload[i] @ phi
    return total


def test_preload_makes_joint_zero_stationary() -> None:
    """Differ the energy of weight, springs and pre-loads about joint zero, where balls may be relaxed elsewhere."""
    rng, step = np.random.default_rng(5), 1e-5
    tree = random_tree(rng, 12, joints=ALL, bent_rest=True)
    balls = tree.joint == Joint.SPHERICAL
    rest = tree.rest.copy()
    rest[balls] = np.roll(Rotation.from_rotvec(rng.normal(0, 0.8, (balls.sum(), 3))).as_quat(), 1, axis=1)
    rest[np.flatnonzero(balls)[::2]] *= -1.0  # the same orientations
    tree = tree.with_(rest=rest)
    tree = hold_rest_pose(tree, gravity=3.7)
    for i, start in enumerate(coordinate_start(tree)):
        for k in range(Joint(tree.joint[i]).dofs):
            values = []
            for side in (step, -step):
                qpos = zero_qpos(tree)
                if balls[i]:
                    turn = Rotation.from_rotvec(side * np.eye(3)[k]).as_quat()
                    qpos[start : start + 4] = np.roll(turn, 1)
                else:
                    qpos[start] = side
                values.append(energy(tree, qpos, 3.7))
            # Differences of an energy of some 100 J carry round-off of 1e-14 * 100 / 1e-5.
            assert (values[0] - values[1]) / (2 * step) == pytest.approx(0.0, abs=1e-5)
    assert np.abs(tree.preload).max() > 5.0


@pytest.mark.parametrize(
    ("call", "found"),
    [
        (lambda t: rudimentary(t, lower=0.0), "lower: found 0"),
        (lambda t: rudimentary(t, upper=4.0), "lower: found 5; allowed: above 0, at most upper = 4"),
        (lambda t: rudimentary(t, upper=float("inf")), "upper: found inf"),
        (lambda t: rudimentary(t, decay=0.0), "decay: found 0"),
        (lambda t: rudimentary(t, decay=1.5), "decay: found 1.5"),
        (lambda t: rudimentary(t, sigma=-1.0), "sigma: found -1"),
        (lambda t: beam(t, young=0.0), "young: found 0"),
        (lambda t: beam(t.with_(shape_end=t.shape_start)), "link segment_0"),
    ],
)
def test_refuses_bad_arguments(call, found: str) -> None:
    """Check that parameter or link is named."""
    with pytest.raises(InputError) as info:
        call(grow("Ta", 1))
    assert found in str(info.value)
