"""Replay or torque: how joints measured directly are compared with a model, chosen by what was measured.

A replay integrates the efforts, so an error of the model lives as long as the mechanism remembers: a damped spring
forgets it within a few swings, a robot's axis without a spring never does, a chaotic arm enlarges it. Torques predicted
from the measured motion (equation error) hold at every instant, but need every position and effort, and a motion that
can be differentiated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
import torch

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ..cases.case import BranchCase, JointCase
from ..cases.noise import difference_sigma, estimate_noise
from ..systems.system import values_of
from .equation_error import low_pass, torque_recordings
from .recording import recordings
from .rollout import Rollout

Fit = Literal["replay", "torque"]

#: Share of a recording that an error of the model must outlive for its torques to be fitted.
LONG = 0.3
#: Largest noise of a rate relative to its rms, and largest share of a rate's rms above the filter's cut-off, at which a
#: motion is taken for differentiable.
NOISY, FAST = 0.1, 0.2
#: How far the noise of the efforts may move a replay, relative to the sensors' noise: beyond, a right model leaves more
#: than noise. Replays of such noise that are simulated to tell.
STIRRED, REPLAYS = 1.0, 4
#: Push that shows how long an error lives, relative to the rms of a joint's rate.
PUSH = 0.02


@dataclass(frozen=True)
class Choice:
    """How a case is fitted, and why.

    Attributes:
        case: The case, with its ``fit``.
        reason: Why, in a phrase; empty for a branch, which is always replayed.
        other: The other way, where the data allow it too.
        torn: Whether torques, of a motion faster than their filter, are judged where a replay names nothing.
    """

    case: BranchCase | JointCase
    reason: str = ""
    other: Fit | None = None
    torn: bool = False

    @property
    def stated(self) -> dict[str, str]:
        """Method, reason and the other way, as ``verdict.json`` holds them; empty for a branch."""
        if isinstance(self.case, BranchCase):
            return {}
        return {"method": self.case.fit, "reason": self.reason, "other": self.other or ""}

    def turned(self) -> Choice:
        """Return the other way, taken because this one names nothing."""
        assert isinstance(self.case, JointCase) and self.other is not None
        reason = f"a {self.case.fit}, which comes first ({self.reason}), names nothing"
        return Choice(replace(self.case, fit=self.other), reason, self.case.fit)


def choose(case: BranchCase | JointCase, wanted: Fit | None = None) -> Choice:
    """Return a case with the way it is fitted: as wanted, as ``meta.yaml`` says, or by what was measured.

    Raises:
        InputError: Torques are wanted of a branch, or where not every position and effort was measured.
    """
    if isinstance(case, BranchCase):
        if wanted == "torque":
            raise InputError("diagnose", "--fit", "torque with a branch", "replay; torques are fitted of joints")
        return Choice(case)
    lacking = missing(case)
    if wanted is not None:
        if wanted == "torque" and lacking:
            raise InputError(case.folder / "meta.yaml", "fit", f"torque without {lacking}", ALLOWED)
        return Choice(replace(case, fit=wanted), "asked for", None if lacking else _other(wanted))
    if lacking:
        return Choice(case, f"{lacking} was not measured")
    if case.stated:
        return Choice(case, "meta.yaml says so", _other(case.fit))
    rough = roughness(case)
    if rough is not None:
        reason = f"every position and effort was measured, but {rough.reason}"
        return Choice(replace(case, fit="replay"), reason, "torque", rough.fast)
    found, reason = _by_data(case)
    return Choice(replace(case, fit=found), reason, _other(found))


ALLOWED = "replay, or position and input of every joint"


def _other(fit: Fit) -> Fit:
    return "replay" if fit == "torque" else "torque"


def missing(case: JointCase) -> str | None:
    """Return what a fit of torques lacks, such as ``the position of elbow``, or None."""
    located = [o.joint for o in case.outputs if o.quantity == "position"]
    driven = [item.joint for item in case.inputs]
    lacking = [f"the {what} of {joint.name}" for what, names in (("position", located), ("effort", driven))
               for joint in case.joints if joint.name not in names]  # fmt: skip
    return lacking[0] if lacking else None


def _by_data(case: JointCase) -> tuple[Fit, str]:
    """Return how a case with every position and effort is fitted, and why."""
    life, length = life_of_errors(case), float(np.median([t.t[-1] for t in case.trajectories]))
    lives = f"an error of the model lives {life:.2g} s in recordings of {length:.2g} s"
    if life < LONG * length:
        stirred = moved_by_noise(case)
        if stirred > STIRRED:
            return "torque", f"the noise of the efforts moves a replay {stirred:.2g} times as far as the sensors' noise"
        return "replay", f"{lives}, so a replay forgets it"
    return "torque", f"every position and effort was measured, and {lives}, so a replay adds it up"


class Rough(NamedTuple):
    """Why a measured motion is not differentiated under the filter.

    Attributes:
        reason: In a phrase.
        fast: Whether it could be, but for what is faster than the filter.
    """

    reason: str
    fast: bool


def roughness(case: JointCase) -> Rough | None:
    """Return why the measured motion cannot be differentiated under the filter, or None."""
    if any(len(t.t) < 3 * np.ceil(1.0 / (case.filter_hz * case.dt)) for t in case.trajectories):
        return Rough(f"a recording is shorter than three periods of the filter's {case.filter_hz:.3g} Hz", False)
    sigma = estimate_noise(case).sigma
    motion = np.concatenate([r.input for r in torque_recordings(case)])
    fast = ""
    for k, joint in enumerate(case.joints):
        rate = float(motion[:, 3 * k + 1].std())
        columns = {o.quantity: c for c, o in enumerate(case.outputs) if o.joint == joint.name}
        noise = sigma[columns["position"]] * 2.0 * np.pi * case.filter_hz / np.sqrt(3.0)
        if min(noise, sigma[columns["velocity"]] if "velocity" in columns else np.inf) > NOISY * rate:
            return Rough(f"the rate of {joint.name} is noise under the filter's {case.filter_hz:.3g} Hz", False)
        if _above(case, columns["position"]) - noise > FAST * rate:
            fast = fast or f"{joint.name} moves faster than the filter's {case.filter_hz:.3g} Hz"
    return Rough(fast, True) if fast else None


def _above(case: JointCase, column: int) -> float:
    """Return the rms rate of a position between the filter's cut-off and three times that, as far as it is sampled."""
    wide = min(3.0 * case.filter_hz, 0.45 / case.dt)
    rates = []
    for t in case.trajectories:
        position = t.output[:, column : column + 1]
        band = low_pass(position, case.dt, wide) - low_pass(position, case.dt, case.filter_hz)
        period = int(np.ceil(1.0 / (case.filter_hz * case.dt)))
        rates.append(np.gradient(band[:, 0], case.dt)[period:-period])
    return float(np.concatenate(rates).std())


def life_of_errors(case: JointCase) -> float:
    """Return how long a push on the base model is felt in a replay [s]: until it is below 1 / e of its largest effect.

    The median over the recordings, of the joint that forgets last; the whole recording where it stays, or grows.
    """
    own = replace(case, fit="replay")
    chosen = recordings(own)
    count = len(case.joints)
    rollout = Rollout(own, chosen, 1 + count)
    start = np.stack([r.start for r in chosen])
    starts = np.repeat(start[None], 1 + count, axis=0)
    for j, rate in enumerate(_rates(case)):
        starts[1 + j, :, j, 1] += PUSH * rate
    out = rollout(_typical(rollout, 1 + count), torch.as_tensor(starts)).double().cpu()
    apart = (out[1:] - out[:1]).numpy()
    scale = np.concatenate([t.output for t in case.trajectories]).std(axis=0)
    lives = [max(_felt(x[j, : len(r.t)] / scale, r.t) for x in apart) for j, r in enumerate(chosen)]
    return float(np.median(lives))


def moved_by_noise(case: JointCase) -> float:
    """Return how far the noise of the efforts moves a replay of the base model, in units of the sensors' noise.

    The rms over all samples, of the output that it moves most; the noise is what differences of the efforts show.
    """
    own = replace(case, fit="replay")
    chosen, generator = recordings(own), np.random.default_rng(0)
    efforts = [t.effort for t in case.trajectories]
    sigma = np.nan_to_num([difference_sigma([e[:, k] for e in efforts])[0] for k in range(efforts[0].shape[1])])
    noisy = [replace(r, input=r.input + sigma * generator.standard_normal(r.input.shape))
             for _ in range(REPLAYS) for r in chosen]  # fmt: skip
    rollout = Rollout(own, [*chosen, *noisy], 1)
    starts = np.stack([r.start for r in chosen] * (1 + REPLAYS))[None]
    out = rollout(_typical(rollout, 1), torch.as_tensor(starts))[0].double().cpu().numpy()
    apart = out[len(chosen) :].reshape(REPLAYS, *out[: len(chosen)].shape) - out[: len(chosen)]
    squares = sum((apart[:, j, : len(r.t)] ** 2).sum((0, 1)) for j, r in enumerate(chosen))
    count = REPLAYS * sum(len(r.t) for r in chosen)
    return float(np.nan_to_num(np.sqrt(squares / count) / estimate_noise(case).sigma, nan=np.inf).max())


def _typical(rollout: Rollout, sets: int) -> torch.Tensor:
    """Return typical values of a rollout's parameters, so many times, [sets, n]."""
    parameters = rollout.system.parameters
    return values_of(parameters, torch.tensor([[p.start for p in parameters]] * sets, dtype=torch.float64))


def _rates(case: JointCase) -> list[float]:
    """Return the rms rate of every joint, of its measured position."""
    column = {o.joint: c for c, o in enumerate(case.outputs) if o.quantity == "position"}
    every = [np.concatenate([np.diff(t.output[:, column[j.name]]) for t in case.trajectories]) for j in case.joints]
    return [float(x.std() / case.dt) for x in every]


def _felt(apart: Array, t: Array) -> float:
    """Return the last time at which a difference [T, C] is above 1 / e of its largest size."""
    size = np.sqrt(np.sum(apart**2, axis=1))
    if not np.isfinite(size).all() or size.max() == 0.0:
        return float(t[-1])
    return float(t[np.flatnonzero(size >= size.max() / np.e)[-1]])
