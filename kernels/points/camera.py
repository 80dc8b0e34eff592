"""Colour, depth and labels of several cameras that look at one world of round cones, leaves and ground.

A camera looks along its +z, x to the right, y down; pixel (column u, row v) sees the ray ((u - cx)/fx, (v - cy)/fy, 1),
so that whole numbers are pixel centres. Depth is measured along +z.

Stereo: a point at the depth z is seen with the disparity d = f b / z by two imagers a baseline b apart, so an error of
d becomes one of z that grows with its square, dz = z^2 dd / (f b). The second imager stands at +b along the camera's
x; what it cannot see has no match, and so no depth.
"""

import warp as wp

from .raytrace import GROUND, SKY, Light, Solids, first_hit, ground_color, sky_around, sky_gradient, xyz

wp.set_module_options({"enable_backward": False})


@wp.struct
class Eye:
    """Where a camera is, world axes, and its focal lengths and middle [pixels]."""

    position: wp.vec3
    rotation: wp.quat  # x, y, z, w: from the camera's axes to the world's
    focal: wp.vec2
    middle: wp.vec2


@wp.struct
class Stereo:
    """How a pair of imagers measures depth; lengths in m, disparities in pixels of the imagers."""

    focal: float  # of the imagers [pixels]
    baseline: float
    noise: float  # standard deviation of the disparity
    step: float  # of the disparity, 0 for none
    unit: float  # of the depth that is reported, 0 for none
    nearest: float
    farthest: float
    reach: int  # pixels on each side that a match is made over
    agree: wp.vec2  # share of them at one disparity below which there is never, above which there is always a match
    graze: wp.vec2  # cosine of incidence, likewise


@wp.kernel
def look(
    solids: Solids, light: Light, eyes: wp.array(dtype=Eye), label: wp.array(dtype=wp.uint8), baseline: float,
    colour_out: wp.array(dtype=wp.vec3, ndim=3), depth_out: wp.array3d(dtype=float),
    slant_out: wp.array3d(dtype=float), label_out: wp.array3d(dtype=wp.uint8),
):  # fmt: skip
    """Trace one ray a pixel: radiance, true depth [m], cosine of incidence, label of what is seen.

    Depth is 0 for the sky. ``label`` [C + 2] is that of each solid, then of the ground and of the sky. The cosine is 0
    where a second imager at ``baseline`` does not see the point. Launched over the outputs' shape [cameras, H, W].
    """
    k, i, j = wp.tid()
    eye = eyes[k]
    at = wp.vec3((float(j) - eye.middle[0]) / eye.focal[0], (float(i) - eye.middle[1]) / eye.focal[1], 1.0)
    along = wp.normalize(at)
    direction = wp.quat_rotate(eye.rotation, along)
    hit = first_hit(solids, eye.position, direction, 0.0)
    count = solids.start.shape[0]
    if hit.item == SKY:
        colour_out[k, i, j] = sky_gradient(light, direction)
        depth_out[k, i, j] = 0.0
        slant_out[k, i, j] = 0.0
        label_out[k, i, j] = label[count + 1]
        return
    p = eye.position + direction * hit.distance
    albedo = wp.vec3(0.0)
    kind = count
    if hit.item == GROUND:
        albedo = ground_color(solids, p, direction, hit.distance / eye.focal[0])
    else:
        kind = hit.item
        albedo = xyz(solids.color[kind])
    lit = light.sun * (wp.max(wp.dot(hit.normal, light.to_sun), 0.0) / wp.pi) + sky_around(light, hit.normal)
    colour_out[k, i, j] = wp.cw_mul(albedo, lit)
    depth_out[k, i, j] = hit.distance * along[2]
    label_out[k, i, j] = label[kind]
    slant = -wp.dot(hit.normal, direction)
    if baseline > 0.0:
        second = eye.position + wp.quat_rotate(eye.rotation, wp.vec3(baseline, 0.0, 0.0))
        way = p - second
        far = wp.length(way)
        seen = first_hit(solids, second, way / far, 0.0)
        if seen.distance < far * 0.999 - 1.0e-3:
            slant = 0.0
    slant_out[k, i, j] = slant


@wp.func
def between(x: float, range: wp.vec2) -> float:
    """Probability that goes from 0 below a range to 1 above it."""
    return wp.clamp((x - range[0]) / wp.max(range[1] - range[0], 1.0e-6), 0.0, 1.0)


@wp.kernel
def measure(
    stereo: Stereo, seed: int, depth: wp.array3d(dtype=float), slant: wp.array3d(dtype=float),
    depth_out: wp.array3d(dtype=float),
):  # fmt: skip
    """Measure depth as a pair of imagers does: noise of the disparity, steps of it, holes.

    A match is made over a square of pixels, and is found the more surely, the more of them have the pixel's own
    disparity, to within one pixel. Launched over the shape [cameras, H, W]; numbers depend on ``seed`` and pixel alone.
    """
    k, i, j = wp.tid()
    z = depth[k, i, j]
    depth_out[k, i, j] = 0.0
    if z < stereo.nearest or z > stereo.farthest:
        return
    height, width = depth.shape[1], depth.shape[2]
    random = wp.rand_init(seed, (k * height + i) * width + j)
    scale = stereo.focal * stereo.baseline
    disparity = scale / z
    same = wp.int32(0)
    for di in range(-stereo.reach, stereo.reach + 1):
        for dj in range(-stereo.reach, stereo.reach + 1):
            other = depth[k, wp.clamp(i + di, 0, height - 1), wp.clamp(j + dj, 0, width - 1)]
            if other > 0.0:
                if wp.abs(scale / other - disparity) < 1.0:
                    same += 1
    side = 2 * stereo.reach + 1
    share = float(same) / float(side * side)
    found = between(share, stereo.agree) * between(slant[k, i, j], stereo.graze)
    if wp.randf(random) >= found:
        return
    disparity += stereo.noise * wp.randn(random)
    if stereo.step > 0.0:
        disparity = stereo.step * wp.round(disparity / stereo.step)
    if disparity <= 0.0:
        return
    out = scale / disparity
    if stereo.unit > 0.0:
        out = stereo.unit * wp.round(out / stereo.unit)
    if out >= stereo.nearest and out <= stereo.farthest:
        depth_out[k, i, j] = out
