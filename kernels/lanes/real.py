"""Scalar types of the kernels: one world, or several worlds in the lanes of one thread.

Physics here is written once over a scalar called a *real*, and compiled for

- ``float32`` : one world a thread (GPU, or a plain CPU thread),
- `Double`    : one world a thread in float64,
- lanes       : 8 or 16 worlds in the SIMD lanes of one CPU thread (float32).

Lane arithmetic is bit-equal to scalar arithmetic: every operation is the IEEE operation on each lane, and the compiler
contracts nothing: products are fused with sums only where the source says ``fma``. Operators resolve to the overloads
named ``add``, ``sub``, ``mul`` and ``div`` below; named helpers are overloaded likewise:

========================  ==============================================================================
``real(c, like)``         the constant c as a real of the type of ``like`` (whose value is not read)
``where_neg(c, a, b)``    a where c < 0, else b (also where c is NaN)
``any_neg(c)``            whether c < 0 in any world of the group
``fma(a, b, c)``          a b + c, rounded once (so that scalar and lane code agree to the bit)
``fnma(a, b, c)``         c - a b, rounded once
``sqrt_(a)``              square root
``round_(a)``             nearest integer, ties to even
``sin_ratio(u)``          sin(x)/x with x = sqrt(u)
``cos_root(u)``           cos(x) with x = sqrt(u)
``atan_ratio(u)``         atan(x)/x with x = sqrt(u), for u in [0, 1]
``atan_excess(u)``        (atan(x)/x - 1) / u with x = sqrt(u), for u in [0, 1]
``lane_neg(c, i)``        whether c < 0 in world i of the group
``lane(a, i)``            value of world i of the group, as a float32 or float64 number
========================  ==============================================================================
"""

import zlib
from pathlib import Path
from typing import Any

import warp as wp

__all__ = ["SOURCE", "WIDTHS", "Double", "real_type"]

F = wp.float32

_files = [Path(__file__), Path(__file__).with_name("algebra.py")]
#: Digest of the files that define operators. Warp's cache key sees the functions that a kernel calls by name, but not
#: operator overloads, so every kernel names this.
SOURCE = wp.constant(zlib.crc32(b"".join(f.read_bytes() for f in _files)) & 0x7FFFFFFF)

WIDTHS = (1, 8, 16)

# Polynomials in u = x^2, highest power first.
# atan(x)/x on [0, 1]: Chebyshev interpolation of degree 9, error below 2.5e-9
ATAN = wp.constant(
    wp.types.vector(10, wp.float64)(
        -0.001743701143, 0.0106807194421, -0.0307175088961, 0.0574635578387, -0.0837206394734,
        0.1094019896483, -0.1426157368021, 0.1999823064037, -0.3333328229551, 0.999999997546,
    )
)  # fmt: skip
# Taylor series of sin(x)/x and cos(x); the next term is below 1.1e-4 for a half turn, x = pi
SINE = wp.constant(
    wp.types.vector(7, wp.float64)(
        1.0 / 6227020800.0, -1.0 / 39916800.0, 1.0 / 362880.0, -1.0 / 5040.0, 1.0 / 120.0, -1.0 / 6.0, 1.0
    )
)
COSINE = wp.constant(
    wp.types.vector(7, wp.float64)(
        1.0 / 479001600.0, -1.0 / 3628800.0, 1.0 / 40320.0, -1.0 / 720.0, 1.0 / 24.0, -1.0 / 2.0, 1.0
    )
)


@wp.func
def series_atan_excess(u: Any):
    """(atan(x)/x - 1) / u, u = x^2 in [0, 1], by Horner's rule: the polynomial without its last coefficient."""
    y = real(ATAN[0], u)
    for k in range(1, 9):
        y = fma(y, u, real(ATAN[k], u))
    return y


@wp.func
def series_atan(u: Any):
    """atan(x)/x, u = x^2 in [0, 1]."""
    return fma(series_atan_excess(u), u, real(ATAN[9], u))


@wp.func
def series_sine(u: Any):
    """sin(x)/x, u = x^2, by Horner's rule."""
    y = real(SINE[0], u)
    for k in range(1, 7):
        y = fma(y, u, real(SINE[k], u))
    return y


@wp.func
def series_cosine(u: Any):
    """cos(x), u = x^2, by Horner's rule."""
    y = real(COSINE[0], u)
    for k in range(1, 7):
        y = fma(y, u, real(COSINE[k], u))
    return y


# ---- float32, one world ------------------------------------------------------------------------------------------


@wp.func
def real(c: F, like: F):
    """The constant c as a real of the type of ``like``."""
    return c


@wp.func
def real(c: wp.float64, like: F):
    """The constant c as a real of the type of ``like``."""
    return wp.float32(c)


@wp.func
def where_neg(c: F, a: F, b: F):
    """a where c < 0, else b (also where c is NaN)."""
    return wp.where(c < 0.0, a, b)


@wp.func
def any_neg(c: F):
    """Whether c < 0 in any world of the group."""
    return c < 0.0


@wp.func_native("\n#ifdef __CUDA_ARCH__\nreturn fmaf(a, b, c);\n#else\nreturn __builtin_fmaf(a, b, c);\n#endif\n")
def _fma32(a: wp.float32, b: wp.float32, c: wp.float32) -> wp.float32: ...


@wp.func_native("\n#ifdef __CUDA_ARCH__\nreturn fma(a, b, c);\n#else\nreturn __builtin_fma(a, b, c);\n#endif\n")
def _fma64(a: wp.float64, b: wp.float64, c: wp.float64) -> wp.float64: ...


@wp.func
def fma(a: F, b: F, c: F):
    """a b + c, rounded once."""
    return _fma32(a, b, c)


@wp.func
def fnma(a: F, b: F, c: F):
    """c - a b, rounded once."""
    return _fma32(-a, b, c)


@wp.func
def sqrt_(a: F):
    """Square root."""
    return wp.sqrt(a)


@wp.func
def round_(a: F):
    """Nearest integer, ties to even."""
    return wp.rint(a)


@wp.func
def sin_ratio(u: F):
    """sin(x)/x with x = sqrt(u)."""
    return series_sine(u)


@wp.func
def cos_root(u: F):
    """cos(x) with x = sqrt(u)."""
    return series_cosine(u)


@wp.func
def atan_ratio(u: F):
    """atan(x)/x with x = sqrt(u), u in [0, 1]."""
    return series_atan(u)


@wp.func
def atan_excess(u: F):
    """(atan(x)/x - 1) / u with x = sqrt(u), u in [0, 1]."""
    return series_atan_excess(u)


@wp.func
def lane_neg(c: F, i: int):
    """Whether c < 0 in world i of the group."""
    return c < 0.0


@wp.func
def lane(a: F, i: int):
    """Value of world i of the group."""
    return a


# ---- float64, one world ------------------------------------------------------------------------------------------


@wp.struct
class Double:
    """A float64 scalar. The wrapping makes literals and operators resolve as they do for lanes."""

    v: wp.float64


@wp.func
def real(c: F, like: Double):
    """The constant c as a real of the type of ``like``."""
    return type(like)(wp.float64(c))


@wp.func
def real(c: wp.float64, like: Double):
    """The constant c as a real of the type of ``like``."""
    return type(like)(c)


@wp.func
def add(a: Double, b: Double):
    """a + b."""
    return type(a)(a.v + b.v)


@wp.func
def add(a: Double, b: F):
    """a + b."""
    return type(a)(a.v + wp.float64(b))


@wp.func
def add(a: F, b: Double):
    """a + b."""
    return type(b)(wp.float64(a) + b.v)


@wp.func
def sub(a: Double, b: Double):
    """a - b."""
    return type(a)(a.v - b.v)


@wp.func
def sub(a: Double, b: F):
    """a - b."""
    return type(a)(a.v - wp.float64(b))


@wp.func
def sub(a: F, b: Double):
    """a - b."""
    return type(b)(wp.float64(a) - b.v)


@wp.func
def mul(a: Double, b: Double):
    """a b."""
    return type(a)(a.v * b.v)


@wp.func
def mul(a: Double, b: F):
    """a b."""
    return type(a)(a.v * wp.float64(b))


@wp.func
def mul(a: F, b: Double):
    """a b."""
    return type(b)(wp.float64(a) * b.v)


@wp.func
def div(a: Double, b: Double):
    """a / b."""
    return type(a)(a.v / b.v)


@wp.func
def div(a: F, b: Double):
    """a / b."""
    return type(b)(wp.float64(a) / b.v)


@wp.func
def where_neg(c: Double, a: Double, b: Double):
    """a where c < 0, else b (also where c is NaN)."""
    return type(a)(wp.where(c.v < wp.float64(0.0), a.v, b.v))


@wp.func
def any_neg(c: Double):
    """Whether c < 0 in any world of the group."""
    return c.v < wp.float64(0.0)


@wp.func
def fma(a: Double, b: Double, c: Double):
    """a b + c, rounded once."""
    return type(a)(_fma64(a.v, b.v, c.v))


@wp.func
def fnma(a: Double, b: Double, c: Double):
    """c - a b, rounded once."""
    return type(a)(_fma64(-a.v, b.v, c.v))


@wp.func
def sqrt_(a: Double):
    """Square root."""
    return type(a)(wp.sqrt(a.v))


@wp.func
def round_(a: Double):
    """Nearest integer, ties to even."""
    return type(a)(wp.rint(a.v))


SMALL = wp.constant(wp.float64(1.0e-3))


@wp.func
def sin_ratio(u: Double):
    """sin(x)/x with x = sqrt(u)."""
    x = wp.sqrt(u.v)
    if u.v > SMALL:
        return type(u)(wp.sin(x) / x)
    return series_sine(u)


@wp.func
def cos_root(u: Double):
    """cos(x) with x = sqrt(u)."""
    return type(u)(wp.cos(wp.sqrt(u.v)))


@wp.func
def atan_ratio(u: Double):
    """atan(x)/x with x = sqrt(u), u in [0, 1]."""
    x = wp.sqrt(u.v)
    if u.v > wp.float64(1.0e-12):
        return type(u)(wp.atan(x) / x)
    return type(u)(wp.float64(1.0) - u.v / wp.float64(3.0))


#: Taylor series of (atan(x)/x - 1) / u, highest power first; the next term is below 7e-20 where u = x^2 < 1e-3.
EXCESS = wp.constant(
    wp.types.vector(6, wp.float64)(1.0 / 13.0, -1.0 / 11.0, 1.0 / 9.0, -1.0 / 7.0, 1.0 / 5.0, -1.0 / 3.0)
)


@wp.func
def atan_excess(u: Double):
    """(atan(x)/x - 1) / u with x = sqrt(u), u in [0, 1]."""
    if u.v > SMALL:
        x = wp.sqrt(u.v)
        return type(u)((wp.atan(x) / x - wp.float64(1.0)) / u.v)
    y = EXCESS[0]
    for k in range(1, 6):
        y = y * u.v + EXCESS[k]
    return type(u)(y)


@wp.func
def lane_neg(c: Double, i: int):
    """Whether c < 0 in world i of the group."""
    return c.v < wp.float64(0.0)


@wp.func
def lane(a: Double, i: int):
    """Value of world i of the group."""
    return a.v


# ---- 8 or 16 worlds in the lanes of a CPU thread --------------------------------------------------------------------


def _native(width: int, expression: str, arguments: str, result: str = "") -> str:
    """C++ of one lane operation, its arguments seen as clang vectors (CPU only)."""
    vector = f"typedef float V __attribute__((ext_vector_type({width}),aligned(4)));"
    loads = "".join(f"V {n}_; __builtin_memcpy(&{n}_,&{n},sizeof(V));" for n in arguments)
    store = f"wp::vec_t<{width},float> o; V r={expression}; __builtin_memcpy(&o,&r,sizeof(V)); return o;"
    return vector + loads + (result or store)


REAL_OF_WIDTH: dict[int, type] = {1: F}

for _W in (8, 16):
    V = wp.types.vector(_W, F)

    @wp.struct
    class Lanes:
        """Worlds side by side; wrapped so that a missing overload is an error and not Warp's slow vector loop."""

        v: V

    REAL_OF_WIDTH[_W] = Lanes

    @wp.func_native(_native(_W, "a_+b_", "ab"))
    def _add(a: V, b: V) -> V: ...

    @wp.func_native(_native(_W, "a_-b_", "ab"))
    def _sub(a: V, b: V) -> V: ...

    @wp.func_native(_native(_W, "a_*b_", "ab"))
    def _mul(a: V, b: V) -> V: ...

    @wp.func_native(_native(_W, "a_/b_", "ab"))
    def _div(a: V, b: V) -> V: ...

    @wp.func_native(_native(_W, "__builtin_elementwise_fma(a_,b_,c_)", "abc"))
    def _fma(a: V, b: V, c: V) -> V: ...

    @wp.func_native(_native(_W, "__builtin_elementwise_fma(-a_,b_,c_)", "abc"))
    def _fnma(a: V, b: V, c: V) -> V: ...

    @wp.func_native(_native(_W, "__builtin_elementwise_sqrt(a_)", "a"))
    def _sqrt(a: V) -> V: ...

    @wp.func_native(_native(_W, "__builtin_elementwise_rint(a_)", "a"))
    def _round(a: V) -> V: ...

    @wp.func_native(_native(_W, "c_<0.0f?a_:b_", "cab"))
    def _where(c: V, a: V, b: V) -> V: ...

    @wp.func_native(_native(_W, "", "c", "return __builtin_reduce_or(c_<0.0f)!=0;"))
    def _any(c: V) -> bool: ...

    @wp.func
    def real(c: F, like: Lanes):
        """The constant c as a real of the type of ``like``."""
        return type(like)(type(like.v)(c))

    @wp.func
    def real(c: wp.float64, like: Lanes):
        """The constant c as a real of the type of ``like``."""
        return type(like)(type(like.v)(wp.float32(c)))

    @wp.func
    def add(a: Lanes, b: Lanes):
        """a + b."""
        return type(a)(_add(a.v, b.v))

    @wp.func
    def add(a: Lanes, b: F):
        """a + b."""
        return type(a)(_add(a.v, type(a.v)(b)))

    @wp.func
    def add(a: F, b: Lanes):
        """a + b."""
        return type(b)(_add(type(b.v)(a), b.v))

    @wp.func
    def sub(a: Lanes, b: Lanes):
        """a - b."""
        return type(a)(_sub(a.v, b.v))

    @wp.func
    def sub(a: Lanes, b: F):
        """a - b."""
        return type(a)(_sub(a.v, type(a.v)(b)))

    @wp.func
    def sub(a: F, b: Lanes):
        """a - b."""
        return type(b)(_sub(type(b.v)(a), b.v))

    @wp.func
    def mul(a: Lanes, b: Lanes):
        """a b."""
        return type(a)(_mul(a.v, b.v))

    @wp.func
    def mul(a: Lanes, b: F):
        """a b."""
        return type(a)(_mul(a.v, type(a.v)(b)))

    @wp.func
    def mul(a: F, b: Lanes):
        """a b."""
        return type(b)(_mul(type(b.v)(a), b.v))

    @wp.func
    def div(a: Lanes, b: Lanes):
        """a / b."""
        return type(a)(_div(a.v, b.v))

    @wp.func
    def div(a: F, b: Lanes):
        """a / b."""
        return type(b)(_div(type(b.v)(a), b.v))

    @wp.func
    def where_neg(c: Lanes, a: Lanes, b: Lanes):
        """a where c < 0, else b (also where c is NaN)."""
        return type(a)(_where(c.v, a.v, b.v))

    @wp.func
    def any_neg(c: Lanes):
        """Whether c < 0 in any world of the group."""
        return _any(c.v)

    @wp.func
    def fma(a: Lanes, b: Lanes, c: Lanes):
        """a b + c, rounded once."""
        return type(a)(_fma(a.v, b.v, c.v))

    @wp.func
    def fnma(a: Lanes, b: Lanes, c: Lanes):
        """c - a b, rounded once."""
        return type(a)(_fnma(a.v, b.v, c.v))

    @wp.func
    def sqrt_(a: Lanes):
        """Square root."""
        return type(a)(_sqrt(a.v))

    @wp.func
    def round_(a: Lanes):
        """Nearest integer, ties to even."""
        return type(a)(_round(a.v))

    @wp.func
    def sin_ratio(u: Lanes):
        """sin(x)/x with x = sqrt(u)."""
        return series_sine(u)

    @wp.func
    def cos_root(u: Lanes):
        """cos(x) with x = sqrt(u)."""
        return series_cosine(u)

    @wp.func
    def atan_ratio(u: Lanes):
        """atan(x)/x with x = sqrt(u), u in [0, 1]."""
        return series_atan(u)

    @wp.func
    def atan_excess(u: Lanes):
        """(atan(x)/x - 1) / u with x = sqrt(u), u in [0, 1]."""
        return series_atan_excess(u)

    @wp.func
    def lane_neg(c: Lanes, i: int):
        """Whether c < 0 in world i of the group."""
        return c.v[i] < 0.0

    @wp.func
    def lane(a: Lanes, i: int):
        """Value of world i of the group."""
        return a.v[i]


del V, Lanes


def real_type(width: int = 1, precision: int = 32) -> type:
    """Return the scalar type for ``width`` worlds a thread at 32 or 64 bit.

    Raises:
        ValueError: No such type exists (lanes are float32 only).
    """
    if precision == 64 and width == 1:
        return Double
    if precision == 32 and width in REAL_OF_WIDTH:
        return REAL_OF_WIDTH[width]
    raise ValueError(f"no real of {precision} bit with {width} worlds a thread; 32 bit with 1, 8, 16 or 64 bit with 1")
