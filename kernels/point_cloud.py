"""Points on capsules and cylinders, as a camera would see them: three clouds a world, drawn anew at every tick.

A capsule of radius r whose axis has length L has the area 2 pi r (L + 2 r), and equal lengths of its whole extent from
-r to L + r carry equal areas (Archimedes' hat-box theorem holds for the caps). So one number in (0, area of all
capsules) picks a capsule, in proportion to its area, and the place along its axis together; a second one
is the angle about it.

The first numbers are drawn in ascending order: with E_0 ... E_N exponential, (E_0 + ... + E_i) / (E_0 + ... + E_N) are
the order statistics of N independent uniform numbers (Devroye, Non-Uniform Random Variate Generation, 1986, V.2.1). As
a set the points are independent; in memory neighbours are neighbours in space, so that 8 or 16 of them have a small box
and most pairs of boxes need no look at their points. Everything computed from a cloud is symmetric in its points.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from .lanes import (
    below,
    greatest,
    key_of,
    lane_sum,
    least,
    log_,
    max_,
    min_,
    running_sum,
    short_cosine,
    short_sine,
    uniform,
    uniform_high,
    uniform_low,
)
from .real import SOURCE, add, div, fma, fnma, lane, mul, real, real_type, sqrt_, sub, where_neg

__all__ = ["BRANCHES", "NUM_CLOUDS", "ROBOT", "TARGET", "cloud_types", "sample_kernel"]

ROBOT = wp.constant(0)
TARGET = wp.constant(1)
BRANCHES = wp.constant(2)
NUM_CLOUDS = 3

#: Hashes that a point of a cloud takes: level, angle and two pairs of normal numbers. The spare counts for level N.
STREAMS = wp.constant(5)
ANGLE = wp.constant(1)
NOISE_XY = wp.constant(2)
NOISE_Z = wp.constant(3)
LAST_LEVEL = wp.constant(4)

TWO_PI = wp.constant(6.283185307179586)
FAR_EDGE = wp.constant(1.0e30)


@wp.struct
class Shapes:
    """Capsules to draw points on, per world; radius 0 is none. Ends [m] of axes, world axes."""

    start: wp.array2d(dtype=wp.vec3)
    end: wp.array2d(dtype=wp.vec3)
    radius: wp.array2d(dtype=wp.float32)


@cache
def cloud_types(width: int = 1) -> SimpleNamespace:
    """Return the struct Clouds for a lane width: ``width`` points of a world fill a chunk.

    ``point`` [worlds, clouds, 3, chunks] in m and ``flat`` [worlds, clouds, 3, points] are one memory; ``near``
    [worlds, chunks] is 1 for branch points near the target; ``bound`` and ``box`` (one memory) hold the least and the
    greatest coordinates of chunks [worlds, clouds, 6, ...], whole lanes of them, and then those of the groups of
    ``width`` chunks; ``present`` [worlds, clouds] is 0 for a cloud without points.
    """
    Real = real_type(width)

    @wp.struct
    class Clouds:
        point: wp.array4d(dtype=Real)
        flat: wp.array4d(dtype=wp.float32)
        near: wp.array2d(dtype=Real)
        box: wp.array4d(dtype=Real)
        bound: wp.array4d(dtype=wp.float32)
        present: wp.array2d(dtype=int)

    return SimpleNamespace(Real=Real, Clouds=Clouds)


@wp.func
def shape_area(s: Shapes, w: int, i: int, cap: float):
    """2 pi r (L + 2 r cap) [m^2]: ``cap`` is 1 with round ends, 0 for the side alone."""
    r = s.radius[w, i]
    if r <= 0.0:
        return 0.0
    return TWO_PI * r * (wp.length(s.end[w, i] - s.start[w, i]) + 2.0 * r * cap)


@wp.func
def spacing(key: wp.uint32, n: int, like: Any):
    """Exponential numbers of mean 1."""
    return real(0.0, like) - log_(uniform(key, n, like))


@wp.func
def across(d: wp.vec3):
    """A unit vector square to the unit vector d (Duff et al., Building an Orthonormal Basis, Revisited, JCGT 6 (1))."""
    sign = wp.where(d[2] < 0.0, -1.0, 1.0)
    a = -1.0 / (sign + d[2])
    return wp.vec3(1.0 + sign * d[0] * d[0] * a, sign * d[0] * d[1] * a, -sign * d[0])


@wp.func
def frame_of(axis: wp.vec3):
    """Columns d, n1, n2: the direction of an axis (z for a point) and two unit vectors square to it."""
    length = wp.length(axis)
    d = wp.vec3(0.0, 0.0, 1.0)
    if length > 0.0:
        d = axis / length
    n1 = across(d)
    return wp.matrix_from_cols(d, n1, wp.cross(d, n1))


@wp.func
def on_capsule(
    ahead: Any, cosine: Any, sine: Any, start: wp.vec3, frame: wp.mat33, length: float, r: float, cap: float
):
    """Points of a capsule's surface whose levels are ``ahead`` of the capsule's first:

    a = ahead / (2 pi r) - r cap,  p = start + a d + rho (cos phi n1 + sin phi n2),
    rho^2 = r^2 - (how far a lies beyond the axis)^2
    """
    zero = real(0.0, ahead)
    a = max_(min_(ahead * (1.0 / (TWO_PI * r)) - r * cap, real(length + r * cap, ahead)), real(-r * cap, ahead))
    over = max_(max_(zero - a, a - length), zero)
    rho = sqrt_(max_(fnma(over, over, real(r * r, ahead)), zero))
    u = rho * cosine
    v = rho * sine
    x = fma(a, real(frame[0, 0], a), fma(u, real(frame[0, 1], a), fma(v, real(frame[0, 2], a), real(start[0], a))))
    y = fma(a, real(frame[1, 0], a), fma(u, real(frame[1, 1], a), fma(v, real(frame[1, 2], a), real(start[1], a))))
    z = fma(a, real(frame[2, 0], a), fma(u, real(frame[2, 1], a), fma(v, real(frame[2, 2], a), real(start[2], a))))
    return x, y, z


@wp.func
def draw_levels(w: int, k: int, key: wp.uint32, draw: int, lanes: int, c: Any):
    """Put running sums of exponential numbers into the x of cloud k; return the sum of one more than points."""
    chunks = c.point.shape[3]
    zero = real(0.0, c.point[w, k, 0, 0])
    reached = wp.float32(0.0)
    for j in range(chunks):
        level = running_sum(spacing(key, draw + j * lanes, zero)) + reached
        c.point[w, k, 0, j] = level
        reached = lane(level, lanes - 1)
    return reached + spacing(key, draw + LAST_LEVEL * chunks * lanes, 0.0)


@wp.func
def direction(u: Any):
    """cos and sin of the angle 2 h, h = (u - 1/2) pi, for u in (0, 1)."""
    h = (u - 0.5) * wp.static(0.5 * 6.283185307179586)
    s = short_sine(h)
    return fnma(s, s + s, real(1.0, h)), (s + s) * short_cosine(h)


@wp.func
def spread_points(w: int, k: int, s: Shapes, first: int, last: int, cap: float, key: wp.uint32, lanes: int, c: Any):
    """Draw points on shapes first ... last - 1 of world w into cloud k.

    Shapes come in their order, and so do levels: a chunk is finished by the shape that its last point is on, and stored
    then (a store of some lanes is slow on a CPU).
    """
    total = wp.float32(0.0)
    final = wp.int32(-1)
    for i in range(first, last):
        area = shape_area(s, w, i, cap)
        if area > 0.0:
            total = total + area
            final = i
    c.present[w, k] = wp.where(final < 0, 0, 1)
    chunks = c.point.shape[3]
    draw = k * STREAMS * chunks * lanes
    scale = total / draw_levels(w, k, key, draw, lanes, c)
    angle = draw + ANGLE * chunks * lanes
    j = wp.int32(0)
    level = c.point[w, k, 0, 0] * scale
    cosine, sine = direction(uniform(key, angle, level))
    x = level
    y = level
    z = level
    edge = wp.float32(0.0)
    for i in range(first, final + 1):
        area = shape_area(s, w, i, cap)
        if area > 0.0:
            start_level = edge
            edge = wp.where(i == final, FAR_EDGE, edge + area)
            start = s.start[w, i]
            axis = s.end[w, i] - start
            frame = frame_of(axis)
            length = wp.length(axis)
            r = s.radius[w, i]
            while j < chunks:
                ahead = level - start_level
                px, py, pz = on_capsule(ahead, cosine, sine, start, frame, length, r, cap)
                x = where_neg(ahead, x, px)
                y = where_neg(ahead, y, py)
                z = where_neg(ahead, z, pz)
                if lane(level, lanes - 1) >= edge:
                    break
                c.point[w, k, 0, j] = x
                c.point[w, k, 1, j] = y
                c.point[w, k, 2, j] = z
                j = j + 1
                if j < chunks:
                    level = c.point[w, k, 0, j] * scale
                    cosine, sine = direction(uniform(key, angle + j * lanes, level))


@wp.func
def normal_pair(key: wp.uint32, n: int, sigma: float, like: Any):
    """sigma sqrt(-2 log u1) times cos and sin of 2 pi u2 (Box and Muller), of 16 bits: within 4.9 sigma."""
    size = sqrt_(log_(uniform_high(key, n, like)) * -2.0) * sigma
    cosine, sine = direction(uniform_low(key, n, like))
    return size * cosine, size * sine


@wp.func
def shift(w: int, k: int, m: int, j: int, amount: Any, c: Any):
    """Move coordinate m of the points of chunk j."""
    c.point[w, k, m, j] = c.point[w, k, m, j] + amount


@wp.func
def add_noise(w: int, k: int, sigma: float, key: wp.uint32, lanes: int, c: Any):
    """Move every coordinate of every point by Gaussian noise of deviation sigma [m].

    Three pairs of normal numbers serve two points, one of each half of the cloud; a half is whole chunks of 16.
    """
    chunks = c.point.shape[3]
    half = 16 * ((chunks * lanes + 31) // 32) // lanes
    xy = (k * STREAMS + NOISE_XY) * chunks * lanes
    z = (k * STREAMS + NOISE_Z) * chunks * lanes
    zero = real(0.0, c.point[w, k, 0, 0])
    for j in range(half):
        other = j + half
        up, up_other = normal_pair(key, z + j * lanes, sigma, zero)
        east, north = normal_pair(key, xy + j * lanes, sigma, zero)
        shift(w, k, 0, j, east, c)
        shift(w, k, 1, j, north, c)
        shift(w, k, 2, j, up, c)
        if other < chunks:
            east, north = normal_pair(key, xy + other * lanes, sigma, zero)
            shift(w, k, 0, other, east, c)
            shift(w, k, 1, other, north, c)
            shift(w, k, 2, other, up_other, c)


@wp.func
def bound_chunks(w: int, k: int, lanes: int, c: Any):
    """Note the least and the greatest coordinates of every chunk, and after them of every ``lanes`` chunks."""
    chunks = c.point.shape[3]
    groups = (chunks + lanes - 1) // lanes
    for j in range(chunks):
        for m in range(3):
            p = c.point[w, k, m, j]
            c.bound[w, k, m, j] = least(p)
            c.bound[w, k, 3 + m, j] = greatest(p)
    for g in range(groups):
        for m in range(3):
            c.bound[w, k, m, groups * lanes + g] = least(c.box[w, k, m, g])
            c.bound[w, k, 3 + m, groups * lanes + g] = greatest(c.box[w, k, 3 + m, g])


@wp.func
def mark_near(w: int, k: int, s: Shapes, zoom: float, c: Any):
    """Mark the points that lie nearer than ``zoom`` [m] to the axis of one of the shapes, a segment."""
    for j in range(c.point.shape[3]):
        px = c.point[w, k, 0, j]
        py = c.point[w, k, 1, j]
        pz = c.point[w, k, 2, j]
        o = real(0.0, px)
        found = o
        for i in range(s.radius.shape[1]):
            start = s.start[w, i]
            axis = s.end[w, i] - start
            x = px - start[0]
            y = py - start[1]
            z = pz - start[2]
            along = fma(z, real(axis[2], o), fma(y, real(axis[1], o), x * axis[0]))
            u = min_(max_(along * (1.0 / wp.max(wp.dot(axis, axis), 1.0e-12)), o), real(1.0, o))
            x = fnma(u, real(axis[0], o), x)
            y = fnma(u, real(axis[1], o), y)
            z = fnma(u, real(axis[2], o), z)
            found = max_(found, below(fma(z, z, fma(y, y, x * x)), real(zoom * zoom, o)))
        c.near[w, j] = found


@cache
def sample_kernel(width: int = 1) -> Any:
    """Return the kernel that draws all clouds, thread (world, cloud): robot and branch capsules, and the target.

    ``max_noise_in`` [worlds] is three deviations of the noise [m], ``tick_in`` [worlds] counts the draws.
    """
    t = cloud_types(width)
    Clouds, W = t.Clouds, width

    @wp.kernel(enable_backward=False, module="unique")
    def sample(
        capsules_in: Shapes, num_arm: int, target_in: Shapes, cap: float, zoom: float, seed: int,
        tick_in: wp.array(dtype=int), max_noise_in: wp.array(dtype=wp.float32), first: int, c_out: Clouds,
    ):  # fmt: skip
        tag = SOURCE  # noqa: F841
        i = wp.int32(0)
        k = wp.int32(0)
        if wp.static(W > 1):
            i, k = wp.tid()
        else:
            k, i = wp.tid()  # neighbouring threads are neighbouring worlds
        w = first + i
        key = key_of(seed, w, tick_in[w])
        if k == ROBOT:
            spread_points(w, k, capsules_in, 0, num_arm, 1.0, key, W, c_out)
        elif k == BRANCHES:
            spread_points(w, k, capsules_in, num_arm, capsules_in.radius.shape[1], 1.0, key, W, c_out)
        else:
            spread_points(w, k, target_in, 0, target_in.radius.shape[1], cap, key, W, c_out)
        if max_noise_in[w] > 0.0:
            add_noise(w, k, max_noise_in[w] / 3.0, key, W, c_out)
        if k == BRANCHES:
            mark_near(w, k, target_in, zoom, c_out)
        if wp.static(W > 1):
            bound_chunks(w, k, W, c_out)

    return sample
