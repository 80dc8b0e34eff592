"""The step of worlds whose joints and links obey laws of `terms`, each world with values of its own.

Values lie as a user writes them, a number a world and link. Every launch first takes them over into the lanes' order
and notes which terms any world of a group uses (``active``); a term that none uses costs the steps that follow nothing.
The rest is `articulated.advance_loaded` with these terms:

``joint``     effort and damper of the law at every joint, the damper implicit
``link``      a force on every link, and its moment about the joint
``tip_mass``  a mass at the end of every link, over its last share or beside it; torques hold it in the springs' rest
              pose, where there is a spring

A law's time is the world's own: ``clock`` counts the seconds since the world's start in float64.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from ..lanes.algebra import add, add_cross, cross, div, dot, mul, rotate, sub, unrotate
from ..lanes.real import SOURCE, fma, real, where_neg
from ..tree.articulated import (
    PRISMATIC,
    REVOLUTE,
    SPHERICAL,
    advance_links,
    fold_link,
    held_at,
    own_force,
    own_inertia,
    own_moment,
    place_links,
    place_root,
    skew,
)
from ..tree.momentum import HELD, PIVOTED, add_gravity, add_impulses, restore_momentum, sum_momentum
from .structs import PARAMETERS, effect_types
from .terms import (
    Present,
    Term,
    effective_damping,
    is_on,
    laws_of,
    mass_at,
    mass_inertia,
    slot_of,
    strain_of,
    strips_of,
)

__all__ = ["FLAGS", "KINDS", "term_functions", "term_kernels", "term_types", "time_of"]

#: Kinds of terms that a free step knows; ``active`` holds a flag for each behind those of the terms.
KINDS = ("joint", "link", "tip_mass")
#: All flags: those, and whether any world has a crown that feels the air.
FLAGS = (*KINDS, "crown")


@cache
def term_types(width: int = 1, precision: int = 32) -> SimpleNamespace:
    """Return the structs of `structs.effect_types` and ``Terms``.

    Rows of ``value`` are parameters; ``source`` says in which column a lane's number stands, -1 where there is none.
    """
    t = effect_types(width, precision)
    Real, Vec, Quat = t.Real, t.Vec, t.Quat
    Scalar: Any = wp.float64 if precision == 64 else wp.float32

    @wp.struct
    class Terms:
        """Values and memories of the laws of a free step."""

        value: wp.array2d(dtype=Scalar)
        source: wp.array3d(dtype=int)
        term: wp.array(dtype=int)
        kind: wp.array(dtype=int)
        target: wp.array(dtype=int)
        own: wp.array(dtype=int)
        balls: wp.array(dtype=int)
        neutral: wp.array(dtype=wp.float64)
        elsewhere: wp.array(dtype=wp.float64)
        parameter: wp.array2d(dtype=Real)
        entry: wp.array4d(dtype=Scalar)
        active: wp.array2d(dtype=int)
        stride: int
        memory: wp.array2d(dtype=Vec)
        clock: wp.array(dtype=wp.float64)
        begin: wp.array(dtype=Real)
        begin_entry: wp.array4d(dtype=Scalar)
        damping: wp.array2d(dtype=Real)
        area: wp.array2d(dtype=Real)
        centre: wp.array2d(dtype=Vec)
        end: wp.array2d(dtype=Vec)
        crown: wp.array2d(dtype=Real)
        leaf: wp.array2d(dtype=int)
        pose: wp.array2d(dtype=Quat)
        offset: wp.array2d(dtype=Vec)
        hold: wp.array2d(dtype=Vec)
        effort: wp.array2d(dtype=Vec)
        wind: wp.array2d(dtype=Vec)
        swirl: wp.array2d(dtype=Vec)
        course: wp.array2d(dtype=Vec)

    return SimpleNamespace(**vars(t), Scalar=Scalar, Terms=Terms)


# ---- before the steps of a launch --------------------------------------------------------------------------------


def _taking(t: SimpleNamespace, count: int, key: str) -> Any:
    """Device function that takes over values and time.

    It is made per width: Warp unrolls loops over lanes only where their number is a constant of the function, and a
    launch of a single step then takes two thirds of the time.
    """
    Scalar, W, flags = t.Scalar, t.width, count + len(FLAGS)

    def take(e: int, m: Any, fx: Any, duration: wp.float64):
        """Take over what was written, mark the terms that any world uses, and move the clocks on by ``duration``."""
        for n in range(flags):
            fx.active[e, n] = 0
        for r in range(fx.term.shape[0]):
            own = fx.own[r]
            balls = fx.balls[r]
            first = fx.target[r] * fx.stride
            neutral = Scalar(fx.neutral[r])
            elsewhere = Scalar(fx.elsewhere[r])
            used = wp.int32(0)
            for i in range(own, m.count[e] * own + 1):
                given = balls == 0 or m.kind[e, i] == SPHERICAL
                off = wp.where(given, neutral, elsewhere)
                for k in range(W):
                    value = off
                    at = fx.source[e, i, k]
                    if given and at >= 0:
                        value = fx.value[r, at]
                    if value != off:
                        used = 1
                    fx.entry[e, first + i, 0, k] = value
            if used == 1:
                fx.active[e, fx.term[r]] = 1
                fx.active[e, count + fx.kind[r]] = 1
        for k in range(W):
            now = fx.clock[e * W + k]
            fx.begin_entry[e, 0, 0, k] = Scalar(now)
            fx.clock[e * W + k] = now + duration

    return wp.func(take, name=f"take_{key}")


@wp.func
def holding(kind: int, pose: Any, axis: Any, moment: Any, force: Any):
    """Joint force that carries a moment and force (world axes) in the joint's own coordinates."""
    out = unrotate(pose, moment)
    o = real(0.0, out.x)
    if kind == REVOLUTE:
        out = type(out)(dot(axis, moment), o, o)
    if kind == PRISMATIC:
        out = type(out)(dot(axis, force), o, o)
    return out


@wp.func
def hold_ends(e: int, row: int, slot: int, m: Any, fx: Any, s: Any):
    """Joint forces that carry the weight of the masses at links' ends in the springs' rest pose."""
    n = m.count[e]
    like = m.offset[e, 1]
    o = real(0.0, like.x)
    lift = type(like)(real(m.lift[0], o), real(m.lift[1], o), real(m.lift[2], o))
    for i in range(n + 1):
        s.n[row, i] = type(like)(o, o, o)
        s.f[row, i] = type(like)(o, o, o)
    for step in range(n):
        i = n - step
        pose = fx.pose[e, i]
        own = lift * fx.parameter[e, slot * PARAMETERS * fx.stride + i]
        force = s.f[row, i] + own
        moment = add_cross(s.n[row, i], rotate(pose, mass_at(e, i, i, slot, fx, like)), own)
        held = holding(m.kind[e, i], pose, rotate(pose, m.axis[e, i]), moment, force)
        none = o - m.stiffness[e, i]
        fx.hold[row, i] = type(like)(where_neg(none, held.x, o), where_neg(none, held.y, o), where_neg(none, held.z, o))
        p = m.parent[e, i]
        s.f[row, p] = s.f[row, p] + force
        s.n[row, p] = add_cross(s.n[row, p] + moment, fx.offset[e, i], force)


# ---- the step ----------------------------------------------------------------------------------------------------


@wp.func
def blow(e: int, row: int, m: Any, fx: Any, s: Any, time: Any, strips: wp.Function):
    """Write the laws' force on every link and its moment about the joint."""
    for i in range(1, m.count[e] + 1):
        blown = strips(e, row, i, m, fx, s, time)
        fx.wind[row, i] = blown.force
        fx.swirl[row, i] = blown.moment


@wp.func
def torque_of(
    e: int, row: int, i: int, m: Any, x: Any, u: Any, fx: Any, h: wp.float64, time: Any, strain: wp.Function
):  # fmt: skip
    """Return the laws' effort at a joint; its damper becomes what they make of it."""
    v = x.velocity[e, i]
    r = strain(e, i, m, x, u.effort[e, i], v - v, fx, h, time)
    m.damping[e, i] = effective_damping(
        m.kind[e, i], fx.damping[e, i], m.stiffness[e, i], r.stiffness, r.damping, m.inertia[e, i].z, h
    )
    fx.effort[row, i] = r.torque
    return r.torque


@wp.func
def fold_laws(
    e: int, row: int, m: Any, x: Any, u: Any, fx: Any, s: Any, h: wp.float64, time: Any, at: Present,
    strain: wp.Function,
):  # fmt: skip
    """Fold as `articulated.fold_links_loaded` does, with the laws' efforts, forces and masses."""
    n = m.count[e]
    for step in range(n):
        i = n - step
        A = own_inertia(e, row, i, m, s)
        mass = m.mass[e, i]
        pose = s.pose[row, i]
        mc = rotate(pose, m.com[e, i]) * mass
        effort = u.effort[e, i]
        if is_on(e, at.tip, fx):
            extra = fx.parameter[e, at.tip * PARAMETERS * fx.stride + i]
            arm = rotate(pose, mass_at(e, i, i, at.tip, fx, mc))
            A = A + mass_inertia(e, i, i, at.tip, arm, pose, fx, A)
            mass = mass + extra
            mc = mc + arm * extra
            effort = effort + held_at(e, i, m, x, fx.hold[row, i])
        if at.joint >= 0:
            if fx.active[e, at.joint] == 1:
                effort = effort + torque_of(e, row, i, m, x, u, fx, h, time, strain)
            else:
                m.damping[e, i] = fx.damping[e, i]
        B = skew(mc, s.U[row, i])
        pushed = u.force[e, i]
        f = own_force(row, i, s, mass, mc) - pushed
        n0 = add_cross(own_moment(row, i, s, A, mc) - u.torque[e, i], pushed, rotate(pose, u.point[e, i]))
        if is_on(e, at.link, fx):
            f = f - fx.wind[row, i]
            n0 = n0 - fx.swirl[row, i]
        fold_link(e, row, i, m, x, s, h, A, B, mass, n0, f, effort)


@wp.func
def push_laws(e: int, row: int, m: Any, fx: Any, s: Any, h: wp.float64, at: Present):
    """Add the impulses of the laws' forces, and of their torque at a ball root, to the momenta before the step."""
    if is_on(e, at.link, fx):
        for i in range(1, m.count[e] + 1):
            s.accel[row, i] = s.accel[row, m.parent[e, i]] + s.r[row, i]
            lasts = real(h, m.mass[e, i])
            impulse = fx.wind[row, i] * lasts
            s.f[row, 0] = s.f[row, 0] + impulse
            s.n[row, 0] = add_cross(s.n[row, 0] + fx.swirl[row, i] * lasts, s.accel[row, i], impulse)
    if is_on(e, at.joint, fx):
        if m.free[e] == PIVOTED:
            torque = rotate(s.pose[row, 1], fx.effort[row, 1])
            s.n[row, 0] = s.n[row, 0] + torque * real(h, torque.x)


@wp.func
def advance_laws(
    e: int, row: int, m: Any, x: Any, u: Any, fx: Any, s: Any, h: wp.float64, time: Any, bound: wp.float64,
    feel: wp.Function, fold: wp.Function,
):  # fmt: skip
    """Take one semi-implicit step of length h [s] from the worlds' times."""
    place_root(e, row, m, s)
    place_links(e, row, m, x, s)
    feel(e, row, m, fx, s, time)
    fold(e, row, m, x, u, fx, s, h, time)
    advance_links(e, row, m, x, s, h, bound)
    x.tick[e] = x.tick[e] + 1


@wp.func
def time_of(e: int, fx: Any, k: int, h: wp.float64):
    """Time of the worlds at step k of a launch [s]."""
    begin = fx.begin[e]
    return begin + real(h * wp.float64(k), begin)


@cache
def term_functions(width: int, precision: int, terms: tuple[Term, ...]) -> SimpleNamespace:
    """Return the device functions of a step with terms.

    ``start(e, row, m, fx, s, duration)``  before the steps of a launch, which take ``duration`` together
    ``feel(e, row, m, fx, s, time)``       after links are placed: forces on links
    ``fold(e, row, m, x, u, fx, s, h, time)``  in the place of `articulated.fold_links_loaded`
    ``push(e, row, m, fx, s, h)``          adds the laws' impulses to the momenta before a step
    """
    t, count = term_types(width, precision), len(terms)
    key = f"free_{width}_{precision}_" + "_".join(f"{term.name}_{term.kind}" for term in terms)
    strain = strain_of(laws_of("joint", terms, t, key), t, key)
    strips = strips_of(terms, t, key, count + FLAGS.index("crown"))
    kinds = [term.kind for term in terms]
    at_joint, at_link = (count + KINDS.index(kind) if kind in kinds else -1 for kind in ("joint", "link"))
    take, tip = _taking(t, count, key), slot_of(terms, "tip_mass")

    def start(e: int, row: int, m: Any, fx: Any, s: Any, duration: wp.float64):
        """Take over values and time, and hold the masses at links' ends."""
        take(e, m, fx, duration)
        if is_on(e, tip, fx):
            hold_ends(e, row, tip, m, fx, s)

    def feel(e: int, row: int, m: Any, fx: Any, s: Any, time: Any):
        """Write the laws' force on every link, where there is any."""
        if is_on(e, at_link, fx):
            blow(e, row, m, fx, s, time, strips)

    def fold(e: int, row: int, m: Any, x: Any, u: Any, fx: Any, s: Any, h: wp.float64, time: Any):
        """Fold with the laws that the kernel is built with."""
        fold_laws(e, row, m, x, u, fx, s, h, time, Present(at_joint, at_link, tip), strain)

    def push(e: int, row: int, m: Any, fx: Any, s: Any, h: wp.float64):
        """Add the impulses of the laws that the kernel is built with."""
        push_laws(e, row, m, fx, s, h, Present(at_joint, at_link, tip))

    named = {"start": start, "feel": feel, "fold": fold, "push": push}
    return SimpleNamespace(**{name: wp.func(function, name=f"{name}_{key}") for name, function in named.items()})


@cache
def term_kernels(width: int, precision: int, terms: tuple[Term, ...], free: bool = False) -> SimpleNamespace:
    """Return the kernels ``step`` (`step.step_kernels` under a load, with terms of the kinds in `KINDS`) and ``rest``.

    With ``free`` the momentum of trees that nothing holds is kept (`momentum`).
    """
    t, parts = term_types(width, precision), term_functions(width, precision, terms)
    start, feel, fold, push = parts.start, parts.feel, parts.fold, parts.push
    Model, State, Load, Scratch, Terms = t.Model, t.State, t.Load, t.Scratch, t.Terms

    @wp.kernel(enable_backward=False, module="unique")
    def step_terms(
        m: Model, x_in_out: State, u_in: Load, fx: Terms, s_out: Scratch, first: int, row: int, substeps: int,
        h: wp.float64, bound: wp.float64,
    ):  # fmt: skip
        """Advance a group by ``substeps`` steps of ``h`` [s] under its load and the laws that are active in it."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        start(e, r, m, fx, s_out, h * wp.float64(substeps))
        for k in range(substeps):
            if wp.static(free):
                if m.free[e] != HELD:
                    sum_momentum(e, r, m, x_in_out, s_out)
                    add_gravity(r, s_out, h)
                    add_impulses(e, r, m, u_in, s_out, h)
            advance_laws(e, r, m, x_in_out, u_in, fx, s_out, h, time_of(e, fx, k, h), bound, feel, fold)
            if wp.static(free):
                if m.free[e] != HELD:
                    push(e, r, m, fx, s_out, h)
                    restore_momentum(e, r, m, x_in_out, s_out)

    @wp.kernel(enable_backward=False, module="unique")
    def rest_terms(m: Model, x_in: State, fx: Terms, s_out: Scratch, first: int, row: int):
        """Note poses and offsets (world axes) of a state, for `hold_ends`."""
        tag = SOURCE  # noqa: F841
        e = first + wp.tid()
        r = wp.where(row < 0, e, row)
        place_root(e, r, m, s_out)
        place_links(e, r, m, x_in, s_out)
        for i in range(1, m.count[e] + 1):
            fx.pose[e, i] = s_out.pose[r, i]
            fx.offset[e, i] = s_out.r[r, i]

    return SimpleNamespace(step=step_terms, rest=rest_terms)
