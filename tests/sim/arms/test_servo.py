"""Servos that a diagnosis found: late, with weight that they do not carry; the file that says so, what it refuses."""

from dataclasses import replace

import numpy as np
import pytest
from bough.sim.arms.jaco2 import jaco2
from bough.sim.arms.servo import FORMAT, NUMBERS, read_arm_file, with_servo
from bough.sim.arms.statics import statics
from bough.sim.base.errors import InputError
from oracles.contact_case import DT, post, simulator

FAR = post((50.0, 0.0, 1.0))
LINKS = tuple(jaco2().tree.link_name)
ROW = "{name: %s, gain_Nmsprad: 60, friction_Nm: 2, damping_Nmsprad: 0.5, weight_error: 0.1, delay_s: 0.05}"


def written(path, *, arm="jaco2", names=LINKS, more="", fmt=FORMAT):
    """Write a model.yaml and return its path."""
    rows = "\n".join(f"  - {ROW % name}" for name in names)
    path.write_text(f"format: {fmt}\nname: test\narm: {arm}\njoints:\n{rows}\n{more}")
    return path


def test_late_servos_do_the_same_later():
    """Targets are obeyed as many steps later as the delay holds: to the bit the motion of one that is in time.

    Joint positions of a step k are those of an arm in time at step k - 12, since that arm rests until its first target.
    """
    arm = jaco2()

    def path(own, start):
        sim, out = simulator(FAR, own), []
        for k in range(120):
            sim.target.fill_(0.3 * np.sin(4.0 * max(0, k - start) * DT))
            sim.step()
            out.append(sim.q[0].numpy().copy())
        return np.array(out)

    late = path(replace(arm, delay=np.full(6, 12 * DT)), 0)
    np.testing.assert_array_equal(late, path(arm, 12))


def test_weight_that_is_not_carried_lets_the_arm_sink():
    """A servo asked for rest sinks at e g / D until the pose changes: g is `statics`', which MuJoCo confirms.

    After 0.1 s (the servo's own time is inertia / D < 10 ms) the arm has turned by less than 0.01 rad.
    """
    arm, error = jaco2(), np.array([0.0, 0.3, -0.2, 0.0, 0.0, 0.0])
    arm = replace(arm, weight_error=error, friction=np.zeros(6))
    sim = simulator(FAR, arm)
    for _ in range(24):
        sim.step()
    weight = statics(arm, sim.q[0].numpy().astype(float))[0]
    np.testing.assert_allclose(sim.qd[0].numpy(), -error * weight / arm.gain, atol=2e-4)
    np.testing.assert_allclose(sim.torque[0].numpy(), weight, atol=0.02)  # at rest or slow, it holds itself


def test_a_file_gives_an_arm_its_servos(tmp_path):
    """Every number of the file is the arm's, and nothing else of it changes."""
    arm = jaco2()
    file = read_arm_file(written(tmp_path / "model.yaml"), arm, "jaco2")
    got = with_servo(arm, file.servo)
    for name, value in zip(("gain", "friction", "weight_error", "delay"), (60, 2, 0.1, 0.05), strict=True):
        np.testing.assert_array_equal(getattr(got, name), np.full(6, value))
    np.testing.assert_array_equal(got.tree.damping, np.full(6, 0.5))
    np.testing.assert_array_equal(got.torque_limit, arm.torque_limit)
    assert with_servo(arm, ()) is arm and len(NUMBERS) == len(file.servo[0])


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"arm": "ur5"}, ("ur5", "jaco2")),
        ({"fmt": "branch-model/1"}, ("branch-model/1", FORMAT)),
        ({"names": ("shoulder", "arm")}, ("2 joints", "6")),
        ({"names": ("arm", "shoulder", "forearm", "wrist_1", "wrist_2", "hand")}, ("arm", "base first")),
        ({"more": "mass: 2\n"}, ("mass",)),
    ],
)
def test_what_a_file_cannot_be(tmp_path, change, words):
    """Refuse another arm's, a branch's, one with joints too few or in another order, and keys that are not known."""
    with pytest.raises(InputError) as found:
        read_arm_file(written(tmp_path / "model.yaml", **change), jaco2(), "jaco2")
    assert all(word in str(found.value) for word in words)


def test_what_servos_cannot_be():
    """Refuse rows that are not one for each joint, and delays and shares that cannot be."""
    arm = jaco2()
    for change in ({"delay": np.full(6, -0.1)}, {"weight_error": np.full(6, 1.5)}):
        with pytest.raises(InputError):
            replace(arm, **change)
    with pytest.raises(InputError, match="one for each joint"):
        with_servo(arm, ((80.0, 0.0, 0.0, 0.0, 0.0),))
