"""Steps of replayed joints: second order with dampers, velocity products and driving tones, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from bough.learn.cases.case import load_case
from bough.learn.hidden.joints.hide import _write
from bough.learn.hidden.joints.rigs import draw_rig
from bough.learn.replay.midstep import driving
from bough.learn.replay.recording import recordings
from bough.learn.replay.rollout import Rollout
from bough.learn.systems.choose import system_of


def case_of(folder, kind, seed):
    """Return a case without noise of a drawn rig, by another integrator with 48 steps a sample, and the true values."""
    rig = draw_rig(kind, np.random.default_rng(seed))
    motion = rig.move([], fine=48)
    tables = [np.column_stack([motion.time, *motion.angle[:, r].T, *motion.effort[:, r].T]) for r in range(3)]
    _write(folder, rig, tables, {})
    known = {"damping": rig.chain.damping, "stiffness": rig.chain.stiffness, "offset": [0.0]}
    return replace(load_case(folder), fit="replay"), known


def left(case, known, share, monkeypatch):
    """Return what a replay at the true values leaves, as a share of the motion, with steps of a share of a sample."""
    system, chosen = system_of(case), recordings(case)
    system.substep = share * case.dt
    monkeypatch.setattr("bough.learn.replay.worlds.system_of", lambda case, unknowns: system)
    replay = Rollout(case, chosen, 1)
    values = [known[p.name.split()[0]][int(p.name[-1])] for p in replay.system.parameters]
    at_rest = torch.zeros(1, len(chosen), len(case.joints), 2, dtype=torch.float64)
    out = replay(torch.tensor([values], dtype=torch.float64), at_rest)[0].double().numpy()
    seen = np.stack([r.output for r in chosen])
    return float((np.sqrt(np.mean((out - seen) ** 2, axis=(0, 1))) / seen.std(axis=(0, 1))).max())


@pytest.mark.parametrize("kind, most", [("spring", 1.5e-3), ("links", 6e-3)])
def test_half_the_step_leaves_a_quarter_of_the_error(tmp_path, monkeypatch, kind, most):
    """Replay a driven spring, and two links, under tones: a second-order step, four times better for half its length.

    A step of first order (implicit dampers, velocity products at its start) gains a factor of two; so does one of an
    effort that is half a step late. At a third of a sample a tone of 18 samples turns by 0.12 rad a step; its phase and
    gain err by 0.12^2 / 24 = 6e-4, a resonance of Q 10 by as much as ten times that.
    """
    case, known = case_of(tmp_path / "case", kind, 1)
    wide, narrow = (left(case, known, 1.0 / n, monkeypatch) for n in (3, 6))
    assert wide < most and 3.0 < wide / narrow < 5.0


def test_samples_are_raised_where_lines_cut_tones(tmp_path):
    """Give a tone of eighteen samples a period back to 3e-4, of which lines between samples leave 1 % less.

    Leave noise, steps and inputs that are held as they are.
    """
    case, _ = case_of(tmp_path / "case", "spring", 1)

    def acts(x, hold="linear"):
        of = replace(case, inputs=tuple(replace(i, hold=hold) for i in case.inputs),
                     trajectories=tuple(replace(t, effort=x) for t in case.trajectories))  # fmt: skip
        return driving(of, recordings(of))[0]

    phase = 2.0 * np.pi / 18.0 * np.arange(len(case.trajectories[0].t))
    tone, fine = np.sin(phase)[:, None], np.linspace(0.0, 18.0 * 2.0 * np.pi, 20001)
    for x, loss in ((tone, 1e-2), (acts(tone), 3e-4)):
        gain = 2.0 * np.mean(np.interp(fine, phase, x[:, 0]) * np.sin(fine))
        assert 0.3 * loss < abs(gain - 1.0) < 1.5 * loss
    noise, step = np.random.default_rng(0).normal(size=tone.shape), 1.0 * (phase > 9.0)[:, None]
    assert all((acts(x) == x).all() for x in (noise, step)) and (acts(tone, "zero_order") == tone).all()
