"""A robot behind rosbridge, against a scripted peer: topics, units, order of joints, and what happens when it fails."""

import time

import numpy as np
import pytest

pytest.importorskip("roslibpy", reason="rosbridge needs the extra robot")

from bough.learn.robot import rosbridge
from bough.learn.robot.guard import Guard
from bough.learn.robot.limits import default_limits
from bough.learn.robot.log import joint_columns, read_log
from bough.learn.robot.rosbridge import RosBridge, StateReader
from bough.learn.robot.service import Service
from bough.learn.robot.workspace import Workspace
from bough.sim.arms.jaco2 import jaco2
from bough.sim.base.errors import InputError
from oracles.robot.peer import Peer

ARM = jaco2()
LIMITS = default_limits(ARM)
KINOVA = [f"j2n6s300_joint_{k}" for k in range(1, 7)] + [f"j2n6s300_joint_finger_{k}" for k in (1, 2, 3)]


def wait(true, seconds=10.0):
    """Wait until something is so."""
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end
        time.sleep(0.01)


def guard():
    return Guard(LIMITS, Workspace(ARM, LIMITS.workspace_low - 9.0, LIMITS.workspace_high + 9.0).clearance, False)


def test_kinova_s_driver_moves_and_stops_with_its_measurements(tmp_path):
    """Start stopped; send degrees a second; stop when states stay out or repeat; stay stopped when they come again."""
    peer = Peer(KINOVA, lambda m: [np.radians(m[f"joint{k}"]) for k in range(1, 7)])
    backend = RosBridge(ARM, "127.0.0.1", peer.port, "kinova")
    service = Service(backend, guard(), tmp_path)
    service.start()
    try:
        wait(lambda: service.latest and np.isfinite(service.latest.q).all() and not service.guard.danger)
        assert peer.subscribed == {"/j2n6s300_driver/out/joint_state": "sensor_msgs/JointState"}
        assert peer.advertised == {"/j2n6s300_driver/in/joint_velocity": "kinova_msgs/JointVelocity"}
        assert service.latest.q == pytest.approx(peer.q) and service.latest.torque == pytest.approx(0.1 * np.arange(6))
        ask = [0.2, 0.0, 0.0, -0.4, 0.0, 0.0]
        assert service.command("a", "velocity", np.array(ask))[0].reason == "stopped"
        for number, fail in enumerate(("talks", "freezes"), start=1):
            assert service.arm(number).accepted
            before = len(peer.published)
            for _ in range(20):
                assert service.command("a", "velocity", np.array(ask))[0].accepted
                time.sleep(1 / 60)
            moving = [m for *_, m in peer.published[before:] if m["joint1"]]  # a busy machine may be late for the last
            assert moving[-1]["joint1"] == pytest.approx(np.degrees(0.2))
            assert moving[-1]["joint4"] == pytest.approx(np.degrees(-0.4))
            setattr(peer, fail, fail == "freezes")
            wait(lambda: service.guard.stop)
            assert "no measurement for 0.2" in service.guard.stop.cause
            wait(lambda: not any(peer.published[-1][2].values()))
            setattr(peer, fail, fail == "talks")
            wait(lambda: not service.guard.danger)
            assert service.guard.stop.number == number + 1
    finally:
        service.close()
        peer.close()
    sent = joint_columns(read_log(tmp_path), "dq_cmd{}_rad_s")
    assert sent.max() == pytest.approx(0.2) and sent.min() == pytest.approx(-0.4) and not sent[-1].any()


def test_nothing_old_is_sent_after_a_lost_connection(tmp_path):
    """Cut the connection in a motion: stop; once it is back, only zeros are published, until it is re-armed."""

    def speeds(message):
        return message["data"]

    names = [f"joint_{k}" for k in (6, 5, 4, 3, 2, 1)]
    peer = Peer(names, speeds)
    backend = RosBridge(ARM, "127.0.0.1", peer.port, "ros2_control", joints=names[::-1])
    service = Service(backend, guard(), tmp_path)
    service.start()
    try:
        wait(lambda: service.latest and np.isfinite(service.latest.q).all() and not service.guard.danger)
        assert peer.advertised == {"/forward_velocity_controller/commands": "std_msgs/msg/Float64MultiArray"}
        assert service.latest.q == pytest.approx(peer.q[::-1]), "by name, not by place"
        assert service.arm(1).accepted
        for _ in range(20):
            service.command("a", "velocity", np.full(6, 0.1))
            time.sleep(1 / 60)
        assert peer.published[-1][2]["data"] == pytest.approx([0.1] * 6)
        peer.close()
        wait(lambda: service.guard.stop)
        assert "lost" in service.guard.stop.cause or "cannot be asked" in service.guard.stop.cause
        time.sleep(0.3)
        again = Peer(names, speeds, peer.port)
        wait(lambda: len(again.published) > 20, 20.0)
        assert not np.any([m[2]["data"] for m in again.published])
        assert service.guard.stop is not None
        again.close()
    finally:
        service.close()


def test_states_that_cannot_be_read():
    """Say what is wrong with states without efforts, with null or too few joints; keep the last good one."""
    reader = StateReader(ARM, ())
    good = {"header": {"stamp": 1}, "name": KINOVA, **{k: [0.5] * 9 for k in ("position", "velocity", "effort")}}
    reader.take(good, 1.0)
    assert reader.sample.time == 1.0 and not reader.fault
    spoilt = ({"effort": []}, {"position": [None] * 9}, {"name": KINOVA[:5]}, {"name": 7}, {"velocity": "fast"})
    for n, wrong in enumerate(spoilt):
        reader.take(good | {"header": {"stamp": 2 + n}} | wrong, 2.0)
        assert "cannot be read" in reader.fault and reader.sample.time == 1.0
    reader.take({}, 2.0)
    assert "cannot be read" in reader.fault
    reader.take(good | {"header": {"stamp": 9}}, 3.0)
    assert reader.sample.time == 3.0 and not reader.fault


def test_nobody_answers(monkeypatch):
    """Say where nobody answers, when patience has ended."""
    monkeypatch.setattr(rosbridge, "_PATIENCE", 0.5)
    with pytest.raises(InputError, match="nobody answers"):
        RosBridge(ARM, "127.0.0.1", 9, "kinova")
