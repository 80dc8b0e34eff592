"""Kernels that place a scene anew in chosen worlds: the tree, the line (or another target), and how the wood behaves.

A place is proposed from the counter-based draws of (seed, world, episode, attempt): the tree at a distance and bearing
from the arm's base, its trunk turned; a point on one of its branches; the target beside that point, so that the branch
reaches ``depth`` into the region around the target where a point counts as occluding (within d_th of its surface). The
first proposal that breaks no rule is taken, else the one that breaks them least:

- branches occlude: expected pairs of points within d_th, N_b N_c sum_s (A_s / A) P(|x_s - y| < d_th), within the bounds
  asked for, by a least number of branches;
- one arm can clear the target, where that is asked for: no branch nearer to the target's axis than ``depth`` allows,
  wood too firm to be pushed not at all, not more than so many pairs;
- the target's nearest part lies within reach; the arm's home pose is free of the branches and of the target.
"""

from typing import Any

import warp as wp

from ..lanes.philox import TURN, uniform4

__all__ = ["NO_ATTEMPT", "SceneArrays", "SceneRules", "place_scene", "plant_roots", "scale_joints", "try_places"]

GOLDEN_ANGLE = wp.constant(2.399963229728653)
AXIS_POINTS = wp.constant(6)  # quadrature points on the axis of a branch's capsule
TARGET_POINTS = wp.constant(48)  # and on the target
TINY = wp.constant(1.0e-9)
NO_ATTEMPT = wp.constant(2147483647)


@wp.struct
class SceneArrays:
    """Branches in their tree's frame, joints at zero ([trees, capsules], radius 0 = none), and the arm at home."""

    start: wp.array2d(dtype=wp.vec3)
    end: wp.array2d(dtype=wp.vec3)
    radius: wp.array2d(dtype=wp.float32)
    firm: wp.array2d(dtype=int)
    soft: wp.array2d(dtype=int)
    count: wp.array(dtype=int)
    num_soft: wp.array(dtype=int)
    fork: wp.array(dtype=wp.float32)
    tree: wp.array(dtype=int)
    home_start: wp.array(dtype=wp.vec3)
    home_end: wp.array(dtype=wp.vec3)
    home_radius: wp.array(dtype=wp.float32)
    shoulder: wp.vec3


@wp.struct
class SceneRules:
    """Ranges (low, high) of uniform draws, and bounds; metres and radians."""

    distance: wp.vec2
    bearing: wp.vec2
    height: wp.vec2
    length: wp.vec2
    depth: wp.vec2
    reach: wp.vec2
    stiffness: wp.vec2
    damping: wp.vec2
    friction: wp.vec2
    tilt: float
    side: float
    shift: float
    clearance: float
    near: float
    gap: float
    target_gap: float
    pairs: wp.vec2
    branches: float
    feasible: int
    points: float
    strips: int
    width: float
    rounded: int
    attempts: int


@wp.struct
class Place:
    """Where the tree stands and how it is turned, and the target's axis."""

    root: wp.vec3
    turn: float
    start: wp.vec3
    end: wp.vec3
    across: wp.vec3
    spot: wp.vec3


@wp.func
def between(bounds: wp.vec2, u: float) -> float:
    """Number a share u, 0 to 1, of the way from the first bound to the second."""
    return bounds[0] + (bounds[1] - bounds[0]) * u


@wp.func
def between_log(bounds: wp.vec2, u: float) -> float:
    """Number whose logarithm is uniform between the bounds' logarithms."""
    return bounds[0] * wp.pow(bounds[1] / bounds[0], u)


@wp.func
def planted(p: wp.vec3, place: Any) -> wp.vec3:
    """Point of the tree's frame in world axes: turned about z by ``place.turn``, then moved to ``place.root``."""
    c = wp.cos(place.turn)
    s = wp.sin(place.turn)
    return place.root + wp.vec3(c * p[0] - s * p[1], s * p[0] + c * p[1], p[2])


@wp.func
def propose(a: SceneArrays, r: SceneRules, key: wp.vec2ui, world: int, episode: int, attempt: int) -> Place:
    """Draw one place of tree and target."""
    u = uniform4(key, world, episode, attempt, 0)
    v = uniform4(key, world, episode, attempt, 1)
    w = uniform4(key, world, episode, attempt, 2)
    place = Place()
    bearing = between(r.bearing, u[1])
    outward = wp.vec3(wp.cos(bearing), wp.sin(bearing), 0.0)
    tree = a.tree[world]
    place.root = outward * between(r.distance, u[0]) + wp.vec3(0.0, 0.0, between(r.height, u[3]) - a.fork[tree])
    place.turn = TURN * u[2]
    s = a.soft[tree, wp.min(int(v[0] * float(a.num_soft[tree])), a.num_soft[tree] - 1)]
    place.spot = planted(wp.lerp(a.start[tree, s], a.end[tree, s], v[1]), place)
    # within the tilt of the axis through trunk and base, uniform over the cone's disc
    sideways = wp.vec3(-outward[1], outward[0], 0.0)
    tilt = r.tilt * wp.sqrt(w[0])
    off = wp.cos(TURN * w[1]) * sideways + wp.sin(TURN * w[1]) * wp.vec3(0.0, 0.0, 1.0)
    along = wp.cos(tilt) * outward + wp.sin(tilt) * off
    flat = wp.normalize(wp.cross(wp.vec3(0.0, 0.0, 1.0), along))
    above = wp.cross(along, flat)
    # beside the branch, to the left or right, within ``side`` of level
    left = wp.where(v[3] < 0.5, 1.0, -1.0)
    slope = r.side * (2.0 * wp.abs(2.0 * v[3] - 1.0) - 1.0)
    beside = wp.cos(slope) * left * flat + wp.sin(slope) * above
    middle = place.spot + beside * (r.clearance + r.near - between(r.depth, v[2]))
    length = between(r.length, w[2])
    middle = middle + along * (length * r.shift * (2.0 * w[3] - 1.0))
    place.start = middle - along * (0.5 * length)
    place.end = middle + along * (0.5 * length)
    place.across = flat
    return place


@wp.func
def segment_gap(p: wp.vec3, q: wp.vec3, a: wp.vec3, b: wp.vec3) -> float:
    """Least distance of two segments."""
    return wp.closest_point_edge_edge(p, q, a, b, TINY)[2]


@wp.func
def strip_offset(i: int, r: SceneRules, place: Place) -> wp.vec3:
    """Way from the target's middle axis to its strip i: strips lie side by side over the width."""
    share = (float(i) + 0.5) / float(r.strips) - 0.5
    return share * r.width * place.across


@wp.func
def target_gap(p: wp.vec3, q: wp.vec3, r: SceneRules, place: Place) -> float:
    """Least distance of a segment from the axes of the target's strips."""
    least = segment_gap(p, q, place.start, place.end)
    for i in range(r.strips):
        o = strip_offset(i, r, place)
        least = wp.min(least, segment_gap(p, q, place.start + o, place.end + o))
    return least


@wp.func
def target_point(i: int, r: SceneRules, place: Place) -> wp.vec3:
    """Point i of TARGET_POINTS that cover the target evenly: a spiral around each strip, or on the sphere."""
    turn = GOLDEN_ANGLE * float(i)
    t = (float(i) + 0.5) / float(TARGET_POINTS)
    if r.rounded == 1:
        z = 1.0 - 2.0 * t
        c = wp.sqrt(wp.max(0.0, 1.0 - z * z))
        return place.start + r.clearance * wp.vec3(c * wp.cos(turn), c * wp.sin(turn), z)
    above = wp.normalize(wp.cross(place.across, place.end - place.start))
    foot = wp.lerp(place.start, place.end, t) + strip_offset(i % r.strips, r, place)
    return foot + r.clearance * (wp.cos(turn) * place.across + wp.sin(turn) * above)


@wp.func
def share_near(x: wp.vec3, r: SceneRules, place: Place) -> float:
    """Share of the target's points within ``near`` of a point."""
    found = wp.float32(0.0)
    for i in range(TARGET_POINTS):
        if wp.length_sq(target_point(i, r, place) - x) < r.near * r.near:
            found = found + 1.0
    return found / float(TARGET_POINTS)


@wp.func
def outside(value: float, bounds: wp.vec2) -> float:
    """How far a value lies outside its bounds."""
    return wp.max(0.0, wp.max(bounds[0] - value, value - bounds[1]))


@wp.func
def wood_at(a: SceneArrays, r: SceneRules, tree: int, place: Place) -> wp.vec3:
    """What reaches into the region of a place where points occlude.

    How far firm wood does, and other branches deeper than ``depth`` allows [m], both summed; the number of branches
    (capsules).
    """
    out = wp.vec3(0.0, 0.0, 0.0)
    for s in range(a.count[tree]):
        gap = target_gap(planted(a.start[tree, s], place), planted(a.end[tree, s], place), r, place)
        reaching = r.clearance + r.near - gap
        if reaching > 0.0:
            out[2] = out[2] + 1.0
        if a.firm[tree, s] == 1:
            out[0] = out[0] + wp.max(0.0, reaching + a.radius[tree, s])
        else:
            out[1] = out[1] + wp.max(0.0, reaching - r.depth[1])
    return out


@wp.func
def expected_pairs(a: SceneArrays, r: SceneRules, tree: int, place: Place) -> float:
    """Pairs of points expected within d_th."""
    pairs = wp.float32(0.0)
    area = wp.float32(0.0)
    for s in range(a.count[tree]):
        p = planted(a.start[tree, s], place)
        q = planted(a.end[tree, s], place)
        size = a.radius[tree, s] * wp.length(q - p)
        area = area + size
        if target_gap(p, q, r, place) < r.clearance + r.near:
            for j in range(AXIS_POINTS):
                x = wp.lerp(p, q, (float(j) + 0.5) / float(AXIS_POINTS))
                pairs = pairs + size * share_near(x, r, place) / float(AXIS_POINTS)
    return r.points * r.points * pairs / wp.max(area, TINY)


@wp.func
def branch_breach(a: SceneArrays, r: SceneRules, tree: int, place: Place) -> float:
    """How far the branches break the rules of occlusion [m]; every branch that lacks, and pairs, count up to d_th.

    Pairs are dear, and asked for only where the other rules hold; else they count as d_th.
    """
    wood = wood_at(a, r, tree, place)
    breach = r.near * wp.max(0.0, r.branches - wood[2])
    bounds = r.pairs
    if r.feasible == 1:
        breach = breach + wood[0] + wood[1]
    else:
        bounds[1] = wp.float32(wp.inf)
    if breach > 0.0:
        return breach + r.near
    return r.near * wp.min(1.0, outside(expected_pairs(a, r, tree, place), bounds) / r.pairs[0])


@wp.func
def arm_breach(a: SceneArrays, r: SceneRules, tree: int, place: Place) -> float:
    """How deep the arm at home lies in the branches or too near to the target [m]."""
    breach = wp.float32(0.0)
    for k in range(a.home_start.shape[0]):
        h = a.home_start[k]
        t = a.home_end[k]
        thick = a.home_radius[k]
        if thick > 0.0:
            breach = breach + wp.max(0.0, thick + r.target_gap - target_gap(h, t, r, place))
            for s in range(a.count[tree]):
                p = planted(a.start[tree, s], place)
                q = planted(a.end[tree, s], place)
                breach = breach + wp.max(0.0, thick + a.radius[tree, s] + r.gap - segment_gap(h, t, p, q))
    return breach


@wp.func
def breach_of(a: SceneArrays, r: SceneRules, tree: int, place: Place) -> float:
    """How far a place breaks the rules [m]; the dearest rule is asked last, and only where the others hold."""
    nearest = wp.closest_point_edge_edge(place.spot, place.spot, place.start, place.end, TINY)[1]
    handle = wp.lerp(place.start, place.end, nearest)
    breach = outside(wp.length(handle - a.shoulder), r.reach) + outside(wp.length(place.spot - a.shoulder), r.reach)
    if breach == 0.0:
        breach = branch_breach(a, r, tree, place)
        if breach == 0.0:
            return arm_breach(a, r, tree, place)
        return breach + 1.0
    return breach + 2.0


@wp.kernel(enable_backward=False)
def try_places(
    mask_in: wp.array(dtype=wp.bool),
    episode_in: wp.array(dtype=int),
    arrays_in: SceneArrays,
    rules_in: SceneRules,
    key_in: wp.vec2ui,
    attempt_out: wp.array2d(dtype=int),
    breach_out: wp.array2d(dtype=wp.float32),
    first_out: wp.array(dtype=int),
):
    """Find the best of every runs-th attempt: the first that breaks no rule, else the one that breaks them least.

    A run ends where another has found, at an earlier attempt, a place that breaks no rule. Which attempts are tried
    then depends on how threads are scheduled, but the earliest such place is always among them. ``first_out`` [worlds]
    is it, `NO_ATTEMPT` before; it is read by an atomic operation, since other threads write it meanwhile.
    """
    world, run = wp.tid()
    if not mask_in[world]:
        return
    best = run
    least = wp.float32(wp.inf)
    attempt = run
    while least > 0.0 and attempt < rules_in.attempts and attempt < wp.atomic_min(first_out, world, NO_ATTEMPT):
        place = propose(arrays_in, rules_in, key_in, world, episode_in[world], attempt)
        breach = breach_of(arrays_in, rules_in, arrays_in.tree[world], place)
        if breach < least:
            least = breach
            best = attempt
        if breach == 0.0:
            wp.atomic_min(first_out, world, attempt)
        attempt = attempt + attempt_out.shape[1]
    attempt_out[world, run] = best
    breach_out[world, run] = least


@wp.kernel(enable_backward=False)
def place_scene(
    mask_in: wp.array(dtype=wp.bool),
    episode_in: wp.array(dtype=int),
    arrays_in: SceneArrays,
    rules_in: SceneRules,
    key_in: wp.vec2ui,
    attempt_in: wp.array2d(dtype=int),
    tried_in: wp.array2d(dtype=wp.float32),
    offset_out: wp.array(dtype=wp.vec3),
    turn_out: wp.array(dtype=wp.vec4),
    line_start_out: wp.array(dtype=wp.vec3),
    line_end_out: wp.array(dtype=wp.vec3),
    strip_start_out: wp.array2d(dtype=wp.vec3),
    strip_end_out: wp.array2d(dtype=wp.vec3),
    stiffness_out: wp.array(dtype=wp.float32),
    damping_out: wp.array(dtype=wp.float32),
    friction_out: wp.array(dtype=wp.float32),
    breach_out: wp.array(dtype=wp.float32),
    crowd_out: wp.array(dtype=wp.vec4),
    first_out: wp.array(dtype=int),
):
    """Place tree and target of the masked worlds, and draw the scales of stiffness, damping and friction.

    Of the runs' finds the earliest of the best is taken, so that the number of runs changes nothing. ``first_out`` is
    left as `try_places` needs it the next time.
    """
    world = wp.tid()
    if not mask_in[world]:
        return
    episode = episode_in[world]
    least = tried_in[world, 0]
    attempt = attempt_in[world, 0]
    for run in range(1, attempt_in.shape[1]):
        other = tried_in[world, run]
        if other < least or (other == least and attempt_in[world, run] < attempt):
            least = other
            attempt = attempt_in[world, run]
    best = propose(arrays_in, rules_in, key_in, world, episode, attempt)
    offset_out[world] = best.root
    turn_out[world] = wp.vec4(wp.cos(0.5 * best.turn), 0.0, 0.0, wp.sin(0.5 * best.turn))
    line_start_out[world] = best.start
    line_end_out[world] = best.end
    for i in range(rules_in.strips):
        o = strip_offset(i, rules_in, best)
        strip_start_out[world, i] = best.start + o
        strip_end_out[world, i] = best.end + o
    u = uniform4(key_in, world, episode, -1, 0)
    stiffness_out[world] = between_log(rules_in.stiffness, u[0])
    damping_out[world] = between_log(rules_in.damping, u[1])
    friction_out[world] = between(rules_in.friction, u[2])
    breach_out[world] = least
    tree = arrays_in.tree[world]
    wood = wood_at(arrays_in, rules_in, tree, best)
    crowd_out[world] = wp.vec4(wood[0], wood[1], expected_pairs(arrays_in, rules_in, tree, best), wood[2])
    first_out[world] = NO_ATTEMPT


@wp.func
def quat_product(a: wp.vec4, b: wp.vec4) -> wp.vec4:
    """Product of two quaternions w, x, y, z."""
    u = wp.vec3(a[1], a[2], a[3])
    v = wp.vec3(b[1], b[2], b[3])
    w = a[0] * v + b[0] * u + wp.cross(u, v)
    return wp.vec4(a[0] * b[0] - wp.dot(u, v), w[0], w[1], w[2])


@wp.kernel(enable_backward=False)
def plant_roots(
    mask_in: wp.array(dtype=wp.bool),
    slot_world_in: wp.array(dtype=int),
    parent_in: wp.array2d(dtype=int),
    root_in: wp.array(dtype=wp.vec3),
    turn_in: wp.array(dtype=wp.vec4),
    nominal_offset_in: wp.array4d(dtype=wp.float32),
    nominal_turn_in: wp.array4d(dtype=wp.float32),
    offset_out: wp.array4d(dtype=wp.float32),
    turn_out: wp.array4d(dtype=wp.float32),
):
    """offset <- root + turn offset_0 and turn <- turn turn_0 of the links on the ground of the masked worlds."""
    g, i = wp.tid()
    lanes = offset_out.shape[3]
    if i > 0:
        if parent_in[g, i] == 0:
            for k in range(lanes):
                world = slot_world_in[g * lanes + k]
                if world >= 0:
                    if mask_in[world]:
                        z = turn_in[world]
                        x = nominal_offset_in[g, i, 0, k]
                        y = nominal_offset_in[g, i, 1, k]
                        c = z[0] * z[0] - z[3] * z[3]
                        s = 2.0 * z[0] * z[3]
                        offset_out[g, i, 0, k] = root_in[world][0] + c * x - s * y
                        offset_out[g, i, 1, k] = root_in[world][1] + s * x + c * y
                        offset_out[g, i, 2, k] = root_in[world][2] + nominal_offset_in[g, i, 2, k]
                        q = wp.vec4(0.0, 0.0, 0.0, 0.0)
                        for j in range(4):
                            q[j] = nominal_turn_in[g, i, j, k]
                        q = quat_product(z, q)
                        for j in range(4):
                            turn_out[g, i, j, k] = q[j]


@wp.kernel(enable_backward=False)
def scale_joints(
    mask_in: wp.array(dtype=wp.bool),
    slot_world_in: wp.array(dtype=int),
    scale_in: wp.array(dtype=wp.float32),
    second_scale_in: wp.array(dtype=wp.float32),
    nominal_in: wp.array4d(dtype=wp.float32),
    field_out: wp.array4d(dtype=wp.float32),
):
    """field <- scale second_scale nominal at every joint of the masked worlds."""
    g, i = wp.tid()
    lanes = field_out.shape[3]
    for k in range(lanes):
        world = slot_world_in[g * lanes + k]
        if world >= 0:
            if mask_in[world]:
                field_out[g, i, 0, k] = scale_in[world] * second_scale_in[world] * nominal_in[g, i, 0, k]
