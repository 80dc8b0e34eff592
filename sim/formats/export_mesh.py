"""Trees as triangle meshes of tapered capsules: for the renderer, and for viewers as GLB or USD."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import trimesh

from ..base.errors import InputError
from ..base.extras import install_hint
from ..base.rotation import quat_rotate
from ..base.types import Array, IntArray
from ..trees.pose import rest_pose
from ..trees.tree import Tree

Pose = tuple[Array, Array]

_BARK = np.array([[0.36, 0.29, 0.22], [0.40, 0.32, 0.22], [0.42, 0.35, 0.22], [0.38, 0.37, 0.18], [0.34, 0.40, 0.16]])


def level_color(level: int | IntArray) -> Array:
    """Colour of wood by branching order: bark brown for the trunk to green twigs, sRGB in 0..1, shape [..., 3]."""
    return _BARK[np.minimum(level, len(_BARK) - 1)]


def mesh(
    tree: Tree, poses: Pose | None = None, *, sides: int = 12, cap_rings: int = 3
) -> tuple[Array, IntArray, Array]:
    """Triangulate a tree's capsules, each a closed surface of revolution whose radius goes from start to end.

    Args:
        tree: The tree, S capsules.
        poses: Body frame origins [L, 3] in metres and orientations [L, 4] (w, x, y, z); joint zero if None.
        sides: Corners of a capsule's cross-section.
        cap_rings: Rings of corners on each rounded end, the widest one included.

    Returns:
        Vertices [V, 3] in metres, world frame, z up; faces [F, 3], counter-clockwise from outside; sRGB colours
        [V, 3] in 0..1 by branching order.
    """
    start, end = shape_ends(tree, poses)
    vertices, faces = capsules_mesh(start, end, tree.shape_radius, sides=sides, cap_rings=cap_rings)
    colors = level_color(tree.level[tree.shape_link])
    return vertices, faces, np.repeat(colors, len(vertices) // max(len(start), 1), axis=0).reshape(-1, 3)


def shape_ends(tree: Tree, poses: Pose | None = None) -> tuple[Array, Array]:
    """Start and end of every capsule's axis in the world [m], shapes [S, 3]; poses as in `mesh`."""
    pos, quat = rest_pose(tree) if poses is None else poses
    link = tree.shape_link
    start = pos[link] + quat_rotate(quat[link], tree.shape_start)
    return start, pos[link] + quat_rotate(quat[link], tree.shape_end)


def capsules_mesh(start: Array, end: Array, radius: Array, *, sides: int, cap_rings: int) -> tuple[Array, IntArray]:
    """Triangulate capsules from ``start`` to ``end`` [S, 3] with ``radius`` [S, 2] at both: vertices, faces."""
    profile, faces = _unit_capsule(sides, cap_rings)
    frame = _frames(end - start)
    thick = np.where(profile[:, 3] > 0, radius[:, 1:], radius[:, :1])
    centre = start[:, None] + profile[None, :, 3:] * (end - start)[:, None]
    vertices = centre + thick[..., None] * np.einsum("vk,ski->svi", profile[:, :3], frame)
    faces = (faces[None] + len(profile) * np.arange(len(start))[:, None, None]).reshape(-1, 3)
    return vertices.reshape(-1, 3), faces


def _frames(direction: Array) -> Array:
    """Right-handed orthonormal frames [S, 3, 3] whose third row points along ``direction`` [S, 3] (z if zero)."""
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    z = np.where(length > 0, direction / np.maximum(length, 1e-300), [0.0, 0.0, 1.0])
    other = np.where(np.abs(z[:, 2:]) < 0.9, [0.0, 0.0, 1.0], [1.0, 0.0, 0.0])
    x = np.cross(other, z)
    x /= np.linalg.norm(x, axis=1, keepdims=True)
    return np.stack([x, np.cross(z, x), z], axis=1)


def _unit_capsule(sides: int, cap_rings: int) -> tuple[Array, IntArray]:
    """Corners [V, 4] of a capsule along z (unit offset from its end point; 0 at start, 1 at end) and faces [F, 3]."""
    latitude = np.linspace(0.0, np.pi / 2, cap_rings, endpoint=False)
    latitude = np.concatenate([-latitude[::-1], latitude])
    end = np.repeat([0.0, 1.0], cap_rings)
    turn = np.arange(sides) * 2 * np.pi / sides
    ring = np.stack(np.broadcast_arrays(
        np.cos(latitude)[:, None] * np.cos(turn), np.cos(latitude)[:, None] * np.sin(turn),
        np.sin(latitude)[:, None], end[:, None]), axis=-1).reshape(-1, 4)  # fmt: skip
    profile = np.concatenate([ring, [[0.0, 0.0, -1.0, 0.0], [0.0, 0.0, 1.0, 1.0]]])
    k = np.arange(sides)
    after = (k + 1) % sides
    faces = [np.stack([np.full(sides, len(ring)), after, k], axis=1)]
    for r in range(2 * cap_rings - 1):
        low, high = r * sides, (r + 1) * sides
        faces += [
            np.stack([low + k, low + after, high + after], axis=1),
            np.stack([low + k, high + after, high + k], 1),
        ]
    last = (2 * cap_rings - 1) * sides
    faces.append(np.stack([np.full(sides, len(ring) + 1), last + k, last + after], axis=1))
    return profile, np.concatenate(faces)


def to_glb(trees: Sequence[Tree], path: str | Path, *, poses: Sequence[Pose] | None = None, sides: int = 12) -> None:
    """Write trees as one binary glTF file: a node a tree, metres, y up as glTF wants, colours at the vertices.

    Args:
        trees: The trees, drawn where their frames put them; a name that occurs twice gets a number.
        path: File to write.
        poses: Body frames of every tree as `mesh` takes them; joint zero if None.
        sides: Corners of a capsule's cross-section.

    Raises:
        InputError: No tree has a shape to draw.
    """
    scene = trimesh.Scene()
    for k, (tree, at) in enumerate(_with_poses(trees, poses)):
        vertices, faces, colors = mesh(tree, at, sides=sides)
        if len(faces):
            y_up = vertices[:, [0, 2, 1]] * [1.0, 1.0, -1.0]
            rgba = np.round(255 * np.column_stack([linear_light(colors), np.ones(len(colors))])).astype(np.uint8)
            name = tree.name if tree.name not in scene.geometry else f"{tree.name}-{k}"
            part = trimesh.Trimesh(y_up, faces, vertex_colors=rgba, process=False)
            scene.add_geometry(part, node_name=name, geom_name=name)
    if not scene.geometry:
        raise InputError(path, "", "no tree with a shape", "at least one capsule to draw")
    Path(path).write_bytes(scene.export(file_type="glb"))


def to_usd(trees: Sequence[Tree], path: str | Path, *, poses: Sequence[Pose] | None = None, sides: int = 12) -> None:
    """Write trees as one USD stage (.usda, .usdc): a mesh prim a tree, metres, z up, colours at the vertices.

    Args: as `to_glb`.

    Raises:
        InputError: The package usd-core is not installed.
    """
    try:
        from pxr import Gf, Usd, UsdGeom, Vt
    except ImportError:
        found, allowed = "no package usd-core (module pxr)", install_hint("usd")
        raise InputError(path, "", found, allowed) from None
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.z)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/forest").GetPrim())
    for k, (tree, at) in enumerate(_with_poses(trees, poses)):
        vertices, faces, colors = mesh(tree, at, sides=sides)
        prim = UsdGeom.Mesh.Define(stage, f"/forest/tree_{k}")
        prim.GetPrim().SetDisplayName(tree.name)
        prim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
        prim.CreatePointsAttr(Vt.Vec3fArray([Gf.Vec3f(*map(float, v)) for v in vertices]))
        prim.CreateFaceVertexCountsAttr(Vt.IntArray([3] * len(faces)))
        prim.CreateFaceVertexIndicesAttr(Vt.IntArray(faces.ravel().tolist()))
        paint = prim.CreateDisplayColorPrimvar(UsdGeom.Tokens.vertex)
        paint.Set(Vt.Vec3fArray([Gf.Vec3f(*map(float, c)) for c in linear_light(colors)]))
    stage.GetRootLayer().Save()


def _with_poses(trees: Sequence[Tree], poses: Sequence[Pose] | None) -> list[tuple[Tree, Pose | None]]:
    return list(zip(trees, [None] * len(trees) if poses is None else poses, strict=True))


def linear_light(srgb: Array) -> Array:
    """Turn sRGB values in 0..1 into linear light (IEC 61966-2-1): what glTF and USD store at vertices."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
