"""Solids, camera and light as host data, and their picture, traced with Warp on the CPU or a GPU."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ...kernels.points import raytrace
from ..base.host import num_threads
from ..base.types import Array, IntArray
from ..formats.export_mesh import linear_light

Image = NDArray[np.uint8]

_SKY_SAMPLES = 4096  # directions that the sky's irradiance is summed over


@dataclass(frozen=True)
class Solids:
    """Round cones and leaves to draw, world axes, z up.

    A round cone is the convex hull of two balls. A leaf is flat and pointed at both ends: `side` is its half-width, its
    radii are zero.

    Attributes:
        start: Centres of the first balls, or roots of leaves [C, 3] in metres.
        end: Centres of the second balls, or tips of leaves [C, 3] in metres.
        radius: Radii of both balls [C, 2] in metres.
        color: sRGB colours [C, 3] in 0..1.
        side: Half-widths of leaves [C, 3] in metres, zero for round cones.
        through: Share of light that passes through, 0 for wood, shape [C].
    """

    start: Array
    end: Array
    radius: Array
    color: Array
    side: Array
    through: Array

    @staticmethod
    def cones(start: Array, end: Array, radius: Array, color: Array) -> Solids:
        """Return round cones alone; ``color`` may be one for all."""
        colors = np.broadcast_to(color, start.shape)
        return Solids(start, end, radius, colors, np.zeros(start.shape), np.zeros(len(start)))

    @staticmethod
    def joined(parts: Sequence[Solids]) -> Solids:
        """Return the solids of all parts, in their order."""
        return Solids(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Solids)))

    def leaf(self) -> NDArray[np.bool_]:
        """Tell which are leaves [C]."""
        return np.linalg.norm(self.side, axis=1) > 0.0

    def cones_first(self) -> Solids:
        """Return the same solids, leaves last."""
        order = np.argsort(self.leaf(), kind="stable")
        return Solids(*(getattr(self, f.name)[order] for f in fields(Solids)))

    def boxes(self) -> tuple[Array, Array]:
        """Return the lowest and highest corners [C, 3] of what holds each solid [m]."""
        wide = np.abs(self.side)
        ends = np.stack([self.start, self.end]), self.radius.T[..., None]
        return (ends[0] - ends[1]).min(axis=0) - wide, (ends[0] + ends[1]).max(axis=0) + wide


@dataclass(frozen=True)
class View:
    """Camera at ``position`` looking at ``target`` [m], z upwards; ``fov`` is the picture's whole width [degrees]."""

    position: tuple[float, float, float]
    target: tuple[float, float, float]
    fov: float = 50.0

    def axes(self) -> tuple[Array, Array, Array]:
        """Return unit vectors forward, right and up."""
        forward = np.subtract(self.target, self.position)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        return forward, right, np.cross(right, forward)

    def pixels(self, points: Array, width: int, height: int) -> Array:
        """Return column and row [..., 2] at which points [..., 3] in front of the camera are seen."""
        forward, right, up = ((np.asarray(points) - self.position) @ axis for axis in self.axes())
        scale = 0.5 * width / np.tan(np.radians(self.fov) / 2) / forward
        return np.stack([0.5 * width + scale * right, 0.5 * height - scale * up], axis=-1)


@dataclass(frozen=True)
class Sunlight:
    """Sun and sky: directions in degrees, linear-light colours, ``haze`` per metre.

    ``azimuth`` is counted from x towards y; ``softness`` is the half-angle of the sun's disc. ``sun`` is irradiance,
    the others are radiance: at the zenith, at the horizon, added around the sun, and of wood that hides the sky.
    """

    azimuth: float = 205.0
    elevation: float = 32.0
    softness: float = 0.7
    sun: tuple[float, float, float] = (4.8, 4.0, 2.9)
    zenith: tuple[float, float, float] = (0.05, 0.17, 0.52)
    horizon: tuple[float, float, float] = (0.38, 0.53, 0.72)
    glow: tuple[float, float, float] = (0.048, 0.030, 0.014)
    inside: tuple[float, float, float] = (0.09, 0.08, 0.06)
    haze: float = 0.0

    def to_sun(self) -> Array:
        """Return the unit vector towards the sun's middle."""
        azimuth, elevation = np.radians([self.azimuth, self.elevation])
        flat = np.cos(elevation)
        return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


@dataclass(frozen=True)
class Ground:
    """The plane z = ``height`` [m] of linear albedo ``color``; squares of edge ``tile`` [m] vary it by ``contrast``."""

    height: float = 0.0
    color: tuple[float, float, float] = (0.17, 0.20, 0.085)
    tile: float = 1.0
    contrast: float = 0.0


def trace(
    solids: Solids, ground: Ground, view: View, light: Sunlight, width: int, height: int, *, samples: int = 8,
    threads: int | None = None, device: str | None = None,
) -> Array:  # fmt: skip
    """Trace a picture's radiance, shape [height, width, 3], linear light, first row on top.

    Args:
        solids: What stands on the ground.
        ground: The ground.
        view: Camera.
        light: Sun and sky.
        width: Picture width [pixels].
        height: Picture height [pixels].
        samples: Rays through a pixel that an outline crosses; the others take one.
        threads: Host threads that share the rows (a Warp launch on the CPU releases Python's lock); all if None.
        device: Warp device; the default one if None.
    """
    where = wp.get_device(device)
    wp.load_module(raytrace, device=where)
    camera = _camera(view, width, height)
    there, _trees = _solids(solids, ground, view, light, camera.pixel, where)
    shining = lamp(light, ground, where)
    workers = num_threads() if threads is None else threads
    bands = np.array_split(np.arange(height), 8 * workers if where.is_cpu else 1)

    def band_radiance(rows: IntArray) -> Array:
        """Trace a band of rows and return its radiance, [rows, width, 3]."""
        out = wp.empty((len(rows), width), dtype=wp.vec3, device=where)
        inputs = [there, shining, camera, height, int(rows[0]), samples]
        wp.launch(raytrace.trace, dim=out.shape, inputs=inputs, outputs=[out], device=where)
        return out.numpy()

    with ThreadPoolExecutor(workers) as pool:
        return np.concatenate(list(pool.map(band_radiance, [band for band in bands if len(band)])))


def _solids(
    solids: Solids, ground: Ground, view: View, light: Sunlight, pixel: float, device: wp.Device
) -> tuple[raytrace.Solids, list[wp.Bvh]]:
    """Return the kernel's solids, and the trees that it names by number: they live as long as somebody holds them."""

    def there(values: Array, kind: type) -> wp.array:
        """Return float32 values as an array of a Warp type on the device."""
        return wp.array(np.ascontiguousarray(values, np.float32), dtype=kind, device=device)

    solids, out = solids.cones_first(), raytrace.Solids()
    out.start = there(np.column_stack([solids.start, solids.radius[:, 0]]), wp.vec4)
    out.end = there(np.column_stack([solids.end, solids.radius[:, 1]]), wp.vec4)
    out.side = there(solids.side, wp.vec3)
    out.color = there(np.column_stack([linear_light(solids.color), solids.through]), wp.vec4)
    out.ground, out.ground_color, out.tile = ground.height, wp.vec3(*ground.color), ground.tile
    out.contrast = ground.contrast
    low, high = solids.boxes()
    trees = []
    for margin in _margins(solids, high[:, 2] - ground.height, view, light, pixel):
        part, room = slice(len(margin)), margin[:, None]
        lowest, highest = there(low[part] - room, wp.vec3), there(high[part] + room, wp.vec3)
        trees.append(wp.Bvh(lowest, highest, constructor="sah" if device.is_cpu else None))
    out.seen, out.lit, out.near = (tree.id for tree in trees)
    return out, trees


def _margins(solids: Solids, height: Array, view: View, light: Sunlight, pixel: float) -> list[Array]:
    """Room around solids for half a pixel, for half-shadows, and around cones for where they dim the sky [m].

    A shadow falls as far as the ground; there it is as soft as the sun's disc makes it, and no sharper than a pixel. A
    leaf's is no softer than the leaf is wide.
    """
    away = np.linalg.norm((solids.start + solids.end) / 2 - view.position, axis=1)
    away += np.linalg.norm(solids.end - solids.start, axis=1)
    fall = np.maximum(height, 0.0) / max(light.to_sun()[2], 0.05)
    half, soft = np.linalg.norm(solids.side, axis=1), np.tan(np.radians(light.softness)) * fall
    soft = np.maximum(np.where(solids.leaf(), np.minimum(soft, half), soft), pixel * (away + fall))
    return [0.5 * pixel * away, soft, raytrace.REACH * solids.radius[~solids.leaf()].max(axis=1)]


def lamp(light: Sunlight, ground: Ground, device: wp.Device) -> raytrace.Light:
    """Return sun and sky as the kernels take them, the sky's harmonics and what a ground sends back included."""
    out = raytrace.Light()
    out.to_sun = wp.vec3(*light.to_sun())
    out.sun, out.sun_radius = wp.vec3(*light.sun), float(np.tan(np.radians(light.softness)))
    out.zenith, out.horizon, out.inside = wp.vec3(*light.zenith), wp.vec3(*light.horizon), wp.vec3(*light.inside)
    out.glow, out.haze = wp.vec3(*light.glow), light.haze
    out.harmonics = wp.empty(9, dtype=wp.vec3, device=device)
    sky = 0.5 * np.add(light.zenith, light.horizon)
    below = np.multiply(ground.color, sky + np.multiply(light.sun, max(light.to_sun()[2], 0.0) / np.pi))
    inputs = [out, wp.vec3(*below), _SKY_SAMPLES]
    wp.launch(raytrace.gather, dim=9, inputs=inputs, outputs=[out.harmonics], device=device)
    return out


def _camera(view: View, width: int, height: int) -> raytrace.Camera:
    forward, right, up = view.axes()
    half = np.tan(np.radians(view.fov) / 2)
    out = raytrace.Camera()
    out.position, out.forward = wp.vec3(*view.position), wp.vec3(*forward)
    out.right, out.up = wp.vec3(*(half * right)), wp.vec3(*(half * height / width * up))
    out.pixel = float(2.0 * half / width)
    return out


def develop(radiance: Array, exposure: float = 1.3) -> Image:
    """Turn linear radiance [..., 3] into sRGB bytes by the filmic curve fitted by Narkowicz (2015) to ACES."""
    x = np.maximum(radiance * exposure, 0.0)
    mapped = np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0.0, 1.0)
    srgb = np.where(mapped <= 0.0031308, 12.92 * mapped, 1.055 * mapped ** (1 / 2.4) - 0.055)
    return np.round(255.0 * srgb).astype(np.uint8)
