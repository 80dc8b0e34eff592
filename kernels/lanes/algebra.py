"""Vectors, quaternions and 3 x 3 matrices over any real, with the operators the physics is written in.

One set of structs per real. Quaternions are w, x, y, z; a `Sym` holds the six entries of a symmetric matrix, a `Mat`
the three columns of a general one. There is no unary minus on structs in Warp: write ``zero - a``.
"""

from types import SimpleNamespace
from typing import Any

import warp as wp

from .real import (
    REAL_OF_WIDTH,
    Double,
    add,
    any_neg,
    atan_excess,
    atan_ratio,
    cos_root,
    div,
    fma,
    fnma,
    lane,
    mul,
    real,
    real_type,
    round_,
    sin_ratio,
    sqrt_,
    sub,
    where_neg,
)

__all__ = ["types_of"]


F = wp.float32


def _structs(scalar: type) -> SimpleNamespace:
    """Vec, Quat, Sym and Mat with entries of one scalar type."""

    @wp.struct
    class Vec:
        """A vector x, y, z."""

        x: scalar
        y: scalar
        z: scalar

    @wp.struct
    class Quat:
        """A quaternion w, x, y, z."""

        w: scalar
        x: scalar
        y: scalar
        z: scalar

    @wp.struct
    class Sym:
        """The six entries of a symmetric matrix."""

        xx: scalar
        xy: scalar
        xz: scalar
        yy: scalar
        yz: scalar
        zz: scalar

    @wp.struct
    class Mat:
        """The three columns of a matrix."""

        x: Vec
        y: Vec
        z: Vec

    return SimpleNamespace(Real=scalar, Vec=Vec, Quat=Quat, Sym=Sym, Mat=Mat)


_TYPES = {scalar: _structs(scalar) for scalar in (*REAL_OF_WIDTH.values(), Double)}

for _T in _TYPES.values():
    R, Vec, Quat, Sym, Mat = _T.Real, _T.Vec, _T.Quat, _T.Sym, _T.Mat

    @wp.func
    def add(a: Vec, b: Vec):
        """a + b."""
        return type(a)(a.x + b.x, a.y + b.y, a.z + b.z)

    @wp.func
    def sub(a: Vec, b: Vec):
        """a - b."""
        return type(a)(a.x - b.x, a.y - b.y, a.z - b.z)

    @wp.func
    def mul(a: Vec, s: R):
        """a b."""
        return type(a)(a.x * s, a.y * s, a.z * s)

    @wp.func
    def mul(a: Vec, s: F):
        """a b."""
        return type(a)(a.x * s, a.y * s, a.z * s)

    @wp.func
    def mul(p: Quat, q: Quat):
        """a b."""
        return type(p)(
            fnma(p.z, q.z, fnma(p.y, q.y, fnma(p.x, q.x, p.w * q.w))),
            fnma(p.z, q.y, fma(p.y, q.z, fma(p.x, q.w, p.w * q.x))),
            fma(p.z, q.x, fma(p.y, q.w, fnma(p.x, q.z, p.w * q.y))),
            fma(p.z, q.w, fnma(p.y, q.x, fma(p.x, q.y, p.w * q.z))),
        )

    @wp.func
    def mul(q: Quat, s: R):
        """a b."""
        return type(q)(q.w * s, q.x * s, q.y * s, q.z * s)

    @wp.func
    def add(a: Sym, b: Sym):
        """a + b."""
        return type(a)(a.xx + b.xx, a.xy + b.xy, a.xz + b.xz, a.yy + b.yy, a.yz + b.yz, a.zz + b.zz)

    @wp.func
    def sub(a: Sym, b: Sym):
        """a - b."""
        return type(a)(a.xx - b.xx, a.xy - b.xy, a.xz - b.xz, a.yy - b.yy, a.yz - b.yz, a.zz - b.zz)

    @wp.func
    def mul(a: Sym, s: R):
        """a b."""
        return type(a)(a.xx * s, a.xy * s, a.xz * s, a.yy * s, a.yz * s, a.zz * s)

    @wp.func
    def mul(a: Sym, v: Vec):
        """a b."""
        return type(v)(
            fma(a.xz, v.z, fma(a.xy, v.y, a.xx * v.x)),
            fma(a.yz, v.z, fma(a.yy, v.y, a.xy * v.x)),
            fma(a.zz, v.z, fma(a.yz, v.y, a.xz * v.x)),
        )

    @wp.func
    def add_mul(c: Vec, a: Sym, v: Vec):
        """a + b c."""
        return type(v)(
            fma(a.xz, v.z, fma(a.xy, v.y, fma(a.xx, v.x, c.x))),
            fma(a.yz, v.z, fma(a.yy, v.y, fma(a.xy, v.x, c.y))),
            fma(a.zz, v.z, fma(a.yz, v.y, fma(a.xz, v.x, c.z))),
        )

    @wp.func
    def sub_mul(c: Vec, a: Mat, v: Vec):
        """a - b c."""
        return type(v)(
            fnma(a.z.x, v.z, fnma(a.y.x, v.y, fnma(a.x.x, v.x, c.x))),
            fnma(a.z.y, v.z, fnma(a.y.y, v.y, fnma(a.x.y, v.x, c.y))),
            fnma(a.z.z, v.z, fnma(a.y.z, v.y, fnma(a.x.z, v.x, c.z))),
        )

    @wp.func
    def add(a: Mat, b: Mat):
        """a + b."""
        return type(a)(a.x + b.x, a.y + b.y, a.z + b.z)

    @wp.func
    def sub(a: Mat, b: Mat):
        """a - b."""
        return type(a)(a.x - b.x, a.y - b.y, a.z - b.z)

    @wp.func
    def mul(a: Mat, s: R):
        """a b."""
        return type(a)(a.x * s, a.y * s, a.z * s)

    @wp.func
    def mul(a: Mat, v: Vec):
        """a b."""
        return add_scaled(add_scaled(a.x * v.x, a.y, v.y), a.z, v.z)

    @wp.func
    def mul(a: Sym, b: Mat):
        """a b."""
        return type(b)(a * b.x, a * b.y, a * b.z)

    @wp.func
    def vec3_of(v: Vec, i: int):
        """A vector of one world as Warp has it."""
        return wp.vec3(lane(v.x, i), lane(v.y, i), lane(v.z, i))


del R, Vec, Quat, Sym, Mat


@wp.func
def dot(a: Any, b: Any):
    """a . b."""
    return fma(a.z, b.z, fma(a.y, b.y, a.x * b.x))


@wp.func
def spread(v: wp.vec3, like: Any):
    """The vector v in all worlds of the group, of the type of ``like``."""
    return type(like)(real(v[0], like.x), real(v[1], like.x), real(v[2], like.x))


@wp.func
def cross(a: Any, b: Any):
    """a x b."""
    return type(a)(fnma(a.z, b.y, a.y * b.z), fnma(a.x, b.z, a.z * b.x), fnma(a.y, b.x, a.x * b.y))


@wp.func
def add_cross(c: Any, a: Any, b: Any):
    """c + a x b."""
    return type(a)(
        fnma(a.z, b.y, fma(a.y, b.z, c.x)), fnma(a.x, b.z, fma(a.z, b.x, c.y)), fnma(a.y, b.x, fma(a.x, b.y, c.z))
    )


@wp.func
def add_scaled(c: Any, v: Any, s: Any):
    """c + v s."""
    return type(v)(fma(v.x, s, c.x), fma(v.y, s, c.y), fma(v.z, s, c.z))


@wp.func
def sub_scaled(c: Any, v: Any, s: Any):
    """c - v s."""
    return type(v)(fnma(v.x, s, c.x), fnma(v.y, s, c.y), fnma(v.z, s, c.z))


@wp.func
def transposed_mul(a: Any, v: Any):
    """a^T v for a matrix of columns."""
    return type(v)(dot(a.x, v), dot(a.y, v), dot(a.z, v))


@wp.func
def add_dot(c: Any, a: Any, b: Any):
    """c + a . b"""
    return fma(a.z, b.z, fma(a.y, b.y, fma(a.x, b.x, c)))


@wp.func
def sub_dot(c: Any, a: Any, b: Any):
    """c - a . b"""
    return fnma(a.z, b.z, fnma(a.y, b.y, fnma(a.x, b.x, c)))


@wp.func
def rotate(q: Any, v: Any):
    """v turned by the unit quaternion q."""
    u = type(v)(q.x, q.y, q.z)
    t = cross(u, v)
    t = t + t
    return add_cross(add_scaled(v, t, q.w), u, t)


@wp.func
def unrotate(q: Any, v: Any):
    """v turned by the inverse of the unit quaternion q."""
    u = type(v)(q.x, q.y, q.z)
    t = cross(v, u)
    t = t + t
    return add_cross(add_scaled(v, t, q.w), t, u)


@wp.func
def renormalised(q: Any):
    """q brought back to unit length by one Newton step of 1/sqrt at 1: |q|^2 is 1 to the accuracy of one step."""
    n = fma(q.w, q.w, fma(q.z, q.z, fma(q.y, q.y, q.x * q.x)))
    return q * fma(n, real(-0.5, n), real(1.5, n))


@wp.func
def quarter_turn(q: Any):
    """s / (1 + |w|), s = sign(w), and u = t^2 of a turn q = (w, v): t = |v| / (1 + |w|) <= 1 is tan(angle / 4)."""
    one = real(1.0, q.w)
    s = where_neg(q.w, real(-1.0, q.w), one)
    i = one / fma(q.w, s, one)
    return i * s, fma(q.z, q.z, fma(q.y, q.y, q.x * q.x)) * (i * i)


@wp.func
def half_angle_log(q: Any):
    """Factor c with log(q) = c (q.x, q.y, q.z), the rotation vector of the short way round.

    The angle is 4 atan(t) (`quarter_turn`), so c = 4 s atan(t)/t / (1 + |w|). No branch, no singularity, and the same
    value for q and -q.
    """
    i, u = quarter_turn(q)
    return atan_ratio(u) * (i * 4.0)


@wp.func
def log_factors(q: Any):
    """Factors f and g of a turn q = (w, v): log(q) = f v, and the right Jacobian J of log(q) has

        J^-T P = P - f/2 v x P + g v x (v x P),   g = (1 - f w / 2) / |v|^2.

    With A = atan(t)/t as in `half_angle_log` and u = t^2, f w / 2 = A (1 - u), so that no difference vanishes in
    g = (A - (A - 1) / u) / (1 + |w|)^2.
    """
    i, u = quarter_turn(q)
    ratio = atan_ratio(u)
    return ratio * (i * 4.0), (ratio - atan_excess(u)) * (i * i)


@wp.func
def exponential(v: Any, like: Any):
    """Unit quaternion (of the type of ``like``) of the rotation vector v [rad]."""
    u = dot(v, v) * 0.25
    s = sin_ratio(u) * 0.5
    return type(like)(cos_root(u), v.x * s, v.y * s, v.z * s)


@wp.func
def about_axis(axis: Any, angle: Any, like: Any):
    """Unit quaternion of a turn by any ``angle`` [rad] about a unit ``axis``.

    The half angle is brought into [-pi/2, pi/2]: whole turns only change the sign of a quaternion, not the rotation.
    """
    half = angle * 0.5
    turns = round_(half * real(INVERSE_PI, half))
    x = fnma(turns, real(PI, half), half)
    u = x * x
    s = sin_ratio(u) * x
    return type(like)(cos_root(u), axis.x * s, axis.y * s, axis.z * s)


PI = wp.constant(wp.float64(3.141592653589793))
INVERSE_PI = wp.constant(wp.float64(0.3183098861837907))


@wp.func
def growth(x: Any):
    """(e^x - 1) / x of x >= 0 to its first four terms: 1 / (1 + x times it) is exp(-x) within 0.012, and falls to 0."""
    y = fma(x, real(1.0 / 24.0, x), real(1.0 / 6.0, x))
    return fma(x, fma(x, y, real(0.5, x)), real(1.0, x))


@wp.func
def size(x: Any):
    """|x| of a real."""
    return where_neg(x, x - x - x, x)


@wp.func
def begun(t: Any, t0: Any, d: Any):
    """(t - t0) / d within 0 and 1: how far what begins at t0 and takes d has come by t."""
    o, one = t - t, real(1.0, t)
    x = (t - t0) / d
    x = where_neg(x, o, x)
    return where_neg(one - x, one, x)


@wp.func
def changed(c: Any, t: Any, t0: Any, d: Any):
    """1 - c (1 - x), x how far what begins at t0 and takes d has come by t: from 1 - c to 1."""
    one = real(1.0, t)
    return fma(c, begun(t, t0, d) - one, one)


@wp.func
def norm(v: Any):
    """|v|, above zero, so that it can be divided by."""
    o = real(0.0, v.x)
    return sqrt_(fma(dot(v, v), real(1.0, o), real(1.0e-20, o)))


@wp.func
def shifted_inverse(a: Any, k: Any):
    """(a + k 1)^-1 of a symmetric matrix, by cofactors."""
    xx = a.xx + k
    yy = a.yy + k
    zz = a.zz + k
    c0 = fnma(a.yz, a.yz, yy * zz)
    c1 = fnma(a.xy, zz, a.xz * a.yz)
    c2 = fnma(a.xz, yy, a.xy * a.yz)
    c3 = fnma(a.xz, a.xz, xx * zz)
    c4 = fnma(xx, a.yz, a.xy * a.xz)
    c5 = fnma(a.xy, a.xy, xx * yy)
    i = 1.0 / fma(xx, c0, fma(a.xy, c1, a.xz * c2))
    return type(a)(c0 * i, c1 * i, c2 * i, c3 * i, c4 * i, c5 * i)


@wp.func
def sub_outer(c: Any, a: Any, b: Any):
    """c - a b^T for a symmetric c and a parallel to b."""
    return type(c)(
        fnma(a.x, b.x, c.xx),
        fnma(a.x, b.y, c.xy),
        fnma(a.x, b.z, c.xz),
        fnma(a.y, b.y, c.yy),
        fnma(a.y, b.z, c.yz),
        fnma(a.z, b.z, c.zz),
    )


def types_of(width: int = 1, precision: int = 32) -> SimpleNamespace:
    """Return the structs Vec, Quat, Sym, Mat and the scalar Real for a lane width and precision."""
    return _TYPES[real_type(width, precision)]
