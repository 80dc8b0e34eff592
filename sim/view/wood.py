"""Capsules on the page: tapered rods with a ball at their far end, thousands of them in a few batches."""

from __future__ import annotations

from typing import Any

import numpy as np

from ..base.types import Array, IntArray

#: Tapers that rods are drawn with; a rod has the nearest, its lower end is exact and the ball hides what is left.
_TAPERS = np.array([1.0, 0.85, 0.7, 0.5, 0.25])
#: Sides of a rod, and of one where there are many.
_SIDES, _FEW_SIDES = 8, 5
#: Capsules above which triangles are few and their light is simple: without a graphics card that is what a frame costs.
MANY = 1500


class Wood:
    """Capsules that are moved all at once.

    A rod is an instance of one of five meshes (by taper), scaled along and across; a ball sits at its end.

    Attributes:
        rods: Handles of the batches of rods.
        members: Which capsules each batch holds, arrays of indices.
        balls: Handle of the balls, one a capsule, in order.
    """

    def __init__(
        self, scene: Any, name: str, ends: tuple[Array, Array], radius: Array, color: Array, *,
        opacity: float | None = None,
    ) -> None:  # fmt: skip
        """Put capsules on the page.

        Args:
            scene: Where to.
            name: Their place in the page's tree of names, such as ``/wood``.
            ends: Start and end of the axes [m], shapes [C, 3].
            radius: At start and end [m], shape [C, 2].
            color: sRGB in 0..1, shape [C, 3].
            opacity: 0..1; opaque if None.
        """
        start, end = ends
        self._scene, self._name = scene, name
        many = len(start) > MANY
        sides = _FEW_SIDES if many else _SIDES
        wide = np.maximum(radius.max(axis=1), 1e-6)
        self._flip = radius[:, 1] > radius[:, 0]
        nearest = np.abs((radius.min(axis=1) / wide)[:, None] - _TAPERS).argmin(axis=1)
        self.members: list[IntArray] = [np.flatnonzero(nearest == k) for k in np.unique(nearest)]
        look: dict[str, Any] = {"lod": "off", "opacity": opacity, "cast_shadow": opacity is None,
                                "material": "toon3" if many else "standard"}  # fmt: skip
        position, turn, length = _along(*self._ordered(start, end))
        self.rods = []
        for k, chosen in zip(np.unique(nearest), self.members, strict=True):
            scale = np.column_stack([wide[chosen], wide[chosen], length[chosen]])
            self.rods.append(scene.add_batched_meshes_simple(
                f"{name}/rods{k}", *_rod(_TAPERS[k], sides), turn[chosen], position[chosen], batched_scales=scale,
                batched_colors=_bytes(color[chosen]), **look,
            ))  # fmt: skip
        self.balls = scene.add_batched_meshes_simple(
            f"{name}/balls", *_ball(many), np.tile([1.0, 0.0, 0.0, 0.0], (len(end), 1)), end,
            batched_scales=np.maximum(radius[:, 1], 1e-6), batched_colors=_bytes(color), **look,
        )  # fmt: skip

    def move(self, start: Array, end: Array) -> None:
        """Put the axes' ends [m], shapes [C, 3], somewhere else; lengths stay."""
        position, turn, _ = _along(*self._ordered(start, end))
        for handle, chosen in zip(self.rods, self.members, strict=True):
            handle.batched_positions, handle.batched_wxyzs = position[chosen], turn[chosen]
        self.balls.batched_positions = end

    def paint(self, color: Array) -> None:
        """Change the colours, sRGB in 0..1, shape [C, 3]."""
        for handle, chosen in zip(self.rods, self.members, strict=True):
            handle.batched_colors = _bytes(color[chosen])
        self.balls.batched_colors = _bytes(color)

    def show(self, visible: bool) -> None:
        """Show or hide all."""
        for handle in (*self.rods, self.balls):
            handle.visible = visible

    def _ordered(self, start: Array, end: Array) -> tuple[Array, Array]:
        """Return the axes from the thicker to the thinner end."""
        flip = self._flip[:, None]
        return np.where(flip, end, start), np.where(flip, start, end)


def _bytes(color: Array) -> Any:
    return np.round(255.0 * np.clip(color, 0.0, 1.0)).astype(np.uint8)


def _along(start: Array, end: Array) -> tuple[Array, Array, Array]:
    """Return starts [C, 3], the turn w x y z from z to the axis [C, 4] and lengths [C] of axes."""
    axis = end - start
    length = np.linalg.norm(axis, axis=1)
    direction = np.where(length[:, None] > 0.0, axis / np.maximum(length, 1e-12)[:, None], [0.0, 0.0, 1.0])
    # half-way rotation from z: (1 + z.d, z x d), and about x where d points down
    turn = np.column_stack([1.0 + direction[:, 2], -direction[:, 1], direction[:, 0], np.zeros(len(axis))])
    turn[direction[:, 2] < -1.0 + 1e-9] = (0.0, 1.0, 0.0, 0.0)
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    return start, turn, np.maximum(length, 1e-6)


def _rod(taper: float, sides: int) -> tuple[Array, IntArray]:
    """Return an open cone of length 1 along z, radius 1 at 0 and ``taper`` at 1: vertices and faces."""
    angle = np.arange(sides) * 2.0 * np.pi / sides
    ring = np.column_stack([np.cos(angle), np.sin(angle)])
    low, high = (np.column_stack([r * ring, np.full(sides, z)]) for r, z in ((1.0, 0.0), (taper, 1.0)))
    k = np.arange(sides)
    after = (k + 1) % sides
    faces = [np.column_stack([k, after, after + sides]), np.column_stack([k, after + sides, k + sides])]
    return np.concatenate([low, high]), np.concatenate(faces)


def _ball(many: bool) -> tuple[Array, IntArray]:
    """Return a ball of radius 1, of 80 faces, or an octahedron where there are many: vertices and faces."""
    import trimesh

    if many:
        mesh = trimesh.Trimesh(np.concatenate([np.eye(3), -np.eye(3)])).convex_hull
    else:
        mesh = trimesh.creation.icosphere(subdivisions=1)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)
