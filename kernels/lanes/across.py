"""Lanes that hold points of one world, not worlds: sums and bounds across lanes, logarithm, random numbers.

Everything has a form for one lane (GPU) and for 8 and 16 lanes (CPU), like the operations of `real`, but what only
serves to leave out chunks of points on a CPU (``row_least``, ``tally``, ``negatives``):

==========================  =========================================================================================
``uniform_high(key, n, a)`` random numbers in (0, 1) of 16 bits, lane i a function of ``key + n + i`` alone;
``centred_low(key, n, a)``  the other 16 bits, in (-1/2, 1/2)
``log_(a)``                 natural logarithm of a in (0, 1), to a share of 2e-6
``sine_pi(r)``              sin(pi r) for r in [-1/2, 1/2], error below 2e-7; ``cosine_pi(r)`` likewise
``running_sum(a)``          lane i holds a[0] + ... + a[i]
``lane_sum(a)``             sum of the lanes, in one order always
``least(a)``                smallest lane; ``greatest(a)`` largest
``row_least(p, ...)``       lane i holds the least of row i of memory; ``row_greatest(p, ...)`` the greatest
``max_(a, b)``              the larger in each lane; ``min_`` the smaller
``below(a, b)``             1 where a < b, else 0
``tally(c, a, b)``          c + 1 where a < b, else c
``negatives(a)``            bit i is set where lane i is negative; ``first_bit(bits)`` is the lowest bit set
==========================  =========================================================================================

Random numbers are counter based: PCG's output permutation (Jarzynski and Olano, Hash Functions for GPU Rendering, JCGT
9 (3), 2020) of ``key + n``, so that number n of a key is the same whatever was drawn before, in any
order, on any device.
"""

from typing import Any

import warp as wp

from .real import REAL_OF_WIDTH, _native, fma, mul, real, sub

__all__ = ["cosine_pi", "key_of", "log_", "sine_pi"]

F = wp.float32

LOG2 = wp.constant(wp.float32(0.6931471824645996))

# Minimax on [sqrt(1/2) - 1, sqrt(2) - 1], highest power first: log(1 + t)/t to a share of 1.1e-6
LOG = wp.constant(
    wp.types.vector(7, wp.float32)(
        0.118961081, -0.186678549, 0.204963289, -0.249097442, 0.333145089, -0.500011129, 1.00000097
    )
)
CELL = wp.constant(wp.float32(2.0**-16))  # of random numbers of 16 bits

# Minimax in u = r^2 on [0, 1/4], highest power first: sin(pi r)/r to 1.4e-8 and cos(pi r) to 4.7e-8
SINE = wp.constant(
    wp.types.vector(5, wp.float32)(0.0776585336902, -0.598291776988, 2.55007760853, -5.16771008819, 3.14159264018)
)
COSINE = wp.constant(
    wp.types.vector(5, wp.float32)(0.219693765228, -1.33187883467, 4.0584117366, -4.93479285129, 0.99999995342)
)


@wp.func
def key_of(seed: int, world: int, tick: int):
    """Key of the random numbers of one world at one tick."""
    return wp.rand_init(wp.int32(wp.rand_init(wp.int32(wp.rand_init(seed) + wp.uint32(world))) + wp.uint32(tick)))


@wp.func
def sine_pi(r: Any):
    """sin(pi r), |r| <= 1/2."""
    u = r * r
    y = real(SINE[0], u)
    for k in range(1, 5):
        y = fma(y, u, real(SINE[k], u))
    return y * r


@wp.func
def cosine_pi(r: Any):
    """cos(pi r), |r| <= 1/2."""
    u = r * r
    y = real(COSINE[0], u)
    for k in range(1, 5):
        y = fma(y, u, real(COSINE[k], u))
    return y


@wp.func
def log_(a: Any):
    """log a = e log 2 + t P(t), t = m - 1, a = 2^e m with m in [sqrt(1/2), sqrt(2))."""
    t = mantissa(a) - 1.0
    y = real(LOG[0], t)
    for k in range(1, 7):
        y = fma(y, t, real(LOG[k], t))
    return fma(exponent(a), real(LOG2, t), y * t)


# ---- one lane ----------------------------------------------------------------------------------------------------


@wp.func
def uniform_high(key: wp.uint32, n: int, like: F):
    """Random numbers in (0, 1) of 16 bits, lane i a function of ``key + n + i`` alone."""
    h = wp.rand_init(wp.int32(key + wp.uint32(n)))
    return fma(wp.float32(h >> wp.uint32(16)), CELL, 0.5 * CELL)


@wp.func
def centred_low(key: wp.uint32, n: int, like: F):
    """The other 16 bits of `uniform_high`, in (-1/2, 1/2)."""
    h = wp.rand_init(wp.int32(key + wp.uint32(n)))
    return fma(wp.float32(h & wp.uint32(65535)), CELL, 0.5 * CELL - 0.5)


@wp.func
def exponent(a: F):
    """Power of two of a, such that a is it times the `mantissa`."""
    return wp.float32((wp.cast(a, wp.int32) - 0x3F3504F3) >> 23)


@wp.func
def mantissa(a: F):
    """a over its power of two, in [sqrt(1/2), sqrt(2))."""
    bits = wp.cast(a, wp.int32)
    return wp.cast(bits - (((bits - 0x3F3504F3) >> 23) << 23), wp.float32)


@wp.func
def running_sum(a: F):
    """Lane i holds a[0] + ... + a[i]."""
    return a


@wp.func
def lane_sum(a: F):
    """Sum of the lanes, in one order always."""
    return a


@wp.func
def least(a: F):
    """Smallest lane."""
    return a


@wp.func
def greatest(a: F):
    """Largest lane."""
    return a


@wp.func
def max_(a: F, b: F):
    """The larger in each lane."""
    return wp.max(a, b)


@wp.func
def min_(a: F, b: F):
    """The smaller in each lane."""
    return wp.min(a, b)


@wp.func
def below(a: F, b: F):
    """1 where a < b, else 0."""
    return wp.where(a < b, 1.0, 0.0)


@wp.func_native("return __builtin_ctz(bits);")
def first_bit(bits: int) -> int:
    """Number of the lowest bit that is set; ``bits`` is not 0."""
    ...


# ---- 8 or 16 lanes -----------------------------------------------------------------------------------------------


def _hashes(width: int, pick: str, offset: float) -> str:
    """C++ of random numbers: 16 bits of PCG of ``key + n + lane``, in cells of 2^-16 from one centred at ``offset``."""
    return (
        f"typedef float V __attribute__((ext_vector_type({width}),aligned(4)));"
        f"typedef unsigned U __attribute__((ext_vector_type({width})));"
        f"typedef int I __attribute__((ext_vector_type({width})));"
        f"U s; for(int i=0;i<{width};++i) s[i]=i; s+=key+(unsigned)n;"
        "U b=s*747796405u+2891336453u; U c=((b>>((b>>28u)+4u))^b)*277803737u; U h=(c>>22u)^c;"
        f"V r=__builtin_elementwise_fma(__builtin_convertvector((I)({pick}),V),(V){2.0**-16!r}f,(V)({offset!r}f));"
        f"wp::vec_t<{width},float> o; __builtin_memcpy(&o,&r,sizeof(V)); return o;"
    )


def _scan(width: int) -> str:
    """C++ of the running sum over lanes: shifted by 1, 2, 4, ... lanes and added (Hillis and Steele)."""
    steps, shift = "V z=0; V r=a_;", 1
    while shift < width:
        order = ",".join(str(i if i < shift else width + i - shift) for i in range(width))
        steps += f"r+=__builtin_shufflevector(z,r,{order});"
        shift *= 2
    return steps + f"wp::vec_t<{width},float> o; __builtin_memcpy(&o,&r,sizeof(V)); return o;"


def _fold(width: int, both: str) -> str:
    """C++ of what lanes come to: halves r and q folded onto each other by ``both``."""
    steps, half = "V r=a_;", width // 2
    while half:
        order = ",".join(str((i + half) % width) for i in range(width))
        steps += f"{{V q=__builtin_shufflevector(r,r,{order}); r={both};}}"
        half //= 2
    return steps + "return r[0];"


def _bits(width: int) -> str:
    """C++ of a bit a lane, set where it is negative."""
    return (
        f"typedef bool B __attribute__((ext_vector_type({width}))); B b=__builtin_convertvector(a_<0.0f,B);"
        f"unsigned {'char' if width == 8 else 'short'} o; __builtin_memcpy(&o,&b,sizeof(o)); return o;"
    )


def _columns(width: int, better: str) -> str:
    """C++ of a lane a row of memory: the ``better`` of the row's ``width`` numbers; ``other`` beyond row ``count``.

    Two rows are folded into one vector, a half of the lanes each, two of those into one with a quarter for each row,
    and so on: 15 folds for 16 rows instead of 4 for each.
    """
    out = f"typedef float V __attribute__((ext_vector_type({width}),aligned(4))); V r[{width}];"
    out += f"const float* p=&wp::index(a,first); for(int i=0;i<{width};++i) {{"
    out += f"if (i<count) __builtin_memcpy(r+i,p+i*{width},sizeof(V)); else r[i]=(V)other;}}"
    rows = width
    while rows > 1:
        rows //= 2
        span = rows  # lanes of a row after this fold
        low, high = [], []
        for old in range(0, width, 2 * span):
            for source in (0, width):
                low += [str(source + old + n) for n in range(span)]
                high += [str(source + old + span + n) for n in range(span)]
        out += f"for(int i=0;i<{rows};++i) {{V b=__builtin_shufflevector(r[i],r[i+{rows}],{','.join(low)});"
        out += f"V t=__builtin_shufflevector(r[i],r[i+{rows}],{','.join(high)}); r[i]=b{better}t?b:t;}}"
    return out + f"wp::vec_t<{width},float> o; __builtin_memcpy(&o,r,sizeof(V)); return o;"


_INT = "typedef int I __attribute__((ext_vector_type({width}))); I b; __builtin_memcpy(&b,&a,sizeof(V));"

for _W in (8, 16):
    V = wp.types.vector(_W, F)
    Lanes = REAL_OF_WIDTH[_W]

    @wp.func_native(_hashes(_W, "h>>16", 2.0**-17))
    def _uniform_high(key: wp.uint32, n: int, like: V) -> V: ...

    @wp.func_native(_hashes(_W, "h&65535u", 2.0**-17 - 0.5))
    def _centred_low(key: wp.uint32, n: int, like: V) -> V: ...

    @wp.func_native(
        _native(_W, "__builtin_convertvector((b-0x3F3504F3)>>23,V)", "a").replace(
            "V r=", _INT.format(width=_W) + "V r="
        )
    )
    def _exponent(a: V) -> V: ...

    @wp.func_native(
        _native(_W, "(V)(b-(((b-0x3F3504F3)>>23)<<23))", "a").replace("V r=", _INT.format(width=_W) + "V r=")
    )
    def _mantissa(a: V) -> V: ...

    @wp.func_native(_native(_W, "", "a", _scan(_W)))
    def _running_sum(a: V) -> V: ...

    @wp.func_native(_native(_W, "", "a", _fold(_W, "r+q")))
    def _total(a: V) -> float: ...

    @wp.func_native(_native(_W, "", "a", _fold(_W, "r<q?r:q")))
    def _least(a: V) -> float: ...

    @wp.func_native(_native(_W, "", "a", _fold(_W, "r>q?r:q")))
    def _greatest(a: V) -> float: ...

    @wp.func_native(_columns(_W, "<"))
    def _column_least(a: wp.array1d(dtype=wp.float32), first: int, count: int, other: float, like: V) -> V: ...

    @wp.func_native(_columns(_W, ">"))
    def _column_greatest(a: wp.array1d(dtype=wp.float32), first: int, count: int, other: float, like: V) -> V: ...

    @wp.func_native(_native(_W, "a_>b_?a_:b_", "ab"))
    def _max(a: V, b: V) -> V: ...

    @wp.func_native(_native(_W, "a_<b_?a_:b_", "ab"))
    def _min(a: V, b: V) -> V: ...

    @wp.func_native(_native(_W, "a_<b_?(V)1.0f:(V)0.0f", "ab"))
    def _below(a: V, b: V) -> V: ...

    @wp.func_native(_native(_W, "a_<b_?c_+1.0f:c_", "cab"))
    def _tally(c: V, a: V, b: V) -> V: ...

    @wp.func_native(_native(_W, "", "a", _bits(_W)))
    def _negatives(a: V) -> int: ...

    @wp.func
    def uniform_high(key: wp.uint32, n: int, like: Lanes):
        """Random numbers in (0, 1) of 16 bits, lane i a function of ``key + n + i`` alone."""
        return type(like)(_uniform_high(key, n, like.v))

    @wp.func
    def centred_low(key: wp.uint32, n: int, like: Lanes):
        """The other 16 bits of `uniform_high`, in (-1/2, 1/2)."""
        return type(like)(_centred_low(key, n, like.v))

    @wp.func
    def exponent(a: Lanes):
        """Power of two of a, such that a is it times the `mantissa`."""
        return type(a)(_exponent(a.v))

    @wp.func
    def mantissa(a: Lanes):
        """a over its power of two, in [sqrt(1/2), sqrt(2))."""
        return type(a)(_mantissa(a.v))

    @wp.func
    def running_sum(a: Lanes):
        """Lane i holds a[0] + ... + a[i]."""
        return type(a)(_running_sum(a.v))

    @wp.func
    def lane_sum(a: Lanes):
        """Sum of the lanes, in one order always."""
        return _total(a.v)

    @wp.func
    def least(a: Lanes):
        """Smallest lane."""
        return _least(a.v)

    @wp.func
    def greatest(a: Lanes):
        """Largest lane."""
        return _greatest(a.v)

    @wp.func
    def row_least(a: wp.array1d(dtype=wp.float32), first: int, count: int, other: float, like: Lanes):
        """Lane i holds the least of row i of memory."""
        return type(like)(_column_least(a, first, count, other, like.v))

    @wp.func
    def row_greatest(a: wp.array1d(dtype=wp.float32), first: int, count: int, other: float, like: Lanes):
        """Lane i holds the greatest of row i of memory."""
        return type(like)(_column_greatest(a, first, count, other, like.v))

    @wp.func
    def max_(a: Lanes, b: Lanes):
        """The larger in each lane."""
        return type(a)(_max(a.v, b.v))

    @wp.func
    def min_(a: Lanes, b: Lanes):
        """The smaller in each lane."""
        return type(a)(_min(a.v, b.v))

    @wp.func
    def below(a: Lanes, b: Lanes):
        """1 where a < b, else 0."""
        return type(a)(_below(a.v, b.v))

    @wp.func
    def tally(count: Lanes, a: Lanes, b: Lanes):
        """c + 1 where a < b, else c."""
        return type(a)(_tally(count.v, a.v, b.v))

    @wp.func
    def negatives(a: Lanes):
        """Bit i is set where lane i is negative."""
        return _negatives(a.v)


del V, Lanes
