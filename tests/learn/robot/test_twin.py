"""The twin: real time, torques as a driver tells them, branches that push back, hidden effects."""

import numpy as np
import pytest
from bough.learn.robot.twin import Twin
from bough.sim.arms.arm import arm_capsules
from bough.sim.arms.jaco2 import jaco2
from bough.sim.cameras.described import unpacked
from bough.sim.cameras.label import Label

ARM = jaco2()


def drive(twin, velocity, seconds, start):
    """Send speeds for some time, in ticks of a sixtieth; return the samples."""
    twin.read(start)
    out = []
    for n in range(1, int(seconds * 60) + 1):
        twin.send(np.asarray(velocity, float))
        out.append(twin.read(start + n / 60))
    return out


@pytest.fixture(scope="module")
def alone():
    return Twin(ARM, away=10.0)


def test_time_is_the_caller_s_and_never_hurries(alone):
    """Turn a joint by speed times time; after a gap of two seconds make up for a tenth of a second at most."""
    before = alone.read(50.0).q
    seen = drive(alone, [0.2, 0, 0, 0, 0, 0], 1.0, 50.0)
    assert seen[-1].q[0] - before[0] == pytest.approx(0.2, abs=0.005)
    assert seen[-1].time == pytest.approx(51.0)
    late = alone.read(53.0)
    assert 0.0 < late.q[0] - seen[-1].q[0] < 0.2 * 0.11


def test_torques_are_told_without_the_arm_s_weight(alone):
    """Tell next to nothing at rest, where the servos carry several newton metres."""
    still = drive(alone, np.zeros(6), 0.5, 100.0)[-1]
    assert np.abs(still.torque).max() < 1e-3 and np.abs(still.qd).max() < 1e-3
    assert float(alone.simulator.torque.abs().max()) > 2.0


def test_branches_push_back():
    """Drive the arm through its tree: joint torques appear that it does not need in the air."""
    near, far = Twin(ARM, seed=3), Twin(ARM, seed=3, away=10.0)
    way = [0.4, 0.3, 0.2, 0, 0, 0]
    push, free = (np.array([s.torque for s in drive(t, way, 2.0, 0.0)]) for t in (near, far))
    assert np.abs(push).max() > np.abs(free).max() + 1.0


def test_a_hidden_effect_acts():
    """Hang a mass on every tip and kick the tree: it takes longer to its turning point than without."""
    turning = []
    for effects in (None, {"tip_mass": {"mass_kg": 0.2}}):
        simulator = Twin(ARM, seed=3, away=10.0, effects=effects).simulator
        start = simulator.observe()[0][0].clone()
        simulator.state.set_qvel([np.full(tree.num_dofs, 0.5) for tree in simulator.model.trees])
        way = []
        for _ in range(240):
            simulator.step()
            way.append(float((simulator.observe()[0][0] - start).norm()))
        turning.append(int(np.argmax(way)))
    assert 5 < turning[0] < 0.8 * turning[1] < 190, turning


def test_cameras_are_told_where_the_arm_is_now(alone):
    """Turn a joint for half a second: the capsules that cameras are told are those at the measured joints."""
    q = drive(alone, [0.4, 0, 0, 0.3, 0, 0], 0.5, 200.0)[-1].q
    world = unpacked(alone.scene()).world
    seen = world.solids.start[world.label == Label.ROBOT]
    start, _ = arm_capsules(ARM, q)
    assert np.abs(seen - start).max() < 1e-4 < np.abs(start - arm_capsules(ARM, ARM.home)[0]).max()
