"""A joint that is turned along a given path, and the torque that an effect's law answers with."""

import numpy as np
import warp as wp
from bough.kernels.effects.structs import effect_types

_T = effect_types(1, 32)
_JointState, _Response, _Parameters, _Vec = _T.JointState, _T.Response, _T.Parameters, _T.Vec
_LongResponse = _T.LongResponse


def turner(law, memory=1):
    """Return ``turned(path, *parameters)``: the torque [samples, 3] along a path from rest at zero, for K = 1.

    A step of 1 s from one place to the next; a law remembers as many vectors as ``memory`` says, one or two. The damper
    that it leaves to the simulator is added; ``preload`` is the torque that carries a weight.
    """

    @wp.kernel(module="unique")
    def turn(
        path_in: wp.array(dtype=wp.vec3), a: float, b: float, c: float, d: float, e: float, f: float, g: float,
        h: float, i: float, n: float, preload: wp.vec3, torque_out: wp.array(dtype=wp.vec3),
    ):  # fmt: skip
        none, z, u = _Vec(0.0, 0.0, 0.0), _Vec(0.0, 0.0, 0.0), _Vec(0.0, 0.0, 0.0)
        carries = _Vec(preload[0], preload[1], preload[2])
        for k in range(path_in.shape[0]):
            rate = path_in[k]
            place = _Vec(rate[0], rate[1], rate[2])
            if k > 0:
                rate = path_in[k] - path_in[k - 1]
            v = _Vec(rate[0], rate[1], rate[2])
            j = _JointState(place, v, carries, none, 1.0, 0.0, 1.0, v)
            p = _Parameters(a, b, c, d, e, f, g, h, i, n)
            if wp.static(memory == 2):
                long = law(j, p, _LongResponse(none, z, u, 0.0, 0.0))
                u = long.second
                r = _Response(long.torque, long.memory, long.stiffness, long.damping)
            else:
                r = law(j, p, _Response(none, z, 0.0, 0.0))
            z = r.memory
            torque_out[k] = wp.vec3(r.torque.x, r.torque.y, r.torque.z) - r.damping * rate

    def turned(path, *parameters, preload=(0.0, 0.0, 0.0)):
        given = wp.array(path, dtype=wp.vec3, device="cpu")
        out = wp.full(len(path), wp.vec3(np.nan, np.nan, np.nan), dtype=wp.vec3, device="cpu")
        rest = [0.0] * (10 - len(parameters))
        wp.launch(turn, dim=1, inputs=[given, *parameters, *rest, wp.vec3(*preload)], outputs=[out], device="cpu")
        return out.numpy()

    return turned
