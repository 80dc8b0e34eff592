"""Worlds of one group of lanes share what their laws cost, not what they do."""

import numpy as np
import pytest
import torch
from bough.learn.replay.recording import recordings
from bough.learn.replay.rollout import Rollout
from bough.learn.systems.acting import Acting
from bough.learn.systems.branch import Unknowns
from bough.sim.effects import effects
from oracles.effect_case import DS, KS, stick_case

DT = 0.04
#: A pull and what a sensor reads of it: it is late by three samples, and reads a fifth of a newton of an open gripper.
FORCE = np.array([0.9, -0.5, 0.3])
OPENED = [(0.0, 0.16), (1.24, 3.96)]
LAWS = [e for e in effects() if e.branch is not None]


def read():
    """Return the readings at the samples [N], shape [100, 3]."""
    t = DT * (np.arange(100) - 3.0)
    return 0.2 + FORCE * np.interp(t, [0.2, 0.6, 1.2, 1.24], [0, 1, 1, 0])[:, None]


def rollout_of(case, names, count):
    """Return a rollout in which laws may act, at the only joint where they act at one."""
    per_joint = {e.name: e.branch.per_joint for e in LAWS}
    acting = tuple(Acting(n, 0 if per_joint[n] else None) for n in names)
    return Rollout(case, recordings(case), count, unknowns=Unknowns(effects=acting))


def values_of(rollout, names, on):
    """Return parameters of a world in which one of some laws acts, a third of the way into its boxes."""
    neutral = [entry.spec.neutral for entry in rollout.system.acting.entries]
    own = rollout.system.parameters[2:]
    of = [p.name.split()[0].split("@")[0] for p in own]
    third = [p.low + (p.high - p.low) / 3.0 for p in own]
    return [KS, DS, *(x if n == on else o for n, x, o in zip(of, third, neutral, strict=True))]


@pytest.mark.parametrize("own", ["force_bias", "dry_friction"])
@pytest.mark.parametrize("other", [e.name for e in LAWS])
def test_a_world_moves_as_it_does_alone(tmp_path, own, other):
    """Move a world beside one with another law as it moves by itself: single precision's last digits apart.

    What counts displacement from where a memory lasts adds the same numbers in another order.
    """
    if own == other:
        pytest.skip("one law")
    case = stick_case(tmp_path / "c", [read()], dt=DT, opened=OPENED)
    names = [e.name for e in LAWS if e.name in (own, other)]
    both, alone = rollout_of(case, names, 2), rollout_of(case, names, 1)
    rows = [values_of(both, names, on) for on in (own, other)]
    for rollout in (both, alone):
        rollout._output.torch.fill_(torch.nan)
    out = both(torch.tensor(rows, dtype=torch.float64))
    wanted = alone(torch.tensor(rows[:1], dtype=torch.float64))
    assert torch.isfinite(out[0]).all() and out[0].abs().max() > 1e-3
    torch.testing.assert_close(out[0], wanted[0], rtol=0.0, atol=3e-6 * float(wanted.abs().max()))
