"""Lanes that hold points of one world, not worlds: sums and bounds across lanes, logarithm, random numbers.

Everything has a form for one lane (GPU) and for 8 and 16 lanes (CPU), like the operations of `real`:

==========================  =========================================================================================
``uniform(key, n, a)``      random numbers in (0, 1) of 23 bits, lane i a function of ``key + n + i`` alone
``uniform_high``, ``_low``  two of 16 bits from one hash
``log_(a)``                 natural logarithm of a in (0, 1), absolute error below 2e-7 of max(1, |log a|)
``turned(h)``               h less the nearest multiple of pi
``short_sine(h)``           sin(h) for h in [-pi/2, pi/2], error below 1e-7; ``short_cosine(h)`` likewise
``running_sum(a)``          lane i holds a[0] + ... + a[i]
``lane_sum(a)``             sum of the lanes, in one order always
``least(a)``                smallest lane; ``greatest(a)`` largest
``max_(a, b)``              the larger in each lane; ``min_`` the smaller
``below(a, b)``             1 where a < b, else 0
==========================  =========================================================================================

Random numbers are counter based: PCG's output permutation (Jarzynski and Olano, Hash Functions for GPU Rendering, JCGT
9 (3), 2020) of ``key + n``, so that number n of a key is the same whatever was drawn before, in any
order, on any device.
"""

from typing import Any

import warp as wp

from .real import REAL_OF_WIDTH, _native, add, div, fma, fnma, mul, real, round_, sqrt_, sub, where_neg

__all__ = ["key_of", "log_", "short_cosine", "short_sine", "turned"]

F = wp.float32

INVERSE_PI = wp.constant(wp.float32(0.3183098861837907))
PI = wp.constant(wp.float32(3.1415927410125732))
PI_REST = wp.constant(wp.float32(-8.742278e-08))  # pi - PI
LOG2 = wp.constant(wp.float32(0.6931471824645996))
LOG2_REST = wp.constant(wp.float32(-1.9046543e-09))  # log 2 - LOG2

# Minimax in u = h^2 on [0, (pi/2)^2], highest power first: sin(h)/h to 4.3e-9 and cos(h) to 4.7e-8
SHORT_SINE = wp.constant(
    wp.types.vector(5, wp.float32)(
        2.6051955754e-06, -1.98090626263e-04, 8.33305089611e-03, -1.66666579850e-01, 0.99999999573
    )
)
SHORT_COSINE = wp.constant(
    wp.types.vector(5, wp.float32)(
        2.31536119612e-05, -1.38536905092e-03, 4.16635828701e-02, -4.99999052722e-01, 0.99999995342
    )
)


@wp.func
def key_of(seed: int, world: int, tick: int):
    """Key of the random numbers of one world at one tick."""
    return wp.rand_init(wp.int32(wp.rand_init(wp.int32(wp.rand_init(seed) + wp.uint32(world))) + wp.uint32(tick)))


@wp.func
def turned(h: Any):
    """h - n pi, n the nearest integer to h / pi (Cody and Waite: pi in two parts)."""
    n = round_(h * real(INVERSE_PI, h))
    return fnma(n, real(PI_REST, h), fnma(n, real(PI, h), h))


@wp.func
def short_sine(h: Any):
    """sin(h), |h| <= pi/2."""
    u = h * h
    y = real(SHORT_SINE[0], u)
    for k in range(1, 5):
        y = fma(y, u, real(SHORT_SINE[k], u))
    return y * h


@wp.func
def short_cosine(h: Any):
    """cos(h), |h| <= pi/2."""
    u = h * h
    y = real(SHORT_COSINE[0], u)
    for k in range(1, 5):
        y = fma(y, u, real(SHORT_COSINE[k], u))
    return y


@wp.func
def log_(a: Any):
    """log a = e log 2 + 2 artanh(s), s = (m - 1) / (m + 1), a = 2^e m with m in [sqrt(1/2), sqrt(2))."""
    e = exponent(a)
    m = mantissa(a)
    s = (m - 1.0) / (m + 1.0)
    u = s * s
    y = fma(fma(fma(real(0.2222222, u), u, real(0.2857143, u)), u, real(0.4, u)), u, real(0.6666667, u))
    tail = fma(y * u, s, e * real(LOG2_REST, u))
    return fma(e, real(LOG2, u), s + s + tail)


# ---- one lane ----------------------------------------------------------------------------------------------------


@wp.func
def uniform(key: wp.uint32, n: int, like: F):
    h = wp.rand_init(wp.int32(key + wp.uint32(n)))
    return (wp.float32(h >> wp.uint32(9)) + 0.5) * wp.static(2.0**-23)


@wp.func
def uniform_high(key: wp.uint32, n: int, like: F):
    h = wp.rand_init(wp.int32(key + wp.uint32(n)))
    return (wp.float32(h >> wp.uint32(16)) + 0.5) * wp.static(2.0**-16)


@wp.func
def uniform_low(key: wp.uint32, n: int, like: F):
    h = wp.rand_init(wp.int32(key + wp.uint32(n)))
    return (wp.float32(h & wp.uint32(65535)) + 0.5) * wp.static(2.0**-16)


@wp.func
def exponent(a: F):
    return wp.float32((wp.cast(a, wp.int32) - 0x3F3504F3) >> 23)


@wp.func
def mantissa(a: F):
    bits = wp.cast(a, wp.int32)
    return wp.cast(bits - (((bits - 0x3F3504F3) >> 23) << 23), wp.float32)


@wp.func
def running_sum(a: F):
    return a


@wp.func
def lane_sum(a: F):
    return a


@wp.func
def least(a: F):
    return a


@wp.func
def greatest(a: F):
    return a


@wp.func
def max_(a: F, b: F):
    return wp.max(a, b)


@wp.func
def min_(a: F, b: F):
    return wp.min(a, b)


@wp.func
def below(a: F, b: F):
    return wp.where(a < b, 1.0, 0.0)


# ---- 8 or 16 lanes -----------------------------------------------------------------------------------------------


def _hashes(width: int, pick: str, bits: int) -> str:
    """C++ of random numbers: PCG of ``key + n + lane``, ``bits`` of it picked and centred in their cells."""
    return (
        f"typedef float V __attribute__((ext_vector_type({width}),aligned(4)));"
        f"typedef unsigned U __attribute__((ext_vector_type({width})));"
        f"typedef int I __attribute__((ext_vector_type({width})));"
        f"U s; for(int i=0;i<{width};++i) s[i]=i; s+=key+(unsigned)n;"
        "U b=s*747796405u+2891336453u; U c=((b>>((b>>28u)+4u))^b)*277803737u; U h=(c>>22u)^c;"
        f"V r=(__builtin_convertvector((I)({pick}),V)+0.5f)*{2.0**-bits!r}f;"
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


def _fold(width: int, better: str) -> str:
    """C++ of the one lane that is ``better`` than all others: halves folded onto each other."""
    steps, half = "V r=a_;", width // 2
    while half:
        order = ",".join(str((i + half) % width) for i in range(width))
        steps += f"{{V q=__builtin_shufflevector(r,r,{order}); r=r{better}q?r:q;}}"
        half //= 2
    return steps + "return r[0];"


_INT = "typedef int I __attribute__((ext_vector_type({width}))); I b; __builtin_memcpy(&b,&a,sizeof(V));"

for _W in (8, 16):
    V = wp.types.vector(_W, F)
    Lanes = REAL_OF_WIDTH[_W]

    @wp.func_native(_hashes(_W, "h>>9", 23))
    def _uniform(key: wp.uint32, n: int, like: V) -> V: ...

    @wp.func_native(_hashes(_W, "h>>16", 16))
    def _uniform_high(key: wp.uint32, n: int, like: V) -> V: ...

    @wp.func_native(_hashes(_W, "h&65535u", 16))
    def _uniform_low(key: wp.uint32, n: int, like: V) -> V: ...

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

    @wp.func_native(_native(_W, "", "a", f"float s=a_[0]; for(int i=1;i<{_W};++i) s+=a_[i]; return s;"))
    def _total(a: V) -> float: ...

    @wp.func_native(_native(_W, "", "a", _fold(_W, "<")))
    def _least(a: V) -> float: ...

    @wp.func_native(_native(_W, "", "a", _fold(_W, ">")))
    def _greatest(a: V) -> float: ...

    @wp.func_native(_native(_W, "a_>b_?a_:b_", "ab"))
    def _max(a: V, b: V) -> V: ...

    @wp.func_native(_native(_W, "a_<b_?a_:b_", "ab"))
    def _min(a: V, b: V) -> V: ...

    @wp.func_native(_native(_W, "a_<b_?(V)1.0f:(V)0.0f", "ab"))
    def _below(a: V, b: V) -> V: ...

    @wp.func
    def uniform(key: wp.uint32, n: int, like: Lanes):
        return type(like)(_uniform(key, n, like.v))

    @wp.func
    def uniform_high(key: wp.uint32, n: int, like: Lanes):
        return type(like)(_uniform_high(key, n, like.v))

    @wp.func
    def uniform_low(key: wp.uint32, n: int, like: Lanes):
        return type(like)(_uniform_low(key, n, like.v))

    @wp.func
    def exponent(a: Lanes):
        return type(a)(_exponent(a.v))

    @wp.func
    def mantissa(a: Lanes):
        return type(a)(_mantissa(a.v))

    @wp.func
    def running_sum(a: Lanes):
        return type(a)(_running_sum(a.v))

    @wp.func
    def lane_sum(a: Lanes):
        return _total(a.v)

    @wp.func
    def least(a: Lanes):
        return _least(a.v)

    @wp.func
    def greatest(a: Lanes):
        return _greatest(a.v)

    @wp.func
    def max_(a: Lanes, b: Lanes):
        return type(a)(_max(a.v, b.v))

    @wp.func
    def min_(a: Lanes, b: Lanes):
        return type(a)(_min(a.v, b.v))

    @wp.func
    def below(a: Lanes, b: Lanes):
        return type(a)(_below(a.v, b.v))


del V, Lanes
