"""Drag on a piece of a segment: the law beside its formula in float64, its shares in plain cases; a wind in time."""

import numpy as np
import pytest
import warp as wp
from bough.kernels.effects.structs import effect_types
from bough.learn.laws.bench import SETTING, ask_link
from bough.sim.effects import effect_of, in_setting
from oracles.effect_case import DS, KS, resting, stick, stick_case
from scipy.spatial.transform import Rotation

T = effect_types(1, 32)
LinkState, Parameters, Vec, Quat = T.LinkState, T.Parameters, T.Vec, T.Quat
LAW = effect_of("quadratic_drag").branch.law
C, AREA, CROWN = 3.0, 0.02, 0.07


@wp.kernel(module="unique")
def drag(
    velocity_in: wp.array(dtype=wp.vec3), arm_in: wp.array(dtype=wp.vec3), turn_in: wp.array(dtype=wp.vec4),
    m: float, s: float, k: float, linear: float, force_out: wp.array(dtype=wp.vec3),
):  # fmt: skip
    """Write the force on every piece, of the shares m (across), s (axis by axis) and k (crown), and the speed l."""
    n = wp.tid()
    v, d, q = velocity_in[n], arm_in[n], turn_in[n]
    b = LinkState(
        Vec(v[0], v[1], v[2]), Vec(d[0], d[1], d[2]), Quat(q[0], q[1], q[2], q[3]), AREA, CROWN, 0.0, Vec(0.0, 0.0, 0.0)
    )
    f = LAW(b, Parameters(C, m, s, k, linear, 0.0, 0.0, 0.0, 0.0, 0.0))
    force_out[n] = wp.vec3(f.x, f.y, f.z)


def forces(velocity, turn, m, s, k=0.0, linear=0.0):
    """Return the forces [N, 3] on pieces whose segments point along their own z axis."""
    quaternion = np.roll(turn.as_quat(), 1, axis=1)  # real part first, as the kernels have it
    given = [wp.array(x, dtype=d, device="cpu") for x, d in
             ((velocity, wp.vec3), (turn.apply([0.0, 0.0, 0.3]), wp.vec3), (quaternion, wp.vec4))]  # fmt: skip
    out = wp.full(len(velocity), wp.vec3(np.nan, np.nan, np.nan), dtype=wp.vec3, device="cpu")
    wp.launch(drag, dim=len(velocity), inputs=[*given, m, s, k, linear], outputs=[out], device="cpu")
    return out.numpy()


@pytest.mark.parametrize(
    ("m", "s", "k", "linear"),
    [(0, 0, 0, 0), (1, 0, 0, 0), (0, 1, 0, 0), (0.6, 0.3, 0, 0), (0.6, 0.3, 0.4, 0.7), (0, 0, 1, 0), (0.6, 0, 0, 0.5)],
)
def test_force_is_the_formula(m, s, k, linear):
    """Give -c A ((1 - s) |u| u + s (|u_k| u_k) + l u), u = v less the share m of what is along the segment.

    A is the piece's own area, in the share k the crown's.
    """
    rng = np.random.default_rng(0)
    velocity, turn = rng.normal(size=(200, 3)), Rotation.random(200, random_state=1)
    u = turn.inv().apply(velocity) * [1.0, 1.0, 1.0 - m]
    own = ((1 - s) * np.linalg.norm(u, axis=1, keepdims=True) + linear) * u + s * np.abs(u) * u
    wanted = -C * ((1 - k) * AREA + k * CROWN) * turn.apply(own)
    atol = 2e-6 * np.abs(wanted).max()  # float32
    np.testing.assert_allclose(forces(velocity, turn, m, s, k, linear), wanted, atol=atol)


def test_motion_along_a_segment_is_free_where_only_the_flow_across_counts():
    """Feel nothing along the segment with m = 1, and the whole of it with m = 0; a slow piece feels next to nothing."""
    turn = Rotation.from_euler("xyz", [[0.4, -0.7, 1.1]])
    along = turn.apply([0.0, 0.0, 2.0])
    assert np.abs(forces(along, turn, 1.0, 0.0)).max() < 1e-6 * C * AREA * 4.0
    np.testing.assert_allclose(forces(along, turn, 0.0, 0.0), -C * AREA * 2.0 * along, rtol=1e-5)
    assert np.all(forces(0.0 * along, turn, 0.5, 0.5) == 0.0)


@pytest.mark.parametrize("name", ["steady_wind", "wind_gust"])
def test_no_wind_is_so_slow_that_it_is_drag(name):
    """Blow the way it blows on whatever moves as fast as was seen: (1 -+ 0.3)^2 of the force on a segment at rest."""
    law = effect_of(name).branch
    slow = next(in_setting(p.high, SETTING) for p in law.parameters if p.name == "slowness_spm")
    given = {"pressure_x_Pa": 5.0, "cosine_x_Pa": 5.0, "slowness_spm": slow}
    values = [given.get(p.name, 0.0) for p in law.parameters]
    speeds = SETTING.speed * np.array([0.0, 1.0, -1.0])
    force = ask_link(law, values, np.stack([speeds, 0.0 * speeds, 0.0 * speeds], axis=-1)[None])[0]
    np.testing.assert_allclose(force[1:, 0] / force[0, 0], [0.49, 1.69], rtol=1e-9)


@pytest.mark.parametrize("changes", [1.0, 0.4, -1.5])
def test_a_wind_sets_in_or_dies_down(tmp_path, changes):
    """Rest in 1 - c of the wind before a moment, from the first sample on, and in all of it after; half way half."""
    case = stick_case(tmp_path / "c", [np.zeros((300, 3))])
    q, moment, takes = np.array([60.0, -90.0, 40.0]), 2.0, 1.0
    on = {f"pressure_{c}_Pa": v for c, v in zip("xyz", q, strict=True)}
    on |= {"changes": changes, "moment_s": moment, "takes_s": takes}
    out = stick(case, steady_wind=on)[0]
    a, b = case.radius[0]
    centre, force = case.length[0] * (a + 2 * b) / (3 * (a + b)), case.length[0] * (a + b) * q
    before, after = (
        resting(case, lambda phi: -KS * phi, lambda R, k=k: k * force, point=centre) for k in (1.0 - changes, 1.0)
    )
    assert np.linalg.norm(after - before) > 0.002
    for k, expected in ((0, before), (99, before), (-1, after)):
        np.testing.assert_allclose(out[k, :3], expected, atol=2e-4 * np.linalg.norm(after))
    half = resting(case, lambda phi: -KS * phi, lambda R: (1.0 - 0.5 * changes) * force, point=centre)
    lag = np.linalg.norm(after - before) / takes * DS / KS  # a damper's, behind a rest that moves evenly
    np.testing.assert_allclose(out[125, :3], half, atol=2.0 * lag + 2e-4)
