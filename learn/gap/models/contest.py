"""One batch of worlds in which many models of a case compete: the base, and every effect at every place.

A kernel holds all effects; a world uses those of its row alone. A row is a vector of free coordinates of all parameters
(base, then effects) and a mask of those that are free in it; what is not stays at its neutral value. Residuals are
whitened with the noise that was estimated from the data before any model, noise of the force seen through the model
included, so that a perfect model leaves white noise of deviation one.

Wood bends inside a segment too. What that would do is simulated on a finer branch and enters every fit as a few linear
columns with a prior (`nuisance`), so that no effect is named for it.
"""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import dataclass

import torch

from ....sim.base.types import Array
from ...cases.case import BranchCase, JointCase
from ...replay.equation_error import simulation_of
from ...replay.input_noise import Colour
from ...replay.recording import Recording
from ...replay.rollout import Rollout
from ...systems.branch import Unknowns
from ...systems.system import box_of, values_of
from .candidates import Candidate, everywhere

#: Sets of parameters in one launch; what is left over runs in launches of the second size.
LAUNCH, SMALL = 128, 16
#: Step for derivatives, in the reach of a free coordinate and in the scale of start states: wide, for it sees past the
#: small waves of a rugged misfit, and narrow, for it does not bend the derivative of a law that is.
STEP, NARROW = 0.01, 0.002
#: Deviation of a base parameter's free coordinate about its typical value; of an effect's, in half widths of its box.
BASE_SPREAD, EFFECT_SPREAD = 3.0, 1.0


@dataclass
class Rows:
    """Models side by side.

    Attributes:
        free: Free coordinates of all parameters, shape [S, n]; only those that are active count.
        active: Which are free, shape [S, n].
        start: Start states, shape [S, R, J, 2].
        weight: Weight of every recording, shape [S, R].
    """

    free: torch.Tensor
    active: torch.Tensor
    start: torch.Tensor
    weight: torch.Tensor

    def __getitem__(self, index: torch.Tensor | slice) -> Rows:
        return Rows(self.free[index], self.active[index], self.start[index], self.weight[index])

    def __len__(self) -> int:
        return len(self.free)

    def copy(self) -> Rows:
        """Return rows that share no memory with these."""
        return Rows(self.free.clone(), self.active.clone(), self.start.clone(), self.weight.clone())

    @staticmethod
    def joined(parts: Sequence[Rows]) -> Rows:
        """Return rows one after the other."""
        return Rows(*(torch.cat([getattr(p, k) for p in parts]) for k in ("free", "active", "start", "weight")))


class Contest:
    """Simulates rows of models of one case.

    Args:
        case: The case.
        recordings: R recordings.
        sigma: Noise of the channels, shape [C].
        names: Effects that may act.
        device: Warp device.

    Attributes:
        parameters: All n parameters: the system's own, then those of every candidate.
        settings: What is known of every joint.
        num_base: How many are the system's own.
        candidates: Every effect at every place.
        low, high: Box of the free coordinates, shape [n].
        centre, spread: Prior of the free coordinates, normal, shape [n].
        reach: Change of a free coordinate over which the response is about linear, shape [n].
        colour: How noise of the force correlates the residuals, None where it does not.
        nuisance: Whitened linear columns that every model may use, shape [m, R T C], with normal priors of mean
            ``nuisance_mean`` and deviation ``nuisance_spread``, shape [m].
        overdispersion: Squared ratio of the misfit that is to be expected anyway to the noise: priors weigh that much
            more, as if the misfit were divided by it.
        names: Effects that may act.
        num_samples: Measured numbers that count.
        world_steps: World-steps taken so far.
    """

    def __init__(
        self, case: BranchCase | JointCase, recordings: Sequence[Recording], sigma: Array, names: Sequence[str], *,
        device: object = None,
    ) -> None:  # fmt: skip
        self.case, self.recordings, self.device = case, list(recordings), device
        self.names = tuple(names)
        self.unknowns = Unknowns(effects=everywhere(case, names))
        self._rollouts: dict[int, Rollout] = {}
        first = self._rollout(SMALL)
        system = first.system
        self.place = first.torch_device
        self.parameters = system.parameters
        self.settings = system.acting.settings
        self.num_base = len(self.parameters) - len(system.acting.parameters)
        self.candidates = self._candidates()
        low, high = box_of(self.parameters)
        self.low, self.high = low.to(self.place), high.to(self.place)
        self._prior()
        self._stack()
        self.weigh(sigma)
        self.colour: Colour | None = None
        self.overdispersion = 1.0
        self._stiffen()

    def _stiffen(self) -> None:
        empty = torch.zeros(0, dtype=torch.float64, device=self.place)
        self.nuisance = empty.new_zeros(0, self.measured.numel())
        self.nuisance_mean, self.nuisance_spread = empty, empty

    def rigid(self) -> Contest:
        """Return the same contest, sharing its memory, in which segments do not bend: as every simulator has them."""
        out = copy(self)
        out._stiffen()
        return out

    def _rollout(self, size: int) -> Rollout:
        if size not in self._rollouts:
            self._rollouts[size] = simulation_of(self.case)(
                self.case, self.recordings, size, unknowns=self.unknowns, device=self.device
            )
        return self._rollouts[size]

    def _candidates(self) -> list[Candidate]:
        system = self._rollout(SMALL).system
        out: list[Candidate] = []
        column = self.num_base
        for acting in system.acting.acting:
            specs = system.acting.laws[acting.name].parameters
            out.append(Candidate(acting, tuple(range(column, column + len(specs))), specs))
            column += len(specs)
        off = [spec.neutral for candidate in out for spec in candidate.specs]
        neutral = [p.typical or 1.0 for p in self.parameters[: self.num_base]] + off
        self._neutral = torch.tensor(neutral, dtype=torch.float64, device=self.place)
        return out

    def _prior(self) -> None:
        n, k = len(self.parameters), self.num_base
        start = torch.tensor([p.start for p in self.parameters], dtype=torch.float64, device=self.place)
        middle, half = 0.5 * (self.low + self.high), 0.5 * (self.high - self.low)
        base = torch.arange(n, device=self.place) < k
        log = torch.tensor([p.scale == "log" for p in self.parameters], device=self.place)
        self.centre = torch.where(base, start, middle)
        self.spread = torch.where(base & log, BASE_SPREAD, EFFECT_SPREAD * half)
        self.reach = torch.where(log, 1.0, half)
        for candidate in self.candidates:
            setting = self.settings[candidate.acting.joint or 0]
            for column, spec in zip(candidate.columns, candidate.specs, strict=True):
                if spec.reach is not None:
                    self.reach[column] = spec.reach(setting) if callable(spec.reach) else spec.reach

    def _stack(self) -> None:
        longest, channels = max(len(r.t) for r in self.recordings), self.recordings[0].output.shape[1]
        self.measured = torch.zeros(len(self.recordings), longest, channels, dtype=torch.float64, device=self.place)
        for j, r in enumerate(self.recordings):
            self.measured[j, : len(r.t)] = torch.as_tensor(r.output, device=self.place)
        self.start0 = torch.stack([torch.as_tensor(r.start) for r in self.recordings]).to(self.place)
        self.start_scale = max(float(self.measured.abs().max()), 1e-9)

    def weigh(self, sigma: Array) -> None:
        """Take the noise of the channels, shape [C], to be this; a channel of noise zero does not count."""
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
        return sum(r.world_steps for r in self._rollouts.values())

    def rows(self, count: int) -> Rows:
        """Return rows of the base model at its typical values, all recordings counted."""
        free = self.centre.expand(count, -1).clone()
        active = torch.zeros_like(free, dtype=torch.bool)
        active[:, : self.num_base] = True
        start = self.start0.expand(count, *self.start0.shape).clone()
        return Rows(free, active, start, free.new_ones(count, len(self.recordings)))

    def values(self, rows: Rows) -> torch.Tensor:
        """Return parameter values in SI units, [S, n]; those that are not active are neutral."""
        return torch.where(rows.active, values_of(self.parameters, rows.free), self._neutral)

    def simulate(self, values: torch.Tensor, start: torch.Tensor) -> torch.Tensor:
        """Return the channels [S, R, T, C] of parameter values [S, n] from start states [S, R, J, 2]."""
        parts, done = [], 0
        while done < len(values):
            size = LAUNCH if len(values) - done > 4 * SMALL else SMALL
            rollout, taken = self._rollout(size), slice(done, done + size)
            own = [_padded(x[taken], size) for x in (values, start)]
            out = rollout(own[0], own[1] if rollout.num_locals else None)
            parts.append(out[: len(values) - done].clone())
            done += size
        return torch.cat(parts)

    def whiten(self, difference: torch.Tensor) -> torch.Tensor:
        """Return differences of channels [S, R, T, C] as numbers that noise makes white, of deviation one."""
        z = torch.nan_to_num(difference.double(), nan=1e6, posinf=1e6, neginf=-1e6) * self._scale
        return z if self.colour is None else self.colour.whiten(z, z.new_ones(len(z)))

    def residual(self, rows: Rows) -> torch.Tensor:
        """Return whitened measured minus simulated, [S, R, T, C], recordings weighted."""
        out = self.whiten(self.measured - self.simulate(self.values(rows), rows.start))
        return out * rows.weight[:, :, None, None]

    def linearise(
        self, rows: Rows, steps: torch.Tensor | None = None
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Return residuals [S, R, T, C], derivatives of the whitened simulation and what they are taken by.

        Args:
            rows: The models.
            steps: Of every row's derivatives, shape [S]; STEP for all if not given.

        Derivatives have the shape [S, p, R, T, C], p the largest number of free entries of a row (parameters, then
        start states, which act on their own recording); entries past a row's own are zero. The third result holds
        the columns of the parameters, shape [S, q], -1 past a row's own.
        """
        count, local = len(rows), self.start0[0].numel()
        if steps is None:
            steps = rows.free.new_full((count,), STEP)
        most = int(rows.active.sum(1).max())
        order = torch.argsort(rows.active.to(torch.int8), dim=1, descending=True, stable=True)[:, :most]
        columns = torch.where(torch.gather(rows.active, 1, order), order, -1)
        who, which = torch.nonzero(columns >= 0, as_tuple=True)
        moved = rows[who]
        at = (torch.arange(len(who), device=self.place), columns[who, which])
        # inwards from the upper end of the box, so that no effect is tried beyond it
        step = steps[who] * self.reach[at[1]]
        step = torch.where(moved.free[at] + step > self.high[at[1]], -step, step)
        moved.free[at] += step
        values, start = [self.values(rows), self.values(moved)], [rows.start, moved.start]
        apart = steps * self.start_scale
        for k in range(local):
            shifted = rows.start.clone().flatten(2)
            shifted[:, :, k] += apart[:, None]
            values.append(values[0])
            start.append(shifted.view_as(rows.start))
        out = self.simulate(torch.cat(values), torch.cat(start))
        base, at_parameters = out[:count], out[count : count + len(who)]
        weight = rows.weight[:, :, None, None]
        derivative = base.new_zeros(count, most + local * len(self.recordings), *base.shape[1:], dtype=torch.float64)
        change = self.whiten(at_parameters - base[who]) / step[:, None, None, None]
        derivative[who, which] = change * weight[who]
        for k in range(local):
            at_start = out[count + len(who) + k * count :][:count]
            change = self.whiten(at_start - base) * weight / apart[:, None, None, None]
            for j in range(len(self.recordings)):
                derivative[:, most + j * local + k, j] = change[:, j]
        return self.whiten(self.measured - base) * weight, derivative, columns


def _padded(values: torch.Tensor, size: int) -> torch.Tensor:
    return torch.cat([values, values[-1:].expand(size - len(values), *values.shape[1:])])


def prior_of(contest: Contest, rows: Rows) -> torch.Tensor:
    """Return twice the negative log prior of every row's active parameters, times the overdispersion, [S]."""
    z = (rows.free - contest.centre) / contest.spread
    return contest.overdispersion * torch.where(rows.active, z**2, 0.0).sum(1)


def active_rows(contest: Contest, rows: Rows, chosen: Sequence[Sequence[int]]) -> Rows:
    """Return rows in which the candidates ``chosen[s]`` are active beside what already is."""
    out = rows.copy()
    for s, members in enumerate(chosen):
        for c in members:
            out.active[s, list(contest.candidates[c].columns)] = True
    return out
