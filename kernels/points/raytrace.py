"""Ray-traced pictures of round cones (tapered capsules) and leaves on a ground plane under sun and sky.

A round cone is the convex hull of two balls; a ray meets it at the root of a quadratic. Nothing is drawn at random, so
there is no noise. With albedo rho, irradiance S of the sun, visible share V of the sun's disc, sky irradiance E(n) and
share O of it that is hidden by wood close by, the radiance that a surface with normal n reflects is

    L = rho (S / pi max(n.s, 0) V + E(n) / pi (1 - O) + inside O)

V: a capsule covers the disc, seen at the distance t as wide as t tan(half-angle), by a strip (`covered`). E: nine
spherical harmonics of the sky, within 3 % (Ramamoorthi and Hanrahan 2001, SIGGRAPH, eqs. 10 and 11). O: a thin
cylinder's form factor in closed form (`occlusion`). Haze replaces L by h + (L - h) exp(-d/D) over the distance d. A
pixel that an outline crosses takes more samples than one. World axes, z up, metres, linear light.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

SKY = wp.constant(-1)
GROUND = wp.constant(-2)
FAR = wp.constant(1.0e8)
REACH = wp.constant(20.0)  # radii of a cone within which it dims the sky


@wp.struct
class Solids:
    """What rays meet: round cones, leaves, and the plane z = ``ground``.

    A leaf is flat: its rib goes from ``start`` to ``end``, ``side`` is its half-width, square to it; its radii are 0.
    Boxes of the trees: ``seen`` holds solids and half a pixel, ``lit`` their half-shadows; ``near`` holds where cones,
    which come first, dim the sky.
    """

    seen: wp.uint64
    lit: wp.uint64
    near: wp.uint64
    start: wp.array(dtype=wp.vec4)  # and radius there
    end: wp.array(dtype=wp.vec4)
    side: wp.array(dtype=wp.vec3)
    color: wp.array(dtype=wp.vec4)  # linear albedo; the share of it that is passed through
    ground: float
    ground_color: wp.vec3
    tile: float  # edge of the squares on the ground [m]
    contrast: float  # of those squares; 0: plain ground


@wp.struct
class Light:
    """Sun and sky in linear light (irradiance of the sun, radiance of the sky)."""

    to_sun: wp.vec3
    sun: wp.vec3
    sun_radius: float  # tangent of the half-angle of the disc that shadows are softened by
    zenith: wp.vec3
    horizon: wp.vec3
    glow: wp.vec3  # radiance added around the sun
    inside: wp.vec3  # radiance found where wood hides the sky
    haze: float  # 1 / distance over which contrast falls to 1/e [1/m]
    harmonics: wp.array(dtype=wp.vec3)  # nine of the radiance from all around


@wp.struct
class Camera:
    """Pinhole at ``position``; ``right`` and ``up`` reach from the middle of the picture at distance 1 to its edges."""

    position: wp.vec3
    forward: wp.vec3
    right: wp.vec3
    up: wp.vec3
    pixel: float  # width of a pixel at distance 1


@wp.struct
class Hit:
    """Nearest surface on a ray: index of the solid, SKY or GROUND; distance [m]; unit normal towards the viewer.

    ``outline`` tells that the ray passes an outline within half a pixel, no farther than what it meets.
    """

    item: int
    distance: float
    normal: wp.vec3
    outline: bool


@wp.struct
class Approach:
    """Where a ray comes nearest to the axis of a solid: ``along`` the ray, ``gap`` between the two, ``radius`` there.

    ``from_start`` and ``to_end`` [m] say how far the nearest place is from both ends where one looks along the ray;
    beyond an end one of them is negative.
    """

    along: float
    gap: float
    radius: float
    from_start: float
    to_end: float


@wp.func
def xyz(v: wp.vec4) -> wp.vec3:
    """Return the first three components."""
    return wp.vec3(v[0], v[1], v[2])


@wp.func
def half_disc(x: float) -> float:
    """Share of a unit disc that lies on the left of a line at x."""
    c = wp.clamp(x, -1.0, 1.0)
    return 0.5 + (c * wp.sqrt(1.0 - c * c) + wp.asin(c)) / wp.pi


# ---- what a ray meets ------------------------------------------------------------------------------------------------


@wp.func
def approach(a: wp.vec4, b: wp.vec4, origin: wp.vec3, direction: wp.vec3) -> Approach:
    """Find where a ray with unit direction comes nearest to the axis from a to b, seen along the ray."""
    to_start, axis = xyz(a) - origin, xyz(b) - xyz(a)
    start = to_start - direction * wp.dot(to_start, direction)
    flat = axis - direction * wp.dot(axis, direction)
    length = wp.max(wp.length(flat), 1.0e-9)
    place = -wp.dot(start, flat) / length
    share = wp.clamp(place / length, 0.0, 1.0)
    out = Approach()
    out.along = wp.dot(to_start + axis * share, direction)
    out.gap = wp.length(start + flat * share)
    out.radius = wp.lerp(a[3], b[3], share)
    out.from_start = place
    out.to_end = length - place
    return out


@wp.func
def enter_ball(centre: wp.vec3, radius: float, origin: wp.vec3, direction: wp.vec3) -> float:
    """Distance along a line at which it enters a ball, FAR if it does not."""
    m = wp.dot(centre - origin, direction)
    off = centre - origin - direction * m
    square = radius * radius - wp.dot(off, off)
    if square < 0.0:
        return FAR
    return m - wp.sqrt(square)


@wp.func
def enter_cone(a: wp.vec4, b: wp.vec4, origin: wp.vec3, direction: wp.vec3) -> float:
    """Distance along a line at which it enters the convex hull of two balls (centre, radius), FAR if it does not.

    The hull's side is a cone; a root counts where the line goes inwards, between the circles at which the balls touch.
    Cross products keep thin cones exact in float32; ``origin`` should be near the solid, for the same reason.
    """
    out = wp.min(enter_ball(xyz(a), a[3], origin, direction), enter_ball(xyz(b), b[3], origin, direction))
    axis, off = xyz(b) - xyz(a), origin - xyz(a)
    drop = a[3] - b[3]
    side = wp.dot(axis, axis) - drop * drop
    if side <= 0.0:  # one ball holds the other
        return out
    across, from_axis = wp.cross(axis, direction), wp.cross(axis, off)
    m1, m2, m3 = wp.dot(axis, off), wp.dot(axis, direction), wp.dot(direction, off)
    k2 = wp.dot(across, across) - drop * drop
    k1 = wp.dot(across, from_axis) - drop * drop * m3 + m2 * drop * a[3]
    k0 = (wp.dot(from_axis, from_axis) - drop * drop * wp.dot(off, off) + 2.0 * m1 * drop * a[3]
          - wp.dot(axis, axis) * a[3] * a[3])  # fmt: skip
    square = k1 * k1 - k0 * k2
    if square < 0.0 or k2 == 0.0:
        return out
    for sign in range(-1, 2, 2):
        t = (float(sign) * wp.sqrt(square) - k1) / k2
        y = m1 - a[3] * drop + t * m2
        inwards = side * wp.dot(off + direction * t, direction) - m2 * y
        if y > 0.0 and y < side and inwards < 0.0:
            out = wp.min(out, t)
    return out


@wp.func
def cone_normal(a: wp.vec4, b: wp.vec4, p: wp.vec3) -> wp.vec3:
    """Unit normal, outwards, of a round cone at a point on its surface."""
    axis, drop = xyz(b) - xyz(a), a[3] - b[3]
    side = wp.dot(axis, axis) - drop * drop
    share = wp.float32(0.0)
    if side > 0.0:
        share = wp.clamp((wp.dot(axis, p - xyz(a)) - a[3] * drop) / side, 0.0, 1.0)
    elif drop < 0.0:
        share = wp.float32(1.0)
    return wp.normalize(p - xyz(a) - axis * share)


@wp.func
def enter_leaf(start: wp.vec3, end: wp.vec3, side: wp.vec3, origin: wp.vec3, direction: wp.vec3) -> wp.vec2:
    """Distance at which a line meets a leaf's plane, and how far inside the leaf's outline that is [m].

    A leaf is |v| < 4 u (1 - u), with u along its rib and v in half-widths.
    """
    rib = end - start
    normal = wp.cross(rib, side)
    t = wp.dot(start - origin, normal) / wp.dot(direction, normal)
    p = origin + direction * t - start
    u, v = wp.dot(p, rib) / wp.dot(rib, rib), wp.dot(p, side) / wp.dot(side, side)
    return wp.vec2(t, (4.0 * u * (1.0 - u) - wp.abs(v)) * wp.length(side))


@wp.func
def first_hit(solids: Solids, origin: wp.vec3, direction: wp.vec3, pixel: float) -> Hit:
    """Find the nearest surface along a ray with unit direction; ``pixel`` is the width of the ray at distance 1."""
    hit = Hit()
    hit.item = SKY
    hit.distance = FAR
    outline = wp.float32(FAR)
    if direction[2] < 0.0 and origin[2] > solids.ground:
        hit.item = GROUND
        hit.normal = wp.vec3(0.0, 0.0, 1.0)
        hit.distance = (solids.ground - origin[2]) / direction[2]
    query = wp.bvh_query_ray(solids.seen, origin, direction)
    i = wp.int32(0)
    while wp.bvh_query_next(query, i, hit.distance):
        a, b, side = solids.start[i], solids.end[i], solids.side[i]
        near = approach(a, b, origin, direction)
        base = origin + direction * near.along
        t, inside = FAR, near.radius - near.gap
        if wp.length_sq(side) == 0.0:
            t = near.along + enter_cone(a, b, base, direction)
        else:
            leaf = enter_leaf(xyz(a), xyz(b), side, base, direction)
            inside = leaf[1]
            if inside > 0.0:
                t = near.along + leaf[0]
        if t > 0.0 and t < hit.distance:
            hit.item = i
            hit.distance = t
        if near.along > 0.0 and wp.abs(inside) < 0.5 * pixel * near.along:
            outline = wp.min(outline, near.along)
    hit.outline = outline < hit.distance + solids.start[wp.max(hit.item, 0)][3]
    if hit.item >= 0:
        hit.normal = normal_of(solids, hit.item, origin + direction * hit.distance, direction)
    return hit


@wp.func
def normal_of(solids: Solids, i: int, p: wp.vec3, direction: wp.vec3) -> wp.vec3:
    """Unit normal of solid i at a point on it, against ``direction``."""
    a, b, side = solids.start[i], solids.end[i], solids.side[i]
    if wp.dot(side, side) == 0.0:
        return cone_normal(a, b, p)
    normal = wp.normalize(wp.cross(xyz(b) - xyz(a), side))
    if wp.dot(normal, direction) > 0.0:
        return -normal
    return normal


# ---- what lights a surface -------------------------------------------------------------------------------------------


@wp.func
def sky_gradient(light: Light, direction: wp.vec3) -> wp.vec3:
    """Radiance of the clear sky: from the horizon's colour to the zenith's, brighter around the sun."""
    high = wp.sqrt(wp.clamp(direction[2], 0.0, 1.0))
    near = wp.max(wp.dot(direction, light.to_sun), 0.0)
    near = near * near * near * near * near * near * near * near
    far = near * near * near
    far = far * far * far * far
    return wp.lerp(light.horizon, light.zenith, high) + light.glow * (near + 2.5 * far)


@wp.func
def harmonic(k: int, n: wp.vec3) -> float:
    """Real spherical harmonic k of the first nine, at the unit vector n."""
    x, y, z = n[0], n[1], n[2]
    if k == 0:
        return 0.282095
    if k < 4:
        return 0.488603 * n[k - 1]
    if k == 4:
        return 1.092548 * x * y
    if k == 5:
        return 1.092548 * y * z
    if k == 6:
        return 1.092548 * x * z
    if k == 7:
        return 0.315392 * (3.0 * z * z - 1.0)
    return 0.546274 * (x * x - y * y)


@wp.kernel
def gather(light: Light, ground: wp.vec3, samples: int, harmonics_out: wp.array(dtype=wp.vec3)):
    """Project the radiance from all around, sky above and ``ground`` below, on harmonics times cosine law over pi.

    Launched over the nine; the directions of ``samples`` are a Fibonacci spiral's.
    """
    k = wp.tid()
    total = wp.vec3(0.0)
    for s in range(samples):
        z = 1.0 - (2.0 * float(s) + 1.0) / float(samples)
        turn, flat = 2.0 * wp.pi * wp.frac(0.618033989 * float(s)), wp.sqrt(1.0 - z * z)
        n = wp.vec3(flat * wp.cos(turn), flat * wp.sin(turn), z)
        radiance = ground
        if z > 0.0:
            radiance = sky_gradient(light, n)
        total += radiance * harmonic(k, n)
    law = wp.float32(1.0)
    if k > 3:
        law = 0.25
    elif k > 0:
        law = 2.0 / 3.0
    harmonics_out[k] = total * (law * 4.0 * wp.pi / float(samples))


@wp.func
def sky_around(light: Light, normal: wp.vec3) -> wp.vec3:
    """Irradiance from all around on a face with this normal, over pi."""
    total = wp.vec3(0.0)
    for k in range(9):
        total += light.harmonics[k] * harmonic(k, normal)
    return total


@wp.func
def covered(near: Approach, wide: float) -> float:
    """Share of a disc of radius ``wide`` about a ray that a capsule hides: across its strip, times along it.

    Neighbours of a chain hide 1 - (1 - c a)^2 together where they join, if each hides the share c across and a along.
    The strip ends so far beyond its end that this is c; a round end is seen where it is wider than the disc.
    """
    c = half_disc((near.gap + near.radius) / wide) - half_disc((near.gap - near.radius) / wide)
    if c < 1.0e-5:
        return 0.0
    more = wp.max(near.radius / wide - 1.0, 0.0) + 0.5 * wp.pi * ((1.0 - wp.sqrt(wp.max(1.0 - c, 0.0))) / c - 0.5)
    return c * (half_disc(near.to_end / wide + more) - half_disc(-near.from_start / wide - more))


@wp.func
def sun_seen(solids: Solids, light: Light, item: int, p: wp.vec3, blur: float) -> float:
    """Share of the sun's disc seen from a point on ``item``; half-shadows are no narrower than ``blur`` [m]."""
    share = wp.float32(1.0)
    query = wp.bvh_query_ray(solids.lit, p, light.to_sun)
    i = wp.int32(0)
    while share > 0.002 and wp.bvh_query_next(query, i, FAR):
        if i != item:
            near = approach(solids.start[i], solids.end[i], p, light.to_sun)
            if near.along > 0.0:
                half, wide = wp.length(solids.side[i]), light.sun_radius * near.along
                if half > 0.0:  # a leaf: at any angle, and no softer than it is wide
                    near.radius = 0.5 * half
                    wide = wp.min(wide, half)
                share *= 1.0 - covered(near, wp.max(wide, blur))
    return share


@wp.func
def line_factor(s: float, h: float, across: float, along: float) -> float:
    """Antiderivative of `occlusion`'s form factor at s along a line at distance h, over radius / pi."""
    square = h * h + s * s
    return across * (s / square + wp.atan(s / h) / h) - along * h / square


@wp.func
def occlusion(a: wp.vec4, b: wp.vec4, p: wp.vec3, normal: wp.vec3) -> float:
    """Form factor of a thin cylinder, as wide as the cone in the mean, on a face at p: the part above its horizon.

    A strip 2 r wide at s along the axis, D away, hides 2 r cos(theta) sin(phi) ds / (pi D^2) of the irradiance of an
    even sky. It fades to nothing at REACH radii.
    """
    axis, to_start = xyz(b) - xyz(a), xyz(a) - p
    length, radius = wp.length(axis), 0.5 * (a[3] + b[3])
    axis = axis / wp.max(length, 1.0e-9)
    low = wp.dot(to_start, axis)
    high = low + length
    foot = to_start - axis * low
    h = wp.max(wp.length(foot), radius)
    across, along = wp.dot(foot, normal) / h, wp.dot(axis, normal)
    if wp.abs(along) > 1.0e-6:
        horizon = -across * h / along
        if along > 0.0:
            low = wp.max(low, horizon)
        else:
            high = wp.min(high, horizon)
    elif across <= 0.0:
        return 0.0
    if high <= low:
        return 0.0
    fade = wp.max(1.0 - wp.pow(h / (REACH * radius), 2.0), 0.0)
    factor = line_factor(high, h, across, along) - line_factor(low, h, across, along)
    return wp.clamp(fade * factor * radius / wp.pi, 0.0, 0.9)


@wp.func
def sky_hidden(solids: Solids, item: int, p: wp.vec3, normal: wp.vec3) -> float:
    """Share of the sky's irradiance at a point on ``item`` that the cones close by hide."""
    share = wp.float32(1.0)
    query = wp.bvh_query_aabb(solids.near, p, p)
    i = wp.int32(0)
    while wp.bvh_query_next(query, i):
        if i != item:
            share *= 1.0 - occlusion(solids.start[i], solids.end[i], p, normal)
    return 1.0 - share


# ---- pixels ----------------------------------------------------------------------------------------------------------


@wp.func
def edge_share(x: float, width: float) -> float:
    """Mean over a box of ``width`` about x of a wave that is 1 and -1 in turn on intervals of length 1."""
    low, high = 0.5 * (x - 0.5 * width), 0.5 * (x + 0.5 * width)
    low, high = low - wp.floor(low), high - wp.floor(high)
    return 2.0 * (wp.abs(low - 0.5) - wp.abs(high - 0.5)) / width


@wp.func
def ground_color(solids: Solids, p: wp.vec3, direction: wp.vec3, blur: float) -> wp.vec3:
    """Albedo of the ground: squares in turn lighter and darker, averaged over the pixel (Quilez's box filter)."""
    if solids.contrast == 0.0:
        return solids.ground_color
    steep = wp.max(-direction[2], 1.0e-4)
    x = edge_share(p[0] / solids.tile, blur * (1.0 + wp.abs(direction[0]) / steep) / solids.tile)
    y = edge_share(p[1] / solids.tile, blur * (1.0 + wp.abs(direction[1]) / steep) / solids.tile)
    return solids.ground_color * (1.0 + solids.contrast * x * y)


@wp.func
def sample(solids: Solids, light: Light, origin: wp.vec3, direction: wp.vec3, pixel: float) -> wp.vec4:
    """Radiance that arrives at ``origin`` against ``direction``; the last number is 1 beside an outline, else 0."""
    hit = first_hit(solids, origin, direction, pixel)
    edge = wp.where(hit.outline, 1.0, 0.0)
    if hit.item == SKY:
        sky = sky_gradient(light, direction)
        return wp.vec4(sky[0], sky[1], sky[2], edge)
    p, blur = origin + direction * hit.distance, wp.max(pixel * hit.distance, 1.0e-6)
    albedo = wp.vec4(0.0)
    if hit.item == GROUND:
        plain = ground_color(solids, p, direction, blur)
        albedo = wp.vec4(plain[0], plain[1], plain[2], 0.0)
    else:
        albedo = solids.color[hit.item]
    cosine = wp.dot(hit.normal, light.to_sun)
    if cosine < 0.0:
        cosine = -cosine * albedo[3]
    if cosine > 0.0:
        cosine *= sun_seen(solids, light, hit.item, p, 0.7 * blur)
    hidden = sky_hidden(solids, hit.item, p, hit.normal)
    lit = light.sun * (cosine / wp.pi) + sky_around(light, hit.normal) * (1.0 - hidden) + light.inside * hidden
    veil = sky_gradient(light, wp.normalize(wp.vec3(direction[0], direction[1], 0.02)))
    color = veil + (wp.cw_mul(xyz(albedo), lit) - veil) * wp.exp(-light.haze * hit.distance)
    return wp.vec4(color[0], color[1], color[2], edge)


@wp.kernel
def trace(
    solids: Solids, light: Light, camera: Camera, height: int, first_row: int, samples: int,
    image_out: wp.array2d(dtype=wp.vec3),
):  # fmt: skip
    """Trace the radiance of each pixel: in its middle, and beside an outline the mean over ``samples`` places in it.

    Launched over image_out's shape [rows, width], rows ``first_row`` on of a picture of ``height`` rows. Places in the
    pixel follow the additive recurrence of the plastic number, so that a picture does not depend on how its rows are
    shared out.
    """
    i, j = wp.tid()
    width = image_out.shape[1]
    total = wp.vec3(0.0)
    count = wp.int32(1)
    k = wp.int32(0)
    while k < count:
        x = wp.frac(0.5 + 0.7548776662 * float(k))
        y = wp.frac(0.5 + 0.5698402910 * float(k))
        across = 2.0 * (float(j) + x) / float(width) - 1.0
        above = 1.0 - 2.0 * (float(first_row + i) + y) / float(height)
        direction = wp.normalize(camera.forward + camera.right * across + camera.up * above)
        seen = sample(solids, light, camera.position, direction, camera.pixel)
        if k == 0 and seen[3] > 0.0:
            count = samples
        total += wp.min(xyz(seen), wp.vec3(8.0))
        k += 1
    image_out[i, j] = total / float(count)
