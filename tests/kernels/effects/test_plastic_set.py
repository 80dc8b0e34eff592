"""The yielding joint: turned along given paths beside the return mapping of a textbook, about one axis and in space."""

import numpy as np
import pytest
import warp as wp
from bough.kernels.effects.structs import effect_types
from bough.sim.effects import effect_of
from oracles.effect_case import simulate, swing_case

T = effect_types(1, 32)
JointState, LongResponse, Parameters, Vec = T.JointState, T.LongResponse, T.Parameters, T.Vec
LAW = effect_of("plastic_set").branch.law
K = 80.0
CLOSE = 400 * 0.5 * 2.0**-24  # rad: as many sums of angles below 0.5 rad, each rounded to float32


@wp.kernel(module="unique")
def turn(
    path_in: wp.array(dtype=wp.vec3), s: float, y: float, i: float, m: float, flow: float, h: float,
    torque_out: wp.array(dtype=wp.vec3),
):  # fmt: skip
    """Turn a joint of unit stiffness along a path in steps of h and write the law's torque."""
    none, b, c = Vec(0.0, 0.0, 0.0), Vec(0.0, 0.0, 0.0), Vec(0.0, 0.0, 0.0)
    for k in range(path_in.shape[0]):
        j = JointState(Vec(path_in[k][0], path_in[k][1], path_in[k][2]), none, none, none, 1.0, 0.0, h, none)
        r = LAW(j, Parameters(s, y, i, m, flow, 0.0, 0.0, 0.0, 0.0, 0.0), LongResponse(none, b, c, 0.0, 0.0))
        b = r.memory
        c = r.second
        torque_out[k] = wp.vec3(r.torque.x, r.torque.y, r.torque.z)


def turned(path, s, y, i, m, flow=0.0, h=1e-3):
    """Return what the law adds to the torque along a path [samples, 3], a sample every h."""
    given = wp.array(path, dtype=wp.vec3, device="cpu")
    out = wp.full(len(path), wp.vec3(np.nan, np.nan, np.nan), dtype=wp.vec3, device="cpu")
    wp.launch(turn, dim=1, inputs=[given, s, y, i, m, flow, h], outputs=[out], device="cpu")
    return out.numpy()


def return_mapping(path, s, y, i):
    """Return the plastic part of a path after Simo & Hughes, box 1.5: unit spring, moduli i H and (1 - i) H."""
    hardening = 1 / s - 1
    plastic, back, total, out = np.zeros(path.shape[1]), np.zeros(path.shape[1]), 0.0, []
    for turn_now in path:
        trial = turn_now - plastic - back
        size = np.linalg.norm(trial)
        excess = size - (y + i * hardening * total)
        if excess > 0:
            slip = excess / (1 + hardening)
            plastic, total = plastic + slip * trial / size, total + slip
            back = back + slip * (1 - i) * hardening * trial / size
        out.append(plastic)
    return np.array(out)


def waves(rng, samples=400):
    """Return a smooth path that grows and goes back and forth about all axes [samples, 3]."""
    t = np.linspace(0, 12, samples)[:, None]
    return (
        0.05 * np.exp(0.2 * t) * np.sin(t * rng.uniform(0.8, 2.0, 3) + rng.uniform(0, 6, 3)) * rng.uniform(0.7, 1.3, 3)
    )


@pytest.mark.parametrize("isotropic", [0.0, 0.4, 1.0])
def test_a_straight_path_yields_as_the_textbook_says(isotropic):
    """Turn to and fro about one oblique axis: the torque is the spring's over the plastic part, to float32."""
    along = np.array([0.6, -0.64, 0.48])
    path = waves(np.random.default_rng(1))[:, :1] * along
    expected = return_mapping(path, 0.3, 0.06, isotropic)
    moves = np.diff(expected @ along)
    assert moves.max() > 1e-4 and moves.min() < -1e-4  # it yields, and back
    np.testing.assert_allclose(turned(path, 0.3, 0.06, isotropic, 0.0), expected, atol=CLOSE)


@pytest.mark.parametrize("isotropic", [0.0, 0.4, 1.0])
def test_each_axis_yields_by_itself(isotropic):
    """Turn along any path with the whole share separate: three times the textbook's one dimension."""
    path = waves(np.random.default_rng(2))
    expected = np.hstack([return_mapping(path[:, k : k + 1], 0.3, 0.06, isotropic) for k in range(3)])
    np.testing.assert_allclose(turned(path, 0.3, 0.06, isotropic, 1.0), expected, atol=CLOSE)


def test_a_round_set_knows_no_axes():
    """Turn path and axes together: kinematic hardening gives the turned torque."""
    path = waves(np.random.default_rng(3))
    turn_all, _ = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))
    here, there = turned(path, 0.3, 0.06, 0.0, 0.0), turned(path @ turn_all.T, 0.3, 0.06, 0.0, 0.0)
    np.testing.assert_allclose(there, here @ turn_all.T, atol=CLOSE)
    np.testing.assert_allclose(here, return_mapping(path, 0.3, 0.06, 0.0), atol=CLOSE)


def test_off_it_gives_nothing():
    """Give no torque at a share of zero."""
    assert (turned(waves(np.random.default_rng(5)), 0.0, 0.06, 0.5, 0.5) == 0.0).all()


def test_a_set_that_flows_comes_by_e_folds():
    """Turn a joint at once beyond yield and hold it: b = (phi - y) (1 - exp(-t / T)), and nothing back below yield.

    Implicit steps of T / 200 are late by at most h / (2 T) of exp(-t / T) t / T, which is 0.37 at most.
    """
    s, y, far, flow, n = 0.3, 0.06, 0.2, 0.5, 600
    along = np.array([0.6, -0.64, 0.48])
    path = np.where(np.arange(2 * n)[:, None] < n, far, 0.5 * far) * along
    h = flow / 200
    set_ = turned(path, s, y, 0.0, 0.0, flow, h) @ along
    t = h * np.arange(1, n + 1)
    wanted = s * (far - y) * -np.expm1(-t / flow)
    np.testing.assert_allclose(set_[:n], wanted, atol=s * (far - y) * 0.37 * h / (2 * flow) + CLOSE)
    np.testing.assert_allclose(set_[n:], set_[n - 1], atol=CLOSE)


@pytest.mark.parametrize("isotropic", [0.0, 1.0])
def test_a_push_back_yields_later_when_hardened(tmp_path, isotropic):
    """Push a joint beyond yield and then back, quasi-statically.

    The first push leaves b = phi - y, phi = (M / K - s y) / (1 - s); pushed back by N, b = phi + y + 2 h b_1 and
    phi = (-N / K + s (y + 2 h b_1)) / (1 - s), h = i (1 - s). s b stays, and |b| at most y / (1 - s) without isotropic
    hardening: it yields once more when let go. 1 % for the rate of the pushes.
    """
    s, y, M, N = 0.4, 0.1, 16.0, 28.0
    times, values = [0, 1, 5, 5.5, 7, 8, 12, 12.5], [0, M, M, 0, 0, -N, -N, 0]
    case = swing_case(tmp_path / "d", [(0.0, 0.0)], torque=lambda t: np.interp(t, times, values), duration=16.0)
    on = {"plastic_set": {"share": s, "yield_rad": y, "isotropic": isotropic}}
    out = simulate(case, K, 25.0, start=[0, 0], **on)[0][:, 0]
    h, b = isotropic * (1 - s), (M / K - s * y) / (1 - s) - y
    far = (-N / K + s * (y + 2 * h * b)) / (1 - s)
    assert far + y + 2 * h * b < b - 0.02  # it yields again
    t = case.trajectories[0].t
    assert out[np.argmin(abs(t - 7.0))] == pytest.approx(s * b, rel=0.01)
    assert out[np.argmin(abs(t - 12.0))] == pytest.approx(far, rel=0.01)
    stays = far + y + 2 * h * b if isotropic else -y / (1 - s)
    assert out[-1] == pytest.approx(s * stays, abs=0.01 * abs(far))
