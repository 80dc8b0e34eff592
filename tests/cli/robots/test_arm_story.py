"""An arm's own gap from the outside: bags of free motions, a case, a verdict, servos that a policy is trained with."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml

pytest.importorskip("rosbags", reason="bags need pip install 'bough[touch]'")

from bough.learn.cases.arm import load_arm_case
from bough.learn.tasks.registry import known_tasks, plain, settings_from
from bough.sim.arms.jaco2 import jaco2
from bough.sim.arms.servo import read_arm_file
from oracles.probed_bag import Bag
from oracles.robot.hidden_arm import Hidden, recorded


class _States:
    """What `Bag.joints` writes of an arm's recording."""

    def __init__(self, t, q, effort):
        self.t, self.q, self.effort = t, q, effort


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    """Two recordings of an arm whose commands are 0.1 s late in every joint, as ROS 2 bags."""
    folder, rng, paths = tmp_path_factory.mktemp("bags"), np.random.default_rng(5), []
    for k in range(2):
        r = recorded(Hidden(delay=np.full(6, 0.1)), 12.0, rng)
        bag = Bag(folder / f"free_{k}.mcap")
        bag.joints(_States(r["time_s"], r["q"], r["tau"]))
        array = bag.type("std_msgs/msg/Float64MultiArray")
        layout = bag.type("std_msgs/msg/MultiArrayLayout")([], 0)
        for t, c in zip(r["time_s"], r["dq_cmd"], strict=True):  # holds until the next: the mean before that row
            bag.add(float(t) - 0.1, "/arm/velocity_controller", "std_msgs/msg/Float64MultiArray", array(layout, c))
        paths.append(bag.write())
    return paths


def test_bags_become_a_verdict_and_servos(bough, inside, bags, tmp_path):
    """Import as a user does, find the delay of all joints to a grid step of 5 ms, write it where train reads it."""
    done = bough("import-arm", *bags, "--out", "case")
    assert done.code == 0 and "2 recordings of 6 joints" in done.out and "weight: out" in done.out, done.err
    case = load_arm_case("case")
    assert case.dt == pytest.approx(0.1) and case.trajectories[0].command is not None
    done = inside("diagnose", "case", "--out", "found")
    assert done.code == 0 and "time_delay in the speed of joint 1 (0.1 s)" in done.out, done.err
    verdict = json.loads((tmp_path / "found/verdict.json").read_text())
    late = {e["joint"]: e["parameters"]["delay_s"]["median"] for e in verdict["effects"] if e["name"] == "time_delay"}
    assert verdict["verdict"] == "effects" and set(late) == set(range(6))
    assert all(abs(d - 0.1) <= 0.0051 for d in late.values())
    assert verdict["gap"]["speed"]["repaired"] < 0.2 * verdict["gap"]["speed"]["base"]
    assert "time_delay" in (tmp_path / "found/report.html").read_text()
    servo = read_arm_file("found/model.yaml", jaco2(), "jaco2").servo
    assert all(abs(row[4] - 0.1) <= 0.0051 for row in servo)


def test_what_import_arm_refuses(inside, bags, tmp_path):
    """One line, exit code 2, nothing written: no bag, another arm's joints, bags some of which lack commands."""
    inside("import-arm", "--out", "case").refused("BAG")
    inside("import-arm", "no.bag", "--out", "case").refused("no.bag")
    bag = Bag(tmp_path / "bare.mcap")
    t = np.arange(30) * 0.1
    bag.joints(_States(t, np.tile(jaco2().home, (30, 1)), np.ones((30, 6))))
    bare = bag.write()
    inside("import-arm", bags[0], bare, "--out", "case").refused("commanded speeds", "bare")
    assert not (tmp_path / "case").exists()


def test_what_other_commands_say_of_an_arm(inside, bags, tmp_path):
    """An arm's case is for diagnose alone; options of other cases and unknown names are refused."""
    assert inside("import-arm", *bags, "--out", "case").code == 0
    inside("identify", "case", "--out", "no").refused("arm", "bough diagnose")
    inside("diagnose", "case", "--fit", "torque", "--out", "no").refused("--fit")
    inside("diagnose", "case", "--effects", "steady_wind", "--out", "no").refused("steady_wind", "dry_friction")


def test_training_takes_an_arm_s_servos(inside, tmp_path):
    """Settings hold the file's servos, as a run keeps them; a branch's model is refused before anything is written."""
    rows = [{"name": n, "gain_Nmsprad": 80.0, "friction_Nm": 4.4, "damping_Nmsprad": 0.0, "weight_error": 0.0,
             "delay_s": 0.12, "backlash_rad": 0.01} for n in jaco2().tree.link_name]  # fmt: skip
    meta = {"format": "arm-model/1", "name": "real", "arm": "jaco2", "joints": rows}
    (tmp_path / "arm.yaml").write_text(yaml.safe_dump(meta))
    kind = known_tasks().of("reach")
    settings = kind.of_arm(kind.sized("cpu"), tmp_path / "arm.yaml")
    assert settings.servo == ((80.0, 4.4, 0.0, 0.0, 0.12),) * 6
    assert settings_from(type(settings), plain(settings), "run") == settings
    (tmp_path / "branch.yaml").write_text("format: branch-model/1\nname: x\n")
    inside("train", "reach", "--arm-model", "branch.yaml", "--out", "run").refused("branch-model/1", "arm-model/1")
    assert not (tmp_path / "run").exists()
