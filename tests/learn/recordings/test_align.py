"""Clocks brought together."""

import numpy as np
import pytest
from bough.learn.recordings.align import clock_offset


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
