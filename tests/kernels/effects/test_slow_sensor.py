"""Sensors that follow with a lag of first order: a tracker, which is simulated, and one of force, which is undone."""

import numpy as np
import pytest
from oracles.effect_case import FORCE, held, stick, stick_case
from scipy.signal import lfilter


@pytest.mark.parametrize("samples", [0.2, 1.0, 4.0])
def test_a_slow_tracker_is_a_filter_of_first_order(tmp_path, samples):
    """Read displacement and velocity through a lag of first order, each recording anew.

    `lfilter` has the closed form of what is linear between samples; ours is without the exponential, to 0.012 of it.
    """
    dt = 0.02
    case = stick_case(tmp_path / "c", [held(120), held(120, -FORCE)], dt=dt)
    slow = samples * dt
    out, plain = stick(case, time_delay={"slow_s": slow}), stick(case)
    a = np.exp(-1 / samples)
    new, old = 1 - (1 - a) * samples, (1 - a) * samples - a
    first = plain[:, :1]
    wanted = first + lfilter([new, old], [1, -a], plain - first, axis=1)
    for own in (slice(0, 3), slice(3, 6)):
        most = np.abs(plain[..., own]).max()
        np.testing.assert_allclose(out[..., own], wanted[..., own], atol=0.012 * most)
        assert np.abs(plain[..., own] - wanted[..., own]).max() > 0.02 * samples * most


@pytest.mark.parametrize("let_go", [False, True])
@pytest.mark.parametrize("samples", [1.0, 3.0, 8.0])
def test_a_slow_force_sensor_is_led(tmp_path, samples, let_go):
    """Record a force through a lag of first order; it moves as if recorded without one, let go at once or not.

    The record solves T y' = F - y in closed form between samples. Led it is a line and a constant in each sample, off
    by up to half of what the force changes in it, a sixteenth of the largest; a sample's impulse is right but for
    dt^2 y'' / 12, 0.6 % of what rises in eight samples. Displacements follow impulses, velocities the force.
    """
    dt, t = 0.02, 0.02 * np.arange(120)
    down = [1.2, 1.22] if let_go else [1.2, 1.5]
    true = np.interp(t, [0.2, 0.36, *down], [0, 1, 1, 0])
    a, slope = np.exp(-1 / samples), np.diff(true) / dt
    seen = np.zeros_like(true)
    for k, s in enumerate(slope):
        seen[k + 1] = true[k + 1] - s * samples * dt + (seen[k] - true[k] + s * samples * dt) * a
    opened = [(0.0, 0.18), (1.22 if let_go else 1.6, 2.38)]
    runs = [stick_case(tmp_path / name, [FORCE * f[:, None]], dt=dt, opened=opened)
            for name, f in (("a", true), ("b", seen))]  # fmt: skip
    wanted = stick(runs[0])[0]
    out = stick(runs[1], time_delay={"slow_s": -samples * dt})[0]
    for own, bound in ((slice(0, 3), 0.01), (slice(3, 6), 1 / 16)):
        np.testing.assert_allclose(out[:, own], wanted[:, own], atol=bound * np.abs(wanted[:, own]).max())
    off = np.abs(stick(runs[1])[0] - wanted)[:, :3].max()
    assert off > 0.1 * np.abs(wanted[:, :3]).max()
