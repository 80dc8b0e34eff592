"""``bough import-case`` from the outside: bags of an arm that moves a branch, with a known force and known clocks."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from oracles import json_page

pytest.importorskip("rosbags", reason="bags need pip install 'bough[touch]'")

from bough.learn.cases.case import load_case
from oracles.probed_bag import SPRING, Bag, Probed, probe, probe_hold

SHAPE = ("--length", "1.2", "--diameter", "24mm", "--rises", "60")
HELD = (*SHAPE, "--at", "0.9")


@pytest.fixture(scope="module")
def probed() -> Probed:
    return probe()


@pytest.fixture(autouse=True)
def _in_a_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def check(case, p: Probed, *, start: float = 0.0, force: float, motion: float) -> None:
    """Compare a case with the truth from a time on; tolerances in N and m."""
    run = case.trajectories[0]
    true = np.stack([np.interp(run.t + start, p.t, c) for c in p.hand.T], axis=-1)
    np.testing.assert_allclose(run.displacement, true - true[0], atol=motion)
    np.testing.assert_allclose(run.force, np.stack([np.interp(run.t + start, p.t, c) for c in p.force.T], axis=-1),
                               atol=force)  # fmt: skip


@pytest.mark.parametrize("name", ["probe.bag", "probe.mcap", "probe.db3"])
def test_joint_torques_less_gravity(inside, probed, name):
    """Find the force by J^T and the motion by the joints, in ROS 1, MCAP and SQLite; MuJoCo knows both."""
    bag = Bag(Path(name).absolute())
    bag.joints(probed)
    done = inside("import-case", bag.write(), *HELD, "--out", "case", "--json")
    assert done.code == 0, done.err
    json_page.check("import-case", json.loads(done.out))
    assert "less what holds jaco2_curved against gravity" in done.out and "a grid of 60 Hz" in done.out
    # gravity and Jacobian agree with MuJoCo to 1e-6; the force is up to 20 N
    check(load_case("case"), probed, force=1e-4, motion=1e-6)
    assert "by J^T" in Path("case/assumptions.txt").read_text()


@pytest.mark.parametrize(("ahead", "late"), [(0.37, 0.0), (-1.62, 0.05), (3600.25, 0.02)])
def test_a_camera_with_another_clock(bough, inside, probed, ahead, late):
    """Find by how much a tag's clock is ahead, from how it moves like the hand; by arrival first where that is far."""
    bag = Bag(Path("probe.mcap").absolute())
    bag.joints(probed)
    bag.tag(probed, ahead=ahead, late=late)
    run = bough if ahead == 0.37 else inside  # once as a process of its own
    done = run("import-case", bag.write(), *HELD, "--out", "case")
    assert done.code == 0, done.err
    found = [float(x) for x in re.findall(r"clock: (?:\S+ is )?(\S+) s (?:are taken|ahead by)", done.out)]
    # lines between samples of 30 Hz, a parabola through three lags of 1/60 s
    assert sum(found) == pytest.approx(ahead, abs=2e-3)
    speed = np.abs(np.gradient(probed.hand, probed.t, axis=0)).max()
    check(load_case("case"), probed, force=SPRING.max() * speed * 3e-3, motion=2e-3 * speed + 2e-4)


def test_clocks_that_agree_are_left_alone(inside, probed):
    """Move no clock where the signals are alike as they are."""
    bag = Bag(Path("probe.mcap").absolute())
    bag.joints(probed)
    bag.tag(probed, ahead=0.0)
    done = inside("import-case", bag.write(), *HELD, "--out", "case")
    assert done.code == 0 and "taken to be on one clock" in done.out, done.err
    check(load_case("case"), probed, force=0.02, motion=2e-4)


@pytest.mark.parametrize("frame", ["world", "j2n6s300_link_6"])
def test_a_wrist_sensor(inside, probed, frame):
    """Turn a wrench from the hand's axes to the world's, and its sign to that of the hand on the branch."""
    bag = Bag(Path("probe.bag").absolute())
    bag.joints(probed, efforts=False)
    bag.wrench(probed, frame=frame)
    done = inside("import-case", bag.write(), *HELD, "--during", "0.5:4", "--force-zero", "0", "--out", "case")
    assert done.code == 0, done.err
    assert "reads the force on the hand, against the motion; turned" in done.out
    # the nearest joint state is half a step of 1/60 s away: 15 N turned by 0.1 rad/s
    run = load_case("case").trajectories[0]
    true = np.stack([np.interp(run.t + 0.5, probed.t, c) for c in probed.force.T], axis=-1)
    np.testing.assert_allclose(run.force, true, atol=0.05)
    assert run.t[-1] == pytest.approx(3.5, abs=0.021)


def test_two_bags_with_an_offset_of_the_sensor(inside, probed):
    """Take the mean before contact from a biased sensor, in each of two bags; leave the clock as it is said to be."""
    away = np.array([2.0, -1.0, 3.0])
    files = []
    for k in (1, 2):
        bag = Bag(Path(f"pull_{k}.bag").absolute())
        bag.joints(probed, efforts=False)
        biased = Probed(probed.t, probed.q, probed.hand, probed.turn, probed.force + k * away, probed.effort)
        bag.wrench(biased, frame="world")
        files.append(bag.write())
    done = inside("import-case", *files, *HELD, "--no-contact", "0:0.1", "--clock-offset", "0", "--flip", "force",
                  "--out", "case")  # fmt: skip
    assert done.code == 0 and "bag pull_2.bag:" in done.out and "its mean before contact" in done.out, done.err
    for run in load_case("case").trajectories:
        true = np.stack([np.interp(run.t, probed.t, c) for c in probed.force.T], axis=-1)
        # the mean of the first 0.1 s, in which the spring is pulled a little already
        np.testing.assert_allclose(run.force, true, atol=np.abs(true[run.t <= 0.1]).max() + 0.01)
        assert run.no_contact.sum() == 6  # 0, 0.02, ..., 0.1 s


def test_a_scale_on_a_rope_and_a_tag_of_tf(inside, probed):
    """Take kilograms along the motion, a tag through a camera that stands still, and the grasp by the branch's base."""
    along = probed.hand[np.argmax(np.linalg.norm(probed.hand - probed.hand[0], axis=1))] - probed.hand[0]
    along /= np.linalg.norm(along)
    bag = Bag(Path("probe.mcap").absolute())
    bag.frames(probed)
    bag.scale(probed, along)
    base = probed.hand[0] - 0.7 * np.array([np.cos(np.radians(60)), 0.0, np.sin(np.radians(60))])
    done = inside("import-case", bag.write(), *SHAPE, "--base", *base, "--frame", "tag_7", "--scale-unit", "kg",
                  "--direction", *along, "--out", "case")  # fmt: skip
    assert done.code == 0, done.err
    case = load_case("case")
    assert case.grasp_distance == pytest.approx(0.7, abs=1e-6)
    run = case.trajectories[0]
    true = np.interp(run.t, probed.t, probed.force @ along)
    np.testing.assert_allclose(run.force, true[:, None] * along, atol=0.05)  # lines between readings of 20 Hz


def test_torques_that_a_driver_has_taken_gravity_out_of(inside, probed):
    """Tell by the torques that gravity is out of them; warn where the other is said, or the sign is wrong."""
    force = probed.force
    bare = probed.effort - probe_hold(probed)
    for name, effort, flags, warned in (
        ("out", bare, (), False), ("said", bare, ("--gravity", "in"), True), ("sign", -probed.effort, (), True),
    ):  # fmt: skip
        bag = Bag(Path(f"{name}.mcap").absolute())
        bag.joints(Probed(probed.t, probed.q, probed.hand, probed.turn, force, effort))
        done = inside("import-case", bag.write(), *HELD, *flags, "--out", name)
        assert ("N where the branch is at rest" in done.err) == warned, done.err
    check(load_case("out"), probed, force=1e-4, motion=1e-6)
    assert "without the arm's weight" in Path("out/assumptions.txt").read_text()


def broken(bag: Bag, p: Probed, what: str) -> tuple[str, ...]:
    """Write into a bag what cannot be imported; return the flags."""
    if what == "efforts":
        bag.joints(p, efforts=False)
    elif what == "topics":
        bag.joints(p)
        bag.joints(p, topic="/other")
    elif what == "motion":
        bag.scale(p, np.array([0.0, 0.0, 1.0]))
    elif what == "gap":
        bag.joints(Probed(*(np.concatenate([x[:100], x[200:]]) for x in vars(p).values())))
    else:
        bag.joints(p)
    return {"frame": ("--frame", "tag"), "arm": ("--arm", "crane"), "during": ("--during", "9:10")}.get(what, ())


@pytest.mark.parametrize(
    ("what", "words"),
    [
        ("efforts", ("probe", "360 of 360 joint states", "without efforts", "--wrench")),
        ("topics", ("--joints", "2 topics", "/other")),
        ("motion", ("no motion", "JointState")),
        ("gap", ("--during", "without a message", "--during 0:1.6")),
        ("frame", ("--frame", "no frame 'tag'")),
        ("arm", ("--arm", "crane", "jaco2")),
        ("during", ("--during", "0 messages")),
        ("shape", ("--length", "no length of the branch")),
    ],
)
def test_what_a_bag_lacks_is_one_line(inside, probed, what, words):
    """Refuse a bag without efforts, with several topics, without motion, with a gap; write nothing."""
    bag = Bag(Path("probe.mcap").absolute())
    flags = broken(bag, probed, what)
    shape = () if what == "shape" else HELD
    inside("import-case", bag.write(), *shape, *flags, "--out", "case").refused(*words)
    assert not Path("case").exists()


def test_a_file_that_is_no_bag(inside):
    """Refuse a text, an empty bag and a bag without anything of use."""
    Path("no.bag").write_text("no bag")
    inside("import-case", "no.bag", *HELD, "--out", "case").refused("no.bag", "no bag that can be read")
    bag = Bag(Path("talk.bag").absolute())
    for k in range(20):
        bag.add(0.1 * k, "/talk", "std_msgs/msg/String", bag.type("std_msgs/msg/String")("hello"))
    inside("import-case", bag.write(), *HELD, "--out", "case").refused("talk.bag", "no force", "WrenchStamped")
