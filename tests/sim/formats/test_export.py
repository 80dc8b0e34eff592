"""MJCF, URDF, GLB and USD, read back by C MuJoCo, Newton, trimesh and OpenUSD."""

from __future__ import annotations

from xml.etree import ElementTree as ET

import mujoco
import newton
import numpy as np
import pytest
import trimesh
from bough.sim.base.errors import InputError
from bough.sim.base.rotation import quat_matrix
from bough.sim.formats.export_mesh import mesh, to_glb, to_usd
from bough.sim.formats.export_mjcf import to_mjcf
from bough.sim.formats.export_urdf import roll_pitch_yaw, to_urdf
from bough.sim.trees.pose import coordinate_start, pose, rest_pose
from bough.sim.trees.tree import Joint, Tree
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.random_tree import random_qpos, random_tree
from scipy.spatial.transform import Rotation

ALL = (Joint.FIXED, Joint.REVOLUTE, Joint.SPHERICAL, Joint.PRISMATIC)
SEED = st.integers(0, 2**32 - 1)


def mass_matrix(tree: Tree, qpos: np.ndarray) -> np.ndarray:
    """Joint-space inertia as the sum over links of J^T I J, velocities of spherical joints in the body frame."""
    pos, quat = pose(tree, qpos)
    R, dofs = quat_matrix(quat), [Joint(int(j)).dofs for j in tree.joint]
    start = np.cumsum(dofs) - dofs
    M = np.zeros((sum(dofs), sum(dofs)))
    for b in range(tree.num_links):
        linear, angular = np.zeros((3, len(M))), np.zeros((3, len(M)))
        com, i = pos[b] + R[b] @ tree.com[b], b
        while i >= 0:
            k, axes = slice(start[i], start[i] + dofs[i]), R[i] @ (np.eye(3) if dofs[i] == 3 else tree.axis[i][:, None])
            if tree.joint[i] == Joint.PRISMATIC:
                linear[:, k] = axes
            elif dofs[i]:
                angular[:, k] = axes
                linear[:, k] = np.cross(axes.T, com - pos[i] - R[i] @ tree.anchor[i]).T
            i = tree.parent[i]
        M += tree.mass[b] * linear.T @ linear + angular.T @ R[b] @ tree.inertia[b] @ R[b].T @ angular
    return M + np.diag(np.repeat(tree.armature, dofs))


@settings(max_examples=15, deadline=None)
@given(seed=SEED, num_links=st.integers(1, 40))
def test_mjcf_carries_every_number(seed, num_links):
    """Give MuJoCo the tree's own numbers: equal bit for bit where MuJoCo does not convert them."""
    tree = random_tree(np.random.default_rng(seed), num_links, joints=ALL, armature=0.1, bent_rest=True)
    m = mujoco.MjModel.from_xml_string(to_mjcf(tree, gravity=3.7, timestep=1e-3))
    moving = tree.joint != Joint.FIXED
    scalar = np.isin(tree.joint, [Joint.REVOLUTE, Joint.PRISMATIC])
    dofs = [Joint(int(j)).dofs for j in tree.joint]
    assert [m.body(b + 1).name for b in range(m.nbody - 1)] == tree.link_name
    np.testing.assert_array_equal(m.body_parentid[1:] - 1, tree.parent)
    np.testing.assert_array_equal(m.body_mass[1:], tree.mass)
    np.testing.assert_array_equal(m.body_pos[1:], tree.position)
    np.testing.assert_array_equal(m.body_ipos[1:], tree.com)
    np.testing.assert_allclose(m.body_quat[1:], tree.rotation, atol=1e-15)  # MuJoCo normalises it again
    turn = quat_matrix(m.body_iquat[1:])
    inertia = np.einsum("nij,nj,nkj->nik", turn, m.body_inertia[1:], turn)  # diagonalised by MuJoCo
    np.testing.assert_allclose(inertia, tree.inertia, rtol=0, atol=1e-12 * tree.inertia.max())
    np.testing.assert_array_equal(m.jnt_pos, tree.anchor[moving])
    np.testing.assert_array_equal(m.jnt_stiffness, tree.stiffness[moving])
    np.testing.assert_allclose(m.jnt_axis[scalar[moving]], tree.axis[scalar], atol=1e-15)
    np.testing.assert_array_equal(m.dof_damping, np.repeat(tree.damping, dofs))
    np.testing.assert_array_equal(m.dof_armature, np.repeat(tree.armature, dofs))
    np.testing.assert_array_equal(m.qpos_spring[coordinate_start(tree)[scalar]], tree.rest[scalar, 0])
    np.testing.assert_array_equal(m.opt.gravity, [0, 0, -3.7])
    assert m.opt.timestep == 1e-3
    assert m.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST


@settings(max_examples=10, deadline=None)
@given(seed=SEED, num_links=st.integers(1, 25))
def test_mjcf_has_the_trees_mass_matrix(seed, num_links):
    """Compare MuJoCo's joint-space inertia at random coordinates with the sum of J^T I J over the links."""
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, num_links, joints=ALL[1:], armature=0.1)
    m = mujoco.MjModel.from_xml_string(to_mjcf(tree))
    d, qpos, M = mujoco.MjData(m), random_qpos(rng, tree), np.zeros((m.nv, m.nv))
    d.qpos[:] = qpos
    mujoco.mj_forward(m, d)
    mujoco.mj_fullM(m, d, M)
    np.testing.assert_allclose(M, mass_matrix(tree, qpos), rtol=0, atol=1e-11 * np.abs(M).max())


def test_mjcf_takes_links_in_any_order():
    """Keep names and parents of a tree that is not numbered depth-first and of a second root."""
    tree = random_tree(np.random.default_rng(5), 5).with_(parent=np.array([-1, 0, 0, 1, -1]))
    m = mujoco.MjModel.from_xml_string(to_mjcf(tree))
    assert [m.body(b + 1).name for b in range(5)] == ["link0", "link1", "link3", "link2", "link4"]
    for name, parent in zip(tree.link_name, tree.parent, strict=True):
        above = "world" if parent < 0 else tree.link_name[parent]
        assert m.body(m.body(name).parentid[0]).name == above


def test_mjcf_keeps_the_preload_and_capsules():
    """Find pre-loads in a custom field, and geoms of the mean radius that neither weigh nor collide."""
    tree = random_tree(np.random.default_rng(1), 4, preloaded=True)
    m = mujoco.MjModel.from_xml_string(to_mjcf(tree))
    np.testing.assert_array_equal(m.numeric("bough_preload").data, tree.preload.ravel())
    np.testing.assert_array_equal(m.geom_size[:, 0], tree.shape_radius.mean(axis=1))
    length = np.linalg.norm(tree.shape_end - tree.shape_start, axis=1)
    np.testing.assert_allclose(2 * m.geom_size[:, 1], length, rtol=1e-14)
    assert not m.geom_contype.any() and not m.geom_conaffinity.any()
    assert "bough_preload" not in to_mjcf(tree.with_(preload=np.zeros((4, 3))))


def _changed(tree: Tree, name: str, link: int, value: object) -> Tree:
    array = getattr(tree, name).copy()
    array[link] = value
    return tree.with_(**{name: array})


@pytest.mark.parametrize(
    ("field", "value", "found"),
    [
        ("rest", [0.8, 0.6, 0.0, 0.0], "relaxed"),
        ("mass", 0.0, "mass 0 kg"),
        ("inertia", np.zeros((3, 3)), "principal"),
        ("inertia", np.diag([1.0, 1.0, 3.0]), "principal"),
    ],
)
def test_mjcf_names_the_link_it_cannot_express(field, value, found):
    """Refuse, naming the link, what MJCF or MuJoCo has no way to represent."""
    tree = _changed(random_tree(np.random.default_rng(2), 4, joints=(Joint.SPHERICAL,)), field, 2, value)
    with pytest.raises(InputError, match=f"link link2: found .*{found}"):
        to_mjcf(tree)


def test_mjcf_takes_massless_links_where_mujoco_does():
    """Let a moving link without mass pass where a link fixed to it has some, as MuJoCo itself does."""
    chain = random_tree(np.random.default_rng(2), 3, max_children=1)
    tree = _changed(chain, "joint", 2, Joint.FIXED)
    for name, value in (("mass", 0.0), ("inertia", np.zeros((3, 3)))):
        tree = _changed(tree, name, 1, value)
    m = mujoco.MjModel.from_xml_string(to_mjcf(tree))
    np.testing.assert_array_equal(m.body_mass[1:], tree.mass)


def test_mjcf_refuses_a_link_named_world():
    """Refuse the one body name that MuJoCo keeps for itself."""
    tree = random_tree(np.random.default_rng(2), 2).with_(link_name=["world", "b"])
    for export in (to_mjcf, to_urdf):
        with pytest.raises(InputError, match="link world"):
            export(tree)


def _urdf_coordinates(tree: Tree, qpos: np.ndarray) -> dict[str, float]:
    """Each URDF joint's coordinate: spherical joints by their intrinsic x-y-z angles."""
    out: dict[str, float] = {}
    for name, joint, k in zip(tree.link_name, tree.joint, coordinate_start(tree), strict=True):
        if joint == Joint.SPHERICAL:
            angles = Rotation.from_quat(np.roll(qpos[k : k + 4], -1)).as_euler("XYZ")
            out |= {f"{name}_{letter}": a for letter, a in zip("xyz", angles, strict=True)}
        elif joint != Joint.FIXED:
            out[f"{name}_joint"] = qpos[k]
    return out


@settings(max_examples=12, deadline=None)
@given(seed=SEED, num_links=st.integers(1, 20))
def test_urdf_moves_as_the_tree_in_mujoco(seed, num_links):
    """Compare link frames in MuJoCo's own URDF reader with the tree's, at random joint coordinates.

    A link's URDF frame sits at its joint: the body frame moved by the anchor. 1e-6: MuJoCo's URDF reader turns rpy
    into quaternions in double precision, over chains of up to 20 links.
    """
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, num_links, joints=ALL)
    spec = mujoco.MjSpec.from_string(to_urdf(tree))
    spec.compiler.fusestatic = False
    m = spec.compile()
    d, qpos = mujoco.MjData(m), random_qpos(rng, tree, angle=0.5)
    for name, value in _urdf_coordinates(tree, qpos).items():
        d.qpos[m.joint(name).qposadr[0]] = value
    mujoco.mj_kinematics(m, d)
    pos, quat = pose(tree, qpos)
    turns = np.isin(tree.joint, [Joint.REVOLUTE, Joint.SPHERICAL])
    R = quat_matrix(quat)
    origin = pos + np.einsum("nij,nj->ni", R, tree.anchor * turns[:, None])
    ids = [m.body(name).id for name in tree.link_name]
    np.testing.assert_allclose(d.xpos[ids], origin, atol=1e-10)
    np.testing.assert_allclose(d.xmat[ids].reshape(-1, 3, 3), R, atol=1e-10)
    com = pos + np.einsum("nij,nj->ni", R, tree.com)
    np.testing.assert_allclose(d.xpos[ids] + np.einsum("nij,nj->ni", R, m.body_ipos[ids]), com, atol=1e-10)
    np.testing.assert_allclose(m.body_mass[ids], tree.mass, rtol=1e-12)


@settings(max_examples=5, deadline=None)
@given(seed=SEED, num_links=st.integers(1, 12))
def test_urdf_reads_in_newton(seed, num_links):
    """Count Newton's joints and add up its masses: float32, and 2e-9 of the mass in light links."""
    tree = random_tree(np.random.default_rng(seed), num_links, joints=ALL)
    builder = newton.ModelBuilder()
    builder.add_urdf(to_urdf(tree))
    spherical = int(np.sum(tree.joint == Joint.SPHERICAL))
    assert sum(k.endswith("_joint") or k[-2:] in ("_x", "_y", "_z") for k in _short(builder.joint_label)) == (
        num_links + 2 * spherical
    )
    np.testing.assert_allclose(sum(builder.body_mass), tree.mass.sum(), rtol=1e-6)


def _short(labels: list[str]) -> list[str]:
    return [label.rsplit("/", 1)[-1] for label in labels]


def test_urdf_keeps_springs_in_its_own_element():
    """Read stiffness, armature, rest and preload back, exactly, from the element other readers skip."""
    tree = random_tree(np.random.default_rng(4), 6, joints=ALL[1:], armature=0.1, bent_rest=True, preloaded=True)
    joints = {j.get("name"): j for j in ET.fromstring(to_urdf(tree)).iter("joint")}
    for i, name in enumerate(tree.link_name):
        ball = tree.joint[i] == Joint.SPHERICAL
        found = joints[f"{name}_x" if ball else f"{name}_joint"].find("bough")
        assert float(found.get("stiffness")) == tree.stiffness[i]
        assert float(found.get("armature")) == tree.armature[i]
        n, m = (4, 3) if ball else (1, 1)
        np.testing.assert_array_equal(np.array(found.get("rest").split(), float), tree.rest[i, :n])
        np.testing.assert_array_equal(np.array(found.get("preload").split(), float), tree.preload[i, :m])


def test_urdf_names_are_unique():
    """Refuse a link named as one of the links inside a spherical joint."""
    tree = random_tree(np.random.default_rng(4), 2, joints=(Joint.SPHERICAL,)).with_(link_name=["a", "a_x"])
    with pytest.raises(InputError, match="link a_x"):
        to_urdf(tree)


@given(seed=SEED, pitch=st.sampled_from([-np.pi / 2, 0.0, np.pi / 2, np.pi / 2 - 1e-9, 1.0]))
def test_roll_pitch_yaw_at_the_pole(seed, pitch):
    """Give back the rotation at 90 degrees of pitch too, where the three angles are not unique."""
    roll, yaw = np.random.default_rng(seed).uniform(-3, 3, 2)
    matrix = Rotation.from_euler("xyz", [roll, pitch, yaw]).as_matrix()
    again = Rotation.from_euler("xyz", roll_pitch_yaw(matrix)).as_matrix()
    np.testing.assert_allclose(again, matrix, atol=1e-14)


def test_mesh_volume_of_a_tapered_capsule():
    """Enclose the volume of cone frustum and half-balls, within 1 % at 96 sides, wound outwards."""
    tree = random_tree(np.random.default_rng(0), 1)
    r0, r1 = tree.shape_radius[0]
    length = np.linalg.norm(tree.shape_end[0] - tree.shape_start[0])
    vertices, faces, colors = mesh(tree, sides=96, cap_rings=24)
    solid = trimesh.Trimesh(vertices, faces, process=False)
    frustum = np.pi * length * (r0 * r0 + r0 * r1 + r1 * r1) / 3
    np.testing.assert_allclose(solid.volume, frustum + 2 / 3 * np.pi * (r0**3 + r1**3), rtol=0.01)
    assert solid.is_watertight
    assert colors.shape == vertices.shape


def test_mesh_follows_the_pose():
    """Move the vertices of each link rigidly with its body frame."""
    rng = np.random.default_rng(6)
    tree = random_tree(rng, 5)
    poses = pose(tree, random_qpos(rng, tree))
    (rest, _, _), (moved, _, _) = mesh(tree), mesh(tree, poses)
    count = len(rest) // 5
    pos, quat = rest_pose(tree)
    for i in range(5):
        part = slice(i * count, (i + 1) * count)
        local = (rest[part] - pos[i]) @ quat_matrix(quat)[i]
        again = (moved[part] - poses[0][i]) @ quat_matrix(poses[1])[i]
        centre_rest, centre_moved = local.mean(axis=0), again.mean(axis=0)
        np.testing.assert_allclose(centre_moved, centre_rest, atol=1e-12)


def test_glb_reads_back(tmp_path):
    """Find in the file every tree, standing up along y, in metres, with its vertex colours."""
    rng = np.random.default_rng(7)
    trees = [random_tree(rng, 6), random_tree(rng, 6)]
    to_glb(trees, tmp_path / "two.glb")
    scene = trimesh.load_scene(tmp_path / "two.glb")
    assert set(scene.geometry) == {"random-6", "random-6-1"}
    vertices = np.concatenate([mesh(t)[0] for t in trees])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    expected = [[low[0], low[2], -high[1]], [high[0], high[2], -low[1]]]
    np.testing.assert_allclose(scene.bounds, expected, atol=1e-5)
    colors = scene.geometry["random-6"].visual.vertex_colors
    assert len(np.unique(colors, axis=0)) == len(np.unique(np.minimum(trees[0].level, 4)))


def test_glb_without_shapes_is_refused(tmp_path):
    """Write no file when there is nothing to draw."""
    tree = random_tree(np.random.default_rng(0), 2)
    empty = tree.with_(shape_link=[], shape_start=np.zeros((0, 3)), shape_end=np.zeros((0, 3)), shape_radius=None)
    with pytest.raises(InputError, match="at least one capsule"):
        to_glb([empty], tmp_path / "none.glb")
    assert not list(tmp_path.iterdir())


def test_usd_reads_back_or_names_the_extra(tmp_path):
    """Find every vertex in the stage, or, without OpenUSD, an error that names what to install."""
    tree = random_tree(np.random.default_rng(8), 3)
    try:
        from pxr import Usd, UsdGeom
    except ImportError:
        with pytest.raises(InputError, match=r"\[usd\]"):
            to_usd([tree], tmp_path / "tree.usda")
        return
    to_usd([tree], tmp_path / "tree.usda")
    stage = Usd.Stage.Open(str(tmp_path / "tree.usda"))
    prim = UsdGeom.Mesh(stage.GetPrimAtPath("/forest/tree_0"))
    np.testing.assert_allclose(np.array(prim.GetPointsAttr().Get()), mesh(tree)[0], atol=1e-6)
