"""Nearest points of capsules' axes, and of axes and a plane."""

import warp as wp

__all__ = ["nearest_on_segments", "ramp"]

#: Angle [rad] below which axes count as parallel: over 0.4 m their distance then differs by 0.1 mm.
PARALLEL = wp.constant(3.0e-4)


@wp.func
def ramp(x: float):
    """x within [0, 1]."""
    return wp.clamp(x, 0.0, 1.0)


@wp.func
def nearest_on_segments(p: wp.vec3, p1: wp.vec3, q: wp.vec3, q1: wp.vec3):
    """Shares (s, t) of the nearest points p + s (p1 - p) and q + t (q1 - q) of two segments.

    Ericson, Real-Time Collision Detection (2005), section 5.1.9, with the determinant |u x v|^2 and its numerator from
    cross products, which keep their digits where u and v are nearly parallel. Of parallel segments the middle of what
    they share is taken, so that a branch that lies along a link is held where it lies and not at an end that changes;
    angles around PARALLEL go over from one to the other without a jump.
    """
    u = p1 - p
    v = q1 - q
    r = p - q
    a = wp.dot(u, u)
    e = wp.dot(v, v)
    f = wp.dot(v, r)
    c = wp.dot(u, r)
    b = wp.dot(u, v)
    tiny = 1.0e-12
    s = float(0.0)
    t = float(0.0)
    if a <= tiny:
        if e > tiny:
            t = ramp(f / e)
    elif e <= tiny:
        s = ramp(0.0 - c / a)
    else:
        across = wp.cross(u, v)
        area = wp.dot(across, across)
        middle = 0.5 * (ramp((0.0 - c) / a) + ramp((b - c) / a))
        few = PARALLEL * PARALLEL * a * e
        s = ramp((few * middle - wp.dot(across, wp.cross(r, v))) / (area + few))
        t = (b * s + f) / e
        if t < 0.0:
            t = 0.0
            s = ramp(0.0 - c / a)
        elif t > 1.0:
            t = 1.0
            s = ramp((b - c) / a)
    return s, t
