"""Measured geometry as a tree, against C MuJoCo's compiler, closed forms and quadrature."""

from __future__ import annotations

import numpy as np
import pytest
from bough.sim.base.errors import InputError
from bough.sim.base.rotation import quat_matrix
from bough.sim.trees.measured import MeasuredBranch, axis_rotation, frustum_inertia, measured_tree
from bough.sim.trees.pose import rest_pose
from bough.sim.trees.tree import Joint
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.branch_case import Branch, build, random_branch
from scipy.integrate import quad


def measured(branch: Branch) -> MeasuredBranch:
    """Return the oracle's branch as measured geometry."""
    return MeasuredBranch(
        name="branch",
        segment_name=tuple(branch.names),
        length=np.array(branch.length),
        radius=np.column_stack([branch.radius_base, branch.radius_tip]),
        elevation=np.radians(branch.elevation),
        azimuth=np.radians(branch.azimuth),
        mass=branch.mass(),
        base_position=np.zeros(3),
        gravity=branch.gravity,
        grasp_segment=len(branch.length) - 1,
        grasp_distance=branch.grasp_distance,
    )


@settings(max_examples=30, deadline=None)
@given(a=st.floats(0.002, 0.1), b=st.floats(0.002, 0.1), length=st.floats(0.15, 3), mass=st.floats(0.01, 50))
def test_frustum_inertia_is_the_integral(a: float, b: float, length: float, mass: float) -> None:
    """Centre and inertia of a frustum equal the integrals over its discs; quadrature is exact to 1e-10 here."""

    def moment(power: int, weight: float) -> float:
        return quad(lambda z: np.pi * (a + (b - a) * z / length) ** power * z**weight, 0, length, epsrel=1e-12)[0]

    density = mass / moment(2, 0)
    centre = density * moment(2, 1) / mass
    along = density * moment(4, 0) / 2
    across = density * (moment(4, 0) / 4 + moment(2, 2)) - mass * centre**2
    com, inertia = frustum_inertia(np.array([mass]), np.array([[a, b]]), np.array([length]))
    np.testing.assert_allclose(com[0], [0, 0, centre], rtol=1e-8)
    np.testing.assert_allclose(inertia[0], np.diag([across, across, along]), rtol=1e-7, atol=1e-15 * mass)


@settings(max_examples=30, deadline=None)
@given(elevation=st.floats(-90, 90), azimuth=st.floats(-360, 360))
def test_axis_rotation(elevation: float, azimuth: float) -> None:
    """The rotation takes z to (cos el cos az, cos el sin az, sin el) and keeps y horizontal."""
    el, az = np.radians(elevation), np.radians(azimuth)
    turn = quat_matrix(axis_rotation(el, az))
    np.testing.assert_allclose(turn[:, 2], [np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], atol=1e-12)
    assert abs(turn[2, 1]) < 1e-12


@pytest.mark.parametrize("segments", [1, 2, 4])
def test_tree_is_mujocos_branch(segments: int) -> None:
    """Joints, centres of mass, masses and inertias in the world are those C MuJoCo compiles for the same cylinders."""
    branch = random_branch(np.random.default_rng(segments), segments)
    branch.radius_tip = branch.radius_base
    tree = measured_tree(measured(branch), branch.stiffness, branch.damping)
    model, data = build(branch, sub=1)
    position, rotation = rest_pose(tree)
    turn = quat_matrix(rotation)
    np.testing.assert_allclose(position, data.xpos[1:], atol=1e-12)
    np.testing.assert_allclose(position + np.einsum("nij,nj->ni", turn, tree.com), data.xipos[1:], atol=1e-12)
    np.testing.assert_allclose(tree.mass, model.body_mass[1:], rtol=1e-12)
    world = turn @ tree.inertia @ turn.transpose(0, 2, 1)
    frames = data.ximat[1:].reshape(-1, 3, 3)
    expected = np.einsum("nij,nj,nkj->nik", frames, model.body_inertia[1:], frames)
    np.testing.assert_allclose(world, expected, rtol=1e-9, atol=1e-12)
    assert (tree.joint == Joint.SPHERICAL).all() and tree.link_name == branch.names
    np.testing.assert_array_equal(tree.stiffness, branch.stiffness)


def test_grasp_point_and_shapes() -> None:
    """The grasp point and the capsules' ends lie where the geometry says."""
    branch = random_branch(np.random.default_rng(0), 3)
    geometry = measured(branch)
    tree = measured_tree(geometry, branch.stiffness, branch.damping)
    position, rotation = rest_pose(tree)
    turn = quat_matrix(rotation)
    link, point = geometry.grasp
    np.testing.assert_allclose(position[link] + turn[link] @ point, branch.grasp(), atol=1e-12)
    ends = position + np.einsum("nij,nj->ni", turn, tree.shape_end)
    np.testing.assert_allclose(ends[:-1], position[1:], atol=1e-12)
    np.testing.assert_allclose(geometry.lower_end, position, atol=1e-12)
    np.testing.assert_array_equal(tree.shape_radius, geometry.radius)


def test_preload_carries_the_load() -> None:
    """The pre-load is the torque that gravity needs in MuJoCo's inverse dynamics at rest, in body axes."""
    branch = random_branch(np.random.default_rng(7), 3)
    branch.radius_tip = branch.radius_base
    tree = measured_tree(measured(branch), branch.stiffness, branch.damping)
    _, data = build(branch, sub=1)
    turn = quat_matrix(rest_pose(tree)[1])
    # MuJoCo's bodies are parallel to the world at rest: its bias is in world axes.
    world = np.einsum("nij,nj->ni", turn, tree.preload)
    np.testing.assert_allclose(world, data.qfrc_bias.reshape(-1, 3), atol=1e-10)


def test_wrong_shapes_are_refused() -> None:
    """Stiffness for another number of segments, or a negative one, is refused with its place."""
    geometry = measured(random_branch(np.random.default_rng(0), 2))
    with pytest.raises(InputError, match=r"stiffness: found shape \(3,\)"):
        measured_tree(geometry, [1.0, 2.0, 3.0], [0.1, 0.1])
    with pytest.raises(InputError, match="link child: found damping -1"):
        measured_tree(geometry, [1.0, 2.0], [0.1, -1.0])
