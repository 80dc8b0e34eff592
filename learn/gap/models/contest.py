"""Many models of one case simulated in one batch of worlds: the base model, and every effect at every place.

The kernel holds all effects; each world switches on those of its own model. A model is a vector of free coordinates of
all parameters (base first, then effects) and a mask of the active ones; the others stay at their neutral values.
Residuals are whitened with the noise estimated from the data alone, including the response to the force's noise, so a
perfect model leaves white noise of standard deviation one.

Wood also bends inside a segment, and a branch's file is a little wrong about its geometry and its sensors. What these
change is simulated apart and enters every fit as linear columns with a prior (`nuisance`), so that no effect is named
for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np
import torch

from ....sim.base.types import Array
from ....sim.effects import in_setting
from ...cases.case import BranchCase, JointCase
from ...replay.input_noise import Colour
from ...replay.motion import about_rest
from ...replay.recording import Recording, beginning
from ...systems.acting import Acting
from ...systems.branch import Unknowns
from ...systems.system import box_of, values_of
from .candidates import Candidate, everywhere, passes_neutral
from .memory import Remembered
from .nuisance import none_of
from .simulations import Simulations

#: Finite-difference steps, relative to the reach of a free coordinate and to the scale of start states. The wide step
#: averages over a rugged chi-squared surface; the narrow one has less truncation error where a law is curved. The
#: narrowest is for joints that swing many times.
STEP, NARROW, NARROWEST = 0.01, 0.002, 0.0004
#: Least length of the beginning of a recording, in samples.
FEWEST = 20
#: What a difference of channels counts as at most, and where a simulation diverged, in SI units: squares are finite.
LOST = 1e6
#: Prior standard deviation of a base parameter's free coordinate; of an effect's, in half widths of its box.
BASE_SPREAD, EFFECT_SPREAD = 3.0, 1.0


@dataclass
class Batch:
    """A batch of S models of one case.

    Attributes:
        free: Free coordinates of all parameters, shape [S, n]; only active ones count.
        active: Mask of the parameters that each model fits, shape [S, n].
        start: Start states, shape [S, R, J, 2].
        weight: Weight of every recording, shape [S, R].
    """

    free: torch.Tensor
    active: torch.Tensor
    start: torch.Tensor
    weight: torch.Tensor

    def __getitem__(self, index: torch.Tensor | slice) -> Batch:
        return Batch(self.free[index], self.active[index], self.start[index], self.weight[index])

    def __len__(self) -> int:
        return len(self.free)

    def copy(self) -> Batch:
        """Return a batch that shares no memory with this one."""
        return Batch(self.free.clone(), self.active.clone(), self.start.clone(), self.weight.clone())

    @staticmethod
    def joined(parts: Sequence[Batch]) -> Batch:
        """Return several batches as one."""
        return Batch(*(torch.cat([getattr(p, k) for p in parts]) for k in ("free", "active", "start", "weight")))


class Contest:
    """Simulates batches of models of one case.

    Args:
        case: The case.
        recordings: R recordings.
        sigma: Noise of the channels, shape [C].
        names: Effects that may act.
        effects: Where they act and what is known of them; None takes every place, nothing known.
        device: Warp device.

    Attributes:
        parameters: All n parameters: the system's own, then those of every candidate.
        settings: What is known of every joint.
        num_base: How many are the system's own.
        candidates: Every effect at every place.
        low, high: Box of the free coordinates, shape [n].
        neutral: Values in SI units of parameters that are not active, shape [n].
        typical: Free coordinates where a search may begin, shape [n]: strengths of either sign at neutral.
        centre, spread: Mean and standard deviation of the normal prior of the free coordinates, shape [n].
        reach: Change of a free coordinate over which the response is about linear, shape [n].
        colour: How noise of the force correlates the residuals; None where it does not.
        nuisance: Linear columns with priors that all models share.
        overdispersion: Reduced chi-squared expected of the best model; prior terms are scaled by it.
        names: Effects that may act.
        simulations: What simulates sets of parameters.
        motion: Measured channels, but joints' positions about their means, [R, T, C]; zero past a recording's end.
        data_sigma: Noise of the channels as it was estimated from the data alone, shape [C].
        num_samples: Number of measured values with noise above zero, the N of the reduced chi-squared.
        world_steps: World-steps taken so far.
    """

    def __init__(
        self, case: BranchCase | JointCase, recordings: Sequence[Recording], sigma: Array, names: Sequence[str], *,
        effects: Sequence[Acting] | None = None, device: object = None,
    ) -> None:  # fmt: skip
        self.case, self.recordings, self.device = case, list(recordings), device
        self.names = tuple(names)
        self.unknowns = Unknowns(effects=everywhere(case, names) if effects is None else tuple(effects))
        self.simulations = Simulations(case, self.recordings, self.unknowns, device=device)
        self._beginnings: dict[float, Contest] = {}
        system = self.simulations.whole.system
        self.place = self.simulations.whole.torch_device
        self.parameters = system.parameters
        self.settings = system.acting.settings
        self.num_base = len(self.parameters) - len(system.acting.parameters)
        self.candidates = self._candidates()
        low, high = box_of(self.parameters)
        self.low, self.high = low.to(self.place), high.to(self.place)
        self._prior()
        self._stack()
        self.data_sigma = np.array(sigma)
        self.set_noise(sigma)
        self.colour: Colour | None = None
        self.overdispersion = 1.0
        self._stiffen()

    def _stiffen(self) -> None:
        self.nuisance = none_of(self.measured)

    def rigid(self) -> Contest:
        """Return the same contest, sharing memory, without nuisances: rigid segments as the file has them."""
        out = copy(self)
        out._stiffen()
        return out

    def unlimited(self) -> Contest:
        """Return the same contest, sharing memory, whose nuisances may be off by any amount."""
        out = copy(self)
        out.nuisance = self.nuisance.unlimited()
        return out

    def finely(self) -> Contest:
        """Return the same contest, sharing memory, with steps half as long."""
        out = copy(self)
        out.simulations = self.simulations.finely()
        return out

    def smoothly(self) -> Contest:
        """Return the same contest, sharing memory, with inputs that bend between samples, see `Simulations`."""
        out = copy(self)
        out.simulations = self.simulations.smoothly()
        return out

    def remembering(self) -> Contest:
        """Return the same contest, sharing memory, that simulates nothing twice in a row."""
        out = copy(self)
        out.simulate = Remembered(self.simulate)  # type: ignore[method-assign]
        return out

    def beginnings(self, share: float) -> Contest:
        """Return a contest over the first share of every recording."""
        if share not in self._beginnings:
            cut = [beginning(r, max(FEWEST, round(share * len(r.t)))) for r in self.recordings]
            sigma = self.sigma.cpu().numpy()
            self._beginnings[share] = Contest(
                self.case, cut, sigma, self.names, effects=self.unknowns.effects, device=self.device
            )
        return self._beginnings[share]

    def _candidates(self) -> list[Candidate]:
        system = self.simulations.whole.system
        out: list[Candidate] = []
        column = self.num_base
        for acting in system.acting.acting:
            law = system.acting.laws[acting.name]
            end = column + len(law.parameters) - len(acting.known)
            out.append(Candidate(acting, tuple(range(column, end)), law))
            column = end
        off = [spec.neutral for candidate in out for spec in candidate.specs]
        neutral = [p.typical or 1.0 for p in self.parameters[: self.num_base]] + off
        self.neutral = torch.tensor(neutral, dtype=torch.float64, device=self.place)
        return out

    def _prior(self) -> None:
        n, k = len(self.parameters), self.num_base
        start = torch.tensor([p.start for p in self.parameters], dtype=torch.float64, device=self.place)
        middle, half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        base = torch.arange(n, device=self.place) < k
        log = torch.tensor([p.scale == "log" for p in self.parameters], device=self.place)
        self.centre = torch.where(base, start, middle)
        self.typical = self.centre.clone()
        self.spread = torch.where(base & log, BASE_SPREAD, EFFECT_SPREAD * half)
        self.reach = torch.where(log, 1.0, half)
        for candidate in self.candidates:
            setting = self.settings[candidate.acting.joint or 0]
            for column, spec in zip(candidate.columns, candidate.specs, strict=True):
                if passes_neutral(spec, self.parameters[column]):
                    self.typical[column] = self.parameters[column].free(spec.neutral)
                if spec.reach is not None:
                    self.reach[column] = in_setting(spec.reach, setting)

    def _stack(self) -> None:
        longest, channels = max(len(r.t) for r in self.recordings), self.recordings[0].output.shape[1]
        self.measured = torch.zeros(len(self.recordings), longest, channels, dtype=torch.float64, device=self.place)
        for j, r in enumerate(self.recordings):
            self.measured[j, : len(r.t)] = torch.as_tensor(r.output, device=self.place)
        self.start0 = torch.stack([torch.as_tensor(r.start) for r in self.recordings]).to(self.place)
        self.motion = about_rest(self.case, self.recordings, self.measured)
        self.start_scale = max(float(self.motion.abs().max()), 1e-9)

    def set_noise(self, sigma: Array) -> None:
        """Set the noise of the channels, shape [C]; channels with zero noise are ignored."""
        self.sigma = torch.as_tensor(sigma, dtype=torch.float64, device=self.place)
        used = self.sigma > 0.0
        inverse = torch.where(used, 1.0 / torch.where(used, self.sigma, 1.0), 0.0)
        self._scale = torch.zeros_like(self.measured)
        for j, r in enumerate(self.recordings):
            self._scale[j, : len(r.t)] = inverse
        self.num_samples = int((self._scale > 0.0).sum())

    @property
    def world_steps(self) -> int:
        """World-steps taken so far."""
        return self.simulations.world_steps

    def base_batch(self, count: int) -> Batch:
        """Return a batch of ``count`` base models at typical values, all recordings with weight one."""
        free = self.centre.expand(count, -1).clone()
        active = torch.zeros_like(free, dtype=torch.bool)
        active[:, : self.num_base] = True
        start = self.start0.expand(count, *self.start0.shape).clone()
        return Batch(free, active, start, free.new_ones(count, len(self.recordings)))

    def values(self, batch: Batch) -> torch.Tensor:
        """Return parameter values in SI units, [S, n]; inactive parameters are neutral."""
        return torch.where(batch.active, values_of(self.parameters, batch.free), self.neutral)

    def simulate(self, values: torch.Tensor, start: torch.Tensor) -> torch.Tensor:
        """Return the channels [S, R, T, C] of parameter values [S, n] from start states [S, R, J, 2]."""
        return self.simulations(values, start)

    def whiten(self, difference: torch.Tensor) -> torch.Tensor:
        """Return differences of channels [S, R, T, C] whitened: noise alone gives standard deviation one."""
        z = torch.nan_to_num(difference.double(), nan=LOST).clamp(-LOST, LOST) * self._scale
        return z if self.colour is None else self.colour.whiten(z, z.new_ones(len(z)))

    def whiten_one(self, j: int, difference: torch.Tensor) -> torch.Tensor:
        """Return differences of the channels of recording j alone, [S, T, C], whitened as `whiten` does."""
        z = difference.double() * self._scale[j]
        if self.colour is None:
            return z
        return self.colour.of([j]).whiten(z[:, None], z.new_ones(len(z)))[:, 0]

    def residual(self, batch: Batch) -> torch.Tensor:
        """Return whitened measured minus simulated, [S, R, T, C], recordings weighted."""
        out = self.whiten(self.measured - self.simulate(self.values(batch), batch.start))
        return out * batch.weight[:, :, None, None]

    def linearise(
        self, batch: Batch, steps: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return residuals [S, R, T, C], derivatives of the whitened simulation, and their parameters.

        Args:
            batch: The models.
            steps: Finite-difference step of each model, shape [S]; STEP for all if not given.

        Derivatives have the shape [S, p, R, T, C], with p the largest number of free entries of a model (parameters,
        then start states, each of which acts on its own recording); unused entries are zero. The third result holds
        the parameter index of each derivative, shape [S, q], -1 where unused.
        """
        if steps is None:
            steps = batch.free.new_full((len(batch),), STEP)
        columns = _active_columns(batch)
        who, which = torch.nonzero(columns >= 0, as_tuple=True)
        moved, step = self._moved(batch, who, columns[who, which], steps)
        apart = steps * self.start_scale
        shifted = self._shifted_starts(batch, apart)
        own = self.values(batch)
        values = torch.cat([own, self.values(moved), *[own] * len(shifted)])
        out = self.simulate(values, torch.cat([batch.start, moved.start, *shifted]))
        base, at_parameters, at_starts = out.split([len(batch), len(who), len(shifted) * len(batch)])
        weight, most, local = batch.weight[:, :, None, None], columns.shape[1], len(shifted)
        shape = (len(batch), most + local * len(self.recordings), *base.shape[1:])
        derivative = base.new_zeros(*shape, dtype=torch.float64)
        change = self.whiten(at_parameters - base[who]) / step[:, None, None, None]
        derivative[who, which] = change * weight[who]
        for k, at_start in enumerate(at_starts.split(len(batch)) if local else ()):
            change = self.whiten(at_start - base) * weight / apart[:, None, None, None]
            for j in range(len(self.recordings)):
                derivative[:, most + j * local + k, j] = change[:, j]
        return self.whiten(self.measured - base) * weight, derivative, columns

    def _moved(
        self, batch: Batch, who: torch.Tensor, column: torch.Tensor, steps: torch.Tensor
    ) -> tuple[Batch, torch.Tensor]:
        """Return the models ``who`` with one parameter moved each, and by how much.

        Steps at the upper end of the box go inwards, so that no effect is tried beyond it.
        """
        moved, at = batch[who], (torch.arange(len(who), device=self.place), column)
        step = steps[who] * self.reach[column]
        step = torch.where(moved.free[at] + step > self.high[column], -step, step)
        moved.free[at] += step
        return moved, step

    def _shifted_starts(self, batch: Batch, apart: torch.Tensor) -> list[torch.Tensor]:
        """Return the start states with one entry moved in all recordings, one tensor [S, R, J, 2] per entry."""
        out = []
        for k in range(self.start0[0].numel()):
            shifted = batch.start.clone().flatten(2)
            shifted[:, :, k] += apart[:, None]
            out.append(shifted.view_as(batch.start))
        return out


def _active_columns(batch: Batch) -> torch.Tensor:
    """Return the indices of each model's active parameters in order, -1 where there are fewer, [S, q]."""
    most = int(batch.active.sum(1).max())
    order = torch.argsort(batch.active.to(torch.int8), dim=1, descending=True, stable=True)[:, :most]
    return torch.where(torch.gather(batch.active, 1, order), order, -1)


def prior_of(contest: Contest, batch: Batch) -> torch.Tensor:
    """Return minus twice the log prior of each model's active parameters, times the overdispersion, [S]."""
    z = (batch.free - contest.centre) / contest.spread
    return contest.overdispersion * torch.where(batch.active, z**2, 0.0).sum(1)


def activated(contest: Contest, batch: Batch, chosen: Sequence[Sequence[int]]) -> Batch:
    """Return a copy of a batch with the candidates ``chosen[s]`` activated in model s."""
    out = batch.copy()
    for s, members in enumerate(chosen):
        for c in members:
            out.active[s, list(contest.candidates[c].columns)] = True
    return out
