"""The guard, stepped with made-up times: what it lets through for any sequence of commands, and what it refuses."""

import numpy as np
import pytest
from bough.learn.robot.backend import Sample
from bough.learn.robot.guard import PERIOD, Command, Guard
from bough.learn.robot.limits import RAMP, default_limits
from bough.learn.robot.workspace import Workspace
from bough.sim.arms.jaco2 import jaco2
from hypothesis import given, settings
from hypothesis import strategies as st

ARM = jaco2()
LIMITS = default_limits(ARM)
BOX = Workspace(ARM, LIMITS.workspace_low, LIMITS.workspace_high)
ZERO = np.zeros(6)


class Rig:
    """A guard and an arm that does exactly what it is told, on a clock that only the rig moves."""

    def __init__(self, armed=True, start=ARM.home):
        self.guard = Guard(LIMITS, BOX.clearance, armed)
        self.now, self.q, self.velocity, self.number = 100.0, np.array(start), ZERO, 0
        self.tick()

    def tick(self, dt=PERIOD, *, torque=ZERO, measured=True, trouble="", touch=0.0):
        self.q = self.q + self.velocity * dt
        self.now += dt
        sample = Sample(self.now, self.q, self.velocity, torque, np.zeros(3), np.zeros(4)) if measured else None
        self.velocity = self.guard.step(self.now, sample, touch, trouble)
        return self.velocity

    def ask(self, values, who="a", kind="velocity", age=None, number=None):
        self.number += 1
        return self.guard.command(self.now, Command(who, kind, np.asarray(values, float), number or self.number, age))


numbers = st.one_of(st.floats(-3.0, 3.0), st.sampled_from([np.nan, np.inf, -np.inf, 1e300, 0.0]))
ticks = st.tuples(st.just("tick"), st.floats(0.002, 0.020))
moves = st.one_of(
    ticks,
    ticks,
    st.tuples(st.just("velocity"), st.lists(numbers, min_size=5, max_size=7)),
    st.tuples(st.just("velocity"), st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6)),
    st.tuples(st.just("position"), st.lists(st.floats(0.0, 6.0), min_size=6, max_size=6)),
    st.tuples(st.just("who"), st.sampled_from("ab")),
    st.tuples(st.sampled_from(["halt", "arm", "release", "torque", "blind", "stall", "late", "old"]), st.none()),
)


@settings(max_examples=300, deadline=None)
@given(st.lists(moves, max_size=80))
def test_any_sequence_of_commands_keeps_the_limits(sequence):
    """Keep speed, acceleration, joint limits and workspace, and stand still 150 ms after the last valid lease.

    Ticks come within 20 ms, as the service measures; joints may overshoot a limit by rounding alone.
    """
    rig, who, last, known = Rig(), "a", -np.inf, set()
    for kind, value in [*sequence, *[("tick", PERIOD)] * 12]:
        before, until = rig.velocity.copy(), rig.now
        if kind == "tick":
            rig.tick(value)
        elif kind in ("velocity", "position"):
            if rig.ask(value, who, kind).accepted:
                last = rig.now
                known.add(who)
        elif kind == "who":
            who = value
        elif kind == "halt":
            rig.guard.halt(rig.now, "asked")
        elif kind == "arm" and rig.guard.stop is not None:
            rig.guard.arm(rig.guard.stop.number)
        elif kind == "release":
            rig.guard.release(rig.now, who)
        elif kind == "late":
            assert not rig.ask(ZERO + 0.1, who, age=0.2).accepted
        elif kind == "old" and who in known:
            assert not rig.ask(ZERO + 0.1, who, number=-5).accepted
        elif kind in ("torque", "blind", "stall"):
            rig.tick(0.2 if kind == "stall" else PERIOD, torque=ZERO + 99.0 * (kind == "torque"),
                     measured=kind != "blind")  # fmt: skip
            assert rig.guard.stop is not None
        v, dt = rig.velocity, rig.now - until
        assert np.isfinite(v).all() and (np.abs(v) <= LIMITS.speed).all()
        same = np.where(np.sign(v) == np.sign(before), np.abs(before), 0.0)
        grew = np.abs(v) - same
        assert (grew <= LIMITS.acceleration * min(dt, 2 * PERIOD) + 1e-12).all()
        if kind != "tick" or dt > 0.021:
            continue
        assert (rig.q >= LIMITS.lower - 1e-9).all() and (rig.q <= LIMITS.upper + 1e-9).all()
        if rig.now > last + 0.150 or (rig.guard.stop is not None and rig.guard.stop.cause == "not armed yet"):
            assert not v.any()


@settings(max_examples=60, deadline=None)
@given(st.floats(-0.6, 0.6), st.floats(-0.6, 0.6), st.integers(1, 20), st.floats(0.0, 0.1))
def test_joints_stay_within_their_limits(second, third, ticks, age):
    """Drive joints 2 and 3 for ten seconds, with measurements up to 0.1 s old: they come near a limit and stay inside.

    The guard estimates where the joint is meanwhile from the last speed sent, which errs by a tick's change of speed.
    """
    rig, past = Rig(), []
    rig.guard._clearance = lambda q: np.ones(len(q))
    for n in range(600):
        if n % ticks == 0 or n % 6 == 0:
            rig.ask([0.0, second, third, 0.0, 0.0, 0.0])
        rig.q, rig.now = rig.q + rig.velocity * PERIOD, rig.now + PERIOD
        past.append(rig.q)
        late = int(age / PERIOD)
        seen = Sample(rig.now - late * PERIOD, past[max(n - late, 0)], rig.velocity, ZERO, np.zeros(3), np.zeros(4))
        rig.velocity = rig.guard.step(rig.now, seen)
        assert (rig.q >= LIMITS.lower - 0.01).all() and (rig.q <= LIMITS.upper + 0.01).all()
    if abs(second) > 0.5:
        assert min(rig.q[1] - LIMITS.lower[1], LIMITS.upper[1] - rig.q[1]) < 0.1


@settings(max_examples=20, deadline=None)
@given(st.lists(st.floats(-0.8, 0.8), min_size=6, max_size=6), st.integers(30, 240))
def test_the_arm_stays_in_its_workspace(values, count):
    """Drive any way for up to four seconds; the capsules leave the box by less than what a tick's path bends."""
    rig = Rig()
    for _ in range(count):
        rig.ask(values)
        rig.tick()
    assert BOX.clearance(rig.q) > -0.005


def test_speed_grows_to_the_command_and_falls_when_the_lease_ends():
    """Follow a command at 5 rad/s^2; hold it 100 ms; be at zero a ramp later, with no command but the first."""
    rig = Rig()
    assert rig.ask([0.3, 0, 0, 0, 0, 0]).accepted
    seen = [rig.tick()[0] for _ in range(12)]
    rise = np.minimum(5.0 * PERIOD * np.arange(1, 13), 0.3)
    assert seen[:4] == pytest.approx(rise[:4])
    lease = int(0.100 / PERIOD)
    assert seen[4] == pytest.approx(0.3) and not np.any(seen[int((0.100 + RAMP) / PERIOD) :])
    assert seen[lease] < 0.3


@pytest.mark.parametrize(
    ("spoil", "cause"),
    [
        ({"torque": np.array([0, 0, 0, 0, 16.1, 0])}, "torque of joint 5"),
        ({"touch": 0.95}, "touch"),
        ({"touch": np.nan}, "touch"),
        ({"measured": False}, "no measurement"),
        ({"trouble": "the log cannot be written"}, "the log"),
        ({"torque": ZERO + np.nan}, "not finite"),
        ({"dt": 0.3}, "control loop stood"),
    ],
)
def test_danger_stops_and_the_stop_latches(spoil, cause):
    """Stop for the reason, refuse commands, stay stopped when the reason is gone, move again once re-armed."""
    rig = Rig()
    for _ in range(5):
        rig.ask([0.2] * 6)
        rig.tick()
    rig.tick(**spoil)
    assert cause in rig.guard.stop.cause and rig.guard.stop.number == 1
    assert not rig.guard.arm(1).accepted, "the danger lasts, or the arm moves"
    for _ in range(10):
        assert rig.ask([0.2] * 6).reason == "stopped"
        rig.tick()
    assert not rig.velocity.any()
    assert not rig.guard.arm(2).accepted and rig.guard.arm(1).accepted and not rig.guard.arm(1).accepted
    rig.tick()
    assert not rig.velocity.any(), "re-arming moves nothing"
    assert rig.ask([0.2] * 6).accepted and rig.tick().all()


def test_refusals_are_counted_by_reason():
    """Refuse duplicates, old numbers, late answers, other controllers, NaN, wrong counts, degrees; move for none."""
    rig = Rig(armed=False)
    assert rig.ask(ZERO).reason == "stopped" and rig.guard.arm(1).accepted
    assert rig.ask(ZERO, number=10).accepted
    for reason, given_ in {
        "duplicate": {"number": 10}, "out of order": {"number": 9}, "late": {"age": 0.11}, "held": {"who": "b"},
        "not finite": {"values": [np.nan] * 6}, "malformed": {"values": [0.1] * 5}, "implausible": {"values": [36] * 6},
        "outside": {"values": [0.0] * 6, "kind": "position"},
    }.items():  # fmt: skip
        before = rig.guard.refused[reason]
        rig.number = 20
        assert rig.ask(**{"values": [0.1] * 6, **given_}).reason == reason
        assert rig.guard.refused[reason] == before + 1
    for _ in range(10):
        assert not rig.tick().any()
    assert rig.ask([0.7] + [0.1] * 5, number=30).clipped and rig.guard.clipped == 1
    rig.now += 1.1
    assert rig.ask([0.1] * 6, who="b", number=1).accepted, "free again after a second"


def test_a_position_is_reached_and_ends_with_its_keeper():
    """Reach a goal within 0.01 rad while it is kept, and stand still soon after nobody keeps it."""
    goal, rig = ARM.home + np.array([0.3, -0.2, 0.2, 0.4, 0.0, -0.4]), Rig()
    move = Command("a", "position", goal)
    assert rig.guard.command(rig.now, move).accepted
    for _ in range(240):
        assert rig.guard.keep(rig.now, move)
        rig.tick()
    assert rig.guard.arrived and np.abs(rig.q - goal).max() < 0.01
    back = Command("a", "position", ARM.home)
    rig.guard.command(rig.now, back)
    for _ in range(9):
        rig.tick()
    assert not rig.velocity.any() and not rig.guard.keep(rig.now, move) and rig.guard.keep(rig.now, back)


def test_outside_of_a_limit_only_the_way_back_is_open():
    """Begin beyond a joint's limit and below the table: refuse to go further, allow to come back."""
    start = ARM.home.copy()
    start[1] = LIMITS.upper[1] + 0.05
    rig = Rig(start=start)
    rig.ask([0, 0.3, 0, 0, 0, 0])
    assert not rig.tick().any()
    rig.ask([0, -0.3, 0, 0, 0, 0])
    assert rig.tick()[1] < 0.0
