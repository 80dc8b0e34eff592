r"""From a string of modules to segments in space, and from segments to a `Tree` of capsule links.

The turtle of Prusinkiewicz and Lindenmayer, The Algorithmic Beauty of Plants, sections 1.5 and 2.3.4, with z up. It has
a heading H, a left L and an up U with H x L = U and begins at the origin with H = +z, L = -x, U = -y. In the sense of
an aircraft's pilot (angles in degrees):

======== =====================================================================================
``F(l)`` draw a segment of length l, then bend by the tropism
``f(l)`` move by l without drawing
``!(w)`` set the width (the diameter) of what follows
``+ -``  turn left, right about U
``& ^``  pitch down, up about L
``/ \``  roll right, left about H
``|``    turn around (180 degrees about U)
``$``    roll so that L is horizontal and U points up as far as it can
``[ ]``  begin, end a branch
======== =====================================================================================

Other symbols leave the turtle alone.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..base.errors import InputError
from ..base.rotation import quat_multiply, quat_rotate
from ..base.types import Array, IntArray
from .tree import Joint, Tree, capsule_inertia

Module = tuple[str, tuple[float, ...]]
"""One symbol with its parameters."""

COMMANDS: dict[str, tuple[int, ...]] = {
    "F": (0, 1), "f": (0, 1), "!": (1,), "+": (0, 1), "-": (0, 1), "&": (0, 1), "^": (0, 1), "/": (0, 1),
    "\\": (0, 1), "|": (0,), "$": (0,),
}  # fmt: skip
"""Turtle commands and the numbers of parameters each may have."""

WOOD_DENSITY = 700.0  # air-dry hardwood [kg/m^3]

_Vector = tuple[float, float, float]
_Quaternion = tuple[float, float, float, float]
_X, _Y, _Z = 1, 2, 3  # body axes are -L, -U, H, so that the turtle begins with the identity
_TURNS = {"+": (_Y, -1.0), "-": (_Y, 1.0), "&": (_X, -1.0), "^": (_X, 1.0), "/": (_Z, 1.0), "\\": (_Z, -1.0)}


@dataclass(frozen=True)
class Segments:
    """Straight pieces drawn by a turtle, N in the order drawn, which is depth-first. Lengths in the string's units.

    Attributes:
        start, end: End points, shape [N, 3].
        rotation: Turtle frame (x = -L, y = -U, z = H) while drawing, quaternion w, x, y, z, shape [N, 4].
        width: Diameter, shape [N].
        parent: Segment drawn last before this one on the way from the root, -1 for none, shape [N].
        level: Number of open brackets, shape [N].
    """

    start: Array
    end: Array
    rotation: Array
    width: Array
    parent: IntArray
    level: IntArray


@dataclass(slots=True)
class _State:
    """What brackets save."""

    position: _Vector = (0.0, 0.0, 0.0)
    rotation: _Quaternion = (1.0, 0.0, 0.0, 0.0)
    width: float = 1.0
    segment: int = -1


def interpret(
    modules: Iterable[Module],
    *,
    tropism: Sequence[float] = (0.0, 0.0, 0.0),
    bending: float = 0.0,
    angle_deg: float | None = None,
    source: str = "turtle",
) -> Segments:
    """Draw a string of modules.

    Args:
        modules: Symbols with parameters; brackets balanced.
        tropism: Direction T toward which segments bend, z up; its length counts.
        bending: Susceptibility e: after each segment the turtle turns by e |H x T| rad about H x T.
        angle_deg: Angle of turns written without one [degrees].
        source: What errors name as the place of the fault.

    Raises:
        InputError: A segment of zero, negative or non-finite length, a width that is not positive, a turn without an
            angle, unbalanced brackets, nothing drawn.
    """
    turtle = _Turtle((tropism[0], tropism[1], tropism[2]), bending, angle_deg, source)
    for index, (symbol, parameters) in enumerate(modules):
        turtle.obey(index, symbol, parameters)
    return turtle.segments()


class _Turtle:
    def __init__(self, tropism: _Vector, bending: float, angle_deg: float | None, source: str) -> None:
        self.tropism, self.bending, self.angle_deg, self.source = tropism, bending, angle_deg, source
        self.bends = bending != 0.0 and any(tropism)
        self.state, self.stack = _State(), list[_State]()
        self.drawn: list[tuple[_Vector, _Vector, _Quaternion, float, int, int]] = []

    def obey(self, index: int, symbol: str, parameters: tuple[float, ...]) -> None:
        """Carry out one module: turn, draw, set the width, or save or restore the state; ignore other symbols."""
        state = self.state
        if symbol in _TURNS:
            axis, sign = _TURNS[symbol]
            angle = parameters[0] if parameters else self._default_angle(index, symbol)
            state.rotation = _turned(state.rotation, axis, sign * math.radians(angle))
        elif symbol == "F":
            self._draw(index, parameters)
        elif symbol == "!":
            self._set_width(index, parameters[0])
        elif symbol == "[":
            self.stack.append(_State(state.position, state.rotation, state.width, state.segment))
        elif symbol == "]":
            if not self.stack:
                raise InputError(self.source, f"module {index}", "']' without '['", "balanced brackets")
            self.state = self.stack.pop()
        elif symbol == "f":
            state.position = self._ahead(parameters[0] if parameters else 1.0)
        elif symbol == "|":
            state.rotation = _turned(state.rotation, _Y, math.pi)
        elif symbol == "$":
            state.rotation = _levelled(state.rotation)

    def segments(self) -> Segments:
        """Return what was drawn; raise where a bracket is still open or nothing was drawn."""
        if self.stack:
            raise InputError(self.source, "the end", f"{len(self.stack)} brackets '[' still open", "balanced brackets")
        if not self.drawn:
            raise InputError(self.source, "", "nothing drawn", "a string with at least one F")
        start, end, rotation, width, parent, level = (np.array(c) for c in zip(*self.drawn, strict=True))
        return Segments(start, end, rotation, width, parent, level)

    def _default_angle(self, index: int, symbol: str) -> float:
        if self.angle_deg is None:
            place = f"module {index} {symbol}"
            raise InputError(
                self.source, place, "a turn without an angle", f"{symbol}(degrees), or a default angle_deg"
            )
        return self.angle_deg

    def _set_width(self, index: int, width: float) -> None:
        if not (width > 0.0 and math.isfinite(width)):
            raise InputError(self.source, f"module {index} !({width:g})", f"the width {width:g}", "more than 0")
        self.state.width = width

    def _ahead(self, length: float) -> _Vector:
        (x, y, z), (hx, hy, hz) = self.state.position, _heading(self.state.rotation)
        return x + length * hx, y + length * hy, z + length * hz

    def _draw(self, index: int, parameters: tuple[float, ...]) -> None:
        length = parameters[0] if parameters else 1.0
        state, end = self.state, self._ahead(length)
        if not (length > 0.0 and all(map(math.isfinite, end))):
            place = f"segment_{len(self.drawn)} (module {index} F({length:g}))"
            raise InputError(
                self.source, place, f"the length {length:g}", "a length above 0 that ends at a finite point"
            )
        self.drawn.append((state.position, end, state.rotation, state.width, state.segment, len(self.stack)))
        state.position, state.segment = end, len(self.drawn) - 1
        if self.bends:
            state.rotation = _bent(state.rotation, self.tropism, self.bending)


def _product(a: _Quaternion, b: _Quaternion) -> _Quaternion:
    """Product a b, brought back to unit length: strings may hold any number of turns."""
    (aw, ax, ay, az), (bw, bx, by, bz) = a, b
    w, x = aw * bw - ax * bx - ay * by - az * bz, aw * bx + ax * bw + ay * bz - az * by
    y, z = aw * by - ax * bz + ay * bw + az * bx, aw * bz + ax * by - ay * bx + az * bw
    norm = math.sqrt(w * w + x * x + y * y + z * z)
    return w / norm, x / norm, y / norm, z / norm


def _heading(q: _Quaternion) -> _Vector:
    w, x, y, z = q
    return 2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)


def _turned(q: _Quaternion, axis: int, angle: float) -> _Quaternion:
    """Frame turned by ``angle`` [rad] about one of its own axes."""
    turn = [math.cos(0.5 * angle), 0.0, 0.0, 0.0]
    turn[axis] = math.sin(0.5 * angle)
    return _product(q, (turn[0], turn[1], turn[2], turn[3]))


def _bent(q: _Quaternion, tropism: _Vector, bending: float) -> _Quaternion:
    """Frame turned by e |H x T| about H x T."""
    (hx, hy, hz), (tx, ty, tz) = _heading(q), tropism
    x, y, z = hy * tz - hz * ty, hz * tx - hx * tz, hx * ty - hy * tx
    norm = math.sqrt(x * x + y * y + z * z)
    if norm < 1e-12:
        return q
    s = math.sin(0.5 * bending * norm) / norm
    return _product((math.cos(0.5 * bending * norm), s * x, s * y, s * z), q)


def _levelled(q: _Quaternion) -> _Quaternion:
    """Frame rolled about H so that L = V x H / |V x H| with V = +z; unchanged where H is vertical."""
    hx, hy, _ = _heading(q)
    if math.hypot(hx, hy) < 1e-12:
        return q
    w, x, y, z = q
    # The x axis wanted is -L = (hy, -hx, 0) / |..|: the roll is its angle from x toward y in the frame.
    ex = (1.0 - 2.0 * (y * y + z * z)) * hy - 2.0 * (x * y + w * z) * hx
    ey = 2.0 * (x * y - w * z) * hy - (1.0 - 2.0 * (x * x + z * z)) * hx
    return _turned(q, _Z, math.atan2(ey, ex))


def segments_to_tree(
    segments: Segments,
    *,
    name: str,
    scale: float = 1.0,
    width_scale: float = 1.0,
    density: float = WOOD_DENSITY,
    joint: Joint = Joint.SPHERICAL,
    fixed_base: bool = False,
) -> Tree:
    """Make each segment one solid capsule link on a joint at its start; springs are still zero.

    Body frames begin at the segment's start with z along it. A link hangs on the segment it grows from, the first on
    the world. A revolute joint turns about the horizontal axis across the segment, so that the link swings in its own
    vertical plane and a positive angle lowers its tip (about L, as ``&`` does, where the segment is vertical). The
    half-spheres at the capsule's ends count in its mass; the centre of mass is at the middle of the axis.

    Args:
        segments: N segments.
        name: Name of the tree; links are called segment_0, segment_1, ...
        scale: Metres per unit of length.
        width_scale: Metres of diameter per unit of width.
        density: Density of the wood [kg/m^3].
        joint: Kind of the joints.
        fixed_base: Whether links on the world are fixed to it.

    Raises:
        InputError: A scale or the density is not positive.
    """
    for label, value in (("scale", scale), ("width_scale", width_scale), ("density", density)):
        if not (value > 0.0 and math.isfinite(value)):
            raise InputError(name, label, f"{value:g}", "a finite number above 0")
    count, parent = len(segments.parent), segments.parent
    length = scale * np.linalg.norm(segments.end - segments.start, axis=1)
    radius = 0.5 * width_scale * segments.width
    mass = density * np.pi * radius**2 * (length + 4.0 / 3.0 * radius)
    across, along = capsule_inertia(mass, radius, length)  # type: ignore[arg-type]
    position, rotation = _in_parents(segments)
    tip = np.stack([np.zeros(count), np.zeros(count), length], axis=1)
    return Tree(
        name=name, link_name=[f"segment_{i}" for i in range(count)], parent=parent,
        joint=np.where((parent < 0) & fixed_base, Joint.FIXED, joint), position=scale * position, rotation=rotation,
        axis=_drooping_axis(segments.rotation), mass=mass, com=0.5 * tip,
        inertia=np.stack([across, across, along], axis=1)[:, :, None] * np.eye(3),
        stiffness=np.zeros(count), damping=np.zeros(count), level=segments.level,
        shape_link=np.arange(count), shape_start=np.zeros((count, 3)), shape_end=tip,
        shape_radius=np.stack([radius, radius], axis=1),
    )  # fmt: skip


def _in_parents(segments: Segments) -> tuple[Array, Array]:
    """Frames of the segments in their parents' frames: origins [N, 3] and orientations [N, 4]."""
    rooted = (segments.parent < 0)[:, None]
    above = np.where(rooted, [1.0, 0.0, 0.0, 0.0], segments.rotation[segments.parent])
    origin = np.where(rooted, 0.0, segments.start[segments.parent])
    back = above * [1.0, -1.0, -1.0, -1.0]
    return quat_rotate(back, segments.start - origin), quat_multiply(back, segments.rotation)


def _drooping_axis(rotation: Array) -> Array:
    """Find unit axes [N, 3] along H x (-z), in the segments' frames: a positive turn about them lowers the tip."""
    down = quat_rotate(rotation * [1.0, -1.0, -1.0, -1.0], np.array([0.0, 0.0, -1.0]))
    axis = np.cross([0.0, 0.0, 1.0], down)
    norm = np.linalg.norm(axis, axis=1, keepdims=True)
    return np.where(norm > 1e-9, axis / np.maximum(norm, 1e-9), [-1.0, 0.0, 0.0])
