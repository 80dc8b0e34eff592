"""Each hidden law by itself, against a closed form: joints, sensors and the grasp point do what is prescribed."""

from __future__ import annotations

import numpy as np
import pytest
from bough.learn.hidden.drive import drive, simulate
from bough.learn.hidden.joint_laws import Bristles, Creep, Directed, Elastic, Hysteresis, Rupture, Yielding
from bough.learn.hidden.outside_laws import RECIPES as OUTSIDE
from bough.learn.hidden.outside_laws import ChangingSpring, CubicDamper, FluidMemory, Neighbour, Tether
from bough.learn.hidden.parts import AIR, Part, Readings
from bough.learn.hidden.rig import Trunk, build
from bough.learn.hidden.sensor_laws import RECIPES as SENSORS
from bough.learn.hidden.sensor_laws import shifted
from bough.learn.hidden.world_laws import Gust, Slip
from oracles.held_joint import RATE, STEP, Held, K, follow, held_by, rod, scale, triangle
from scipy.optimize import brentq

# ---- joints ------------------------------------------------------------------------------------------------------


def test_friction_loses_four_amplitudes_of_torque_a_cycle() -> None:
    """Lose 4 A T a cycle, less the bristles' share: each reversal costs 2 bend T; a stopped joint stays held."""
    size, torque, bend = 0.2, 0.7, 0.004
    angle = triangle(size)
    added = follow(Bristles(0, torque, bend), angle)[:, 0]
    cycle = slice(4000, 8001)
    lost = -np.trapezoid(added[cycle], angle[cycle])
    assert abs(lost / (4 * size * torque) - 1) < bend / size + 1e-3
    assert np.abs(added).max() <= torque * (1 + 1e-12)
    stopped = follow(Bristles(0, torque, bend), [0.0, 0.1, 0.1, 0.1])[:, 0]
    np.testing.assert_allclose(stopped[1:], -torque, rtol=1e-9)


def test_bouc_wen_saturates_and_knows_no_speed() -> None:
    """Saturate at k / (beta + gamma); the same path in half the steps gives the same loop to first order in a step."""
    law = (0, K, 6.0, 4.0)
    fine, coarse = triangle(0.5, 8000), triangle(0.5, 4000)
    a, b = follow(Hysteresis(*law), fine)[::2, 0], follow(Hysteresis(*law), coarse)[:, 0]
    assert abs(a.min() + K / 10.0) < 0.01 * K / 10.0
    assert np.abs(a - b).max() < 10.0 * 0.5 * 4 / 4000 * K
    assert -np.trapezoid(a[4000:8001], coarse[4000:8001]) > 0.1


def test_creep_relaxes_exponentially() -> None:
    """Answer a step of angle with -k phi exp(-t / T), exactly at every step."""
    added = follow(Creep(0, K, 0.05), [0.0] + [0.1] * 200)[1:, 0]
    np.testing.assert_allclose(added, -K * 0.1 * np.exp(-np.arange(1, 201) * STEP / 0.05), rtol=1e-12)


def test_yielding_leaves_its_share() -> None:
    """Slip (a - y) / (1 + h) in a first load to a, nothing in a second like it, and nothing below y."""
    law = Yielding(0, K, 0.1, 3.0)
    up = np.linspace(0, 0.3, 300)
    added = follow(law, np.concatenate([up, up[::-1], up, up[::-1]]))[:, 0]
    assert not added[:99].any()
    np.testing.assert_allclose(added[[299, 599, 899, 1199]], K * 0.2 / 4.0, rtol=1e-9)
    assert not follow(Yielding(0, K, 0.1, 3.0), 0.0999 * np.sin(np.arange(50))).any()


def test_rupture_is_for_good() -> None:
    """Add nothing before the limit is passed, and the share of the spring ever after."""
    angle = np.array([0.1, 0.19, -0.1, 0.21, 0.05, -0.1])
    added = follow(Rupture(0, K, 0.2, 0.4), angle)[:, 0]
    np.testing.assert_allclose(added, [0, 0, 0, *(0.4 * K * angle[3:])])


def test_elastic_laws() -> None:
    """Follow -K a phi_k^3 axis by axis; a dead band has no spring at zero and K (phi - g) far out."""
    angle = np.array([[0.2, -0.1, 0.05]])
    np.testing.assert_allclose(follow(Elastic(0, K, cubic=3.0), angle), -3.0 * K * angle**3)
    near, far = follow(Elastic(0, K, gap=0.02), [1e-6, 0.4])[:, 0]
    np.testing.assert_allclose([near, far], [K * 1e-6, K * 0.02], rtol=1e-6)


def test_directed_laws() -> None:
    """Act along the axis only; one-sided for the sharp corner, symmetric and without power of its own if coupled."""
    n = np.array([0.6, 0.8, 0.0])
    stiff = Directed(0, 0.5 * K * np.outer(n, n))
    np.testing.assert_allclose(follow(stiff, [0.1 * n, [0, 0, 0.1], [-0.08, 0.06, 0]])[0], -0.05 * K * n)
    np.testing.assert_allclose(follow(stiff, [[0, 0, 0.1], [-0.08, 0.06, 0]]), 0, atol=1e-12)
    sided = Directed(0, 0.5 * K * np.outer(n, n), -n)
    np.testing.assert_allclose(follow(sided, [0.1 * n, -0.1 * n]), [np.zeros(3), 0.05 * K * n], atol=1e-12)
    off = np.outer(n, [0, 0, 1])
    np.testing.assert_allclose(follow(Directed(0, 0.3 * K * (off + off.T)), [0.1 * n])[0], [0, 0, -0.03 * K])


# ---- bodies and air ----------------------------------------------------------------------------------------------


def test_tip_mass_adds_its_inertia() -> None:
    """Add M L^2 to the joint's inertia, and the weight that the pre-load carries."""
    import mujoco

    inertia = []
    for mass in (0.0, 0.3):
        model, data = build(rod(9.81), sub=1, tip_mass=mass)
        full = np.zeros((model.nv, model.nv))
        mujoco.mj_fullM(model, full, data.qM) if hasattr(data, "qM") else mujoco.mj_fullM(model, data, full)
        inertia.append(full[2, 2])
        np.testing.assert_allclose(data.qacc, 0, atol=1e-3)
    assert abs(inertia[1] - inertia[0] - 0.3 * 0.4**2) < 1e-4


def test_trunk_adds_its_compliance() -> None:
    """A small vertical force F at x = l turns the trunk by F l / K_t about its pivot: that much more, times l."""
    part = Part({}, trunk=Trunk(200.0, 4.0, 1.0))
    force = held_by([0, 0, 0.2])
    stiff, soft = (drive(rod(), force, RATE, parts=p, sub=1, dt=2e-3).moved[0, -1] for p in ((), (part,)))
    assert abs((soft - stiff)[2] / (0.2 * 0.3**2 / 200.0) - 1) < 0.01
    assert abs((soft - stiff)[0] / (-0.2 * 0.3 / 200.0) - 1) < 0.05  # the base swings back by F l / K_t times one metre


def test_steady_wind_bends_by_its_pressure_from_the_start() -> None:
    """Rest displaced downwind from the first sample on; twice the pressure, twice as far."""
    calm = np.zeros((2, 40, 3))
    moved = [
        drive(rod(), calm, RATE, parts=[Part({}, wind=np.array([0.0, v, 0.0]))], sub=1, dt=2e-3).moved
        for v in (6.0, 6.0 * np.sqrt(2))
    ]
    assert (moved[0][..., 1] > 1e-4).all() and np.ptp(moved[0][..., 1]) < 0.01 * moved[0][0, 0, 1]
    assert abs(moved[1][0, 0, 1] / moved[0][0, 0, 1] - 2) < 0.02


def test_gust_follows_the_absolute_clock() -> None:
    """Swing in dynamic pressure between plus and minus 0.6 V^2, alike at the same time on the clock."""
    gust = Gust(9.0, np.array([0.0, 1.0, 0.0]), 0.8, 0.3, 0.0, 0.05)
    time = np.linspace(3.0, 8.0, 1001)
    speed = gust.gust(time)[:, 1]
    pressure = 0.5 * AIR * np.abs(speed) * speed
    np.testing.assert_allclose(pressure, 0.5 * AIR * 81.0 * np.sin(2 * np.pi * 0.8 * time + 0.3), atol=1e-9)
    law = Part({}, law=lambda: gust, wind=np.zeros(3))
    calm = np.zeros((3, 30, 3))
    moved = drive(rod(), calm, RATE, parts=[law], clock=np.array([1.0, 1.0 + 5 / 0.8, 1.5]), sub=1, dt=2e-3).moved
    np.testing.assert_allclose(moved[0], moved[1], atol=1e-9)
    assert np.abs(moved[0] - moved[2]).max() > 0.1 * np.abs(moved[0]).max() > 1e-5


def test_fluid_drags_large_swings_more() -> None:
    """Lose a larger share of a large swing than of a small one; a linear damper does not."""
    releases = np.concatenate([held_by([0, f, 0], 80) * (np.arange(80) < 40)[None, :, None] for f in (0.5, 8.0)])
    left = {}
    for density in (0.0, 1000.0):
        moved = drive(rod(damping=0.02), releases, RATE, parts=[Part({}, density=density)], sub=1, dt=1e-3).moved
        left[density] = np.abs(moved[:, 45:50, 1]).max(axis=1) / np.abs(moved[:, 39, 1])
    assert abs(left[0.0][1] / left[0.0][0] - 1) < 0.1
    assert left[1000.0][1] / left[1000.0][0] < 0.7


@pytest.mark.parametrize(("mobility", "end"), [(0.01, 0.05), (-0.01, -0.1)])
def test_slip_slides_beyond_its_limit(mobility: float, end: float) -> None:
    """Slide mobility e^2 / (e + w), e = |F| - limit, wherever the force points; couple s a x F; stop at the end."""
    held, law = Held(), Slip(mobility, 2.0, 0.5, (0.1, 0.05))
    held.force, held.grip_spin = np.array([[3.0, 0.0, -4.0]]), np.array([[0.0, 2.0, 0.0]])
    law.begin(held)
    for _ in range(500):
        held.couple = np.zeros((1, 3))
        law.act(held)
    rate = mobility * 3.0**2 / 3.5
    np.testing.assert_allclose(law.slide, rate * 0.5)
    np.testing.assert_allclose(held.couple, [[0.0, rate * 0.5 * 3.0, 0.0]])
    np.testing.assert_allclose(law.beside(held), [[0, 0, rate * 0.5, 2.0 * rate * 0.5, 0, rate]], atol=1e-15)
    for _ in range(50000):
        law.act(held)
    held.force = np.array([[1.2, 0.0, 1.2]])  # below the limit: nothing moves
    law.act(held)
    np.testing.assert_allclose(law.beside(held), [[0, 0, end, 2.0 * end, 0, 0]])


@pytest.mark.parametrize("mobility", [0.012, -0.02])
def test_slip_shows_the_point_that_is_held(mobility: float) -> None:
    """Show the drift of the held point, stay there when let go, and start the next recording at the marked one."""
    force = held_by([0, 3.0, 0], 160) * (np.arange(160) < 101)[None, :, None]
    part = Part({}, law=lambda: Slip(mobility, 1.0, 0.1, (0.27, 0.09)))
    run = drive(rod(), np.repeat(force, 2, axis=0), RATE, parts=[part], sub=1, dt=1e-3)
    np.testing.assert_array_equal(run.moved[0], run.moved[1])

    def slid(rise: float, hold: float) -> float:
        """Integrate over a rise from the limit to 3 N that lasts ``rise``, and over a hold there [s]."""
        e, w = 2.0, 0.1
        return mobility * ((e / 2 - w + w**2 / e * np.log1p(e / w)) * rise + e**2 / (e + w) * hold)

    fall = slid(2 / 3 / RATE, 0.0)  # the force falls to zero within a sample
    at = 0.3 + slid(2 / 3, 2.0)  # at 3 s
    turn = brentq(lambda phi: K * phi - 3.0 * at * np.cos(phi), 0.0, 1.5)
    expected = at * np.array([np.cos(turn), np.sin(turn), 0.0]) - [0.3, 0.0, 0.0]
    # the rod lags by D / K = 50 ms of the change of its turn; the law slides in steps of 1 ms
    lag = 0.05 * abs(mobility) * 2.0 * (1 + 3.0 / K)
    np.testing.assert_allclose(run.moved[0, 75], expected, atol=lag)
    slope = (run.moved[0, 76] - run.moved[0, 74]) * RATE / 2
    np.testing.assert_allclose(run.velocity[0, 75], slope, atol=0.01 * np.linalg.norm(slope))
    stays = slid(2 / 3, 3.0) + fall
    np.testing.assert_allclose(run.moved[0, -1], [stays, 0.0, 0.0], atol=1e-3 * abs(stays))


# ---- sensors -----------------------------------------------------------------------------------------------------


def seen(force, turn=(1.0, 0.0, 0.0, 0.0)) -> Readings:
    """Return readings of one recording of a force [T, 3]."""
    force = np.asarray(force, dtype=float)[None]
    moved = np.linspace(-0.1, 0.1, force.shape[1])[None, :, None] * np.ones(3)
    return Readings(
        np.arange(force.shape[1]) * 0.04, force, moved, moved, np.tile(np.array(turn), (1, force.shape[1], 1))
    )


def made(recipes, name: str, strength: float) -> Part:
    """Return an effect of a given strength."""
    return recipes[name](np.random.default_rng(4), scale(), 0).make(strength)


def test_force_faults() -> None:
    """Add a bias of a tenth of 10 N; scale by exp of the strength; both also with the gripper open."""
    force = np.outer(np.arange(5.0), [1.0, 2.0, 0.0])
    biased = made(SENSORS, "force_bias", 0.1).sense(seen(force)).force[0] - force
    np.testing.assert_allclose(np.linalg.norm(biased, axis=1), 1.0)
    part = made(SENSORS, "force_scale", 0.2)
    np.testing.assert_allclose(part.sense(seen(force)).force[0], part.params["scale"] * force)
    assert abs(abs(np.log(part.params["scale"])) - 0.2) < 1e-12


def test_delay_in_samples() -> None:
    """Delay by one and a half samples: a ramp is late by that, a whole sample shifts the record."""
    force = np.outer(np.arange(10.0), np.ones(3))
    part = made(SENSORS, "time_delay", 1.5)
    np.testing.assert_allclose(part.sense(seen(force)).force[0, 2:], force[2:] - 1.5)
    assert abs(part.params["lag_s"] - 1.5 * 0.04) < 1e-12
    values = np.random.default_rng(0).normal(size=(2, 8, 3))
    np.testing.assert_allclose(shifted(np.arange(8.0), values, 1.0)[:, 1:], values[:, :-1])


def test_weight_is_tared_at_rest() -> None:
    """Read 1 - k of the weight in the rest pose and 1 + k of it with the gripper upside down."""
    part = made(SENSORS, "gravity_comp_error", 0.3)
    weight, tared = -part.params["mass_kg"] * 9.81, part.params["tared"]
    for turn, share in (((1, 0, 0, 0), 1 - tared), ((0, 1, 0, 0), 1 + tared)):
        read = part.sense(seen(np.zeros((3, 3)), turn)).force[0]
        np.testing.assert_allclose(read, np.tile([0, 0, weight * share], (3, 1)), atol=1e-12)


# ---- outside the list --------------------------------------------------------------------------------------------


def test_outside_sensors() -> None:
    """Turn forces without changing their size, cut displacement off, scale it per axis, leave it with no jitter."""
    force = np.random.default_rng(1).normal(size=(20, 3))
    turned = made(OUTSIDE, "frame_misalignment", 0.3).sense(seen(force)).force[0]
    np.testing.assert_allclose(np.linalg.norm(turned, axis=1), np.linalg.norm(force, axis=1))
    assert np.abs(turned - force).max() > 0.01
    assert abs(made(OUTSIDE, "displacement_saturation", 0.4).sense(seen(force)).moved.max() - 0.06) < 1e-12
    gain = made(OUTSIDE, "displacement_gain_error", 0.2)
    np.testing.assert_allclose(gain.sense(seen(force)).moved, seen(force).moved * gain.params["gain"])
    record = Readings(np.arange(101) * 0.04, *(np.random.default_rng(2).normal(size=(2, 101, n)) for n in (3, 3, 3, 4)))
    np.testing.assert_allclose(made(OUTSIDE, "clock_jitter", 0.0).sense(record).moved, record.moved)
    assert np.abs(made(OUTSIDE, "clock_jitter", 0.5).sense(record).moved - record.moved).max() > 0.1


def test_outside_laws() -> None:
    """Check each law's torque or push at one moment by hand."""
    held = Held()
    held.phi, held.w, held.time = np.array([[0.1, 0, 0]]), np.array([[2.0, 0, 0]]), np.array([25.0])
    held.moved, held.velocity = np.array([[0.0, 0.3, 0.0]]), np.array([[0.0, 1.0, 0.0]])
    ChangingSpring({0: K}, drift=0.5, span=(5.0, 40.0)).act(held)
    np.testing.assert_allclose(held.torque[0], [-K * 0.5 * 0.5 * 0.1, 0, 0])
    held.torque = np.zeros((1, 3))
    CubicDamper(0, 0.3, 10.0).act(held)
    np.testing.assert_allclose(held.torque[0], [-0.3 * 8.0, 0, 0])
    Neighbour(50.0, np.array([0.0, 1.0, 0.0]), 0.2).act(held)
    np.testing.assert_allclose(held.push[0], [0, -50.0 * (0.1 + 0.02), 0])
    held.push = np.zeros((1, 3))
    Tether(10.0, np.array([0.0, -1.0, 0.0]), 0.1).act(held)
    np.testing.assert_allclose(held.push[0], [0, -10.0 * 0.2, 0])
    held.push = np.zeros((1, 3))
    Neighbour(50.0, np.array([0.0, -1.0, 0.0]), 0.0).act(held)
    Tether(10.0, np.array([0.0, 1.0, 0.0]), 0.0).act(held)
    assert not held.push.any()
    fluid = FluidMemory(2.0, 0.1)
    fluid.begin(held)
    fluid.act(held)
    np.testing.assert_allclose(held.push[0], [0, -2.0 * np.exp(-STEP / 0.1), 0])


# ---- the steps ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("law", [lambda: Elastic(0, K), lambda: Rupture(0, K, 0.1, 0.0)])
def test_steps_with_laws_are_mujocos(law) -> None:
    """A law that adds nothing leaves MuJoCo's own motion, side by side and one after the other."""
    forces = np.concatenate([held_by([0, 3.0, 1.0], 30), held_by([1.0, -2.0, 0], 30)])
    alone = simulate(rod(9.81), forces, RATE, dt=2e-3)
    stepped = drive(rod(9.81), forces, RATE, parts=[Part({}, law=law)], dt=2e-3)
    np.testing.assert_allclose(stepped.moved, alone[0], atol=1e-12)
    np.testing.assert_allclose(stepped.velocity, alone[1], atol=1e-10)


def test_damage_lasts_and_memory_does_not() -> None:
    """A replicate after yielding starts from its set; one with creep starts like the first."""
    forces = np.repeat(held_by([0, 6.0, 0], 60) * (np.arange(60) < 30)[None, :, None], 2, axis=0)
    yielded = drive(rod(), forces, RATE, parts=[Part({}, law=lambda: Yielding(0, K, 0.03, 1.0))], sub=1, dt=2e-3)
    assert abs(yielded.moved[0, 0, 1]) < 1e-9 and yielded.moved[1, 0, 1] > 0.003
    assert abs(yielded.moved[1, 0, 1] / yielded.moved[0, -1, 1] - 1) < 1e-3  # where the first one came to rest
    crept = drive(rod(), forces, RATE, parts=[Part({}, law=lambda: Creep(0, K, 0.5))], sub=1, dt=2e-3)
    np.testing.assert_allclose(crept.moved[0], crept.moved[1], atol=1e-12)
