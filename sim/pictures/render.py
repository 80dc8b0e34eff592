"""Pictures of trees and forests, ray-traced with Warp on the CPU or a GPU."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import PIL.Image
import warp as wp
from numpy.typing import NDArray

from ...kernels.points import raytrace
from ..base.errors import InputError
from ..base.rotation import axis_angle_quat, quat_multiply, quat_rotate
from ..base.types import Array, IntArray
from ..formats.export_mesh import Pose, linear_light, mesh
from ..trees.pose import rest_pose
from ..trees.tree import Tree
from .foliage import foliage, grass, leafy

Image = NDArray[np.uint8]

MOST_TREES = 400
"""Trees that a picture of a forest shows at most: more would be pixels, and memory."""

_TWIGS = 16_000  # twigs that a picture's trees share


@dataclass(frozen=True)
class Mesh:
    """Triangles to draw, world axes, z up.

    Attributes:
        vertices: Corners [V, 3] in metres.
        faces: Corner indices [F, 3].
        colors: sRGB colours of the corners [V, 3] in 0..1.
        through: Share of light that passes through the surface at each corner, 0 for wood, shape [V].
        ground: Height of the ground [m].
        size: Scale of surface detail: height of a tree [m].
    """

    vertices: Array
    faces: IntArray
    colors: Array
    through: Array
    ground: float
    size: float


@dataclass(frozen=True)
class View:
    """Camera at ``position`` looking at ``target`` [m], z upwards; ``fov`` is the picture's whole width [degrees]."""

    position: tuple[float, float, float]
    target: tuple[float, float, float]
    fov: float = 50.0


@dataclass(frozen=True)
class Sunlight:
    """Sun and sky: directions in degrees, linear-light colours, ``haze`` per metre.

    ``azimuth`` is counted from x towards y; ``softness`` is the half-angle of the sun's disc. ``sun`` is irradiance,
    the others are radiance: at the zenith, at the horizon, added around the sun, and of what shades a point in a crown.
    """

    azimuth: float = 205.0
    elevation: float = 32.0
    softness: float = 0.7
    sun: tuple[float, float, float] = (4.8, 3.7, 2.3)
    zenith: tuple[float, float, float] = (0.07, 0.19, 0.52)
    horizon: tuple[float, float, float] = (0.46, 0.56, 0.66)
    glow: tuple[float, float, float] = (0.048, 0.030, 0.014)
    inside: tuple[float, float, float] = (0.07, 0.10, 0.04)
    haze: float = 0.0


def trace(
    scene: Mesh, view: View, light: Sunlight, width: int, height: int, *,
    samples: int = 9, detail: float = 1.0, ground_color: tuple[float, float, float] = (0.09, 0.15, 0.035),
    seed: int = 0, threads: int = 2, device: str | None = None,
) -> Array:  # fmt: skip
    """Trace a picture's radiance, shape [height, width, 3], linear light, first row on top.

    Args:
        scene: What to draw.
        view: Camera.
        light: Sun and sky.
        width: Picture width [pixels].
        height: Picture height [pixels].
        samples: Rays through every pixel.
        detail: 1 for bark, grass, hills and clouds, 0 for plain colours.
        ground_color: Albedo of the ground in linear light.
        seed: Seed of all random rays; the same seed gives the same picture however many threads there are.
        threads: Host threads that share the rows (a Warp launch on the CPU releases Python's lock).
        device: Warp device; the default one if None.
    """
    where = wp.get_device(device)
    bvh = _bvh(scene, where)
    surfaces = _surfaces(scene, bvh, detail, ground_color, where)
    lamp, camera = _light(light), _camera(view, width / height)
    bands = np.array_split(np.arange(height), 8 * threads if where.is_cpu else 1)
    bands = [band for band in bands if len(band)]
    wp.load_module(raytrace, device=where)

    def band_radiance(rows: IntArray) -> Array:
        out = wp.empty((len(rows), width), dtype=wp.vec3, device=where)
        inputs = [surfaces, lamp, camera, height, int(rows[0]), samples, seed]
        wp.launch(raytrace.trace, dim=out.shape, inputs=inputs, outputs=[out], device=where)
        return out.numpy()

    with ThreadPoolExecutor(threads) as pool:
        return np.concatenate(list(pool.map(band_radiance, bands)))


def _bvh(scene: Mesh, device: wp.Device) -> wp.Mesh:
    points: wp.array = wp.array(scene.vertices.astype(np.float32), dtype=wp.vec3, device=device)
    indices: wp.array = wp.array(scene.faces.astype(np.int32).ravel(), dtype=wp.int32, device=device)
    # The fastest pair on the CPU for leaves and grass: 1.7 times the rays a second of Warp's own choice there.
    return wp.Mesh(points, indices, bvh_constructor="cubql" if device.is_cpu else None, bvh_leaf_size=4)


def _surfaces(
    scene: Mesh, bvh: wp.Mesh, detail: float, ground_color: Sequence[float], device: wp.Device
) -> raytrace.Surfaces:
    normal = vertex_normals(scene.vertices, scene.faces).astype(np.float32)
    color = np.column_stack([linear_light(scene.colors), scene.through]).astype(np.float32)
    out = raytrace.Surfaces()
    out.mesh = bvh.id
    out.normal = wp.array(normal, dtype=wp.vec3, device=device)
    out.color = wp.array(color, dtype=wp.vec4, device=device)
    out.ground, out.size, out.detail = scene.ground, scene.size, detail
    out.ground_color = wp.vec3(*ground_color)
    return out


def vertex_normals(vertices: Array, faces: IntArray) -> Array:
    """Average the normals of adjacent faces [F, 3] at vertices [V, 3], weighted by area: unit vectors [V, 3]."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area = np.cross(b - a, c - a)
    total = [np.bincount(faces.ravel(), np.repeat(area[:, k], 3), minlength=len(vertices)) for k in range(3)]
    normal = np.stack(total, axis=1)
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)


def _light(light: Sunlight) -> raytrace.Light:
    azimuth, elevation = np.radians([light.azimuth, light.elevation])
    out = raytrace.Light()
    flat = np.cos(elevation)
    out.to_sun = wp.vec3(flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation))
    out.sun, out.sun_radius = wp.vec3(*light.sun), float(np.tan(np.radians(light.softness)))
    out.zenith, out.horizon, out.inside = wp.vec3(*light.zenith), wp.vec3(*light.horizon), wp.vec3(*light.inside)
    out.glow, out.haze = wp.vec3(*light.glow), light.haze
    return out


def _camera(view: View, aspect: float) -> raytrace.Camera:
    forward = np.subtract(view.target, view.position)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    half = np.tan(np.radians(view.fov) / 2)
    out = raytrace.Camera()
    out.position, out.forward = wp.vec3(*view.position), wp.vec3(*forward)
    out.right, out.up = wp.vec3(*(half * right)), wp.vec3(*(half / aspect * np.cross(right, forward)))
    return out


def develop(radiance: Array, exposure: float = 1.3) -> Image:
    """Turn linear radiance [..., 3] into sRGB bytes by the filmic curve fitted by Narkowicz (2015) to ACES."""
    x = np.maximum(radiance * exposure, 0.0)
    mapped = np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0.0, 1.0)
    srgb = np.where(mapped <= 0.0031308, 12.92 * mapped, 1.055 * mapped ** (1 / 2.4) - 0.055)
    return np.round(255.0 * srgb).astype(np.uint8)


def forest_layout(count: int, spacing: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """Places [count, 2] in metres on a jittered, staggered grid about the origin, and yaw angles [count] in rad."""
    columns = int(np.ceil(np.sqrt(1.3 * count)))
    row, column = np.divmod(np.arange(count), columns)
    in_row = np.minimum(columns, count - row * columns)
    x = column - (in_row - 1) / 2 + np.where(row % 2 == 1, 0.25, -0.25) * (count > columns)
    grid = np.stack([x, row - row.max() / 2], axis=1)
    return spacing * (grid + rng.uniform(-0.22, 0.22, grid.shape)), rng.uniform(0.0, 2 * np.pi, count)


def _planted(tree: Tree, at: Pose | None, place: Array, yaw: float) -> Pose:
    """Body frames turned by ``yaw`` about the first link's origin, which is put over ``place`` [2]."""
    pos, quat = rest_pose(tree) if at is None else at
    turn = axis_angle_quat(np.array([0.0, 0.0, 1.0]), np.array(yaw))
    root, spot = np.array([*pos[0, :2], 0.0]), np.array([*place, 0.0])
    return quat_rotate(turn, pos - root) + spot, quat_multiply(turn, quat)


def forest_mesh(trees: Sequence[Tree], poses: Sequence[Pose | None], *, leaves: bool, rng: np.random.Generator) -> Mesh:
    """Join the capsules of all trees, and their leaves if wanted, into one mesh on the ground."""
    parts = []
    twigs = int(np.clip(_TWIGS // max(sum(np.count_nonzero(leafy(t)) for t in trees), 1), 1, 13))
    for tree, at in zip(trees, poses, strict=True):
        wood, faces, colors = mesh(tree, at)
        parts.append((wood, faces, colors, np.zeros(len(wood))))
        if leaves and len(wood):
            parts.append(foliage(tree, at, rng, twigs=twigs))
    vertices, faces, colors, through = _joined(parts)
    if not len(faces):
        raise InputError("picture", "", "no tree with a shape", "at least one capsule to draw")
    ground = min(0.0, float(vertices[:, 2].min()))
    size = float(np.percentile(vertices[:, 2], 99.0)) - ground
    return Mesh(vertices, faces, colors, through, ground, max(size, 1e-3))


def _joined(parts: Sequence[tuple[Array, IntArray, Array, Array]]) -> tuple[Array, IntArray, Array, Array]:
    """Join (vertices, faces, colours, through) of several meshes into one."""
    offset = np.cumsum([0, *(len(p[0]) for p in parts[:-1])])
    faces = np.concatenate([p[1] + o for p, o in zip(parts, offset, strict=True)])
    vertices, colors, through = (np.concatenate([p[k] for p in parts]) for k in (0, 2, 3))
    return vertices, faces, colors, through


def _with_grass(scene: Mesh, view: View, rng: np.random.Generator) -> Mesh:
    blades = grass(np.array(view.position), np.array(view.target), view.fov, scene.ground, scene.size, rng)
    vertices, faces, colors, through = _joined([(scene.vertices, scene.faces, scene.colors, scene.through), blades])
    return replace(scene, vertices=vertices, faces=faces, colors=colors, through=through)


def render_trees(
    trees: Sequence[Tree], poses: Sequence[Pose | None] | None = None, *, width: int = 1280, height: int = 720,
    samples: int = 9, leaves: bool = False, view: View | None = None, light: Sunlight | None = None, seed: int = 0,
    device: str | None = None,
) -> Image:  # fmt: skip
    """Draw trees where their frames put them, seen from the side at mid height unless ``view`` says otherwise.

    Args:
        trees: Trees with at least one capsule among them.
        poses: Body frame origins [L, 3] in metres and orientations [L, 4] (w, x, y, z) a tree; joint zero if None.
        width: Picture width [pixels].
        height: Picture height [pixels].
        samples: Rays through every pixel.
        leaves: Whether to dress outermost links with twigs and leaves.
        view: Camera.
        light: Sun and sky.
        seed: Seed of leaves and rays.
        device: Warp device; the default one if None.

    Returns:
        sRGB picture, shape [height, width, 3].

    Raises:
        InputError: There is nothing to draw.
    """
    rng = np.random.default_rng(seed)
    scene = forest_mesh(trees, [None] * len(trees) if poses is None else poses, leaves=leaves, rng=rng)
    view = view or _portrait(scene, width / height)
    radiance = trace(
        scene, view, light or Sunlight(haze=0.006 / scene.size), width, height,
        samples=samples, seed=seed, device=device,
    )  # fmt: skip
    return develop(radiance)


def _portrait(scene: Mesh, aspect: float) -> View:
    """Look at the whole mesh from a little above its middle, along +y."""
    low, high = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
    low[2] = min(low[2], scene.ground)
    middle, reach = (low + high) / 2, (high - low) / 2
    half = np.tan(np.radians(35.0) / 2)
    distance = 1.12 * max(reach[0] / half, reach[2] * aspect / half) + reach[1]
    position = middle + distance * np.array([0.35, -0.94, 0.06])
    position[2] = max(position[2], scene.ground + 0.1 * distance)
    return View(tuple(position), tuple(middle), fov=35.0)


def _spacing(trees: Sequence[Tree]) -> float:
    """Distance between neighbours [m]: their crowns just part."""
    spans = [np.ptp(mesh(t, sides=4, cap_rings=1)[0], axis=0) for t in trees if len(t.shape_link)]
    widths = [max(s[0], s[1], 0.3 * s[2]) for s in spans]
    return 1.25 * float(np.median(widths)) if widths else 1.0


def _overlook(scene: Mesh) -> View:
    """Look into the forest from before its edge, from a little above the crowns."""
    low, high = scene.vertices.min(axis=0), scene.vertices.max(axis=0)
    middle, size = (low + high) / 2, scene.size
    half = max(high[0] - low[0], size) / 2
    position = (middle[0] - 0.1 * half, low[1] - 0.35 * half - 1.35 * size, scene.ground + 0.7 * size)
    return View(position, (middle[0], middle[1], scene.ground + 0.53 * size), fov=54.0)


def render_forest(
    trees: Sequence[Tree], path: str | Path, *, width: int = 1600, height: int = 900, samples: int = 5,
    leaves: bool = True, seed: int = 0, device: str | None = None,
) -> Image:  # fmt: skip
    """Plant trees on a jittered grid, each turned at random, and write a picture of the forest as PNG.

    Args:
        trees: Trees with at least one capsule among them, in their rest pose; the first `MOST_TREES` are drawn.
        path: PNG file to write.
        width: Picture width [pixels].
        height: Picture height [pixels].
        samples: Rays through every pixel.
        leaves: Whether to dress outermost links with twigs and leaves.
        seed: Seed of places, leaves and rays.
        device: Warp device; the default one if None.

    Returns:
        The sRGB picture, shape [height, width, 3].

    Raises:
        InputError: There is nothing to draw.
    """
    rng, trees = np.random.default_rng(seed), trees[:MOST_TREES]
    places, yaws = forest_layout(len(trees), _spacing(trees), rng)
    poses = [_planted(t, None, place, yaw) for t, place, yaw in zip(trees, places, yaws, strict=True)]
    scene = forest_mesh(trees, poses, leaves=leaves, rng=rng)
    light = Sunlight(haze=0.010 / scene.size)
    view = _overlook(scene)
    scene = _with_grass(scene, view, rng) if leaves else scene
    image = develop(trace(scene, view, light, width, height, samples=samples, seed=seed, device=device))
    PIL.Image.fromarray(image).save(path, format="PNG")
    return image
