"""A tracker that is late by many samples, beside a force and a gripper on one clock."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from bough.learn.cases.noise import estimate_noise
from bough.learn.replay.recording import recordings, timed_together
from bough.learn.replay.rollout import Rollout
from bough.learn.systems.acting import Acting
from bough.learn.systems.branch import Unknowns
from oracles.effect_case import DS, KS, stick, stick_case

DT = 0.04
FORCE = np.array([0.9, -0.5, 0.3])
#: Seconds of a pull: the force rises, is held, and falls to zero in the sample in which the gripper opens.
PULL, OPENED = [0.2, 0.6, 1.2, 1.24], [(0.0, 0.16), (1.24, 3.96)]


def pulled(late=0.0):
    """Return the force at the samples, read ``late`` samples late [N], shape [100, 3]."""
    t = DT * (np.arange(100) - late)
    return FORCE * np.interp(t, PULL, [0, 1, 1, 0])[:, None]


def let_go(folder, forces):
    """Return a branch that is pulled and let go, with these readings."""
    return stick_case(folder, forces, dt=DT, opened=OPENED)


@pytest.mark.parametrize("samples", [7, 20, 31])
def test_what_a_late_tracker_shows_happened_before(tmp_path, samples):
    """Show at each sample what a tracker in time shows ``samples`` earlier, the release too; at first nothing.

    A whole number of samples moves the same forces into the same steps: the last digits of single precision are left.
    """
    case = let_go(tmp_path / "c", [pulled()])
    wanted = stick(case)[0]
    out = stick(case, time_delay={"lag_s": -samples * DT})[0]
    np.testing.assert_allclose(out[samples:], wanted[:-samples], atol=1e-5 * np.abs(wanted).max())
    np.testing.assert_allclose(out[:samples], 0.0, atol=1e-7)


def test_worlds_of_one_group_are_late_by_their_own_time(tmp_path):
    """Give every set of parameters its own delay, from thirty samples one way to twelve the other, in one launch."""
    case = let_go(tmp_path / "c", [pulled()])
    late = DT * np.array([-30.0, 0.0, 2.3, 12.0, -0.4])
    unknowns = Unknowns(effects=(Acting("time_delay", None, {"slow_s": 0.0}),))
    rollout = Rollout(case, recordings(case), len(late), unknowns=unknowns)
    rollout._output.torch.fill_(torch.nan)
    out = rollout(torch.tensor([[KS, DS, x] for x in late], dtype=torch.float64))[:, 0].numpy()
    for run, x in zip(out, late, strict=True):
        alone = stick(case, time_delay={"lag_s": x})[0]
        np.testing.assert_allclose(run, alone, atol=1e-5 * np.abs(out).max())


@pytest.mark.parametrize(
    ("late", "offset", "together"),
    [(0.0, 0.0, True), (0.0, 0.3, True), (0.5, 0.0, False), (2.3, 0.0, False), (-0.7, 0.0, False)],
)
def test_the_clock_of_the_gripper_is_read_off_its_releases(tmp_path, late, offset, together):
    """Tell a force that falls as the gripper opens, whatever it reads of an open one, from one that falls otherwise."""
    noise = 0.01 * np.random.default_rng(0).normal(size=(2, 100, 3))
    case = let_go(tmp_path / "c", [pulled(late) + offset + n for n in noise])
    assert timed_together(case, estimate_noise(case)) is together
    assert all(r.together is together for r in recordings(case))


def test_a_force_that_is_let_down_slowly_tells_nothing(tmp_path):
    """Count as timed together where no force is let go at once, and where the case tells of no opening."""
    t = DT * np.arange(100)
    slow = FORCE * np.interp(t, [0.2, 0.6, 1.2], [0, 1, 0])[:, None]
    case = let_go(tmp_path / "c", [slow + 0.01 * np.random.default_rng(1).normal(size=(100, 3))])
    assert timed_together(case, estimate_noise(case))
    held = tuple(replace(x, no_contact=np.zeros(100, dtype=bool)) for x in case.trajectories)
    assert timed_together(replace(case, trajectories=held), estimate_noise(case))
