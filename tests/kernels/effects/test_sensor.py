"""What a force sensor gets wrong beside an offset and a gain: tools that turn, pre-loads, and a sensor that warms."""

from dataclasses import replace

import numpy as np
import pytest
from bough.learn.replay.recording import headings, recordings
from bough.learn.systems.acting import Acting, ActingSet
from bough.sim.effects import Setting
from oracles.effect_case import FORCE, KS, held, resting, settled, stick, stick_case
from torch import tensor


def facing(case, *directions):
    """Return a case whose gripper pulls along the given directions."""
    turned = tuple(replace(t, direction=d) for t, d in zip(case.trajectories, directions, strict=True))
    return replace(case, trajectories=turned)


def test_a_tools_offset_turns_with_the_pull(tmp_path):
    """Rest under the reading less a ahead of the level way of each pull and b to the left of it, wherever that points.

    (0.6, 0.8, 2) heads (0.6, 0.8), to the left of which is (-0.8, 0.6); (0, -3, 0) heads (0, -1), left (1, 0).
    """
    case = facing(stick_case(tmp_path / "c", [held(), held()]), np.array([0.6, 0.8, 2.0]), np.array([0.0, -3.0, 0.0]))
    a, b = 0.5, -0.3
    out = stick(case, gravity_comp_error={"ahead_N": a, "across_N": b})
    offsets = np.array([[0.6 * a - 0.8 * b, 0.8 * a + 0.6 * b, 0.0], [b, -a, 0.0]])
    for run, off in zip(out, offsets, strict=True):
        expected = resting(case, lambda phi: -KS * phi, lambda R, o=off: FORCE - o)
        np.testing.assert_allclose(settled(run), expected, atol=1e-4)
        assert np.linalg.norm(settled(run) - settled(stick(case)[0])) > 1e-3


def test_a_heading_must_turn_to_be_one(tmp_path):
    """Know no heading where the case gives none, where all pulls share one, or of a pull straight up."""
    case = stick_case(tmp_path / "c", [held(), held()])
    x, y, up = np.eye(3)
    for directions in ((None, None), (x, 2.0 * x), (x, None), (x, up)):
        assert not np.any(headings(facing(case, *directions)))
    assert np.allclose(headings(facing(case, x, -1.0 * y)), [x, -y])
    assert (recordings(facing(case, x, y))[1].heading == y).all()


@pytest.mark.parametrize("overload", [0.4, -0.3])
def test_pre_loads_that_do_not_carry_the_weight(tmp_path, overload):
    """Stand off the given pose, before a pull and under one, where a pre-load that is too strong or too weak has it."""
    free = np.where(np.arange(200)[:, None] < 60, 0.0, np.roll(held(), 60, axis=0))
    case = stick_case(tmp_path / "c", [free])
    out = stick(case, gravity_comp_error={"overload": overload})[0]
    for k, force in ((0, 0.0 * FORCE), (59, 0.0 * FORCE), (-1, FORCE)):
        expected = resting(case, lambda phi: -KS * phi, lambda R, f=force: f, lost=-overload)
        np.testing.assert_allclose(out[k, :3], expected, atol=1e-4)
    assert np.linalg.norm(out[0, :3]) > 1e-3


def test_only_a_pre_load_moves_a_branch_off_its_pose():
    """Let no world rest elsewhere for a tool's weight; a wind and a pre-load do, and what hysteresis remembers."""
    entries = (Acting("gravity_comp_error"), Acting("steady_wind"), Acting("hysteresis_boucwen", 0))
    own = ActingSet(entries, "branch", [Setting()])
    sets = np.tile([e.spec.neutral for e in own.entries], (6, 1))
    sets[0, [0, 1, 2, 8]], sets[1, 4], sets[2, 6] = [0.1, 0.5, 0.2, 1.0], 0.2, 30.0
    share = next(k for k, e in enumerate(own.entries) if e.spec.name == "share")
    sets[4:, share], sets[5, 4] = 0.3, 0.2
    assert own.marks(tensor(sets)).tolist() == [0.0, 2.0, 2.0, 0.0, 1.0, 2.0]


def test_a_warming_sensor_reads_ever_more(tmp_path):
    """Take from a reading s exp(c exp(-t / w)) times the force what was read too much, on the absolute clock."""
    s, c, w = 1.4, -0.5, 25.0
    starts = [0.0, 30.0]
    true = stick_case(tmp_path / "a", [held(), held()], starts=starts)
    t = np.arange(200) * 0.02
    gains = [s * np.exp(c * np.exp(-(t + begin) / w)) for begin in starts]
    read = stick_case(tmp_path / "b", [g[:, None] * held() for g in gains], starts=starts)
    out = stick(read, force_scale={"scale": s, "cold": c, "warms_s": w})
    # the kernel's exponential is right to 0.012, and as much of c
    reach = np.abs(stick(true)).max(axis=(0, 1))
    assert (np.abs(out - stick(true)).max(axis=(0, 1)) < 0.013 * abs(c) * reach).all()
    assert np.abs(stick(read, force_scale={"scale": s}) - stick(true)).max() > 0.1 * reach[:3].max()


@pytest.mark.parametrize("curved", [0.06, -0.02])
def test_a_curved_sensor_is_read_back(tmp_path, curved):
    """Rest under the force of a reading F (1 + q |F|), gains of axes taken off first: the root in single precision."""
    gains = np.array([1.3 / (0.9 * 1.1), 1.3 * 0.9, 1.3 * 1.1])
    true = stick_case(tmp_path / "a", [held()])
    size = np.linalg.norm(held(), axis=1, keepdims=True)
    assert abs(curved) * size.max() > 0.05
    read = stick_case(tmp_path / "b", [gains * held() * (1.0 + curved * size)])
    law = {"scale": 1.3, "relative_y": 0.9, "relative_z": 1.1, "curved_pN": curved}
    wanted = settled(stick(true)[0])
    np.testing.assert_allclose(settled(stick(read, force_scale=law)[0]), wanted, atol=2e-5 * np.abs(wanted).max())
    assert np.abs(settled(stick(read, force_scale=law | {"curved_pN": 0.0})[0]) - wanted).max() > 1e-3


@pytest.mark.parametrize("changes", [1.0, 2.0, -1.0])
def test_an_offset_may_jump_between_recordings(tmp_path, changes, same_steps):
    """Read an offset from the second of three recordings on, and before that 1 - e of it: take both off again."""
    offset, forces = np.array([0.5, -0.4, 0.3]), [held(), held(force=-FORCE), held(force=0.5 * FORCE)]
    true = stick_case(tmp_path / "a", forces, starts=[0.0, 10.0, 20.0])
    read = [f + offset * (1.0 - changes * (k == 0)) for k, f in enumerate(forces)]
    read = stick_case(tmp_path / "b", read, starts=[0.0, 10.0, 20.0])
    bias = {f"force_{c}_N": b for c, b in zip("xyz", offset, strict=True)}
    undone = stick(read, force_bias=bias | {"changes": changes, "moment_s": 7.0})
    np.testing.assert_allclose(undone, stick(true), atol=3e-6)
    assert np.abs(stick(read, force_bias=bias)[0] - undone[0]).max() > 1e-3
