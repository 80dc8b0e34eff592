"""Friction's bristles, from elastic and then slipping to Dahl's: turned along given paths beside closed forms."""

import numpy as np
import pytest
from bough.sim.effects import effect_of
from oracles.turned_joint import turner

along_path = turner(effect_of("dry_friction").branch.law)
Y, STEPS = 0.02, 4000
CLOSE = 0.2 / STEPS / Y  # of T: one step's turn over the bend; the law's step is of first order


def turned(path, gradual):
    """Return the torque along a path [samples, 3], for T = 1."""
    return along_path(path, 1.0, Y, gradual)


def bend(x, start, gradual):
    """Return z / y after a turn x / y away from where it was ``start``: z' = 1 - g z, at most 1."""
    if gradual == 0.0:
        return np.minimum(start + x, 1.0)
    return np.minimum((1 - (1 - gradual * start) * np.exp(-gradual * x)) / gradual, 1.0)


@pytest.mark.parametrize("gradual", [0.0, 0.5, 1.0])
def test_there_and_back_follows_the_closed_form(gradual):
    """Turn five bends along an oblique axis and back; the torque is against the turn and along the axis."""
    along, far = np.array([0.6, -0.64, 0.48]), 5.0
    there = np.linspace(0, far, STEPS)
    path = Y * np.concatenate([there, there[::-1]])
    up = bend(there, 0.0, gradual)
    expected = np.concatenate([up, -bend(there, -up[-1], gradual)])
    np.testing.assert_allclose(turned(path[:, None] * along, gradual), -expected[:, None] * along, atol=CLOSE)


@pytest.mark.parametrize("gradual", [0.0, 0.5, 1.0])
def test_in_space_it_is_round_and_never_above_its_size(gradual):
    """Turn path and axes together: the torque is turned; nowhere is it more than T."""
    t = np.linspace(0, 12, STEPS)[:, None]
    path = 0.1 * np.sin(t * np.array([1.0, 1.4, 0.7]) + np.array([0.0, 1.0, 2.0]))
    path -= path[0]
    axes, _ = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))
    out = turned(path, gradual)
    np.testing.assert_allclose(turned(path @ axes.T, gradual), out @ axes.T, atol=2e-5)
    assert (np.linalg.norm(out, axis=1) < 1 + 1e-5).all()


@pytest.mark.parametrize("stribeck", [-1.0, -0.4, 0.0, 0.8])
def test_its_size_depends_on_the_rate(stribeck):
    """Turn ever faster: T (1 + s exp(-|w| / v)) against the turn, up to the exponential's own error of 0.012."""
    v, along = 0.01, np.array([0.6, -0.64, 0.48])
    rate = np.geomspace(1e-4, 0.3, STEPS)
    path = np.cumsum(rate)[:, None] * along
    path = np.concatenate([np.linspace(0, 10 * Y, STEPS)[:, None] * along, 10 * Y * along + path])  # slipping by then
    out = along_path(path, 1.0, Y, 0.0, stribeck, v)[STEPS + 1 :] @ along
    expected = 1 + stribeck * np.exp(-rate[1:] / v)
    # the path is kept in float32: its differences are off by 1e-6 of 60 rad, which the damper of s / v sees at rest
    np.testing.assert_allclose(out, -expected, atol=0.012 * abs(stribeck) + 4e-6 / v + 1e-5)


def test_at_rest_it_may_creep():
    """Bend, then stop: friction with s = -1 has nothing left to hold with, that with s = 0 has all."""
    path = np.zeros((40, 3))
    path[:20, 0] = np.linspace(0, 5 * Y, 20)
    path[20:, 0] = 5 * Y
    assert np.abs(along_path(path, 1.0, Y, 0.0, -1.0, 1e-3)[21:]).max() == 0.0
    np.testing.assert_allclose(along_path(path, 1.0, Y, 0.0, 0.0, 1e-3)[21:, 0], -1.0, rtol=1e-6)


@pytest.mark.parametrize("preload", [0.0, -0.4])
def test_it_grows_with_what_the_spring_carries(preload):
    """Turn far out along an oblique axis and back: T + mu |K phi - P| against the turn, where it slips; K = 1."""
    along, size, grows = np.array([0.6, -0.64, 0.48]), 0.3, 0.2
    there = np.linspace(0, 1, STEPS)
    path = np.concatenate([there, there[::-1]])
    out = along_path(path[:, None] * along, size, Y, 0.0, 0.0, 1.0, 0.0, grows, preload=preload * along) @ along
    slips = np.concatenate([abs(there - 0.5) < 0.4, abs(there[::-1] - 0.5) < 0.4])
    expected = -np.sign(np.gradient(path)) * (size + grows * np.abs(path - preload))
    np.testing.assert_allclose(out[slips], expected[slips], atol=1e-4)
