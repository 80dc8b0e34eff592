"""The laws of control on a joint whose servo is not the model's: friction, gain and gravity compensation differ."""

import numpy as np
import pytest
import warp as wp
from bough.kernels.tasks.control import LAWS, drive
from bough.kernels.tasks.parts import Clock
from bough.sim.arms.jaco2 import jaco2
from bough.sim.arms.servo import read_arm_file

N, RATE, STEP, SECONDS = 6, 60, 0.4, 8.0  # slices a policy step, slices a second, rad/s a whole action
INERTIA, MODEL = 0.3, (80.0, 0.0, 0.0)  # kg m^2; gain [N m s/rad], dry friction and weight not carried [N m]
REAL = (50.0, 3.0, 4.0)


def joint(law, policy, servo, blocked=(), late=0):
    """Return position, speed, both as wanted, and the push at every policy step of a joint that servo and law drive.

    J v' = D (v* - v) - F sign(v) - G, in exact steps of 1/2400 s with friction that can hold; ``policy`` is a function
    of step, position, speed. In the steps ``blocked`` something firm holds the joint; the last column is the push.
    The servo obeys ``late`` slices later.
    """
    gain, friction, weight = servo
    clock, target, waiting, speed = Clock(), array(1, 1), array(2, 1, 1), array(1, 1)
    clock.clock, clock.action_delay = array(1, dtype=int), array(1, dtype=int)
    limit = wp.array([0.63], dtype=wp.float32, device="cpu")
    q, v, rows, h = 0.0, 0.0, [], 1.0 / (40 * RATE)
    waiting_targets = [0.0] * late
    for step in range(int(SECONDS * RATE / N)):
        wanted = reference(step)
        action = wp.array([[policy(step, q, v) / STEP]], dtype=wp.float32, device="cpu")
        for period in range(N):
            speed.fill_(v)
            wp.launch(drive, dim=1, inputs=[action, limit, speed, LAWS.index(law), period, N, STEP, clock, waiting,
                                            target], device="cpu")  # fmt: skip
            waiting_targets.append(float(target.numpy()[0, 0]))
            asked = waiting_targets.pop(0)
            for _ in range(40):
                free = (INERTIA * v + h * (gain * asked - weight)) / (INERTIA + h * gain)
                hold = h * friction / (INERTIA + h * gain)
                v = 0.0 if step in blocked else np.sign(free) * max(abs(free) - hold, 0.0)
                q += h * v
        clock.clock.fill_(step + 1)
        rows.append((q, v, *wanted, gain * (asked - v)))
    return np.array(rows)


def array(*shape, dtype=wp.float32):
    return wp.zeros(shape, dtype=dtype, device="cpu")


def reference(step):
    """Position [rad] and speed [rad/s] wanted at the end of a policy step: 1 rad in 4 s, smoothly, then still."""
    t = min((step + 1) * N / RATE, 4.0)
    return 0.5 * (1 - np.cos(np.pi * t / 4.0)), (np.pi / 8.0 * np.sin(np.pi * t / 4.0) if t < 4.0 else 0.0)


def blind(step, _q, _v):
    """Play the changes of speed that are right where the servo follows at once."""
    return reference(step)[1] - (reference(step - 1)[1] if step else 0.0)


def seeing(step, q, v):
    """Ask for the wanted speed and half of the error of position a policy step, from where the joint is."""
    wanted = reference(step)
    return wanted[1] + 5.0 * (wanted[0] - q - v * N / RATE) - v


def errors(law, policy, servo, late=0):
    """Return the mean error of position over the last two seconds, and by how much it changes in them [rad]."""
    rows = joint(law, policy, servo, late=late)[-20:]
    off = rows[:, 0] - rows[:, 2]
    return abs(off).mean(), abs(off[-1] - off[0])


def test_a_joint_as_modelled_arrives_with_every_law():
    """Within a milliradian, at rest, where the policy sees the joint."""
    for law in ("nominal", "plai", "s3ec"):
        assert max(errors(law, seeing, MODEL)) < 1e-3


def test_steady_state_error_of_another_servo():
    """Nominal stands still: a sixth of the change, 0.4 / 6 x 50 = 3.3 N m, is less than friction and weight, 7 N m.

    S3EC builds up the whole change within a policy step, PLAI whatever it takes.
    """
    nominal, s3ec, plai = (errors(law, seeing, REAL)[0] for law in ("nominal", "s3ec", "plai"))
    assert nominal > 1.0 and plai < 1e-3 and 0.01 < s3ec < 0.06


def test_drift_of_another_servo():
    """The weight less friction, 1 N m, sinks a joint whose policy sees nothing.

    PLAI goes on to ask for rest and sinks at 1 / D rad/s; those that start from the measured speed sink at their limit.
    """
    nominal, s3ec, plai = (errors(law, blind, REAL)[1] for law in ("nominal", "s3ec", "plai"))
    assert plai == pytest.approx(1.0 / 50.0 * 19 * N / RATE, rel=0.02)
    assert nominal > 10 * plai and s3ec > 10 * plai


def test_only_plai_winds_up_against_what_blocks():
    """Held for two seconds, after the first step: S3EC pushes with one action's change at most, 0.4 x 50 N m.

    Nominal pushes with a sixth of it, PLAI with the speed limit, 0.63 x 50 N m.
    """
    push = {law: np.abs(joint(law, seeing, REAL, blocked=range(10, 30))[11:30, 4]).max()
            for law in ("nominal", "plai", "s3ec")}  # fmt: skip
    assert push["nominal"] == pytest.approx(20.0 / 6.0, rel=1e-5) and push["plai"] == pytest.approx(31.5, rel=1e-5)
    assert 10.0 < push["s3ec"] <= 20.0 + 1e-4


def test_the_servo_of_a_real_arm(tmp_path):
    """As a diagnosis writes it of a real Jaco 2's elbow: 4.6 N m of friction and 0.12 s, gain as modelled.

    PLAI winds up against the friction and hunts about the target, since its pushes come late; S3EC comes to rest. It is
    off by what cannot move the joint: an error e asks for 5 e at once, and 80 x 5 e = 4.6 N m at e = 0.0115 rad.
    """
    rows = "".join(f"  - {{name: {n}, gain_Nmsprad: 80, friction_Nm: 4.6, damping_Nmsprad: 0, weight_error: 0, "
                   "delay_s: 0.12}\n" for n in jaco2().tree.link_name)  # fmt: skip
    (tmp_path / "model.yaml").write_text(f"format: arm-model/1\nname: real\narm: jaco2\njoints:\n{rows}")
    gain, friction, _, error, delay = read_arm_file(tmp_path / "model.yaml", jaco2(), "jaco2").servo[2]
    servo, late = (gain, friction, error * 2.0), round(delay * RATE)
    found = {law: errors(law, seeing, servo, late) for law in ("nominal", "plai", "s3ec")}
    assert found["s3ec"][0] < 4.6 / (80 * 5) and found["s3ec"][1] < 1e-3
    assert found["plai"][0] > 3 * found["s3ec"][0] and found["plai"][1] > 0.02
