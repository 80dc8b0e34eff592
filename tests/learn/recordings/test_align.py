"""Clocks brought together."""

import numpy as np
import pytest
from bough.learn.recordings.align import clock_offset, force_on_grid


def pushes(t: np.ndarray) -> np.ndarray:
    """Two pushes of different length, as a function of true time [s]."""
    return np.exp(-(((t - 3.0) / 0.5) ** 2)) + 0.7 * np.exp(-(((t - 5.2) / 0.9) ** 2))


@pytest.mark.parametrize("ahead", [0.0, 0.123, -0.777, 2.5, -4.0])
@pytest.mark.parametrize("rates", [(100.0, 30.0), (20.0, 65.0)])
def test_offsets_of_known_clocks(ahead, rates):
    """Find offsets between streams of other rates, begins, signs and scales, with noise."""
    rng = np.random.default_rng(0)
    a, b = np.arange(0.0, 9.0, 1 / rates[0]), np.arange(0.4, 8.0, 1 / rates[1])
    first = (a, pushes(a) + rng.normal(0.0, 0.01, len(a)))
    second = (b + ahead, -3.0 * pushes(b) + rng.normal(0.0, 0.03, len(b)))
    found = clock_offset(first, second, 5.0)
    # noise of 1 % over the slope of a push, averaged over some thirty samples: a few milliseconds
    assert found.seconds == pytest.approx(ahead, abs=5e-3)
    assert found.correlation > 0.99 and (found.before < 0.9 or abs(ahead) < 0.2)


def test_signals_that_have_nothing_in_common():
    """Say by a low correlation that noise is like nothing."""
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 9.0, 0.01)
    assert clock_offset((t, rng.normal(size=len(t))), (t, rng.normal(size=len(t))), 4.0).correlation < 0.3
    assert clock_offset((t, np.zeros(len(t))), (t, pushes(t)), 4.0).correlation == 0.0


def swung(t, force, mass=0.5, stiffness=60.0):
    """Displacement at the end of t of a mass on a spring that begins in equilibrium: the sine's convolution."""
    rate = np.sqrt(stiffness / mass)
    pulled = np.trapezoid(np.sin(rate * (t[-1] - t)) * (force - force[0]), t) / (mass * rate)
    return force[0] / stiffness + pulled


@pytest.mark.parametrize("rate", [500.0, 120.0, 60.0])
def test_a_release_between_two_samples_keeps_its_impulse(rate):
    """A mass that is let go of between the points of a 30 Hz grid swings as it does under all samples of the force.

    Samples of step h miss up to F' h^2 / 8 of the impulse of a force that falls with F', which moves a mass on a spring
    by 1 / sqrt(m k) of that. Read off at the grid's points it is off by more.
    """
    fine, grid = np.linspace(0.0, 3.0, 30001), np.arange(91) / 30.0
    missed, left = [], []
    for let_go in 1.5 + np.linspace(0.0, 1.0, 7) / 30.0:
        force = np.interp(fine, [let_go, let_go + 0.03], [8.0, 0.0])
        t = np.arange(-1, int(3.0 * rate) + 2) / rate + 0.3 / rate
        rows = np.interp(t, fine, force)[:, None]
        put = force_on_grid(t, rows, grid)[:, 0]
        inside = (t >= 0.0) & (t <= 3.0)
        assert np.interp(t[inside], grid, put).sum() == pytest.approx(rows[inside].sum(), rel=1e-9)
        true = swung(fine, force)
        missed.append(swung(fine, np.interp(fine, grid, np.interp(grid, t, rows[:, 0]))) - true)
        left.append(swung(fine, np.interp(fine, grid, put)) - true)
    bound = 8.0 / 0.03 / (8.0 * rate**2) / np.sqrt(0.5 * 60.0)
    assert np.abs(left).max() < bound < np.abs(missed).max()


def test_a_force_no_faster_than_the_grid_is_interpolated():
    """Take a slow sensor's force linear between its samples, also where one sample is missing."""
    grid = np.arange(31) / 30.0
    t = np.delete(np.arange(-1, 45) / 40.0, 20)
    rows = np.random.default_rng(2).normal(size=(len(t), 3))
    np.testing.assert_allclose(force_on_grid(t, rows, grid)[:, 1], np.interp(grid, t, rows[:, 1]))
