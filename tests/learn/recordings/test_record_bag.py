"""A bag that is written tick by tick, and a Ctrl-C that comes in the middle of one."""

import os
import signal

import pytest

pytest.importorskip("rosbags", reason="bags need pip install 'bough[touch]'")

from bough.learn.recordings import record_bag
from bough.learn.recordings.bag import read_bag
from bough.learn.recordings.record_bag import record

PERIOD = 1 / 60


def _ticks(count):
    for k in range(count):
        told = {"tick": k, "time_s": k * PERIOD, "hand_pos": [0.1, 0.2, 0.3], "hand_rot": [0.0, 0.0, 0.0, 1.0]}
        yield told | {f"robot_dof_{name}": [0.01 * k] * 6 for name in ("pos", "vel", "torque")}, 10**18 + k


@pytest.mark.parametrize("step", [0, 1, 2, 3])
def test_ctrl_c_inside_a_tick_ends_after_it(tmp_path, monkeypatch, step):
    """Press Ctrl-C before, between and after the two messages of the eighth tick: it is whole, and counted."""

    class Pressed(record_bag.BagRecorder):
        def _press(self, at):
            if at == step and self.ticks == 7:
                os.kill(os.getpid(), signal.SIGINT)

        def add(self, tick, received):
            super().add(tick, received)
            if self.ticks == 8 and step == 3:
                os.kill(os.getpid(), signal.SIGINT)

        def _messages(self, tick, stamp):
            for k, message in enumerate(super()._messages(tick, stamp)):
                self._press(k)
                yield message
            self._press(2)

    monkeypatch.setattr(record_bag, "BagRecorder", Pressed)
    before = signal.getsignal(signal.SIGINT)
    told = record("", _ticks(20), tmp_path / "bag", None, lambda _: None)
    assert signal.getsignal(signal.SIGINT) is before
    assert (told.ticks, told.missed, told.cut_off) == (8, 0, False)
    assert told.seconds == pytest.approx(7 * PERIOD)
    streams = read_bag(tmp_path / "bag").streams
    assert [len(streams[topic].arrays()[0]) for topic in (record_bag.JOINTS, record_bag.HAND)] == [8, 8]
