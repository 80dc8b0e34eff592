"""Points on capsules and cylinders, as a camera would see them: three clouds a world, drawn anew at every tick.

They are drawn where the surfaces are (`sample_kernel`), which is what rewards are scored on, and then moved by the
noise of a camera (`blur_kernel`), which is what a policy sees.

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

from ..lanes.across import (
    below,
    centred_low,
    cosine_pi,
    greatest,
    key_of,
    least,
    log_,
    max_,
    min_,
    row_greatest,
    row_least,
    running_sum,
    sine_pi,
    uniform_high,
)
from ..lanes.real import SOURCE, add, div, fma, fnma, lane, mul, real, real_type, sqrt_, sub, where_neg

__all__ = [
    "BRANCHES", "NOWHERE", "NUM_CLOUDS", "ROBOT", "TARGET", "TILE", "blur_kernel", "cloud_types", "sample_kernel",
    "side",
]  # fmt: skip

ROBOT = wp.constant(0)
TARGET = wp.constant(1)
BRANCHES = wp.constant(2)
NUM_CLOUDS = 3

#: Hashes set aside for a point of a cloud: level and angle, level N (one a cloud), and two pairs of normal numbers.
STREAMS = wp.constant(4)
LAST_LEVEL = wp.constant(1)
NOISE_XY = wp.constant(2)
NOISE_Z = wp.constant(3)

TWO_PI = wp.constant(6.283185307179586)
TILE = wp.constant(16)  # points that a GPU thread holds in registers, and that share a box
NOWHERE = wp.constant(1.0e18)  # m, where the box of a chunk that does not exist begins
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

    Rows are worlds, of all on a GPU, of those that CPU threads are at on a CPU.

    ``point`` [rows, clouds, 3, chunks] in m and ``flat`` [rows, clouds, 3, points] are one memory; ``near``
    [rows, chunks] is 1 for branch points near the target; ``bound`` and ``box`` (one memory) hold the least and the
    greatest coordinates of chunks [rows, clouds, 6, ...], whole lanes of them, and then those of the groups of
    ``width`` chunks; of every `TILE` points where there are no lanes; ``present`` [rows, clouds] is 0 for a cloud
    without points.
    """
    Real = real_type(width)

    @wp.struct
    class Clouds:
        """Memory of the clouds of some worlds."""

        point: wp.array4d(dtype=Real)
        flat: wp.array4d(dtype=wp.float32)
        near: wp.array2d(dtype=Real)
        box: wp.array4d(dtype=Real)
        bound: wp.array4d(dtype=wp.float32)
        present: wp.array2d(dtype=int)

    return SimpleNamespace(Real=Real, Clouds=Clouds)


def side(width: int) -> int:
    """Return how many neighbouring threads are neighbouring worlds, a kernel's innermost dimension: a warp on a GPU."""
    return 32 if width == 1 else 1


@wp.func
def capsule_area(r: float, length: float, cap: float):
    """2 pi r (L + 2 r cap) [m^2]: ``cap`` is 1 with round ends, 0 for the side alone; 0 where r is not above 0."""
    return TWO_PI * wp.max(r, 0.0) * (length + 2.0 * r * cap)


@wp.func
def across(d: wp.vec3):
    """A unit vector square to the unit vector d (Duff et al., Building an Orthonormal Basis, Revisited, JCGT 6 (1))."""
    sign = wp.where(d[2] < 0.0, -1.0, 1.0)
    a = -1.0 / (sign + d[2])
    return wp.vec3(1.0 + sign * d[0] * d[0] * a, sign * d[0] * d[1] * a, -sign * d[0])


@wp.func
def frame_of(axis: wp.vec3, length: float):
    """Columns d, n1, n2: the direction of an axis (z for a point) and two unit vectors square to it."""
    d = wp.vec3(0.0, 0.0, 1.0)
    if length > 0.0:
        d = axis * (1.0 / length)
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
    a = fma(ahead, real(1.0 / (TWO_PI * r), ahead), real(-r * cap, ahead))
    over = a - min_(max_(a, zero), real(length, ahead))
    rho = sqrt_(max_(fnma(over, over, real(r * r, ahead)), zero))
    u = rho * cosine
    v = rho * sine
    x = fma(a, real(frame[0, 0], a), fma(u, real(frame[0, 1], a), fma(v, real(frame[0, 2], a), real(start[0], a))))
    y = fma(a, real(frame[1, 0], a), fma(u, real(frame[1, 1], a), fma(v, real(frame[1, 2], a), real(start[1], a))))
    z = fma(a, real(frame[2, 0], a), fma(u, real(frame[2, 1], a), fma(v, real(frame[2, 2], a), real(start[2], a))))
    return x, y, z


@wp.func
def direction(h: Any):
    """cos and sin of the angle 2 pi h, h in (-1/2, 1/2)."""
    s = sine_pi(h)
    return fnma(s, s + s, real(1.0, h)), (s + s) * cosine_pi(h)


@wp.func
def draw_levels(key: wp.uint32, n: int, lanes: int, x: Any, y: Any, z: Any):
    """Put running sums of exponential numbers into x, cos and sin of angles into y, z; return the sum of one more."""
    zero = real(0.0, x[0])
    reached = wp.float32(0.0)
    j = wp.int32(0)
    while j < x.shape[0]:
        level = running_sum(zero - log_(uniform_high(key, n + j * lanes, zero))) + reached
        cosine, sine = direction(centred_low(key, n + j * lanes, zero))
        x[j] = level
        y[j] = cosine
        z[j] = sine
        reached = lane(level, lanes - 1)
        j = j + 1
    return reached - log_(uniform_high(key, n + LAST_LEVEL * x.shape[0] * lanes, 0.0))


@wp.func
def shape_of(w: int, i: int, s: Shapes, cap: float):
    """Return radius, start, axis, length and area of shape i of world w."""
    r = s.radius[w, i]
    start = s.start[w, i]
    axis = s.end[w, i] - start
    length = wp.length(axis)
    return r, start, axis, length, capsule_area(r, length, cap)


@wp.func
def measure_shapes(w: int, s: Shapes, first: int, last: int, cap: float):
    """Return the area of shapes first ... last - 1 of world w and which is the last that has any, -1 for none."""
    total = wp.float32(0.0)
    final = wp.int32(-1)
    for i in range(first, last):
        area = capsule_area(s.radius[w, i], wp.length(s.end[w, i] - s.start[w, i]), cap)
        if area > 0.0:
            total = total + area
            final = i
    return total, final


@wp.func
def spread_points(
    w: int, s: Shapes, first: int, last: int, cap: float, row: int, k: int, key: wp.uint32, lanes: int, c: Any
):
    """Draw points on shapes first ... last - 1 of world w into cloud k of a row.

    Shapes come in their order, and so do levels: a chunk is finished by the shape that its last point is on, and stored
    then (a store of some lanes is slow on a CPU).
    """
    total, final = measure_shapes(w, s, first, last, cap)
    c.present[row, k] = wp.where(final < 0, 0, 1)
    xs = c.point[row, k, 0]
    ys = c.point[row, k, 1]
    zs = c.point[row, k, 2]
    chunks = xs.shape[0]
    scale = total / draw_levels(key, k * STREAMS * chunks * lanes, lanes, xs, ys, zs)
    j = wp.int32(0)
    level = xs[0] * scale
    x = level
    y = level
    z = level
    edge = wp.float32(0.0)
    for i in range(first, final + 1):
        r, start, axis, length, area = shape_of(w, i, s, cap)
        if area > 0.0:
            frame = frame_of(axis, length)
            start_level = edge
            edge = wp.where(i == final, FAR_EDGE, edge + area)
            while j < chunks:
                ahead = level - start_level
                px, py, pz = on_capsule(ahead, ys[j], zs[j], start, frame, length, r, cap)
                x = where_neg(ahead, x, px)
                y = where_neg(ahead, y, py)
                z = where_neg(ahead, z, pz)
                if lane(level, lanes - 1) >= edge:
                    break
                xs[j] = x
                ys[j] = y
                zs[j] = z
                j = j + 1
                if j < chunks:
                    level = xs[j] * scale


@wp.func
def sum_levels(key: wp.uint32, n: int, points: int, begin: int):
    """Sum of the exponential numbers before point ``begin``, and of all with one more, added up in one order always."""
    reached = wp.float32(0.0)
    before = wp.float32(0.0)
    for p in range(points):
        if p == begin:
            before = reached
        reached = reached - log_(uniform_high(key, n + p, reached))
    return before, reached - log_(uniform_high(key, n + LAST_LEVEL * points, reached))


@wp.func
def store_point(
    row: int, k: int, p: int, ahead: float, h: float, start: wp.vec3, frame: wp.mat33, length: float, r: float,
    cap: float, c: Any,
):  # fmt: skip
    """Put point p of cloud k on a capsule, its level ``ahead`` of the capsule's first and its angle 2 pi h."""
    cosine, sine = direction(h)
    x, y, z = on_capsule(ahead, cosine, sine, start, frame, length, r, cap)
    c.flat[row, k, 0, p] = x
    c.flat[row, k, 1, p] = y
    c.flat[row, k, 2, p] = z


@wp.func
def spread_part(
    w: int, s: Shapes, first: int, last: int, cap: float, row: int, k: int, key: wp.uint32, begin: int, end: int, c: Any
):
    """Draw points begin ... end - 1 of what `spread_points` draws, to the bit: a GPU thread's part of a cloud.

    Every thread of the cloud adds up all levels, which costs less than a launch that would hand them on.
    """
    total, final = measure_shapes(w, s, first, last, cap)
    c.present[row, k] = wp.where(final < 0, 0, 1)
    points = c.flat.shape[3]
    n = k * STREAMS * points
    reached, whole = sum_levels(key, n, points, begin)
    scale = total / whole
    p = wp.int32(begin)
    reached = reached - log_(uniform_high(key, n + p, reached))
    edge = wp.float32(0.0)
    for i in range(first, final + 1):
        r, start, axis, length, area = shape_of(w, i, s, cap)
        if area > 0.0:
            start_level = edge
            edge = wp.where(i == final, FAR_EDGE, edge + area)
            if p < end and reached * scale < edge:
                frame = frame_of(axis, length)
                while p < end and reached * scale < edge:
                    h = centred_low(key, n + p, reached)
                    store_point(row, k, p, reached * scale - start_level, h, start, frame, length, r, cap, c)
                    p = p + 1
                    reached = reached - log_(uniform_high(key, n + p, reached))


@wp.func
def bound_tile(row: int, k: int, j: int, c: Any):
    """Note the least and the greatest coordinates of the points of tile j."""
    for m in range(3):
        low = c.flat[row, k, m, TILE * j]
        high = low
        for q in range(TILE * j + 1, TILE * j + TILE):
            low = wp.min(low, c.flat[row, k, m, q])
            high = wp.max(high, c.flat[row, k, m, q])
        c.bound[row, k, m, j] = low
        c.bound[row, k, 3 + m, j] = high


@wp.func
def normal_pair(key: wp.uint32, n: int, variance: float, like: Any):
    """sqrt(-2 variance log u) times cos and sin of 2 pi v (Box and Muller), u and v of 16 bits: within 4.9 sigma."""
    size = sqrt_(log_(uniform_high(key, n, like)) * (-2.0 * variance))
    cosine, sine = direction(centred_low(key, n, like))
    return size * cosine, size * sine


@wp.func
def half_of(chunks: int, lanes: int):
    """Chunks of the first half of a cloud, whole ones of 16 points."""
    return 16 * ((chunks * lanes + 31) // 32) // lanes


@wp.func
def move_pair(k: int, j: int, half: int, variance: float, key: wp.uint32, lanes: int, x: Any, y: Any, z: Any):
    """Move chunks j and j + half of cloud k by Gaussian noise on every coordinate.

    Three pairs of normal numbers serve two points, one of each half of the cloud.
    """
    chunks = x.shape[0]
    other = j + half
    first_xy = (k * STREAMS + NOISE_XY) * chunks * lanes
    first_z = (k * STREAMS + NOISE_Z) * chunks * lanes
    zero = real(0.0, x[0])
    up, up_other = normal_pair(key, first_z + j * lanes, variance, zero)
    east, north = normal_pair(key, first_xy + j * lanes, variance, zero)
    x[j] = x[j] + east
    y[j] = y[j] + north
    z[j] = z[j] + up
    if other < chunks:
        east, north = normal_pair(key, first_xy + other * lanes, variance, zero)
        x[other] = x[other] + east
        y[other] = y[other] + north
        z[other] = z[other] + up_other


@wp.func
def add_noise(row: int, k: int, sigma: float, key: wp.uint32, lanes: int, c: Any):
    """Move every coordinate of every point by Gaussian noise of deviation sigma [m]."""
    x = c.point[row, k, 0]
    y = c.point[row, k, 1]
    z = c.point[row, k, 2]
    half = half_of(x.shape[0], lanes)
    j = wp.int32(0)
    while j < half:
        move_pair(k, j, half, sigma * sigma, key, lanes, x, y, z)
        j = j + 1


@wp.func
def add_noise_part(row: int, k: int, sigma: float, key: wp.uint32, t: int, team: int, c: Any):
    """Move every ``team``-th tile from t of the first half and its peer of the second, and note their bounds anew."""
    x = c.point[row, k, 0]
    y = c.point[row, k, 1]
    z = c.point[row, k, 2]
    half = half_of(x.shape[0], 1)
    for j in range(t, half // TILE, team):
        for p in range(TILE * j, TILE * j + TILE):
            move_pair(k, p, half, sigma * sigma, key, 1, x, y, z)
        bound_tile(row, k, j, c)
        if half + TILE * j < c.flat.shape[3]:
            bound_tile(row, k, half // TILE + j, c)


@wp.func
def bound_chunks(row: int, k: int, lanes: int, c: Any):
    """Note the least and the greatest coordinates of every chunk, and after them of every ``across`` chunks."""
    chunks = c.point.shape[3]
    groups = (chunks + lanes - 1) // lanes
    like = c.point[row, k, 0, 0]
    for m in range(3):
        p = c.flat[row, k, m]
        for g in range(groups):
            count = wp.min(chunks - g * lanes, lanes)
            low = row_least(p, g * lanes * lanes, count, NOWHERE, like)
            high = row_greatest(p, g * lanes * lanes, count, -NOWHERE, like)
            c.box[row, k, m, g] = low
            c.box[row, k, 3 + m, g] = high
            c.bound[row, k, m, groups * lanes + g] = least(low)
            c.bound[row, k, 3 + m, groups * lanes + g] = greatest(high)


@wp.func
def mark_near(w: int, s: Shapes, zoom: float, row: int, k: int, j: int, c: Any):
    """Mark the points of chunk j that lie nearer than ``zoom`` [m] to the axis of one of the shapes, a segment."""
    px = c.point[row, k, 0, j]
    py = c.point[row, k, 1, j]
    pz = c.point[row, k, 2, j]
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
    c.near[row, j] = found


@wp.func
def mark_part(w: int, s: Shapes, zoom: float, row: int, t: int, team: int, c: Any):
    """Mark the branch points that thread t has moved in `add_noise_part`."""
    half = half_of(c.flat.shape[3], 1)
    for j in range(t, half // TILE, team):
        for p in range(TILE * j, TILE * j + TILE):
            mark_near(w, s, zoom, row, BRANCHES, p, c)
            if p + half < c.flat.shape[3]:
                mark_near(w, s, zoom, row, BRANCHES, p + half, c)


@cache
def sample_kernel(width: int = 1) -> Any:
    """Return the kernel that draws all clouds without noise: robot, target and branches.

    Threads are (worlds / S, cloud, T, S), S as of `side`: on a CPU one thread draws a cloud, on a GPU T of them do,
    each a run of tiles. ``team`` is T. ``tick_in`` [worlds] counts the draws.
    """
    t = cloud_types(width)
    Clouds, W, S = t.Clouds, width, side(width)

    @wp.kernel(enable_backward=False, module="unique")
    def sample(
        capsules_in: Shapes, num_arm: int, target_in: Shapes, cap: float, seed: int, tick_in: wp.array(dtype=int),
        first: int, first_row: int, count: int, team: int, c_out: Clouds,
    ):  # fmt: skip
        """Draw cloud k of a world on its capsules and note its bounds; thread t draws its run of tiles."""
        tag = SOURCE  # noqa: F841
        g, k, t, lane = wp.tid()
        i = g * S + lane
        if i >= count:
            return
        w = first + i
        row = first_row + i
        key = key_of(seed, w, tick_in[w])
        shapes = capsules_in
        begin = wp.where(k == BRANCHES, num_arm, 0)
        end = wp.where(k == ROBOT, num_arm, shapes.radius.shape[1])
        ends = wp.float32(1.0)
        if k == TARGET:  # one call for all clouds: code that is there three times does not stay in a cache
            shapes = target_in
            end = shapes.radius.shape[1]
            ends = cap
        if wp.static(W > 1):
            spread_points(w, shapes, begin, end, ends, row, k, key, W, c_out)
            bound_chunks(row, k, W, c_out)
        else:
            tiles = c_out.flat.shape[3] // TILE
            part = (tiles + team - 1) // team
            last = wp.min(part * (t + 1), tiles)
            if part * t < last:
                spread_part(w, shapes, begin, end, ends, row, k, key, part * t * TILE, last * TILE, c_out)
                for j in range(part * t, last):
                    bound_tile(row, k, j, c_out)

    return sample


@cache
def blur_kernel(width: int = 1) -> Any:
    """Return the kernel that moves drawn points by noise and marks branch points near the target, threads as there.

    ``max_noise_in`` [worlds] is three deviations of the noise [m]; 0 leaves the clouds as they are, to the bit.
    """
    t = cloud_types(width)
    Clouds, W, S = t.Clouds, width, side(width)

    @wp.kernel(enable_backward=False, module="unique")
    def blur(
        target_in: Shapes, zoom: float, seed: int, tick_in: wp.array(dtype=int),
        max_noise_in: wp.array(dtype=wp.float32), first: int, first_row: int, count: int, team: int, c_out: Clouds,
    ):  # fmt: skip
        """Move the points of cloud k of a world by noise of a third of ``max_noise_in`` [m]; mark branch points."""
        tag = SOURCE  # noqa: F841
        g, k, t, lane = wp.tid()
        i = g * S + lane
        if i >= count:
            return
        w = first + i
        row = first_row + i
        sigma = max_noise_in[w] / 3.0
        if wp.static(W > 1):
            if sigma > 0.0:
                add_noise(row, k, sigma, key_of(seed, w, tick_in[w]), W, c_out)
                bound_chunks(row, k, W, c_out)
            if k == BRANCHES:
                for j in range(c_out.point.shape[3]):
                    mark_near(w, target_in, zoom, row, k, j, c_out)
        else:
            if sigma > 0.0:
                add_noise_part(row, k, sigma, key_of(seed, w, tick_in[w]), t, team, c_out)
            if k == BRANCHES:
                mark_part(w, target_in, zoom, row, t, team, c_out)

    return blur
