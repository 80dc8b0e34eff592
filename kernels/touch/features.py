"""Features of the last joint torques of all worlds: one launch a sample, a ring of samples on the device.

A torque tau is first compared with what the joint needs in free motion (`FreeMotion` of learn/touch/free_motion.py),
in units of the noise there, with s = tanh(v / V0) and m what the robot's own model expects:

    z = (tau - (c0 + c1 s + c2 v + c3 m + c4 s |m|)) / n

Fifteen features a joint, of x the last M values of z and y the last M means of K of them: z; minimum, maximum, mean,
variance, skewness and excess kurtosis of x; the same of y; commanded and executed speed. With d_i = x_i - x_0,

    mu = mean d,  V = mean (d - mu)^2,  skewness = mean (d - mu)^3 / (V + EPS)^(3/2),
    kurtosis = mean (d - mu)^4 / (V + EPS)^2 - 3

While fewer samples are there, the statistics are of those. Computed in float64, handed over in float32.
"""

import warp as wp

__all__ = ["EPS", "FEATURES", "RING", "V0", "FreeRows", "K", "M", "features"]

#: Values in a window (m of the thesis, 4.3.4) and of which a smoothed value is the mean (k).
M = 10
K = 3
#: Samples that are kept.
RING = M + K - 1
#: Features a joint.
FEATURES = 15
#: Added to a variance of z, whose noise has variance one: windows that hardly vary have no shape.
EPS = 1.0e-4
#: Speed at which dry friction has three quarters of its value [rad/s].
V0 = 0.02

_M = wp.constant(M)
_K = wp.constant(K)
_RING = wp.constant(RING)
_EPS = wp.constant(wp.float64(EPS))
_V0 = wp.constant(wp.float64(V0))
Window = wp.types.vector(length=M, dtype=wp.float64)
History = wp.types.vector(length=RING, dtype=wp.float64)


@wp.struct
class FreeRows:
    """What a joint needs in free motion, [dof, 5], and its noise, [dof]."""

    mean: wp.array2d(dtype=wp.float64)
    noise: wp.array(dtype=wp.float64)


@wp.func
def standardised(tau: wp.float64, m: wp.float64, v: wp.float64, j: int, free: FreeRows):
    """z = (tau - (c0 + c1 s + c2 v + c3 m + c4 s |m|)) / n"""
    s = wp.tanh(v / _V0)
    needed = free.mean[j, 0] + free.mean[j, 1] * s + free.mean[j, 2] * v
    needed += free.mean[j, 3] * m + free.mean[j, 4] * s * wp.abs(m)
    return (tau - needed) / free.noise[j]


@wp.func
def write_statistics(x: Window, n: int, w: int, at: int, features_out: wp.array2d(dtype=wp.float32)):
    """Write minimum, maximum, mean, variance, skewness and excess kurtosis of the first n values."""
    count = wp.float64(n)
    low = x[0]
    high = x[0]
    mu = wp.float64(0.0)
    for i in range(n):
        low = wp.min(low, x[i])
        high = wp.max(high, x[i])
        mu += (x[i] - x[0]) / count
    second = wp.float64(0.0)
    third = wp.float64(0.0)
    fourth = wp.float64(0.0)
    for i in range(n):
        d = x[i] - x[0] - mu
        second += d * d / count
        third += d * d * d / count
        fourth += d * d * d * d / count
    spread = second + _EPS
    features_out[w, at] = wp.float32(low)
    features_out[w, at + 1] = wp.float32(high)
    features_out[w, at + 2] = wp.float32(x[0] + mu)
    features_out[w, at + 3] = wp.float32(second)
    features_out[w, at + 4] = wp.float32(third / (spread * wp.sqrt(spread)))
    features_out[w, at + 5] = wp.float32(fourth / (spread * spread) - wp.float64(3.0))


@wp.kernel(enable_backward=False, module="unique", module_options={"max_unroll": 0})
def features(
    torque_in: wp.array2d(dtype=wp.float32), expected_in: wp.array2d(dtype=wp.float32),
    command_in: wp.array2d(dtype=wp.float32), velocity_in: wp.array2d(dtype=wp.float32),
    restarted_in: wp.array(dtype=wp.bool), due_in: wp.array(dtype=wp.bool), free: FreeRows, first: int,
    ring: wp.array3d(dtype=wp.float64),
    count: wp.array2d(dtype=int), features_out: wp.array2d(dtype=wp.float32),
):  # fmt: skip
    """Take a sample of one joint of one world into its ring [worlds, dof, RING] and write the joint's features.

    ``count`` [worlds, dof] is how many samples came since the world's episode began; ``restarted_in`` begins one.
    Worlds that are not due keep what they had.
    """
    t = wp.tid()
    dof = torque_in.shape[1]
    w = first + t // dof
    j = t % dof
    if not due_in[w]:
        return
    if restarted_in[w]:
        count[w, j] = 0
    v = wp.float64(velocity_in[w, j])
    z = standardised(wp.float64(torque_in[w, j]), wp.float64(expected_in[w, j]), v, j, free)
    head = count[w, j]
    ring[w, j, head % _RING] = z
    count[w, j] = head + 1
    have = wp.min(head + 1, _RING)
    n = wp.min(head + 1, _M)
    h = History()
    for age in range(have):
        h[age] = ring[w, j, (head - age) % _RING]
    x = Window()
    y = Window()
    for age in range(n):
        x[age] = h[age]
        parts = wp.min(_K, have - age)
        total = wp.float64(0.0)
        for i in range(parts):
            total += h[age + i]
        y[age] = total / wp.float64(parts)
    at = j * 15
    features_out[w, at] = wp.float32(z)
    write_statistics(x, n, w, at + 1, features_out)
    write_statistics(y, n, w, at + 7, features_out)
    features_out[w, at + 13] = command_in[w, j]
    features_out[w, at + 14] = velocity_in[w, j]
