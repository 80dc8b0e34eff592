"""Finding contacts: spheres around capsules in the lanes of a group, then capsules against capsules world by world."""

from typing import Any

import warp as wp

from ..lanes.across import max_, min_
from ..lanes.algebra import add, add_cross, cross, dot, mul, rotate, sub, sub_scaled, vec3_of
from ..lanes.real import any_neg, div, fma, lane, lane_neg, real, sqrt_
from .arm import entry_vec
from .collide import nearest_on_segments
from .law import BASE, GROUND, LINE, NONE, Contact, ContactRule, add_contact

__all__ = ["find_arm_contacts", "find_branch_contacts", "find_crossings", "note_arms", "note_line"]


@wp.func(inline=True)
def note_arms(row: int, a: Any, g: Any, touch: Any):
    """Write down where the arms' capsules are: middle, half axis and 1 / |half axis|^2."""
    n = a.shape_link.shape[0]
    for c in range(n):
        start = g.start[row, c]
        half = (g.end[row, c] - start) * 0.5
        length = max_(dot(half, half), real(1.0e-12, half.x))
        inverse = real(1.0, length) / length
        touch.near[row, c] = start + half
        touch.near[row, n + 3 + c] = half
        touch.near[row, 2 * n + 3 + c] = type(half)(inverse, inverse, inverse)


@wp.func(inline=True)
def note_line(w: int, row: int, lane_: int, arms: int, rule: ContactRule, touch: Any, speed: float):
    """Write down for the group's lanes where the line is, and how fast the arm may be."""
    start = rule.line_start[w]
    along = wp.normalize(rule.line_end[w] - start)
    for axis in range(3):
        touch.near_entry[row, arms, axis, lane_] = start[axis]
        touch.near_entry[row, arms + 1, axis, lane_] = along[axis]
        touch.near_entry[row, arms + 2, axis, lane_] = speed


@wp.func
def crossing(p: wp.vec3, p1: wp.vec3, q: wp.vec3, q1: wp.vec3, reach: float):
    """Gap, normal from q's capsule to p's and the point between their surfaces, of radii that sum to ``reach``."""
    s, t = nearest_on_segments(p, p1, q, q1)
    on_p = p + s * (p1 - p)
    on_q = q + t * (q1 - q)
    d = on_p - on_q
    length = wp.length(d)
    normal = wp.vec3(0.0, 0.0, 1.0)
    if length > 1.0e-9:
        normal = d / length
    else:
        across = wp.cross(p1 - p, q1 - q)
        if wp.length(across) > 1.0e-12:
            normal = wp.normalize(across)
    return length - reach, normal, on_q


# ---- the arm with what does not move, and with itself ----------------------------------------------------------------


@wp.func
def add_arm_contact(w: int, rule: ContactRule, link: int, other: int, gap: float, normal: wp.vec3, point: wp.vec3):
    """Keep a contact of the arm's link with the line or the ground (``other`` -1), or with another link."""
    c = Contact()
    c.body = link
    c.other = other
    c.gap = gap
    c.normal = normal
    c.point = point
    add_contact(w, rule, c)


@wp.func(inline=True)
def find_arm_contacts(w: int, row: int, lane_: int, a: Any, g: Any, rule: ContactRule, reach: float):
    """Find contacts of the arm with the line, the ground and itself, up to ``reach`` [m] away."""
    for i in range(a.shape_link.shape[0]):
        link = a.shape_link[i]
        radius = a.shape_radius[i]
        if link >= 0:
            if rule.arm_line == 1:
                gap, normal, point = crossing(
                    entry_vec(g.start_entry, row, i, lane_), entry_vec(g.end_entry, row, i, lane_),
                    rule.line_start[w], rule.line_end[w], radius + rule.line_radius,
                )  # fmt: skip
                if gap < reach:
                    on_surface = point + normal * (rule.line_radius + 0.5 * gap)
                    add_arm_contact(w, rule, link, -1, gap, normal, on_surface)
            if rule.has_ground == 1:
                if link > 0:
                    ground_arm(w, rule, link, entry_vec(g.start_entry, row, i, lane_), radius, reach)
                    ground_arm(w, rule, link, entry_vec(g.end_entry, row, i, lane_), radius, reach)
    if rule.arm_arm == 1:
        for p in range(a.pair.shape[0]):
            i = a.pair[p, 0]
            j = a.pair[p, 1]
            gap, normal, point = crossing(
                entry_vec(g.start_entry, row, j, lane_), entry_vec(g.end_entry, row, j, lane_),
                entry_vec(g.start_entry, row, i, lane_), entry_vec(g.end_entry, row, i, lane_),
                a.shape_radius[i] + a.shape_radius[j],
            )  # fmt: skip
            if gap < reach:
                on_surface = point + normal * (a.shape_radius[i] + 0.5 * gap)
                add_arm_contact(w, rule, a.shape_link[j], a.shape_link[i], gap, normal, on_surface)


@wp.func
def ground_arm(w: int, rule: ContactRule, link: int, end: wp.vec3, radius: float, reach: float):
    """Find whether one end of a capsule of the arm touches the ground."""
    gap = end[2] - radius - rule.ground
    if gap < reach:
        point = wp.vec3(end[0], end[1], rule.ground + 0.5 * gap)
        add_arm_contact(w, rule, link, -1, gap, wp.vec3(0.0, 0.0, 1.0), point)


# ---- branches ------------------------------------------------------------------------------------------------------


@wp.struct
class Piece:
    """One capsule of a branch in one world: the middle and half of its axis in world axes.

    ``link`` is its place in the kernel arrays, ``capsule`` its number in the world, ``world`` -1 where there is none.
    ``reach`` is the gap [m] that a step may close.
    """

    world: int
    lane: int
    link: int
    capsule: int
    middle: wp.vec3
    half: wp.vec3
    radius: float
    reach: float


@wp.func
def piece_of(
    e: int, row: int, width: int, lane_: int, c: int, slot_world: wp.array(dtype=int), shapes: Any, s: Any, centre: Any,
    reach: Any,
):  # fmt: skip
    """Capsule c of the group in the world of one of its lanes."""
    slot = e * width + lane_
    i = shapes.link[e, c]
    piece = Piece()
    piece.world = slot_world[slot]
    piece.lane = lane_
    piece.link = i
    piece.capsule = shapes.slot_capsule[slot, c]
    if piece.capsule < 0:
        piece.world = -1
    piece.middle = vec3_of(centre, lane_)
    piece.half = vec3_of(rotate(s.pose[row, i], shapes.half[e, c]), lane_)
    piece.radius = lane(shapes.radius[e, c], lane_)
    piece.reach = lane(reach, lane_) - lane(shapes.bound[e, c], lane_)
    return piece


@wp.func
def nominal_velocity(row: int, lane_: int, i: int, lever: wp.vec3, s: Any, touch: Any, h: float):
    """Velocity of a link's point after the step with joint accelerations zero; gravity is not in it."""
    spin = vec3_of(s.spin[row, i], lane_)
    nominal = vec3_of(s.accel0[row, i], lane_) - vec3_of(s.accel0[row, 0], lane_)
    nominal = nominal + wp.cross(vec3_of(s.alpha0[row, i], lane_), lever) + wp.cross(spin, wp.cross(spin, lever))
    return vec3_of(touch.velocity[row, i], lane_) + wp.cross(spin, lever) + h * nominal


@wp.func
def contact_of(
    piece: Piece, row: int, body: int, gap: float, normal: wp.vec3, point: wp.vec3, s: Any, touch: Any, h: float
):  # fmt: skip
    """Return the contact of a branch with something at a point."""
    c = Contact()
    c.link = piece.link
    c.capsule = piece.capsule
    c.body = body
    c.other = -1
    c.gap = gap
    c.normal = normal
    c.point = point
    c.lever = point - vec3_of(touch.at[row, piece.link], piece.lane)
    c.branch = nominal_velocity(row, piece.lane, piece.link, c.lever, s, touch, h)
    return c


@wp.func(inline=True)
def find_crossings(
    e: int, row: int, width: int, slot_world: wp.array(dtype=int), rule: ContactRule, shapes: Any, s: Any, touch: Any,
    h: float,
):  # fmt: skip
    """Find contacts of branches with branches, of the pairs that may touch."""
    for n in range(shapes.pairs[e]):
        c = shapes.pair[e, n, 0]
        b = shapes.pair[e, n, 1]
        lanes = shapes.pair[e, n, 2]
        d = touch.centre[row, c] - touch.centre[row, b]
        far = touch.reach[row, c] + touch.reach[row, b]
        verdict = dot(d, d) - far * far
        if any_neg(verdict):
            for lane_ in range(width):
                if lane_neg(verdict, lane_) and ((lanes >> lane_) & 1) == 1:
                    one = piece_of(e, row, width, lane_, c, slot_world, shapes, s, touch.centre[row, c],
                                   touch.reach[row, c])  # fmt: skip
                    two = piece_of(e, row, width, lane_, b, slot_world, shapes, s, touch.centre[row, b],
                                   touch.reach[row, b])  # fmt: skip
                    meet_branch(one, two, row, rule, s, touch, h)


@wp.func
def meet_branch(one: Piece, two: Piece, row: int, rule: ContactRule, s: Any, touch: Any, h: float):
    """A branch's capsule against another branch's."""
    if one.world >= 0 and two.world >= 0:
        gap, normal, point = crossing(one.middle - one.half, one.middle + one.half, two.middle - two.half,
                                      two.middle + two.half, one.radius + two.radius)  # fmt: skip
        if gap < one.reach + two.reach:
            on_surface = point + normal * (two.radius + 0.5 * gap)
            c = contact_of(one, row, NONE, gap, normal, on_surface, s, touch, h)
            c.second_link = two.link
            c.second_capsule = two.capsule
            c.second_lever = on_surface - vec3_of(touch.at[row, two.link], two.lane)
            c.branch = c.branch - nominal_velocity(row, two.lane, two.link, c.second_lever, s, touch, h)
            add_contact(one.world, rule, c)


@wp.func(inline=True)
def beside(d: Any, half: Any, inverse: Any, far: Any):
    """Negative where a point, d from a segment's middle, is nearer to it than ``far``."""
    one = real(1.0, far)
    t = max_(real(-1.0, far), min_(one, dot(d, half) * inverse))
    off = sub_scaled(d, half, t)
    return dot(off, off) - far * far


@wp.func(inline=True)
def find_branch_contacts(
    e: int, row: int, width: int, slot_world: wp.array(dtype=int), a: Any, g: Any, rule: ContactRule, shapes: Any,
    s: Any, touch: Any, with_line: int, h: float,
):  # fmt: skip
    """Find contacts of all branches of a group, as far away as branch and arm may come in a step, lane by lane."""
    arms = a.shape_link.shape[0]
    speed = touch.near[row, arms + 2].x
    for c in range(shapes.count[e]):
        i = shapes.link[e, c]
        spin = s.spin[row, i]
        middle = rotate(s.pose[row, i], shapes.middle[e, c])
        bound = shapes.bound[e, c]
        centre = touch.at[row, i] + middle
        v = add_cross(touch.velocity[row, i], spin, middle)
        pace = sqrt_(dot(v, v)) + sqrt_(dot(spin, spin)) * bound
        reach = fma(pace + speed, real(h, bound), bound)
        touch.centre[row, c] = centre
        touch.reach[row, c] = reach
        if rule.arm_branch == 1:
            for j in range(arms):
                d = centre - touch.near[row, j]
                far = reach + real(rule.arm_bound[j], bound)
                verdict = dot(d, d) - far * far
                if any_neg(verdict):
                    verdict = beside(d, touch.near[row, arms + 3 + j], touch.near[row, 2 * arms + 3 + j].x,
                                     reach + real(a.shape_radius[j], bound))  # fmt: skip
                    if any_neg(verdict):
                        for lane_ in range(width):
                            if lane_neg(verdict, lane_):
                                piece = piece_of(e, row, width, lane_, c, slot_world, shapes, s, centre, reach)
                                meet_arm(piece, row, j, a, g, rule, s, touch, h)
        if with_line == 1:
            d = centre - touch.near[row, arms]
            along = touch.near[row, arms + 1]
            off = sub_scaled(d, along, dot(d, along))
            far = reach + real(rule.line_radius, bound)
            verdict = dot(off, off) - far * far
            if any_neg(verdict):
                for lane_ in range(width):
                    if lane_neg(verdict, lane_):
                        piece = piece_of(e, row, width, lane_, c, slot_world, shapes, s, centre, reach)
                        meet_line(piece, row, rule, s, touch, h)
        if rule.has_ground == 1:
            verdict = centre.z - real(rule.ground, bound) - reach
            if any_neg(verdict):
                for lane_ in range(width):
                    if lane_neg(verdict, lane_):
                        piece = piece_of(e, row, width, lane_, c, slot_world, shapes, s, centre, reach)
                        meet_ground(piece, piece.middle - piece.half, row, rule, s, touch, h)
                        meet_ground(piece, piece.middle + piece.half, row, rule, s, touch, h)


@wp.func
def meet_arm(
    piece: Piece, row: int, j: int, a: Any, g: Any, rule: ContactRule, s: Any, touch: Any, h: float
):  # fmt: skip
    """A branch's capsule against one of the arm's."""
    w = piece.world
    if w >= 0:
        start = entry_vec(g.start_entry, row, j, piece.lane)
        end = entry_vec(g.end_entry, row, j, piece.lane)
        gap, normal, point = crossing(piece.middle - piece.half, piece.middle + piece.half, start, end,
                                      piece.radius + a.shape_radius[j])  # fmt: skip
        if gap < piece.reach:
            body = a.shape_link[j]
            if body < 0:
                body = BASE
            on_surface = point + normal * (a.shape_radius[j] + 0.5 * gap)
            add_contact(w, rule, contact_of(piece, row, body, gap, normal, on_surface, s, touch, h))


@wp.func
def meet_line(piece: Piece, row: int, rule: ContactRule, s: Any, touch: Any, h: float):
    """A branch's capsule against the line, in the worlds whose mask lets them touch."""
    w = piece.world
    if w >= 0:
        if rule.line_mask[w] == 1:
            gap, normal, point = crossing(piece.middle - piece.half, piece.middle + piece.half, rule.line_start[w],
                                          rule.line_end[w], piece.radius + rule.line_radius)  # fmt: skip
            if gap < piece.reach:
                on_surface = point + normal * (rule.line_radius + 0.5 * gap)
                add_contact(w, rule, contact_of(piece, row, LINE, gap, normal, on_surface, s, touch, h))


@wp.func
def meet_ground(
    piece: Piece, end: wp.vec3, row: int, rule: ContactRule, s: Any, touch: Any, h: float
):  # fmt: skip
    """One end of a branch's capsule against the ground."""
    if piece.world >= 0:
        gap = end[2] - piece.radius - rule.ground
        if gap < piece.reach:
            point = wp.vec3(end[0], end[1], rule.ground + 0.5 * gap)
            up = wp.vec3(0.0, 0.0, 1.0)
            add_contact(piece.world, rule, contact_of(piece, row, GROUND, gap, up, point, s, touch, h))
