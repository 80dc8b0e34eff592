"""A law's parameters found again in motion that it made."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np
import torch

from ...sim.base.types import Array
from ...sim.effects import Effect
from ...sim.effects.registry import Form
from ..cases.case import BranchCase, JointCase
from ..inference.fit import find_modes
from ..inference.target import Target
from ..replay.recording import Recording, recordings
from ..replay.rollout import Rollout
from ..systems.acting import Acting
from ..systems.branch import Unknowns
from ..systems.system import Parameter
from .bench import value_of
from .simulated import DAMPER, SPRING

Verdict = Literal["ok", "missing", "unclear"]

#: Noise of a simulated sensor, as a share of the motion's rms, and starts of the search.
NOISE, STARTS = 0.01, 12
#: Deviations by which an estimate may miss the truth, and share of its box that its deviation may have.
MISS, VAGUE = 4.0, 0.2


def recover(
    effect: Effect, form: Form, case: BranchCase | JointCase
) -> tuple[Literal["ok", "missing", "unclear"], str]:
    """Simulate a case with a law, add noise, fit spring, damper and law from starts all over their boxes.

    Parameters that only refine the law (``optional``) stay neutral. Found is what is within four deviations of the
    truth; a deviation of more than a fifth of the box means that this case, a push and a release, cannot tell.
    """
    law = effect.law(form)
    known = {p.name: p.neutral for p in law.parameters if p.optional}
    unknowns = Unknowns(effects=(Acting(effect.name, 0 if law.per_joint else None, known),))
    chosen = recordings(case)
    rollout = Rollout(case, chosen, 1, unknowns=unknowns)
    neutral = [p.neutral for p in law.parameters if not p.optional]
    parameters = rollout.system.parameters
    truth = _truth(parameters, neutral)
    motion = rollout(torch.tensor([truth], dtype=torch.float64))[0].double().cpu().numpy().copy()
    if not np.isfinite(motion).all():
        return "missing", f"the motion is not finite at {_shown(parameters, truth, len(neutral))}"
    idle = _idle(rollout, truth, len(neutral))
    if idle:
        return "missing", f"{', '.join(idle)} changes nothing"
    target = _target(case, chosen, motion, unknowns)
    theta, deviation = _fitted(target)
    wanted = np.array([p.free(v) for p, v in zip(parameters, truth, strict=True)])
    box = np.array([p.free(p.high) - p.free(p.low) for p in parameters])
    own = slice(len(parameters) - len(neutral), None)
    missed = (np.abs(theta - wanted) / deviation)[own]
    shown = _shown(parameters, [np.exp(x) if p.scale == "log" else x for p, x in zip(parameters, theta, strict=True)],
                   len(neutral))  # fmt: skip
    text = f"{shown}, where {_shown(parameters, truth, len(neutral))} is true; {missed.max():.1f} deviations at most"
    if (deviation[own] > VAGUE * box[own]).any():
        return "unclear", f"a push and a release do not tell: {text}"
    return ("ok" if (missed < MISS).all() else "missing"), text


def _idle(rollout: Rollout, truth: list[float], count: int) -> list[str]:
    """Return the parameters of the law, the last ``count``, that leave every bit of the motion when they are halved."""
    motion = rollout(torch.tensor([truth], dtype=torch.float64)).clone()
    found = []
    for k in range(len(truth) - count, len(truth)):
        halved = torch.tensor([truth], dtype=torch.float64)
        halved[0, k] *= 0.5
        if torch.equal(rollout(halved), motion):
            found.append(rollout.system.parameters[k].name.split()[-1])
    return found


def _truth(parameters: tuple[Parameter, ...], neutral: list[float]) -> list[float]:
    """Spring, damper, no offsets, and for the law what `bench.value_in` would try, in the boxes of this case."""
    before = len(parameters) - len(neutral)
    springs = [SPRING, DAMPER, *[0.0] * (before - 2)]
    return springs + [value_of(p, n) for p, n in zip(parameters[before:], neutral, strict=True)]


def _target(case: BranchCase | JointCase, chosen: list[Recording], motion: Array, unknowns: Unknowns) -> Target:
    sigma = NOISE * np.sqrt(np.mean(motion**2, (0, 1)))
    sigma = np.maximum(sigma, 1e-3 * sigma.max())
    seen = motion + sigma * np.random.default_rng(5).standard_normal(motion.shape)
    noisy = [replace(r, output=m[: len(r.t)]) for r, m in zip(chosen, seen, strict=True)]
    return Target(case, noisy, torch.as_tensor(sigma), unknowns=unknowns)


def _fitted(target: Target) -> tuple[Array, Array]:
    """Return the best mode's free coordinates and their deviations, of the parameters alone."""
    share = torch.as_tensor(np.random.default_rng(6).uniform(0.1, 0.9, (STARTS, target.num_parameters)))
    low, high = (end.cpu() for end in target.box)
    rest = torch.cat([target.start0.flatten(), target.log_noise0]).cpu().expand(STARTS, -1)
    modes = find_modes(target, torch.cat([low + share * (high - low), rest], 1).to(target.place))
    best = int(modes.log_posterior.argmax())
    spread = torch.linalg.pinv(modes.precision[best]).diagonal().clamp(min=0.0).sqrt()
    n = target.num_parameters
    return modes.theta[best, :n].cpu().numpy(), spread[:n].cpu().numpy()


def _shown(parameters: tuple[Parameter, ...], values: list[float], count: int) -> str:
    rows = list(zip(parameters, values, strict=True))[len(parameters) - count :]
    return ", ".join(f"{p.name.split()[-1]} {v:.3g}" for p, v in rows)
