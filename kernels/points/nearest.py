"""Pairs of points: how many are closer than a threshold, and the closest ones.

The squared distance is d2 = fma(dz, dz, fma(dy, dy, dx dx)) in float32 everywhere; "closer than d" means d2 < d d in
float32. Its rounding is monotone in |dx|, |dy| and |dz|, so the same formula on the gaps between the boxes of two
chunks never exceeds the d2 of a pair of their points: chunks are left out without changing a bit of the result.

- Occlusion (thesis eq. 5.6): of the k closest pairs of two clouds, the share closer than d_th, which is
  min(k, number of pairs closer than d_th) / k.
- Safety margin (thesis eq. 5.7): whether the mean distance of the 5 closest pairs is below d_sm. It is not where no
  distance is, or where the fifth is 5 d_sm or more, so farther pairs need no look.
"""

from functools import cache
from typing import Any

import warp as wp

from ..lanes.across import first_bit, lane_sum, least, max_, min_, negatives, running_sum, tally
from ..lanes.real import SOURCE, add, fma, lane, mul, real, sub, where_neg
from .cloud import BRANCHES, ROBOT, TARGET, TILE, cloud_types, side

__all__ = ["Few", "finish_kernel", "margin_kernel", "nearest_kernel", "occlusion_kernel"]

#: Greater than the number of any lane.
NOBODY = wp.constant(99.0)
#: Squared distances, ascending.
Few = wp.types.vector(5, wp.float32)
#: A coordinate of the points of a tile.
Tile = wp.types.vector(16, wp.float32)


@wp.func
def squared(x: Any, y: Any, z: Any):
    """x^2 + y^2 + z^2, fused."""
    return fma(z, z, fma(y, y, x * x))


@wp.func
def keep_least(best: Few, value: float):
    """Insert a value into an ascending list, whose greatest falls out."""
    out = best
    v = wp.float32(value)
    for i in range(5):
        low = wp.min(out[i], v)
        v = wp.max(out[i], v)
        out[i] = low
    return out


@wp.func
def box_gap(row: int, a: int, j: int, b: int, g: int, c: Any):
    """Least squared distance that points of chunk j of cloud a and of each chunk of group g of cloud b can have."""
    zero = real(0.0, c.box[row, b, 0, g])
    x = max_(max_(c.box[row, b, 0, g] - c.bound[row, a, 3, j], c.bound[row, a, 0, j] - c.box[row, b, 3, g]), zero)
    y = max_(max_(c.box[row, b, 1, g] - c.bound[row, a, 4, j], c.bound[row, a, 1, j] - c.box[row, b, 4, g]), zero)
    z = max_(max_(c.box[row, b, 2, g] - c.bound[row, a, 5, j], c.bound[row, a, 2, j] - c.box[row, b, 5, g]), zero)
    return squared(x, y, z)


@wp.func
def point_gap(row: int, a: int, j: int, b: int, other: int, c: Any):
    """Least squared distance that each point of chunk j of cloud a can have to points of chunk ``other`` of cloud b."""
    x = c.point[row, a, 0, j]
    y = c.point[row, a, 1, j]
    z = c.point[row, a, 2, j]
    zero = real(0.0, x)
    x = max_(max_(c.bound[row, b, 0, other] - x, x - c.bound[row, b, 3, other]), zero)
    y = max_(max_(c.bound[row, b, 1, other] - y, y - c.bound[row, b, 4, other]), zero)
    z = max_(max_(c.bound[row, b, 2, other] - z, z - c.bound[row, b, 5, other]), zero)
    return squared(x, y, z)


@wp.func
def count_chunk(row: int, a: int, j: int, b: int, other: int, limit: float, lanes: int, c: Any):
    """Count the pairs of chunk j of cloud a and chunk ``other`` of cloud b with d2 < limit."""
    near = negatives(point_gap(row, a, j, b, other, c) - limit)
    if near == 0:
        return 0
    x = c.point[row, b, 0, other]
    y = c.point[row, b, 1, other]
    z = c.point[row, b, 2, other]
    bound = real(limit, x)
    hits = real(0.0, x)
    while near != 0:
        p = j * lanes + first_bit(near)
        near = near & (near - 1)
        d2 = squared(x - c.flat[row, a, 0, p], y - c.flat[row, a, 1, p], z - c.flat[row, a, 2, p])
        hits = tally(hits, d2, bound)
    return int(lane_sum(hits))


@wp.func
def count_group(row: int, a: int, j: int, b: int, g: int, limit: float, most: int, lanes: int, c: Any):
    """Count pairs with d2 < limit of chunk j of cloud a and group g of cloud b until ``most`` are reached."""
    count = wp.int32(0)
    near = negatives(box_gap(row, a, j, b, g, c) - limit)
    while near != 0 and count < most:
        other = g * lanes + first_bit(near)
        near = near & (near - 1)
        count = count + count_chunk(row, a, j, b, other, limit, lanes, c)
    return count


@wp.func
def count_lanes(row: int, a: int, b: int, limit: float, most: int, lanes: int, c: Any):
    """Count pairs with d2 < limit up to ``most``, chunk by chunk; groups of chunks apart are left out together."""
    count = wp.int32(0)
    chunks = c.point.shape[3]
    groups = (chunks + lanes - 1) // lanes
    for j in range(chunks):
        for h in range(groups, c.box.shape[3]):
            near = negatives(box_gap(row, a, j, b, h, c) - limit)
            while near != 0:
                g = (h - groups) * lanes + first_bit(near)
                near = near & (near - 1)
                count = count + count_group(row, a, j, b, g, limit, most - count, lanes, c)
                if count >= most:
                    return most
    return count


@wp.func
def tile_of(row: int, k: int, j: int, c: Any):
    """Coordinates of the points of tile j of cloud k."""
    x = Tile()
    y = Tile()
    z = Tile()
    for i in range(16):
        x[i] = c.flat[row, k, 0, 16 * j + i]
        y[i] = c.flat[row, k, 1, 16 * j + i]
        z[i] = c.flat[row, k, 2, 16 * j + i]
    return x, y, z


@wp.func
def tile_gap(row: int, a: int, j: int, b: int, other: int, c: Any):
    """Least squared distance that points of tile j of cloud a and of tile ``other`` of cloud b can have."""
    x = wp.max(c.bound[row, b, 0, other] - c.bound[row, a, 3, j], c.bound[row, a, 0, j] - c.bound[row, b, 3, other])
    y = wp.max(c.bound[row, b, 1, other] - c.bound[row, a, 4, j], c.bound[row, a, 1, j] - c.bound[row, b, 4, other])
    z = wp.max(c.bound[row, b, 2, other] - c.bound[row, a, 5, j], c.bound[row, a, 2, j] - c.bound[row, b, 5, other])
    return squared(wp.max(x, 0.0), wp.max(y, 0.0), wp.max(z, 0.0))


@wp.func
def count_tiles(row: int, a: int, b: int, limit: float, most: int, t: int, team: int, c: Any):
    """Count pairs with d2 < limit, of every ``team``-th tile of cloud a from t, until ``most`` are reached.

    A GPU's thread holds a tile in registers, so that a point of cloud b is read once for `TILE` pairs.
    """
    count = wp.int32(0)
    tiles = c.bound.shape[3]
    for j in range(t, tiles, team):
        x, y, z = tile_of(row, a, j, c)
        for other in range(tiles):
            if tile_gap(row, a, j, b, other, c) < limit and count < most:
                for q in range(TILE * other, TILE * other + TILE):
                    px = c.flat[row, b, 0, q]
                    py = c.flat[row, b, 1, q]
                    pz = c.flat[row, b, 2, q]
                    for i in range(16):
                        count = count + wp.where(squared(px - x[i], py - y[i], pz - z[i]) < limit, 1, 0)
    return wp.min(count, most)


@cache
def occlusion_kernel(width: int = 1) -> Any:
    """Return the kernel that counts branch-target pairs with d2 < limit, up to ``most``.

    Threads are (worlds / S, T, S), S as of `side`. On a CPU one thread takes a world. On a GPU T of them share it, and
    each takes every T-th tile of branch points; a count cannot depend on the order it is added up in. ``count_out``
    [worlds, T].
    """
    t = cloud_types(width)
    Clouds, W, S = t.Clouds, width, side(width)

    @wp.kernel(enable_backward=False, module="unique")
    def occlusion(
        c_in: Clouds, limit: float, most: int, first: int, first_row: int, worlds: int,
        count_out: wp.array2d(dtype=int),
    ):  # fmt: skip
        """Write how many branch-target pairs with d2 < ``limit`` thread t finds in a world, up to ``most``."""
        tag = SOURCE  # noqa: F841
        g, t, lane = wp.tid()
        i = g * S + lane
        if i >= worlds:
            return
        w = first + i
        row = first_row + i
        count = wp.int32(0)
        if c_in.present[row, BRANCHES] * c_in.present[row, TARGET] > 0:
            if wp.static(W > 1):
                count = count_lanes(row, BRANCHES, TARGET, limit, most, W, c_in)
            else:
                count = count_tiles(row, BRANCHES, TARGET, limit, most, t, count_out.shape[1], c_in)
        count_out[w, t] = count

    return occlusion


@wp.func
def keep_chunk(row: int, b: int, other: int, x: float, y: float, z: float, best: Few, c: Any):
    """Insert the squared distances between (x, y, z) and the points of chunk ``other`` of cloud b."""
    out = best
    d2 = squared(c.point[row, b, 0, other] - x, c.point[row, b, 1, other] - y, c.point[row, b, 2, other] - z)
    closer = negatives(d2 - out[4])
    while closer != 0:
        out = keep_least(out, lane(d2, first_bit(closer)))
        closer = closer & (closer - 1)
    return out


@wp.func_native("""
#if !defined(__CUDA_ARCH__)
    __builtin_prefetch(&wp::index(a, w, k, m, p));
#endif
""")
def fetch_ahead(a: wp.array4d(dtype=wp.float32), w: int, k: int, m: int, p: int):
    """Ask a CPU for memory that is read soon."""


@wp.func
def closest_points(row: int, b: int, place: wp.vec3, limit: float, t: int, team: int, lanes: int, c: Any):
    """Squared distances below ``limit`` of the points of cloud b closest to a place, of every ``team``-th chunk from t.

    Every lane keeps its five least, ascending, with no branch; then the least of all lanes' least is taken five times.
    Meanwhile a CPU asks for the next world's cloud: waiting for its first lines would take as long as all the rest.
    """
    x = real(place[0], c.point[row, b, 0, 0])
    y = real(place[1], x)
    z = real(place[2], x)
    a0 = real(limit, x)
    a1 = a0
    a2 = a0
    a3 = a0
    a4 = a0
    after = wp.min(row + 1, c.flat.shape[0] - 1)
    for j in range(t, c.point.shape[3], team):
        for m in range(3):
            fetch_ahead(c.flat, after, b, m, lanes * j)
        d = squared(c.point[row, b, 0, j] - x, c.point[row, b, 1, j] - y, c.point[row, b, 2, j] - z)
        past0 = max_(a0, d)
        a0 = min_(a0, d)
        past1 = max_(a1, past0)
        a1 = min_(a1, past0)
        past2 = max_(a2, past1)
        a2 = min_(a2, past1)
        a4 = min_(a4, max_(a3, past2))
        a3 = min_(a3, past2)
    best = Few()
    number = running_sum(real(1.0, x))
    for i in range(5):
        best[i] = least(a0)
        # of the lanes that hold it the first one moves up
        holder = where_neg(best[i] - a0, real(NOBODY, x), number)
        others = holder - (least(holder) + 0.5)
        a0 = where_neg(others, a1, a0)
        a1 = where_neg(others, a2, a1)
        a2 = where_neg(others, a3, a2)
        a3 = where_neg(others, a4, a3)
    return best


@wp.func
def closest_in_chunk(row: int, a: int, j: int, b: int, other: int, best: Few, lanes: int, c: Any):
    """Insert the squared distances between points of chunk j of cloud a and chunk ``other`` of cloud b."""
    out = best
    gap = point_gap(row, a, j, b, other, c)
    near = negatives(gap - out[4])
    while near != 0:
        i = first_bit(near)
        near = near & (near - 1)
        if lane(gap, i) < out[4]:
            p = j * lanes + i
            x = c.flat[row, a, 0, p]
            y = c.flat[row, a, 1, p]
            z = c.flat[row, a, 2, p]
            out = keep_chunk(row, b, other, x, y, z, out, c)
    return out


@wp.func
def closest_in_group(row: int, a: int, j: int, b: int, g: int, best: Few, lanes: int, c: Any):
    """Insert the squared distances between points of chunk j of cloud a and of group g of cloud b."""
    out = best
    gap = box_gap(row, a, j, b, g, c)
    near = negatives(gap - out[4])
    while near != 0:
        i = first_bit(near)
        near = near & (near - 1)
        if lane(gap, i) < out[4]:
            out = closest_in_chunk(row, a, j, b, g * lanes + i, out, lanes, c)
    return out


@wp.func
def closest_pairs_lanes(row: int, a: int, b: int, limit: float, lanes: int, c: Any):
    """Squared distances below ``limit`` of the closest pairs, chunk by chunk; groups of chunks apart are left out.

    Chunks of cloud a are taken from the last, the hand's: the sooner close pairs are found the more is left out.
    """
    best = Few(limit)
    chunks = c.point.shape[3]
    groups = (chunks + lanes - 1) // lanes
    for back in range(chunks):
        j = chunks - 1 - back
        for h in range(groups, c.box.shape[3]):
            near = negatives(box_gap(row, a, j, b, h, c) - best[4])
            while near != 0:
                g = (h - groups) * lanes + first_bit(near)
                near = near & (near - 1)
                best = closest_in_group(row, a, j, b, g, best, lanes, c)
    return best


@wp.func
def keep_closest(px: float, py: float, pz: float, x: Tile, y: Tile, z: Tile, best: Few):
    """Insert the squared distances between a point and the points of a tile; most tiles hold none that is closer."""
    out = best
    closest = wp.float32(best[4])
    for i in range(16):
        closest = wp.min(closest, squared(px - x[i], py - y[i], pz - z[i]))
    if closest < best[4]:
        for i in range(16):
            out = keep_least(out, squared(px - x[i], py - y[i], pz - z[i]))
    return out


@wp.func
def closest_tiles(row: int, a: int, b: int, limit: float, t: int, team: int, c: Any):
    """Squared distances below ``limit`` of the closest pairs, of every ``team``-th tile of cloud a from t."""
    best = Few(limit)
    tiles = c.bound.shape[3]
    for j in range(t, tiles, team):
        x, y, z = tile_of(row, a, j, c)
        for other in range(tiles):
            if tile_gap(row, a, j, b, other, c) < best[4]:
                for q in range(TILE * other, TILE * other + TILE):
                    best = keep_closest(c.flat[row, b, 0, q], c.flat[row, b, 1, q], c.flat[row, b, 2, q], x, y, z, best)
    return best


@cache
def nearest_kernel(width: int = 1) -> Any:
    """Return the kernel that finds the five least squared distances [m^2] from a place to branch points.

    Threads as in `occlusion_kernel`. ``point_out`` [worlds, T] is ascending; what is not closer than ``far`` (a squared
    distance) holds that.
    """
    t = cloud_types(width)
    Clouds, W, S = t.Clouds, width, side(width)

    @wp.kernel(enable_backward=False, module="unique")
    def nearest(
        c_in: Clouds, place_in: wp.array(dtype=wp.vec3), far: float, first: int, first_row: int, worlds: int,
        point_out: wp.array2d(dtype=Few),
    ):  # fmt: skip
        """Write the five least squared distances [m^2] that thread t finds from a world's place to its branches."""
        tag = SOURCE  # noqa: F841
        g, t, lane = wp.tid()
        i = g * S + lane
        if i >= worlds:
            return
        w = first + i
        row = first_row + i
        point = Few(far)
        if c_in.present[row, BRANCHES] > 0:
            point = closest_points(row, BRANCHES, place_in[w], far, t, point_out.shape[1], W, c_in)
        point_out[w, t] = point

    return nearest


@cache
def margin_kernel(width: int = 1) -> Any:
    """Return the kernel that finds the five least squared distances [m^2] of robot-target pairs, those below ``limit``.

    Threads as in `occlusion_kernel`. ``pair_out`` [worlds, T] is ascending; what is not below ``limit`` holds that. So
    do all five on a CPU where no pair is below ``near``.
    """
    t = cloud_types(width)
    Clouds, W, S = t.Clouds, width, side(width)

    @wp.kernel(enable_backward=False, module="unique")
    def margin(
        c_in: Clouds, near: float, limit: float, first: int, first_row: int, worlds: int,
        pair_out: wp.array2d(dtype=Few),
    ):  # fmt: skip
        """Write the five least squared distances [m^2] that thread t finds between a world's robot and target."""
        tag = SOURCE  # noqa: F841
        g, t, lane = wp.tid()
        i = g * S + lane
        if i >= worlds:
            return
        w = first + i
        row = first_row + i
        pair = Few(limit)
        if c_in.present[row, ROBOT] * c_in.present[row, TARGET] > 0:
            if wp.static(W > 1):
                if count_lanes(row, ROBOT, TARGET, near, 1, W, c_in) > 0:
                    pair = closest_pairs_lanes(row, ROBOT, TARGET, limit, W, c_in)
            else:
                pair = closest_tiles(row, ROBOT, TARGET, limit, t, pair_out.shape[1], c_in)
        pair_out[w, t] = pair

    return margin


@wp.func
def margin_breach(pair: Few, margin: float):
    """1 where the mean of five distances, given as squares, is below the margin, else 0."""
    total = wp.float32(0.0)
    for i in range(5):
        total = total + wp.sqrt(pair[i])
    return wp.where(total < 5.0 * margin, 1.0, 0.0)


@wp.func
def join(best: Few, other: Few):
    """The five least of two ascending lists."""
    out = best
    if other[0] < best[4]:
        for i in range(5):
            out = keep_least(out, other[i])
    return out


@wp.kernel(enable_backward=False, module="unique")
def finish_kernel(
    true_count_in: wp.array2d(dtype=int), true_pair_in: wp.array2d(dtype=Few), count_in: wp.array2d(dtype=int),
    point_in: wp.array2d(dtype=Few), pair_in: wp.array2d(dtype=Few), most: int, margin: float,
    column: wp.array(dtype=int), first: int, tick_out: wp.array(dtype=int), occlusion_out: wp.array(dtype=wp.float32),
    distances_out: wp.array2d(dtype=wp.float32), breach_out: wp.array(dtype=wp.float32),
    observation_out: wp.array2d(dtype=wp.float32),
):  # fmt: skip
    """Join what the threads of a world found, write true scores and the observation's columns, count the tick."""
    tag = SOURCE  # noqa: F841
    w = first + wp.tid()
    true_count = wp.int32(0)
    count = wp.int32(0)
    true_pair = true_pair_in[w, 0]
    point = point_in[w, 0]
    pair = pair_in[w, 0]
    for t in range(count_in.shape[1]):
        true_count = true_count + true_count_in[w, t]
        count = count + count_in[w, t]
        if t > 0:
            true_pair = join(true_pair, true_pair_in[w, t])
            point = join(point, point_in[w, t])
            pair = join(pair, pair_in[w, t])
    for i in range(5):
        distance = wp.sqrt(point[i])
        distances_out[w, i] = distance
        if column[0] >= 0:
            observation_out[w, column[0] + i] = distance
    occlusion_out[w] = float(wp.min(true_count, most)) / float(most)
    breach_out[w] = margin_breach(true_pair, margin)
    if column[1] >= 0:
        observation_out[w, column[1]] = margin_breach(pair, margin)
    if column[2] >= 0:
        observation_out[w, column[2]] = float(wp.min(count, most)) / float(most)
    tick_out[w] = tick_out[w] + 1
