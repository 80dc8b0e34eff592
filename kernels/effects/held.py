"""Where a recording begins of a branch that a law holds off its rest.

Dry friction stops a branch off centre, a play leaves it where its weight leans, and the next pull finds it there. A
grasp point that stands at d from its calm place while nothing pulls, with r_i to it from joint i, is taken there by

    phi_i = r_i x d / sum_j |r_j|^2

over the joints at which a law holds anything; of one joint this is the smallest turn. The laws hold the spring's
torque K phi_i as far as they can, and the joint begins where they do: without such a law at rest. A law that remembers
the recording before already holds the branch somewhere: there d is counted from that place, and what its memory holds
otherwise, which the grasp point does not show, it keeps.
"""

from types import SimpleNamespace
from typing import Any

import warp as wp

from ..lanes.algebra import add, add_scaled, cross, div, dot, exponential, mul, norm, sub, unrotate
from ..lanes.real import fma, real, where_neg
from ..tree.articulated import SPHERICAL
from .terms import Term, function_of, memory_row, named_all, reader

__all__ = ["held", "holder_of"]


@wp.func
def held(r: Any, spring: Any, y: Any):
    """Of the torque ``r.torque``, what a law tau = -spring z, |z| <= y, holds beyond what it does, and the z for it."""
    most = spring * y
    before = r.memory * spring
    asked = r.torque - before
    full = norm(asked)
    full = where_neg(full - most, most, full)
    o = real(0.0, y)
    return type(r)(add_scaled(before, asked, most / full), asked * ((o - y) / full), o, o)


def _hold_own(term: Term, types: SimpleNamespace, key: str, row: int) -> Any:
    """Device function that holds what is left of a torque, and remembers that; worlds of a mark keep their memory."""
    read, holds, remembers = reader(term, types, key), term.holds, term.memory > 0

    def hold_own(e: int, i: int, fx: Any, j: Any, left: Any, mark: Any):
        """Return what this law leaves of the torque ``left``, and remember what it holds where there is no mark."""
        o = real(0.0, mark)
        k = row * fx.stride + i
        z = left - left
        if wp.static(remembers):
            z = fx.memory[e, k]
        r = holds(j, read(e, i, fx), types.Response(left, z, o, o))
        if wp.static(remembers):
            fx.memory[e, k] = type(z)(
                where_neg(o - mark, z.x, r.memory.x), where_neg(o - mark, z.y, r.memory.y),
                where_neg(o - mark, z.z, r.memory.z),
            )  # fmt: skip
        return left - r.torque

    return function_of(hold_own, term, f"hold{key}")


def _hold_of(terms: tuple[Term, ...], types: SimpleNamespace, key: str) -> Any:
    """Device function that returns what the laws at a joint leave of a torque that they are to hold."""
    own = [term for term in terms if term.holds is not None]
    slots, count = [term.slot for term in own], len(own)
    holds = [_hold_own(term, types, key, memory_row(terms, term.slot)) for term in own]
    named, JointState = named_all(holds, f"hold_{key}"), types.JointState

    def hold(e: int, i: int, m: Any, fx: Any, torque: Any, mark: Any):
        """Return what is left of a torque at joint i once every active law has held its part of it."""
        if wp.static(False):
            named(torque)
        o = real(0.0, mark)
        zero = torque - torque
        j = JointState(zero, zero, m.preload[e, i], zero, m.stiffness[e, i], o, o, zero)
        left = type(torque)(torque.x, torque.y, torque.z)
        for n in range(wp.static(count)):
            for _ in range(fx.active[e, wp.static(slots[n])]):
                left = wp.static(holds[n])(e, i, fx, j, left, mark)
        return left

    return wp.func(hold, name=f"hold_{key}")


def holder_of(terms: tuple[Term, ...], types: SimpleNamespace, key: str) -> Any:
    """Return the device function that begins a recording where laws hold a branch.

    It wants links located, in calm. Worlds that rest under a load, ``settle`` 2, stay as they are.
    """
    hold = _hold_of(terms, types, key)

    def begin(e: int, row: int, place: int, point: Any, off: Any, m: Any, x: Any, fx: Any, s: Any):
        """Turn the joints from ``place`` to the root by (K phi_i - what the laws leave of it) / K, where no mark is."""
        one = real(1.0, fx.settle[e])
        o = one - one
        mark = fx.settle[e] - one
        total = o
        i = place
        while i > 0:
            arm = point - s.accel[row, i]
            asked = type(arm)(m.stiffness[e, i], o, o)
            given = asked - hold(e, i, m, fx, asked, one)
            back = asked + hold(e, i, m, fx, asked * (o - one), one)  # what is held already may be all it can one way
            total = where_neg(o - dot(given, given) - dot(back, back), fma(dot(arm, arm), one, total), total)
            i = m.parent[e, i]
        total = where_neg(o - total, total, one)
        i = place
        while i > 0:
            turn = unrotate(s.pose[row, i], cross(point - s.accel[row, i], off)) * (one / total)
            if m.kind[e, i] != SPHERICAL:
                turn = type(turn)(turn.x, o, o)
            spring = m.stiffness[e, i]
            asked = turn * spring
            spring = where_neg(o - spring, spring, one)  # a joint without a spring has nothing to hold
            turn = (asked - hold(e, i, m, fx, asked, mark)) * (one / spring)
            q = x.coordinate[e, i]
            new = q * exponential(turn, q)
            if m.kind[e, i] != SPHERICAL:
                new = type(q)(one, q.x + turn.x, o, o)
            x.coordinate[e, i] = type(q)(
                where_neg(o - mark, q.w, new.w), where_neg(o - mark, q.x, new.x),
                where_neg(o - mark, q.y, new.y), where_neg(o - mark, q.z, new.z),
            )  # fmt: skip
            i = m.parent[e, i]

    return wp.func(begin, name=f"begin_{key}")
