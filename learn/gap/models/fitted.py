"""Models that were fitted to a case, and the criteria that compare them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....sim.base.types import Array
from ....sim.effects import EffectParameter
from ...cases.case import BranchCase
from ...systems.acting import Acting
from .contest import Contest
from .refit import Fits

#: Reduced chi-squared up to which residuals pass for noise; the noise is itself an estimate.
QUIET = 1.15
#: Least improvement of the information criterion by a further effect.
FURTHER = 20.0


@dataclass
class Model:
    """The base model with some effects, fitted.

    Attributes:
        members: Indices of the candidates in it.
        fit: Its fit, a batch of one.
        settled: Whether it was fitted to the last round.
        rests: Whether its fit is that of a model with fewer effects, the others off, because none with them left less.
        idle: What the information criterion saves without parameters that may as well be neutral, see `idle`.
    """

    members: tuple[int, ...]
    fit: Fits
    settled: bool = False
    rests: bool = False
    idle: float = 0.0

    @property
    def cost(self) -> float:
        """Chi-squared plus prior terms."""
        return float(self.fit.cost[0])

    @property
    def chi2(self) -> float:
        """Sum of the squared whitened residuals."""
        return float(self.fit.chi2[0])


@dataclass
class FittedModels:
    """All models that were fitted to a case.

    Attributes:
        contest: What simulated and fitted them.
        base: The base model.
        models: With one effect and with more, in any order.
    """

    contest: Contest
    base: Model
    models: list[Model]

    @property
    def best(self) -> Model:
        """The model with the least chi-squared."""
        return min([self.base, *self.models], key=lambda m: m.chi2)

    def contained(self, model: Model) -> list[Model]:
        """Return the base and the models whose effects are some, but not all, of a model's."""
        return [self.base, *(m for m in self.models if set(m.members) < set(model.members))]

    def broken(self) -> list[tuple[Model, Model]]:
        """Return models beside a contained one that leaves less; `nested.close` leaves none."""
        return [(m, inner) for m in self.models for inner in self.contained(m) if m.chi2 > inner.chi2]

    @property
    def overdispersion(self) -> float:
        """Reduced chi-squared of the best model, at least one."""
        return overdispersion(self.contest, self.best.chi2)

    def reduced_chi2(self, model: Model) -> float:
        """Return a model's chi-squared per measured number; one where noise alone is left."""
        return model.chi2 / self.contest.num_samples

    def criterion(self, model: Model) -> float:
        """Return the information criterion: cost over the overdispersion, plus the penalty of what is not idle."""
        return model.cost / self.overdispersion + penalty(self.contest, model.members) - model.idle

    def explained(self, model: Model) -> float:
        """Return the share of the base model's excess chi-squared that a model explains.

        The excess is over the number of samples, or over the best model's chi-squared if that is lower (the noise may
        be slightly overestimated).
        """
        excess = self.base.chi2 - min(float(self.contest.num_samples), self.best.chi2)
        return (self.base.chi2 - model.chi2) / excess if excess > 0.0 else 0.0

    def of_size(self, count: int) -> list[Model]:
        """Return the models with ``count`` effects, by the information criterion."""
        return sorted((m for m in self.models if len(m.members) == count), key=self.criterion)

    def names(self, model: Model) -> tuple[str, ...]:
        """Return the names of a model's effects."""
        return tuple(self.contest.candidates[c].name for c in model.members)

    def labels(self, model: Model) -> tuple[str, ...]:
        """Return the labels of a model's effects, such as ``dry_friction@1``."""
        return tuple(a.label for a in self.acting(model))

    def acting(self, model: Model) -> tuple[Acting, ...]:
        """Return a model's effects, and where they act."""
        return tuple(self.contest.candidates[c].acting for c in model.members)

    def needs_more(self, model: Model) -> bool:
        """Return whether a model leaves more than noise."""
        return self.reduced_chi2(model) > 0.5 * (1.0 + QUIET)

    def values(self, model: Model) -> dict[str, float]:
        """Return the fitted values of a model's parameters in SI units, by name."""
        values, active = self.contest.values(model.fit.batch)[0], model.fit.batch.active[0]
        return {p.name: float(v) for p, v, on in zip(self.contest.parameters, values, active, strict=True) if on}

    def stiffness(self, model: Model) -> Array | None:
        """Return the springs [N m/rad] of a branch's joints in a fitted model, base first; None for joints."""
        case, values = self.contest.case, self.values(model)
        return np.array([values[f"stiffness {n}"] for n in case.segment_name]) if isinstance(case, BranchCase) else None

    def output(self, model: Model) -> Array:
        """Return the channels [R, T, C] that a fitted model simulates."""
        batch = model.fit.batch
        return self.contest.simulate(self.contest.values(batch), batch.start)[0].cpu().numpy().astype(np.float64)


def overdispersion(contest: Contest, chi2: float) -> float:
    """Return the reduced chi-squared, at least one."""
    return max(1.0, chi2 / contest.num_samples)


def penalty(contest: Contest, members: Sequence[int]) -> float:
    """Return the penalty of the Bayesian information criterion: log(N) per parameter of the effects."""
    return sum(price(contest, spec) for c in members for spec in contest.candidates[c].specs)


def price(contest: Contest, spec: EffectParameter) -> float:
    """Return what the criterion charges a parameter."""
    return math.log(contest.num_samples) * (len(contest.recordings) if spec.of_each else 1)
