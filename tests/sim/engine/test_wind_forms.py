"""Forms of wind in a forest against closed forms: a crown, air that a segment outruns, gusts with a mean."""

import numpy as np
import pytest
from bough.sim.trees.tree import Joint
from oracles.rods import AREA, LENGTH, H, forked, simulator, stick
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, root

SOFT = 20.0


def run(trees, names, seconds, **values):
    """Step a forest from rest and return where the joints of every world are."""
    sim = simulator(trees, names, **values)
    sim.refresh()
    sim.step(round(seconds / H))
    return [world.copy() for world in sim.state.qpos()]


@pytest.mark.parametrize("crown", [0.0, 0.4, 1.0])
def test_a_crown_catches_the_wind_at_the_tip(crown):
    """Rest where K phi = q A L cos phi ((1 - k) / 2 + k): all along the rod, but the share k at its end."""
    q = 30.0
    tree = stick(stiffness=SOFT, damping=10.0)
    found = run([tree], ("steady_wind",), 20.0, steady_wind={"pressure_x_Pa": q, "crown": crown})[0]
    arm = LENGTH * (0.5 * (1 - crown) + crown)
    wanted = brentq(lambda p: SOFT * p - q * AREA * arm * np.cos(p), -1.5, 1.5)
    np.testing.assert_allclose(found, wanted, atol=1e-9)


def test_the_ends_of_a_tree_share_its_crown():
    """Rest where half of the tree's area catches the wind at each end of two twigs, and none at the stem."""
    fork, length, radius = forked(1.0)
    push = 50.0 * (2 * length * radius).sum() / 2

    def moments(p):
        """Return what the springs' torques lack."""
        arms = length[1:] * np.cos(p[0] + p[1:])
        return fork.stiffness * p - push * np.array([2 * LENGTH * np.cos(p[0]) + arms.sum(), *arms])

    found = run([fork], ("steady_wind",), 20.0, steady_wind={"pressure_x_Pa": 50.0, "crown": 1.0})[0]
    rest = root(moments, np.zeros(3), tol=1e-13).x
    assert np.abs(rest).min() > 0.05
    np.testing.assert_allclose(found, rest, atol=1e-9)


def test_a_slow_wind_takes_a_rod_along_at_its_own_speed():
    """Slide as v' = q A / m (1 - s v)^2 says: s v = 1 - 1 / (1 + s q A t / m)."""
    q, slow, seconds = 40.0, 0.5, 3.0
    tree = stick(Joint.PRISMATIC, stiffness=0.0, damping=0.0, axis=np.array([1.0, 0.0, 0.0]))
    sim = simulator([tree], ("steady_wind",), steady_wind={"pressure_x_Pa": q, "slowness_spm": slow})
    sim.refresh()
    sim.step(round(seconds / H))
    rate = slow * q * AREA
    wanted = (1.0 - 1.0 / (1.0 + rate * seconds)) / slow
    assert wanted > 1.7  # most of the air's 2 m/s
    # a step of h takes the force at its start, which falls by 2 rate h of itself in it
    np.testing.assert_allclose(sim.state.qvel()[0], wanted, rtol=2 * rate * H)


@pytest.mark.parametrize(("mean", "slow"), [(1.0, 0.0), (-0.6, 0.0), (0.7, 0.4)])
def test_a_gust_swings_about_its_mean_in_air_that_may_be_slow(mean, slow):
    """Drive a slide by A |w| w, w = sqrt|q| sgn q - sqrt(Q) s v, q = M (sin + g), Q = M (1 + |g|)."""
    size, f = 30.0, 0.9
    tree = stick(Joint.PRISMATIC, stiffness=30.0, damping=1.5, axis=np.array([1.0, 0.0, 0.0]))
    gust = {"sine_x_Pa": size, "frequency_Hz": f, "mean": mean, "slowness_spm": slow}
    found = run([tree], ("wind_gust",), 1.7, wind_gust=gust)[0]

    def slope(time, y):
        """Return velocity and acceleration of the slide."""
        q = size * (np.sin(2 * np.pi * f * time) + mean)
        w = np.sign(q) * np.sqrt(abs(q)) - np.sqrt(size * (1 + abs(mean))) * slow * y[1]
        return [y[1], AREA * abs(w) * w - 30.0 * y[0] - 1.5 * y[1]]

    path = solve_ivp(slope, (0, 1.7), [0.0, 0.0], rtol=1e-9, atol=1e-12, max_step=0.01).y[0]
    # symplectic Euler is off by h / 2 of the rate: 2 pi f h / 2 = 0.3 % of an amplitude, sqrt(30) h / 2 of the slide's
    np.testing.assert_allclose(found, path[-1], atol=(2 * np.pi * f + np.sqrt(30.0)) * H / 2 * np.abs(path).max())
    assert abs(path).max() > 0.05


def test_gusts_along_two_axes_blow_to_one_side_in_the_mean():
    """Give the mean the direction of the swing where both axes swing together, and of the swing where they oppose."""
    slides = [stick(Joint.PRISMATIC, stiffness=SOFT, damping=60.0, axis=np.array(a)) for a in np.eye(3)[:2]]
    for sign in (1.0, -1.0):
        gust = {"sine_x_Pa": 20.0, "cosine_x_Pa": 5.0, "sine_y_Pa": sign * 8.0, "cosine_y_Pa": sign * 2.0,
                "frequency_Hz": 7.0, "mean": 0.9}  # fmt: skip
        found = run(slides, ("wind_gust",), 60.0, wind_gust=gust)
        most = 0.9 * np.hypot(20.0, 5.0) * AREA / SOFT
        # what the swing adds passes the damper with 1 / (2 pi f D / K) = 0.8 %, of an amplitude 1 / 0.9 as large
        np.testing.assert_allclose(np.concatenate(found), [most, sign * 0.4 * most], atol=0.01 * most)
