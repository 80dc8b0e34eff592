"""Ray-traced pictures of a coloured triangle mesh on a ground plane under sun and sky.

Each sample of a pixel follows one ray to the nearest surface, then one shadow ray into the sun's disc and one ray into
the sky, drawn cosine-weighted about the normal. With albedo rho, sun irradiance E on a face square to it, visibility V
and the radiance L_s found in the sky's direction w, the estimator of the reflected radiance is

    L = rho / pi * E * max(n.s, 0) * V(s) + rho * L_s(w) * V(w)

(Lambert's law; the cosine and 1/pi of the second term cancel against the density of w: Pharr, Jakob and Humphreys,
Physically Based Rendering, 3rd ed., 13.6.3). Thin leaves also pass light: the share ``through`` of rho acts for light
from behind. Haze replaces L by h + (L - h) exp(-d/D) over the distance d. World axes, z up, metres, linear light.
"""

import warp as wp

wp.set_module_options({"enable_backward": False})

SKY = wp.constant(0)
GROUND = wp.constant(1)
MESH = wp.constant(2)
FAR = wp.constant(1.0e8)


@wp.struct
class Surfaces:
    """What rays meet: a mesh with a normal and a colour at every vertex, and the plane z = ``ground``."""

    mesh: wp.uint64
    normal: wp.array(dtype=wp.vec3)
    color: wp.array(dtype=wp.vec4)  # linear albedo; the share of it that is passed through
    ground: float
    ground_color: wp.vec3
    detail: float  # 0: plain colours; 1: bark, grass and earth, hills and clouds
    size: float  # scale of that detail: height of a tree [m]


@wp.struct
class Light:
    """Sun and sky in linear light (irradiance of the sun, radiance of the sky)."""

    to_sun: wp.vec3
    sun: wp.vec3
    sun_radius: float  # tangent of the half-angle of the disc that shadows are softened by
    zenith: wp.vec3
    horizon: wp.vec3
    glow: wp.vec3  # radiance added around the sun
    inside: wp.vec3  # radiance found by a sky ray that meets the mesh: light inside the crowns
    haze: float  # 1 / distance over which contrast falls to 1/e [1/m]


@wp.struct
class Camera:
    """Pinhole at ``position``; ``right`` and ``up`` reach from the middle of the picture at distance 1 to its edges."""

    position: wp.vec3
    forward: wp.vec3
    right: wp.vec3
    up: wp.vec3


@wp.struct
class Hit:
    """Nearest surface on a ray: what it is, how far [m], unit normal towards the viewer, albedo and ``through``."""

    kind: int
    distance: float
    normal: wp.vec3
    color: wp.vec3
    through: float


@wp.func
def octaves(seed: int, p: wp.vec3) -> float:
    """Sum of four octaves of Perlin noise at p, about -1 to 1."""
    state = wp.rand_init(seed)
    total = wp.float32(0.0)
    weight = wp.float32(0.55)
    for _ in range(4):
        total += weight * wp.noise(state, p)
        weight *= 0.55
        p = p * 2.07
    return total


@wp.func
def smooth(low: float, high: float, x: float) -> float:
    """Cubic step from 0 at ``low`` to 1 at ``high``."""
    t = wp.clamp((x - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


@wp.func
def sky_gradient(light: Light, direction: wp.vec3) -> wp.vec3:
    """Radiance of the clear sky: from the horizon's colour to the zenith's, brighter around the sun."""
    high = wp.pow(wp.clamp(direction[2], 0.0, 1.0), 0.5)
    near = wp.max(wp.dot(direction, light.to_sun), 0.0)
    return wp.lerp(light.horizon, light.zenith, high) + light.glow * (wp.pow(near, 8.0) + 2.5 * wp.pow(near, 96.0))


@wp.func
def backdrop(surfaces: Surfaces, light: Light, direction: wp.vec3) -> wp.vec3:
    """Radiance behind everything: sky, clouds on a flat layer, and two ranges of wooded hills on the horizon."""
    color = sky_gradient(light, direction)
    if surfaces.detail == 0.0:
        return color
    rise = direction[2] / wp.length(wp.vec2(direction[0], direction[1]))
    if direction[2] > 0.02:
        layer = wp.vec3(direction[0], direction[1], 0.0) / (direction[2] + 0.12)
        cover = smooth(0.05, 0.5, octaves(11, layer * 1.3) + 0.25 * octaves(12, layer * 3.1))
        lit = light.horizon * 0.9 + light.sun * 0.09
        color = wp.lerp(color, lit, 0.85 * cover * smooth(0.02, 0.25, direction[2]))
    azimuth = wp.atan2(direction[1], direction[0])
    for k in range(2):
        ridge = 0.050 - 0.026 * float(k) + 0.045 * octaves(21 + k, wp.vec3(azimuth * (3.6 + 2.4 * float(k)), 0.3, 0.0))
        trees = 0.0035 * octaves(31 + k, wp.vec3(azimuth * 90.0, 1.7, 0.0))
        dark = wp.cw_mul(wp.vec3(0.045, 0.085, 0.075), light.sun * 0.35 + light.zenith * 2.0)
        mist = wp.max(0.55 - 0.25 * float(k), 1.0 - 30.0 * wp.max(rise, 0.0))
        veil = wp.lerp(dark, light.horizon, mist)
        color = wp.lerp(veil, color, smooth(-0.0015, 0.0015, rise - ridge - trees))
    return color


@wp.func
def ground_color(surfaces: Surfaces, p: wp.vec3, distance: float) -> wp.vec3:
    """Albedo of the ground: grass in patches with bare earth between; fine grain fades with the distance."""
    if surfaces.detail == 0.0:
        return surfaces.ground_color
    q = p * (1.0 / surfaces.size)
    patches = octaves(41, q * 0.55)
    grain = octaves(42, wp.vec3(q[0] * 9.0, q[1] * 9.0, 0.0))
    blades = octaves(43, q * 60.0) * wp.exp(-0.12 * distance / surfaces.size)
    color = wp.lerp(surfaces.ground_color, wp.vec3(0.19, 0.17, 0.065), smooth(-0.15, 0.55, patches + 0.35 * grain))
    color = wp.lerp(color, wp.vec3(0.15, 0.10, 0.06), 0.75 * smooth(0.35, 0.75, -patches + 0.5 * grain))
    return color * (1.0 + 0.35 * grain + 0.75 * blades)


@wp.func
def bark(surfaces: Surfaces, p: wp.vec3, color: wp.vec3, normal: wp.vec3) -> Hit:
    """Give wood upright furrows: a darker albedo and a tilted normal where noise stretched along z is low."""
    q = p * (1.0 / surfaces.size)
    furrow = octaves(51, wp.vec3(q[0] * 90.0, q[1] * 90.0, q[2] * 16.0))
    lean = octaves(52, wp.vec3(q[0] * 90.0, q[1] * 90.0, q[2] * 16.0))
    side = wp.normalize(wp.cross(normal, wp.vec3(0.05, 0.03, 1.0)))
    hit = Hit()
    hit.normal = wp.normalize(normal + side * (0.9 * lean))
    hit.color = color * wp.clamp(0.85 + 0.75 * furrow, 0.3, 1.5)
    return hit


@wp.func
def mesh_hit(surfaces: Surfaces, query: wp.MeshQueryRay, p: wp.vec3, direction: wp.vec3) -> Hit:
    """Interpolate normal and colour over the face that a ray met at p."""
    i = wp.mesh_get_index(surfaces.mesh, 3 * query.face)
    j = wp.mesh_get_index(surfaces.mesh, 3 * query.face + 1)
    k = wp.mesh_get_index(surfaces.mesh, 3 * query.face + 2)
    w = 1.0 - query.u - query.v
    normal = wp.normalize(surfaces.normal[i] * query.u + surfaces.normal[j] * query.v + surfaces.normal[k] * w)
    color = surfaces.color[i] * query.u + surfaces.color[j] * query.v + surfaces.color[k] * w
    hit = Hit()
    hit.color = wp.vec3(color[0], color[1], color[2])
    if surfaces.detail > 0.0 and color[3] == 0.0:
        wood = bark(surfaces, p, hit.color, normal)
        hit.color = wood.color
        normal = wood.normal
    if wp.dot(normal, direction) > 0.0:
        normal = -normal
    hit.kind = MESH
    hit.distance = query.t
    hit.normal = normal
    hit.through = color[3]
    return hit


@wp.func
def first_hit(surfaces: Surfaces, origin: wp.vec3, direction: wp.vec3) -> Hit:
    """Find the nearest surface along a ray with unit direction; ``kind`` is SKY if there is none."""
    hit = Hit()
    hit.kind = SKY
    hit.distance = FAR
    if direction[2] < 0.0 and origin[2] > surfaces.ground:
        hit.kind = GROUND
        hit.distance = (surfaces.ground - origin[2]) / direction[2]
        hit.normal = wp.vec3(0.0, 0.0, 1.0)
    query = wp.mesh_query_ray(surfaces.mesh, origin, direction, hit.distance)
    if query.result:
        return mesh_hit(surfaces, query, origin + direction * query.t, direction)
    if hit.kind == GROUND:
        hit.color = ground_color(surfaces, origin + direction * hit.distance, hit.distance)
    return hit


@wp.func
def tangent(normal: wp.vec3) -> wp.vec3:
    """Make a unit vector square to a unit normal."""
    other = wp.vec3(1.0, 0.0, 0.0)
    if wp.abs(normal[0]) > 0.7:
        other = wp.vec3(0.0, 1.0, 0.0)
    return wp.normalize(wp.cross(normal, other))


@wp.func
def cosine_direction(normal: wp.vec3, u: float, v: float) -> wp.vec3:
    """Draw a direction about ``normal`` with density cos / pi from two uniform numbers (Malley's method)."""
    x = tangent(normal)
    y = wp.cross(normal, x)
    r = wp.sqrt(u)
    a = 2.0 * wp.pi * v
    return wp.normalize(x * (r * wp.cos(a)) + y * (r * wp.sin(a)) + normal * wp.sqrt(wp.max(1.0 - u, 0.0)))


@wp.func
def sun_direction(light: Light, u: float, v: float) -> wp.vec3:
    """Draw a direction evenly from the sun's disc."""
    x = tangent(light.to_sun)
    y = wp.cross(light.to_sun, x)
    r = light.sun_radius * wp.sqrt(u)
    a = 2.0 * wp.pi * v
    return wp.normalize(light.to_sun + x * (r * wp.cos(a)) + y * (r * wp.sin(a)))


@wp.func
def sunlight(surfaces: Surfaces, light: Light, hit: Hit, p: wp.vec3, to_sun: wp.vec3) -> wp.vec3:
    """Reflected (or, through a leaf, passed) radiance of the sun at p: Lambert's law with one shadow ray."""
    cosine = wp.dot(hit.normal, to_sun)
    share = wp.float32(1.0)
    if cosine < 0.0:
        share = hit.through
    if share * cosine == 0.0 or wp.mesh_query_ray_anyhit(surfaces.mesh, p, to_sun, FAR):
        return wp.vec3(0.0)
    return wp.cw_mul(hit.color, light.sun) * (share * wp.abs(cosine) / wp.pi)


@wp.func
def skylight(surfaces: Surfaces, light: Light, hit: Hit, p: wp.vec3, direction: wp.vec3) -> wp.vec3:
    """Reflected radiance of what one ray into the upper half-space of the surface finds."""
    if wp.mesh_query_ray_anyhit(surfaces.mesh, p, direction, FAR):
        return wp.cw_mul(hit.color, light.inside)
    if direction[2] < 0.0:
        lit = light.sun * (wp.max(light.to_sun[2], 0.0) / wp.pi) + 0.5 * (light.zenith + light.horizon)
        return wp.cw_mul(hit.color, wp.cw_mul(surfaces.ground_color, lit)) * 0.6  # the rest lies in shadow
    return wp.cw_mul(hit.color, sky_gradient(light, direction))


@wp.func
def radiance(surfaces: Surfaces, light: Light, origin: wp.vec3, direction: wp.vec3, random: wp.vec4) -> wp.vec3:
    """Estimate the radiance that arrives at ``origin`` against ``direction`` from four uniform numbers."""
    hit = first_hit(surfaces, origin, direction)
    if hit.kind == SKY:
        return backdrop(surfaces, light, direction)
    p = origin + direction * hit.distance + hit.normal * (1.0e-4 * surfaces.size)
    to_sun = sun_direction(light, random[0], random[1])
    if hit.through > 0.0 and wp.dot(hit.normal, to_sun) < 0.0:
        p -= hit.normal * (2.0e-4 * surfaces.size)
    direct = sunlight(surfaces, light, hit, p, to_sun)
    sky = skylight(surfaces, light, hit, p, cosine_direction(hit.normal, random[2], random[3]))
    clear = wp.exp(-light.haze * hit.distance)
    veil = sky_gradient(light, wp.normalize(wp.vec3(direction[0], direction[1], 0.02)))
    return veil + (direct + sky - veil) * clear


@wp.kernel
def trace(
    surfaces: Surfaces, light: Light, camera: Camera, height: int, first_row: int, samples: int, seed: int,
    image_out: wp.array2d(dtype=wp.vec3),
):  # fmt: skip
    """Average ``samples`` estimates of the radiance over each pixel.

    Launched over image_out's shape [rows, width], rows ``first_row`` on of a picture of ``height`` rows. Places in the
    pixel follow the additive recurrence of the plastic number; the other numbers hash seed, pixel and sample, so that
    a picture does not depend on how its rows are shared out.
    """
    i, j = wp.tid()
    width = image_out.shape[1]
    row = first_row + i
    state = wp.rand_init(seed, row * width + j)
    total = wp.vec3(0.0)
    for k in range(samples):
        x = wp.frac(0.5 + 0.7548776662 * float(k))
        y = wp.frac(0.5 + 0.5698402910 * float(k))
        across = 2.0 * (float(j) + x) / float(width) - 1.0
        above = 1.0 - 2.0 * (float(row) + y) / float(height)
        direction = wp.normalize(camera.forward + camera.right * across + camera.up * above)
        random = wp.vec4(wp.randf(state), wp.randf(state), wp.randf(state), wp.randf(state))
        total += wp.min(radiance(surfaces, light, camera.position, direction, random), wp.vec3(8.0))
    image_out[i, j] = total / float(samples)
