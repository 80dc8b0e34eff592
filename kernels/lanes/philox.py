"""Counter-based random numbers: Philox 4x32-10 of Salmon et al., "Parallel random numbers: as easy as 1, 2, 3" (2011).

A draw is a function of a key (the seed) and a counter (world, episode, ...), with no state to carry: it can be made
anywhere, in any order, and again after a resume. One key maps different counters to different draws, always.
"""

import warp as wp

__all__ = ["gaussian2", "philox", "uniform4"]

U32 = wp.uint32
U64 = wp.uint64

M0 = wp.constant(U32(0xD2511F53))
M1 = wp.constant(U32(0xCD9E8D57))
W0 = wp.constant(U32(0x9E3779B9))
W1 = wp.constant(U32(0xBB67AE85))
PER_UNIT = wp.constant(1.0 / 16777216.0)  # the upper 24 bits make a float32 in [0, 1) without rounding
TURN = wp.constant(6.283185307179586)


@wp.func
def high(a: U32, b: U32) -> U32:
    """Upper half of the 64-bit product."""
    return U32((U64(a) * U64(b)) >> U64(32))


@wp.func
def philox(key: wp.vec2ui, counter: wp.vec4ui) -> wp.vec4ui:
    """Ten rounds of the Philox bijection of the counter."""
    c = counter
    k0 = key[0]
    k1 = key[1]
    for _ in range(10):
        c = wp.vec4ui(high(M1, c[2]) ^ c[1] ^ k0, M1 * c[2], high(M0, c[0]) ^ c[3] ^ k1, M0 * c[0])
        k0 = k0 + W0
        k1 = k1 + W1
    return c


@wp.func
def uniform4(key: wp.vec2ui, a: int, b: int, c: int, d: int) -> wp.vec4:
    """Four independent uniform numbers in [0, 1) of the counter (a, b, c, d)."""
    x = philox(key, wp.vec4ui(U32(a), U32(b), U32(c), U32(d)))
    return PER_UNIT * wp.vec4(
        float(x[0] >> U32(8)), float(x[1] >> U32(8)), float(x[2] >> U32(8)), float(x[3] >> U32(8))
    )


@wp.func
def gaussian2(u: float, v: float) -> wp.vec2:
    """Two independent standard normal numbers of two uniform ones (Box and Muller)."""
    length = wp.sqrt(-2.0 * wp.log(1.0 - u))
    return length * wp.vec2(wp.cos(TURN * v), wp.sin(TURN * v))
