"""The client of the service in Python: against the service itself over real sockets, with its log as witness."""

import signal
import time

import numpy as np
import pytest

pytest.importorskip("fastapi", reason="the service needs the extra robot")
pytest.importorskip("uvicorn")

from bough.learn.robot.client import LostError, RefusedError, RobotClient, StoppedError
from bough.learn.robot.log import joint_columns
from bough.sim.base.errors import InputError
from oracles.robot.service import HOME, Served, keeps_limits, keeps_still


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """Serve a twin without a tree."""
    service = Served(tmp_path_factory.mktemp("robot"), "--away", "10")
    yield service
    service.end(signal.SIGINT)


def client(served):
    return RobotClient(f"http://127.0.0.1:{served.port}", served.token)


def test_it_steers_and_goes_where_it_is_told(served):
    """Turn a joint by speed times time at 60 Hz of the client's clock, then go back; leave the arm standing."""
    served.settled()
    with client(served) as robot:
        begin = robot.wait_free()
        assert begin.hand_rotation @ begin.hand_rotation == pytest.approx(1.0, abs=1e-6)
        for n, state in enumerate(robot.paced(60.0)):
            robot.send(np.array([0, 0, 0, 0, 0, 0.3]), state)
            if n == 60:
                break
        end = robot.halt()
        # 61 commands of 1/60 s, and ramps; the rest is how even a shared machine keeps 60 Hz
        assert end.q[5] - begin.q[5] == pytest.approx(0.3, abs=0.06) and robot.accepted > 60
        assert end.tick > begin.tick and robot.next(end).tick > end.tick
        there = robot.move_to(np.array(HOME), speed=0.6)
        assert there.q == pytest.approx(HOME, abs=0.012) and robot.clipped == 0
    log = served.log()
    keeps_limits(log)
    sent = joint_columns(log, "dq_cmd{}_rad_s")
    assert np.abs(sent).max() <= 0.6 + 1e-6 and not sent[-1].any()


def test_a_client_that_says_nothing_lets_the_arm_stand(served):
    """Stop sending in a motion, connection open: still within 150 ms. Nothing of the client says it again."""
    served.settled()
    with client(served) as robot:
        robot.wait_free()
        for n, state in enumerate(robot.paced()):
            robot.send(np.array([0.2, 0, 0, 0, 0, 0]), state)
            if n == 30:
                break
        time.sleep(0.6)
        keeps_still(served)
        with client(served) as other, pytest.raises(RefusedError, match="held"):
            other.wait_free(timeout=0.1)


def test_a_stop_is_told_and_armed_again(served):
    """Raise the stop's number and cause; re-arm it by its number; go on only with a new command."""
    served.settled()
    with client(served) as robot:
        robot.wait_free()
        number = robot.stop()
        with pytest.raises(StoppedError, match=f"stop {number}: asked for over HTTP"):
            robot.move_to(np.array(HOME) + 0.5)
        with pytest.raises(RefusedError, match=f"stop {number} holds"):
            robot.arm(number - 1)
        robot.arm()
        assert robot.status()["stop"] == 0 and robot.move_to(np.array(HOME), speed=0.6).stop == 0


def test_what_cannot_be_is_refused(served):
    """Say in one line that an address is none, that nobody answers, that a token is wrong."""
    for url, words in {"localhost:3738": "http://HOST:PORT", "http://h:x": "http://HOST:PORT",
                       "http://127.0.0.1:9": "nothing that answers",
                       f"http://127.0.0.1:{served.port}": "status 403",
                       f"http://robot:wrong@127.0.0.1:{served.port}": "status 403"}.items():  # fmt: skip
        with pytest.raises(InputError, match=words):
            RobotClient(url)
    with RobotClient(f"http://robot:{served.token}@127.0.0.1:{served.port}") as robot:
        assert served.token not in robot.url


def test_a_service_that_ends_is_told(tmp_path):
    """Kill the service in a motion: the next call says so."""
    service = Served(tmp_path, "--away", "10")
    with client(service) as robot:
        robot.wait_free()
        service.end(signal.SIGKILL)
        with pytest.raises(LostError, match="gone"):
            robot.move_to(np.array(HOME) + 0.5)
