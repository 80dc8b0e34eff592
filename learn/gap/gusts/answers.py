"""What a branch answers to a pressure that lasts for a moment: the columns of which a gust's motion is a sum.

A pressure that is linear between knots is a sum of hats, each zero but about its knot, and to first order the motion is
the sum of what the branch answers to each. About rest that is the same for all hats but for their time, so that one of
each axis is simulated.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from ....sim.base.types import Array
from ....sim.effects import effect_of
from ...cases.case import BranchCase
from ...replay.recording import Recording
from ...replay.rollout import Rollout
from ...systems.acting import Acting
from ...systems.branch import Unknowns
from ..models.contest import Batch, Contest

#: The effect, and its parameter that a course needs.
GUST, SIZE = "wind_gust", "rms_Pa"
#: Most knots of one recording's course.
MOST_KNOTS = 300
#: How long before a recording its course begins [s]; what blew before has died down.
PAST = 1.5
#: Pressure of the simulated hats, over the largest force by the branch's area.
SMALL = 0.05


@dataclass(frozen=True)
class Knots:
    """Where the knots of a recording's course lie.

    Attributes:
        apart: Samples from one knot to the next.
        first: Sample of the first knot, below zero.
        count: How many there are.
        lead: Samples that a course has before the recording.
        dt: Sampling step [s].
    """

    apart: int
    first: int
    count: int
    lead: int
    dt: float

    @property
    def time(self) -> Array:
        """When the knots are, from the recording's first sample on [s], shape [count]."""
        return np.asarray((self.first + self.apart * np.arange(self.count)) * self.dt, dtype=np.float64)

    def course(self, pressure: Array, recording: Recording) -> Array:
        """Return a course at all samples that a recording's course has, [lead + T, axes], of one at the knots."""
        samples = (np.arange(self.lead + len(recording.t)) - self.lead) * self.dt
        return np.column_stack([np.interp(samples, self.time, own, left=0.0) for own in pressure.T])


def knots_of(recording: Recording, case: BranchCase) -> Knots:
    """Return the knots of a recording's course: from `PAST` before it to its end."""
    dt = case.dt
    past, length = round(PAST / dt), len(recording.t)
    apart = -(-(past + length) // MOST_KNOTS)
    before = -(-past // apart)
    return Knots(apart, -before * apart, before + 1 + -(-(length - 1) // apart), case.lead, dt)


def acting_along() -> Acting:
    """Return gusts along a course, of unknown size."""
    law = effect_of(GUST).law("branch")
    return Acting(GUST, None, {p.name: p.neutral for p in law.parameters if p.name != SIZE})


def axes_of(case: BranchCase) -> int:
    """Return along how many axes the pressure is seen, x before y: a planar case shows x alone."""
    return 1 if case.planar else 2


def answers(contest: Contest, base: Batch, j: int, knots: Knots) -> torch.Tensor:
    """Return the whitened answer to one pascal at every knot of recording j, one axis after the other, [A count, T C].

    About the rest of a base model, a batch of one, without any force of a gripper.
    """
    pressure = SMALL * contest.settings[0].force / contest.settings[0].area
    recording = contest.recordings[j]
    calm = _calm(recording, knots)
    assert isinstance(contest.case, BranchCase)
    blown = [replace(calm, course=_hat(calm, knots, axis)) for axis in range(axes_of(contest.case))]
    acting = acting_along()
    unknowns = Unknowns(effects=(replace(acting, known={**acting.known, SIZE: pressure}),))
    values = contest.values(base)[:, : contest.num_base]
    out = Rollout(contest.case, [calm, *blown], 1, unknowns=unknowns, device=contest.device, alone=True)(values)
    change = (out[0, 1:] - out[0, :1]).double() / pressure
    shifted = torch.cat([_shifted(own, recording, knots) for own in change])
    padded = torch.nn.functional.pad(shifted, (0, 0, 0, contest.measured.shape[1] - shifted.shape[1]))
    return contest.whiten_one(j, padded).flatten(1)


def _calm(recording: Recording, knots: Knots) -> Recording:
    """Return a recording in which nothing happens, as long as a hat and all that it may move."""
    length = knots.apart - knots.first + len(recording.t)
    time = np.asarray(knots.dt * np.arange(length), dtype=np.float64)
    still = np.zeros((length, recording.output.shape[1]))
    return replace(
        recording, t=time, input=np.zeros((length, 3)), output=still, sensed=None, off=np.zeros(3), opened=np.zeros(3),
        contact=np.zeros(length, dtype=bool), sways=True, course=None,
    )  # fmt: skip


def _hat(calm: Recording, knots: Knots, axis: int) -> Array:
    """Return the course of one hat about sample ``apart``, [lead + T, 2]."""
    out = np.zeros((knots.lead + len(calm.t), 2))
    away = np.abs(np.arange(len(out)) - knots.lead - knots.apart)
    out[:, axis] = np.maximum(1.0 - away / knots.apart, 0.0)
    return out


def _shifted(answer: torch.Tensor, recording: Recording, knots: Knots) -> torch.Tensor:
    """Return the answers [count, T, C] to hats at all knots, of that [N, C] to one about sample ``apart``."""
    length = len(recording.t)
    out = answer.new_zeros(knots.count, length, answer.shape[1])
    for k in range(knots.count):
        begin = knots.first + (k - 1) * knots.apart  # sample at which this hat's answer begins
        skipped = max(-begin, 0)
        part = answer[skipped : skipped + length - max(begin, 0)]
        out[k, max(begin, 0) : max(begin, 0) + len(part)] = part
    return out
