"""What a plain spring and damper lack, as terms of the step: how laws plug in, and the step that calls them.

A law is a device function of one of three kinds. Laws are chained when a kernel is built, so a kernel holds exactly the
ones it is built with; the plain step (`articulated`) knows nothing of them.

``joint``  ``law(j, p, r)`` takes a `JointState`, the parameters and an empty `Response` that holds the joint's memory
           (zero at the start); it returns one of the type of r: torque added to the joint's effort [N m or N], new
           memory, stiffness beyond the joint's spring [N m/rad], damping [N m s/rad]; torque is without the damper's.
           A law that remembers two vectors gets a `LongResponse`, with ``second`` after ``memory``
``link``   ``law(b, p)`` takes a `LinkState` (``velocity`` of a point [m/s] and ``arm`` from the joint to it [m], world
           axes; ``turn`` of the link; ``area``, ``crown`` [m^2], ``time`` [s]; ``course``, the pressure of gusts over
           their rms at this moment, world axes, zero where no course is known) and returns the force there, world
           axes [N]. It is asked at two points with half of the link's area each, so that a link that turns feels what
           its length does, and at the end of a link that carries no other with the area of the whole tree, divided
           among such ends, as ``crown``, for what a crown feels there (`strips_of`)
``force``  ``law(g, p)`` takes a `ForceState` and returns the force that truly acts, from what the sensor recorded [N];
           ``opened`` is what it reads of an open gripper in the same recording [N], ``heading`` the level unit vector
           that the gripper faces, each zero where it is not known; ``time`` [s], zero at joints measured directly

``p`` holds up to ten parameters, ``p.a`` to ``p.j``, in the order in which the effect lists them. A ball joint's angle
is its rotation vector from rest and its rate the angular velocity, both in the link's frame; other joints use x alone.

Worlds of a group whose parameters of a term are all neutral skip it (``active``), and joints at which no law acts are
not asked (``bent``), so that a kernel with every law in it costs a group little more than the laws it uses.

Damping that a law reports is implicit in the step, so that a law as steep as dry friction at rest stays stable. A ball
joint's stiffness beyond its own spring brings the least damper that an explicit spring needs there (half a step times
the stiffness, less what the segment's inertia about its own axis does).
"""

from functools import cache
from types import SimpleNamespace
from typing import Any, NamedTuple

import warp as wp

from ..lanes.algebra import add, add_cross, cross, div, log_factors, mul, rotate, sub
from ..lanes.real import fma, real, where_neg
from ..tree.articulated import (
    PRISMATIC,
    SPHERICAL,
    advance_links,
    fold_link,
    held_at,
    held_of,
    own_force,
    own_inertia,
    own_moment,
    place_links,
    place_root,
    skew,
)
from ..tree.midway import damper_midway, look_again, look_forward, set_out_from
from .structs import PARAMETERS, effect_types

__all__ = ["GROUPS", "Present", "Term", "step_of"]

#: What follows the terms in ``active``: whether any term at links is on, any damage, any law that holds a branch off
#: its rest, any law that has acted before a recording begins, any load to rest under, and any crown that feels the air.
GROUPS = ("link", "lasting", "holding", "preceding", "resting", "crowned")

#: Least damper of a ball joint over its stiffness, in steps.
LEAST_DAMPER = wp.constant(wp.float64(0.6))


#: Gauss's points of a link's length, from its middle, over the joint's distance from there.
STRIP = wp.constant(wp.float64(3.0**-0.5))

#: What a step is for: to move; to find rest under all that acts; or to find rest in a calm, without link forces.
MOVING = wp.constant(0)
STILL = wp.constant(1)
CALM = wp.constant(2)


@wp.struct
class Present:
    """Where ``active`` tells of laws at joints and at links, and the slot of `tip_mass`; -1 for what is not built in.

    A replay has ``bent`` for laws at joints, and of ``joint`` only whether it is built in. They are constants of a
    kernel: the compiler leaves out what a kernel is built without.
    """

    joint: int
    link: int
    tip: int


class Term(NamedTuple):
    """A law as a kernel is built with it; its parameters start at entry ``slot`` of the parameter array.

    Attributes:
        name: Of the effect.
        kind: ``joint``, ``link``, ``force``, or the name of a term that the replay itself carries out.
        law: Device function; None for the latter.
        slot: Which of the terms it is.
        per_joint: Whether every joint has parameters of its own; else they stand at place 0.
        memory: How many vectors each joint remembers, up to two.
        persistent: Whether that memory outlasts a recording (damage), or is zero at the start of each.
        holds: Device function of the torque that the law holds at rest, see `held`; None where it holds none.
        precedes: Whether it acts by the clock, and so has moved a branch before a recording begins.
        strains: Device function as of kind ``joint`` of what a law of another kind does at joints as well, without a
            memory; None where it does nothing there.
        fades: Which of its parameters is the share of its memory that outlasts a recording; -1 where all of it does.
        follows: Whether its torque follows the joint's angle at rest, by its stiffness.
    """

    name: str
    kind: str
    law: Any
    slot: int
    per_joint: bool
    memory: int = 0
    persistent: bool = False
    holds: Any = None
    precedes: bool = False
    strains: Any = None
    fades: int = -1
    follows: bool = False

    @property
    def lasting(self) -> bool:
        """Whether what outlasts a recording is a joint's, so that a branch rests elsewhere: a grip moves no joint."""
        return self.persistent and self.kind == "joint"

    @property
    def at_joint(self) -> Any:
        """Device function of what it does at joints; None where it does nothing there."""
        return self.law if self.kind == "joint" else self.strains


def slot_of(terms: tuple[Term, ...], kind: str) -> int:
    """Return the slot of the only term of a kind, -1 where there is none."""
    return next((term.slot for term in terms if term.kind == kind), -1)


def group_place(terms: tuple[Term, ...], kind: str) -> int:
    """Return where ``active`` tells whether any term of a kind is on, -1 where there is none."""
    used = any(acts(term, kind) for term in terms)
    return len(terms) + GROUPS.index(kind) if used else -1


def acts(term: Term, kind: str) -> bool:
    """Return whether a law acts in the way of a kind."""
    return term.kind == kind or (kind == "joint" and term.at_joint is not None)


def memory_row(terms: tuple[Term, ...], slot: int) -> int:
    """Return how many vectors the terms before a slot remember: the first row of that term's memory."""
    return sum(term.memory for term in terms if term.slot < slot)


# ---- laws: one function for all terms of a kind, each of which acts where ``active`` says so -------------------------
#
# ``for _ in range(active)`` runs 0 times or once. An ``if`` would do the same and copy what it may change, on each pass
# and at every law: with ten laws of which one acts a step took 1.9 times as long. Warp's hash of a kernel does not see
# functions that a loop takes from a list, so they are named once more where nothing is compiled (`named_all`).


def function_of(function: Any, term: Term, key: str) -> Any:
    """Make a device function of its own: Warp tells functions of one module apart by their names."""
    return wp.func(function, name=f"{key}_{term.kind}_{term.name}_{term.slot}_{term.per_joint}")


def reader(term: Term, types: SimpleNamespace, key: str) -> Any:
    """Device function that reads a term's parameters for joint or link i."""
    first, own, Parameters = term.slot * PARAMETERS, int(term.per_joint), types.Parameters

    def read(e: int, i: int, fx: Any):
        """Return the term's parameters a to j in group e, those of joint or link i where each has its own."""
        k = first * fx.stride + i * own
        n = fx.stride
        return Parameters(
            fx.parameter[e, k], fx.parameter[e, k + n], fx.parameter[e, k + 2 * n], fx.parameter[e, k + 3 * n],
            fx.parameter[e, k + 4 * n], fx.parameter[e, k + 5 * n], fx.parameter[e, k + 6 * n],
            fx.parameter[e, k + 7 * n], fx.parameter[e, k + 8 * n], fx.parameter[e, k + 9 * n],
        )  # fmt: skip

    return function_of(read, term, f"read{key}")


def _add_joint(term: Term, types: SimpleNamespace, key: str, row: int) -> Any:
    """Device function that adds a law's response at a joint to that of those before it."""
    read, law, memory, LongResponse = reader(term, types, key), term.at_joint, term.memory, types.LongResponse
    follows = term.follows

    def add_own(e: int, i: int, fx: Any, j: Any, r: Any, sofar: Any):
        """Return ``sofar`` plus the law's torque, stiffness and damping at joint i, and write its new memory."""
        k = row * fx.stride + i
        p = read(e, i, fx)
        if wp.static(memory == 0):
            own = law(j, p, r)
        if wp.static(memory == 1):
            own = law(j, p, type(r)(r.torque, fx.memory[e, k], r.stiffness, r.damping))
            fx.memory[e, k] = own.memory
        if wp.static(memory == 2):
            long = LongResponse(r.torque, fx.memory[e, k], fx.memory[e, k + fx.stride], r.stiffness, r.damping)
            own = law(j, p, long)
            fx.memory[e, k] = own.memory
            fx.memory[e, k + fx.stride] = own.second
        back = sofar.follows
        if wp.static(follows):
            back = back + own.stiffness
        return type(sofar)(
            sofar.torque + own.torque, sofar.stiffness + own.stiffness, sofar.damping + own.damping, back
        )

    return function_of(add_own, term, f"add{key}")


def _add_link(term: Term, types: SimpleNamespace, key: str) -> Any:
    """Device function that adds a law's force on a link to that of those before it."""
    read, law = reader(term, types, key), term.law

    def add_own(e: int, i: int, fx: Any, b: Any, sofar: Any):
        """Return ``sofar`` plus the law's force on link i at the point of ``b``, world axes [N]."""
        return sofar + law(b, read(e, i, fx))

    return function_of(add_own, term, f"add{key}")


def _add_force(term: Term, types: SimpleNamespace, key: str) -> Any:
    """Device function that makes a law's force of that which those before it made."""
    read, law = reader(term, types, key), term.law

    def add_own(e: int, i: int, fx: Any, g: Any, sofar: Any):
        """Return the force [N] that the law makes of ``sofar``."""
        return law(type(g)(sofar, g.contact, g.turn, g.first, g.gravity, g.opened, g.heading, g.time), read(e, i, fx))

    return function_of(add_own, term, f"add{key}")


def named_all(adds: list[Any], key: str) -> Any:
    """Device function that refers to all of some: what refers to it has them in its hash."""
    out: Any = wp.func(nothing, name=f"nothing_{key}")
    for n, own in enumerate(adds):
        out = wp.func(_both(out, own), name=f"names_{key}_{n}")
    return out


def _both(before: Any, own: Any) -> Any:
    """Return a function that calls two; each has a closure of its own, for Warp looks into it when it hashes."""

    def both(x: Any):
        """Refer to both: the hash of what refers to this function covers them."""
        before(x)
        own(x)

    return both


def nothing(x: Any):
    """Nothing."""
    return x


def laws_of(kind: str, terms: tuple[Term, ...], types: SimpleNamespace, key: str) -> Any:
    """Return the device function that applies all terms of a kind, in their order."""
    own = [term for term in terms if acts(term, kind)]
    slots, count = [term.slot for term in own], len(own)
    if kind == "joint":
        adds = [_add_joint(term, types, key, memory_row(terms, term.slot)) for term in own]
    else:
        adds = [{"link": _add_link, "force": _add_force}[kind](term, types, key) for term in own]
    named, Responses = named_all(adds, f"{key}_{kind}"), types.Responses

    def joint(e: int, i: int, fx: Any, j: Any, r: Any):
        """Return ``r`` plus torque, stiffness and damping of all active laws at joint i."""
        if wp.static(False):
            named(r)
        sofar = Responses(r.torque, r.stiffness, r.damping, r.stiffness - r.stiffness)
        for n in range(wp.static(count)):
            for _ in range(fx.active[e, wp.static(slots[n])]):
                sofar = wp.static(adds[n])(e, i, fx, j, r, sofar)
        return sofar

    def link(e: int, i: int, fx: Any, b: Any):
        """Return the sum of the active laws' forces on link i at the point of ``b``, world axes [N]."""
        if wp.static(False):
            named(b)
        sofar = b.velocity - b.velocity
        for n in range(wp.static(count)):
            for _ in range(fx.active[e, wp.static(slots[n])]):
                sofar = wp.static(adds[n])(e, i, fx, b, sofar)
        return sofar

    def force(e: int, i: int, fx: Any, g: Any):
        """Return the force that truly acts [N]: the recorded one, changed by one active law after the other."""
        if wp.static(False):
            named(g)
        sofar = type(g.force)(g.force.x, g.force.y, g.force.z)
        for n in range(wp.static(count)):
            for _ in range(fx.active[e, wp.static(slots[n])]):
                sofar = wp.static(adds[n])(e, i, fx, g, sofar)
        return sofar

    return wp.func({"joint": joint, "link": link, "force": force}[kind], name=f"{kind}_{key}")


def strips_of(terms: tuple[Term, ...], types: SimpleNamespace, key: str, crowned: int) -> Any:
    """Return the device function of the laws at a link: their force, and its moment about the joint, world axes.

    Strip theory: force per length is integrated along the link by Gauss's two points, exact for cubics. The link
    reaches from its joint to twice its centre of area. What the crown feels at a ``leaf`` link's end is added
    where place ``crowned`` of ``active`` says that some world has one.
    """
    law, LinkState, Wrench = laws_of("link", terms, types, key), types.LinkState, types.Wrench

    def strips(e: int, row: int, i: int, m: Any, fx: Any, s: Any, time: Any):
        """Return force [N] and moment about the joint [N m] of the laws on link i: Gauss's two points and its end."""
        pose = s.pose[row, i]
        middle = rotate(pose, fx.centre[e, i])
        velocity = centre_velocity(e, row, i, m, s, middle)
        half = fx.area[e, i] * real(0.5, time)
        course = fx.course[e, 0]
        away = middle * real(STRIP, time)
        spin = s.spin[row, i]
        o = real(0.0, time)
        far = LinkState(add_cross(velocity, spin, away), middle + away, pose, half, o, time, course)
        near = LinkState(add_cross(velocity, away, spin), middle - away, pose, half, o, time, course)
        outer = law(e, i, fx, far)
        inner = law(e, i, fx, near)
        sofar = Wrench(outer + inner, add_cross(cross(far.arm, outer), near.arm, inner))
        for _ in range(fx.leaf[e, i] * fx.active[e, wp.static(crowned)]):
            end = rotate(pose, fx.end[e, i])
            moves = add_cross(velocity, spin, end - middle)
            hung = law(e, i, fx, LinkState(moves, end, pose, o, fx.crown[e, i], time, course))
            sofar = Wrench(sofar.force + hung, add_cross(sofar.moment, end, hung))
        return sofar

    return wp.func(strips, name=f"strips_{key}")


# ---- the step ----------------------------------------------------------------------------------------------------


@wp.func
def is_on(e: int, place: int, fx: Any):
    """Whether any world of a group uses a term; ``place`` is -1 for one that the kernel is built without."""
    if place < 0:
        return False
    return fx.active[e, place] == 1


@wp.func
def joint_state(
    kind: int, q: Any, w: Any, gain: Any, preload: Any, effort: Any, stiffness: Any, time: Any, h: wp.float64, like: Any
):  # fmt: skip
    """Angle, rate, effort and spring of a joint as laws see them."""
    o = real(0.0, time)
    angle = type(w)(q.x, o, o)
    rate = type(w)(w.x, o, o)
    held = preload
    if kind == SPHERICAL:
        v = type(w)(q.x, q.y, q.z)
        f, g = log_factors(q)
        angle = v * f
        rate = w
        held = held_of(preload, v, f, g)
    return type(like)(angle, rate, held, effort, stiffness, time, real(h, o), rate + gain * real(0.5, o))


def strain_of(law: Any, types: SimpleNamespace, key: str) -> Any:
    """Return the device function that asks laws for their response at a joint in its present state."""
    JointState, Response = types.JointState, types.Response

    def strain(e: int, i: int, m: Any, x: Any, effort: Any, gain: Any, fx: Any, h: wp.float64, time: Any):
        """Return the laws' response at joint i, of its present coordinate, velocity, pre-load, effort and spring.

        In the step its rate gains about as much as in the one before, ``gain``.
        """
        w = x.velocity[e, i]
        o = real(0.0, time)
        zero = type(w)(o, o, o)
        like = JointState(w, w, w, w, o, o, o, w)
        held, spring = m.preload[e, i], m.stiffness[e, i]
        j = joint_state(m.kind[e, i], x.coordinate[e, i], w, gain, held, effort, spring, time, h, like)
        return law(e, i, fx, j, Response(zero, zero, o, o))

    return wp.func(strain, name=f"strain_{key}")


@wp.func
def effective_damping(kind: int, own: Any, stiffness: Any, more: Any, extra: Any, axial: Any, h: wp.float64):
    """Damper of a joint: its own, what laws add, and the least one of a ball joint that laws make stiffer.

    About its own axis a segment turns with the inertia I = ``axial`` at least. There an explicit spring K is stable in
    steps of h where h K / 2 <= D + 2 I / h, see `tree.stability`.
    """
    d = own + extra
    o = real(0.0, d)
    if kind == SPHERICAL:
        need = (stiffness + more) * real(LEAST_DAMPER * h, d) - axial * real(wp.float64(2.0) / h, d) - d
        need = where_neg(need, o, need)
        d = d + where_neg(o - more, need, o)
    return d


@wp.func
def skew_square(d: Any, like: Any):
    """|d|^2 1 - d d^T, the inertia of a unit mass at d, of the type of ``like``."""
    o = real(0.0, d.x)
    return type(like)(
        fma(d.y, d.y, d.z * d.z), (o - d.x) * d.y, (o - d.x) * d.z,
        fma(d.x, d.x, d.z * d.z), (o - d.y) * d.z, fma(d.x, d.x, d.y * d.y),
    )  # fmt: skip


@wp.func
def centre_velocity(e: int, row: int, i: int, m: Any, s: Any, arm: Any):
    """Velocity of a point ``arm`` from a joint point, world axes; joint points' velocities are left in ``s.alpha``."""
    p = m.parent[e, i]
    v = add_cross(s.alpha[row, p], s.spin[row, p], s.r[row, i])
    if m.kind[e, i] == PRISMATIC:
        v = v + s.relative[row, i]
    s.alpha[row, i] = v
    return add_cross(v, s.spin[row, i], arm)


@wp.func
def mass_at(e: int, i: int, entry: int, slot: int, fx: Any, like: Any):
    """Centre of the mass that link i carries, in the link's axes, of the type of ``like``; its values are at ``entry``.

    It lies evenly over the last share of the way from the joint to the end, and beside that by what the law says.
    """
    k = slot * PARAMETERS * fx.stride + entry
    half = real(1.0, like.x) - real(0.5, like.x) * fx.parameter[e, k + 3 * fx.stride]
    end = fx.end[e, i]
    x, y = fx.parameter[e, k + fx.stride], fx.parameter[e, k + 2 * fx.stride]
    return type(like)(fma(end.x, half, x), fma(end.y, half, y), end.z * half)


@wp.func
def mass_inertia(e: int, i: int, entry: int, slot: int, arm: Any, pose: Any, fx: Any, like: Any):
    """Inertia about the joint of the mass at ``arm``, in the world's axes, the type of ``like`` a symmetric matrix's.

    m (|a|^2 1 - a a^T), and of a rod of length l about its own centre m / 12 (|l|^2 1 - l l^T).
    """
    k = slot * PARAMETERS * fx.stride + entry
    mass = fx.parameter[e, k]
    own = rotate(pose, fx.end[e, i]) * fx.parameter[e, k + 3 * fx.stride]
    return skew_square(arm, like) * mass + skew_square(own, like) * (mass / real(12.0, mass))


@wp.func
def act(
    e: int, row: int, m: Any, x: Any, u: Any, fx: Any, s: Any, h: wp.float64, time: wp.float64, still: int,
    lapse: wp.float64, at: Present, strain: wp.Function, strips: wp.Function,
):  # fmt: skip
    """Evaluate the laws of joints and links at the present state; seek rest unless ``still`` is MOVING."""
    for i in range(1, m.count[e] + 1):
        v = x.velocity[e, i]
        o = real(0.0, v.x)
        zero = type(v)(o, o, o)
        total = u.effort[e, i]
        if is_on(e, at.tip, fx):
            total = total + held_at(e, i, m, x, fx.hold[e, i])
        stiffness = m.stiffness[e, i]
        damping = fx.damping[e, i]
        back = stiffness
        steep = stiffness
        if at.joint >= 0:
            if fx.bent[e, i] == 1:
                r = strain(e, i, m, x, u.effort[e, i], fx.gain[e, i], fx, lapse, real(time, o))
                total = total + r.torque
                axial = m.inertia[e, i].z
                damping = effective_damping(m.kind[e, i], damping, stiffness, r.stiffness, r.damping, axial, h)
                back = stiffness + r.follows
                steep = stiffness + where_neg(r.stiffness, o, r.stiffness)
        if still != MOVING:
            damping = back * real(h * wp.float64(1.25), o)
        m.damping[e, i] = damping
        fx.effort[e, i] = total + damper_midway(e, i, m, fx, damping, fx.damping[e, i], steep, h)
        if is_on(e, at.link, fx):
            fx.wind[e, i] = zero
            fx.swirl[e, i] = zero
            if still != CALM:
                blown = strips(e, row, i, m, fx, s, real(time, o))
                fx.wind[e, i] = blown.force
                fx.swirl[e, i] = blown.moment


@wp.func
def fold(e: int, row: int, m: Any, x: Any, u: Any, fx: Any, s: Any, h: wp.float64, at: Present):
    """Fold as `articulated.fold_links_loaded` does, with the laws' efforts, wrenches and mass."""
    n = m.count[e]
    for step in range(n):
        i = n - step
        A = own_inertia(e, row, i, m, s)
        mass = m.mass[e, i]
        pose = s.pose[row, i]
        mc = rotate(pose, m.com[e, i]) * mass
        if is_on(e, at.tip, fx):
            if i == fx.tip:
                extra = fx.parameter[e, at.tip * PARAMETERS * fx.stride]
                arm = rotate(pose, mass_at(e, i, 0, at.tip, fx, mc))
                A = A + mass_inertia(e, i, 0, at.tip, arm, pose, fx, A)
                mass = mass + extra
                mc = mc + arm * extra
        B = skew(mc, s.U[row, i])
        pushed = u.force[e, i]
        f = own_force(row, i, s, mass, mc) - pushed
        n0 = add_cross(own_moment(row, i, s, A, mc), pushed, rotate(pose, u.point[e, i]))
        if is_on(e, at.link, fx):
            f = f - fx.wind[e, i]
            n0 = n0 - fx.swirl[e, i]
        fold_link(e, row, i, m, x, s, h, A, B, mass, n0, f, fx.effort[e, i])


@cache
def step_of(width: int, precision: int, terms: tuple[Term, ...]) -> SimpleNamespace:
    """Return the device functions ``advance`` (one step with all terms), ``joint`` and ``force`` (the chains)."""
    t = effect_types(width, precision)
    key = f"{width}_{precision}_" + "_".join(term.name for term in terms)
    joint, force = laws_of("joint", terms, t, key), laws_of("force", terms, t, key)
    strain, strips = strain_of(joint, t, key), strips_of(terms, t, key, len(terms) + GROUPS.index("crowned"))
    at_joint = 0 if any(acts(term, "joint") for term in terms) else -1
    at_link, tip = group_place(terms, "link"), slot_of(terms, "tip_mass")

    def advance(
        e: int, row: int, m: Any, x: Any, u: Any, fx: Any, s: Any, h: wp.float64, time: wp.float64, bound: wp.float64,
        still: int, lapse: wp.float64,
    ):  # fmt: skip
        """Take one semi-implicit step of length h [s] at an absolute time [s], all terms included (`midway`).

        Of a step that seeks rest h is no time: what laws remember goes on by ``lapse`` [s], h in one that moves.
        """
        at = Present(at_joint, at_link, tip)
        place_root(e, row, m, s)
        if still != MOVING:
            set_out_from(e, m, x, fx)
        look_forward(e, m, x, fx)
        place_links(e, row, m, x, s)
        look_again(e, m, x, fx)
        act(e, row, m, x, u, fx, s, h, time, still, lapse, at, strain, strips)
        fold(e, row, m, x, u, fx, s, h, at)
        advance_links(e, row, m, x, s, h, bound)
        x.tick[e] = x.tick[e] + 1

    advance = wp.func(advance, name=f"advance_{key}")
    return SimpleNamespace(types=t, key=key, advance=advance, joint=joint, force=force)
