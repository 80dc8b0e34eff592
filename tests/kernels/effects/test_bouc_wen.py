"""Bouc and Wen's slider: turned along given paths beside closed forms, about one axis and in space."""

import numpy as np
import pytest
from bough.sim.effects import effect_of
from oracles.turned_joint import turner

along_path = turner(effect_of("hysteresis_boucwen").branch.law, memory=2)
Y, STEPS = 0.05, 4000


def rise(x, n, loading):
    """Return z / y over turn / y from z = 0: z' = 1 - l z^n."""
    return (1 - np.exp(-loading * x)) / loading if n == 1.0 else np.tanh(np.sqrt(loading) * x) / np.sqrt(loading)


def fall(x, n, loading, z):
    """Return z / y over turn / y back from z above none, until that is none: z' = -1 - (1 - l) z^n."""
    rest = 1 - loading
    if rest == 0.0:
        return z - x
    if n == 1.0:
        return (z + 1 / rest) * np.exp(-rest * x) - 1 / rest
    return np.tan(np.arctan(z * np.sqrt(rest)) - np.sqrt(rest) * x) / np.sqrt(rest)


def none_left(n, loading, z):
    """Return turn / y after which `fall` has come to none."""
    rest = 1 - loading
    if rest == 0.0:
        return z
    return np.log(1 + rest * z) / rest if n == 1.0 else np.arctan(z * np.sqrt(rest)) / np.sqrt(rest)


def turned(path, n, m, loading=1.0, twist=1.0):
    """Return the torque along a path [samples, 3]."""
    return along_path(path, 1.0, Y, n, loading, m, twist)


def to_and_fro(far):
    """Return a turn of ``far`` and back to where it began, [samples]."""
    return np.concatenate([np.linspace(0, far, STEPS), np.linspace(far, 0, STEPS)])


def slid(path, n, loading=1.0):
    """Return z along `to_and_fro`: up to y `rise`(far / y), back to none as in `fall`, then down as it went up."""
    x, far = path / Y, path.max() / Y
    top = rise(far, n, loading)
    back, turned_back = far - x[STEPS:], none_left(n, loading, top)
    down = np.where(back < turned_back, fall(np.minimum(back, turned_back), n, loading, top),
                    -rise(np.maximum(back - turned_back, 0.0), n, loading))  # fmt: skip
    return Y * np.concatenate([rise(x[:STEPS], n, loading), down])


CLOSE = 0.2 / STEPS  # one step's turn: the law's step is of first order


@pytest.mark.parametrize("loading", [1.0, 0.7, 0.4])
@pytest.mark.parametrize("n", [1.0, 2.0])
def test_one_axis_follows_the_closed_form(n, loading):
    """Turn four yield angles along an oblique axis and back: round, the torque is along it."""
    along = np.array([0.6, -0.64, 0.48])
    path = to_and_fro(4 * Y)
    expected = -slid(path, n, loading)[:, None] * along
    np.testing.assert_allclose(turned(path[:, None] * along, n, 0.0, loading), expected, atol=CLOSE)


def test_a_slider_that_stiffens_follows_the_closed_form():
    """With less than nothing yielding on loading, z rises faster than the turn; the error grows as z does, e-fold."""
    path = to_and_fro(4 * Y)
    out = turned(path[:, None] * np.array([1.0, 0.0, 0.0]), 1.0, 0.0, -0.2)[:, 0]
    np.testing.assert_allclose(out, -slid(path, 1.0, -0.2), atol=np.e * CLOSE)
    assert -out.min() > 5 * Y


def test_a_slider_that_stiffens_past_all_bounds_keeps_its_sign():
    """Turn so far in a step that the implicit rate would change sign: z doubles at most."""
    out = turned(np.arange(6)[:, None] * np.array([2 * Y, 0.0, 0.0]), 2.0, 0.0, -0.25)[1:, 0]
    before = np.concatenate([[0.0], out[:-1]])
    assert (out < before).all() and (-out <= 2 * (2 * Y - before) + 1e-6).all()


@pytest.mark.parametrize("n", [1.0, 2.0])
def test_each_axis_slides_by_itself(n):
    """Turn along an oblique axis with the whole share separate: every component has its own closed form."""
    far = np.array([4.0, 2.0, 0.5]) * Y
    path = np.stack([to_and_fro(f) for f in far], 1)
    expected = np.stack([slid(path[:, k], n, 0.8) for k in range(3)], 1)
    np.testing.assert_allclose(turned(path, n, 1.0, 0.8), -expected, atol=CLOSE)


def test_exponents_between_are_between():
    """Slide at a rate between those of exponents one and two on the way up."""
    path = to_and_fro(2 * Y)[:STEPS, None] * np.array([1.0, 0.0, 0.0])
    low, middle, high = (-turned(path, n, 0.0)[1:, 0] for n in (1.0, 1.5, 2.0))
    assert (low < middle + 1e-7).all() and (middle < high + 1e-7).all()
    assert middle[-1] - low[-1] > 0.01 * Y and high[-1] - middle[-1] > 0.01 * Y


def test_a_round_slider_knows_no_axes():
    """Turn path and axes together: the torque is turned."""
    t = np.linspace(0, 12, STEPS)[:, None]
    path = 0.1 * np.sin(t * np.array([1.0, 1.4, 0.7]) + np.array([0.0, 1.0, 2.0]))
    path -= path[0]
    turn_all, _ = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))
    np.testing.assert_allclose(turned(path @ turn_all.T, 1.5, 0.0), turned(path, 1.5, 0.0) @ turn_all.T, atol=2e-6)
    step = np.linalg.norm(np.diff(path, axis=0), axis=1).max()
    assert (np.linalg.norm(turned(path, 1.5, 0.0), axis=1) < Y + step).all()
    assert (np.abs(turned(path, 1.5, 1.0)) < Y + step).all()


@pytest.mark.parametrize("twist", [0.0, 0.4])
def test_of_twist_a_share_counts(twist):
    """Turn as if the twist were that share of itself; the work of what is given back is that of the whole twist."""
    t = np.linspace(0, 12, STEPS)[:, None]
    path = 0.1 * np.sin(t * np.array([1.0, 1.4, 0.7]))
    share = np.array([1.0, 1.0, twist])
    out, less = turned(path, 2.0, 0.3, 0.8, twist), turned(share * path, 2.0, 0.3, 0.8)
    np.testing.assert_allclose(out, share * less, atol=2e-6)
    assert np.abs(out - turned(path, 2.0, 0.3, 0.8)).max() > 0.1 * Y


def test_two_sliders_are_the_sum_of_two():
    """Turn in space with two shares of two yields, and by each alone: their torques add, and each alone is a slider."""
    t = np.linspace(0, 12, STEPS)[:, None]
    path = 0.1 * np.sin(t * np.array([1.0, 1.4, 0.7]))
    form = (1.5, 0.8, 0.3, 0.4)
    first, second = along_path(path, 0.6, Y, *form), along_path(path, 1.7, 3 * Y, *form)
    both = along_path(path, 0.6, Y, *form, 1.0, 1.7, 3 * Y)
    np.testing.assert_allclose(both, first + second, atol=1e-6)
    np.testing.assert_allclose(along_path(path, 0.0, Y, *form, 1.0, 1.7, 3 * Y), second, atol=1e-6)
    assert np.abs(both - first).max() > 0.1 * Y


def test_two_sliders_in_a_loop_are_iwan_s():
    """Turn four yields and back by two sliders of exponent two: the closed forms of both, added by their shares."""
    path, shares, yields = to_and_fro(4 * Y), (0.7, 0.4), (Y, 2.5 * Y)
    out = along_path(path[:, None] * np.array([1.0, 0.0, 0.0]), shares[0], yields[0], 2.0, 1.0, 0.0, 1.0, 1.0,
                     shares[1], yields[1])[:, 0]  # fmt: skip
    expected = sum(a * y / Y * slid(path * Y / y, 2.0) for a, y in zip(shares, yields, strict=True))
    np.testing.assert_allclose(out, -expected, atol=sum(shares) * CLOSE)
