"""Where a tree stands, how it is turned, and where the hand is to go: one place for each masked world.

A place is drawn from counters (`kernels.lanes.philox`): seed, world and episode alone decide, so a resumed run places
every world where it would have been. Of several attempts the first is taken that breaks no rule, else the one that
breaks them least:

- the arm at home lies ``gap`` off the branches at least,
- the target lies ``free`` off all wood in its rest pose, and ``least`` off the hand at home.

Nothing ever touches the target: it is a point, with no body.
"""

import warp as wp

from ..lanes.philox import TURN, uniform4
from .scene import between, outside, planted, segment_gap

__all__ = ["Forest", "Ranges", "place_reach"]


@wp.struct
class Forest:
    """Constants: every world's tree in the tree's frame, the arm at home, what is fixed.

    ``start``, ``end``, ``radius`` [trees, capsules] are capsules, ``count`` says how many, ``fork`` is the height of
    the trunk's upper end, ``tree`` the number of each world's tree. ``home_*`` are the arm's capsules at home and
    ``hand`` its hand, ``shoulder`` where reach is measured from. ``turn`` [worlds] is a world's own turn of its tree,
    not drawn if it is 0 or more, and ``fixed`` [worlds] its own target, drawn where ``is_fixed`` is 0.
    """

    start: wp.array2d(dtype=wp.vec3)
    end: wp.array2d(dtype=wp.vec3)
    radius: wp.array2d(dtype=wp.float32)
    count: wp.array(dtype=int)
    fork: wp.array(dtype=wp.float32)
    tree: wp.array(dtype=int)
    home_start: wp.array(dtype=wp.vec3)
    home_end: wp.array(dtype=wp.vec3)
    home_radius: wp.array(dtype=wp.float32)
    hand: wp.vec3
    shoulder: wp.vec3
    turn: wp.array(dtype=wp.float32)
    fixed: wp.array(dtype=wp.vec3)
    is_fixed: int


@wp.struct
class Ranges:
    """Ranges of uniform draws in m and rad, and bounds."""

    distance: wp.vec2
    bearing: wp.vec2
    height: wp.vec2
    reach: wp.vec2
    spread: float
    rise: wp.vec2
    gap: float
    free: float
    least: float
    attempts: int


@wp.struct
class Spot:
    """Foot and turn of a tree, and a target."""

    root: wp.vec3
    turn: float
    target: wp.vec3


@wp.func
def suggest(a: Forest, r: Ranges, key: wp.vec2ui, world: int, episode: int, attempt: int) -> Spot:
    """Draw one place of tree and target, the target evenly in the volume of a part of a shell about the shoulder."""
    u = uniform4(key, world, episode, attempt, 0)
    v = uniform4(key, world, episode, attempt, 1)
    spot = Spot()
    bearing = between(r.bearing, u[0])
    root = between(r.distance, u[1]) * wp.vec3(wp.cos(bearing), wp.sin(bearing), 0.0)
    spot.root = root + wp.vec3(0.0, 0.0, between(r.height, u[2]) - a.fork[a.tree[world]])
    spot.turn = wp.where(a.turn[world] >= 0.0, a.turn[world], TURN * u[3])
    if a.is_fixed == 1:
        spot.target = a.fixed[world]
        return spot
    far = wp.pow(between(wp.vec2(wp.pow(r.reach[0], 3.0), wp.pow(r.reach[1], 3.0)), v[0]), 1.0 / 3.0)
    side = bearing + r.spread * (2.0 * v[1] - 1.0)
    up = between(wp.vec2(wp.sin(r.rise[0]), wp.sin(r.rise[1])), v[2])
    level = wp.sqrt(1.0 - up * up)
    spot.target = a.shoulder + far * wp.vec3(level * wp.cos(side), level * wp.sin(side), up)
    return spot


@wp.func
def broken_by(a: Forest, r: Ranges, world: int, spot: Spot) -> float:
    """How far a place breaks the rules [m]."""
    tree = a.tree[world]
    breach = wp.max(0.0, r.least - wp.length(spot.target - a.hand))
    for i in range(a.count[tree]):
        p = planted(a.start[tree, i], spot)
        q = planted(a.end[tree, i], spot)
        breach = breach + wp.max(0.0, r.free + a.radius[tree, i] - segment_gap(spot.target, spot.target, p, q))
        for k in range(a.home_start.shape[0]):
            thick = a.home_radius[k] + a.radius[tree, i] + r.gap
            breach = breach + wp.max(0.0, thick - segment_gap(a.home_start[k], a.home_end[k], p, q))
    return breach


@wp.kernel(enable_backward=False)
def place_reach(
    mask_in: wp.array(dtype=wp.bool),
    episode_in: wp.array(dtype=int),
    forest_in: Forest,
    ranges_in: Ranges,
    key_in: wp.vec2ui,
    root_out: wp.array(dtype=wp.vec3),
    turn_out: wp.array(dtype=wp.vec4),
    target_out: wp.array(dtype=wp.vec3),
    breach_out: wp.array(dtype=wp.float32),
):
    """Place tree and target of the masked worlds."""
    world = wp.tid()
    if not mask_in[world]:
        return
    best = wp.int32(0)
    attempt = wp.int32(0)
    least = wp.float32(wp.inf)
    while least > 0.0 and attempt < ranges_in.attempts:
        breach = broken_by(forest_in, ranges_in, world, suggest(forest_in, ranges_in, key_in, world,
                                                                episode_in[world], attempt))  # fmt: skip
        if breach < least:
            least = breach
            best = attempt
        attempt = attempt + 1
    spot = suggest(forest_in, ranges_in, key_in, world, episode_in[world], best)
    root_out[world] = spot.root
    turn_out[world] = wp.vec4(wp.cos(0.5 * spot.turn), 0.0, 0.0, wp.sin(0.5 * spot.turn))
    target_out[world] = spot.target
    breach_out[world] = least
