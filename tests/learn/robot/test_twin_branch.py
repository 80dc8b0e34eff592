"""The twin that grasps a branch: what moves what, what its joints carry, what a gripper may be asked for."""

import numpy as np
import pytest
from bough.learn.hidden.branch import random_branch
from bough.learn.hidden.drive import Live, drive
from bough.learn.hidden.parts import Part
from bough.learn.probing.hand import joints_at
from bough.learn.robot.client import RefusedError
from bough.learn.robot.limits import default_limits
from bough.learn.robot.stepped import SteppedRobot
from bough.learn.robot.twin_branch import GRASP, BranchTwin, Hiding, read_hidings
from bough.sim.arms.jaco2 import jaco2
from bough.sim.arms.statics import statics
from bough.sim.base.errors import InputError

ARM = jaco2()


def robot_of(**options):
    twin = BranchTwin(ARM, seed=4, segments=2, **options)
    return twin, SteppedRobot(twin, default_limits(ARM))


def test_a_branch_that_is_stepped_moves_as_one_that_is_driven():
    """Take the same way step by step as MuJoCo's own rollout of the plan, to rounding; a tip mass in both."""
    branch = random_branch(np.random.default_rng(1), 2)
    force = np.array([0.0, 1.0, -2.0])
    for parts in ([], [Part({}, tip_mass=0.05)]):
        live = Live(branch, parts)
        for _ in range(501):  # readings are those of a step's start
            live.advance(force)
        planned = drive(branch, np.tile(force, (1, 6, 1)), 10.0, parts=parts, dt=1e-3)
        assert live.moved == pytest.approx(planned.moved[0, 5], abs=1e-9)
        assert live.velocity == pytest.approx(planned.velocity[0, 5], abs=1e-9)


def test_a_held_branch_goes_with_the_hand_and_pulls_on_the_joints():
    """Hold, move: the tag follows but for what rubber gives; the joints carry J' f; opened, it swings and rests."""
    _, robot = robot_of(noise=0.0)
    rest = robot.latest.tag
    assert rest == pytest.approx(GRASP, abs=1e-9)
    robot.move_to(joints_at(ARM, rest, robot.latest.q), within=0.003)
    robot.grip(1.0)
    begin = robot.latest
    up = statics(ARM, begin.q)[1]
    for n, state in enumerate(robot.paced()):
        robot.send(np.linalg.pinv(up) @ [0.0, 0.0, 0.05], state)
        if n == 60:
            break
    held = robot.halt()
    for _ in range(120):
        held = robot.next()
    moved, force = held.tag - begin.tag, np.linalg.norm(held.force)
    assert moved[2] > 0.025 and 0.5 < force < 60.0
    # fingers of 1500 N/m give f / k; the branch is at rest
    stretched = held.hand_position - begin.hand_position - moved
    assert np.linalg.norm(stretched) == pytest.approx(force / 1500.0, abs=2e-4)
    assert held.torque == pytest.approx(statics(ARM, held.q)[1].T @ held.force, abs=1e-9)
    robot.grip(0.0)
    ways = [robot.next() for _ in range(900)]
    assert not ways[-1].force.any() and ways[-1].gripper == pytest.approx(0.0)
    assert np.ptp([w.tag[2] for w in ways[:60]]) > 0.003
    assert ways[-1].tag == pytest.approx(rest, abs=1e-3)


def test_a_gripper_obeys_the_same_rules():
    """Refuse what is no share, another number of them, a gripper that there is not, and all while a stop holds."""
    _, robot = robot_of()
    for values, reason in ([2.0], "outside"), ([np.nan], "not finite"), ([0.1, 0.2], "malformed"):
        from bough.learn.robot.guard import Command

        reply = robot.guard.command(1.0, Command("stepped", "gripper", np.array(values)))
        assert (reply.accepted, reply.reason) == (False, reason) and robot.guard.refused[reason]
    accepted = robot.guard.accepted
    robot.ask_gripper(0.5)
    assert robot.guard.accepted == accepted + 1 and robot.guard.grip == 0.5
    other = robot.guard.command(robot.latest.time, Command("someone else", "gripper", np.array([1.0])))
    assert other.reason == "held"
    robot.guard.halt(robot.latest.time, "a test")
    assert robot.guard.command(robot.latest.time, Command("stepped", "gripper", np.array([1.0]))).reason == "stopped"
    assert robot.guard.grip == 0.5, "a stop leaves the fingers as they are"
    robot.guard.grips = False
    robot.guard.arm(robot.guard.stop.number)
    assert "no gripper" in robot.guard.command(9.0, Command("stepped", "gripper", np.array([1.0]))).text


def test_a_gripper_beside_a_motion_keeps_its_lease():
    """Keep a motion's lease when the gripper is asked for in between."""
    _, robot = robot_of()
    robot.send(np.array([0.1, 0, 0, 0, 0, 0]))
    robot.ask_gripper(1.0)
    robot.next()
    assert robot.guard.velocity[0] > 0.0 and robot.guard.running.kind == "velocity"


def test_an_arm_without_a_gripper_says_so():
    """Refuse at the client where states have no gripper."""
    _, robot = robot_of()
    robot.latest.__dict__["gripper"] = np.nan
    with pytest.raises(RefusedError, match="no gripper"):
        robot.grip(1.0)


@pytest.mark.parametrize(
    ("word", "words"),
    [
        ("time_delay", ("time_delay", "dry_friction")),
        ("dry_friction:joint=2", ("joint=2", "0 to 1")),
        ("dry_friction:size=3", ("size=3", "0.01 to 1")),
        ("dry_friction:torque_Nm=1", ("torque_Nm=1", "joint=J")),
    ],
)
def test_effects_that_cannot_be(word, words):
    """Name what cannot be hidden, and what can."""
    with pytest.raises(InputError) as error:
        read_hidings([word], 2)
    assert all(w in str(error.value) for w in words)


def test_effects_are_as_large_as_asked():
    """Hide drag of a fifth of the motion, to the tolerance of the search for its strength."""
    twin = BranchTwin(ARM, seed=4, segments=2, hidings=[Hiding("quadratic_drag", None, 0.2)])
    assert twin.hidden[0].name == "quadratic_drag" and twin.hidden[0].size == pytest.approx(0.2, rel=0.3)
    assert read_hidings(["backlash:joint=1,size=0.1"], 2) == [Hiding("backlash", 1, 0.1)]
