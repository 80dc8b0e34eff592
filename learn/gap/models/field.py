"""Models that were fitted to a case, and the criteria that compare them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ....sim.base.types import Array
from ...cases.case import BranchCase
from .contest import Contest
from .refit import Fits

#: Reduced chi-squared up to which what is left passes for noise, whose size is itself an estimate.
QUIET = 1.15


@dataclass
class Model:
    """A base with some effects, fitted.

    Attributes:
        members: Indices of the candidates in it.
        fit: Its fit, one row.
        settled: Whether it was followed to the last round.
    """

    members: tuple[int, ...]
    fit: Fits
    settled: bool = False

    @property
    def cost(self) -> float:
        """Misfit and prior terms."""
        return float(self.fit.cost[0])

    @property
    def chi2(self) -> float:
        """Sum of the squared whitened residuals."""
        return float(self.fit.chi2[0])


@dataclass
class Field:
    """All models that were fitted to a case.

    Attributes:
        contest: Where they were fitted.
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

    @property
    def overdispersion(self) -> float:
        """Reduced chi-squared of the best model, at least one."""
        return overdispersion(self.contest, self.best.chi2)

    def reduced_chi2(self, model: Model) -> float:
        """Return a model's chi-squared per measured number; one where noise alone is left."""
        return model.chi2 / self.contest.num_samples

    def criterion(self, model: Model) -> float:
        """Return the information criterion of a model: misfit over the overdispersion, and what its parameters cost."""
        return model.cost / self.overdispersion + penalty(self.contest, model.members)

    def explained(self, model: Model) -> float:
        """Return the share of the base's excess over the noise that a model explains.

        The estimate of the noise may be a little large: the best model counts as noise where it leaves less.
        """
        excess = self.base.chi2 - min(float(self.contest.num_samples), self.best.chi2)
        return (self.base.chi2 - model.chi2) / excess if excess > 0.0 else 0.0

    def of_size(self, count: int) -> list[Model]:
        """Return the models with a number of effects, by the information criterion."""
        return sorted((m for m in self.models if len(m.members) == count), key=self.criterion)

    def names(self, model: Model) -> tuple[str, ...]:
        """Return the names of a model's effects."""
        return tuple(self.contest.candidates[c].name for c in model.members)

    def labels(self, model: Model) -> tuple[str, ...]:
        """Return the labels of a model's effects, such as ``dry_friction@1``."""
        return tuple(self.contest.candidates[c].acting.label for c in model.members)

    def needs_more(self, model: Model) -> bool:
        """Return whether a model leaves more than noise."""
        return self.reduced_chi2(model) > 0.5 * (1.0 + QUIET)

    def values(self, model: Model) -> dict[str, float]:
        """Return the fitted values of a model's parameters in SI units, by name."""
        values, active = self.contest.values(model.fit.rows)[0], model.fit.rows.active[0]
        return {p.name: float(v) for p, v, on in zip(self.contest.parameters, values, active, strict=True) if on}

    def stiffness(self, model: Model) -> Array | None:
        """Return the springs [N m/rad] of a branch's joints in a fitted model, base first; None for joints."""
        case, values = self.contest.case, self.values(model)
        return np.array([values[f"stiffness {n}"] for n in case.segment_name]) if isinstance(case, BranchCase) else None

    def output(self, model: Model) -> Array:
        """Return the channels [R, T, C] that a fitted model simulates."""
        rows = model.fit.rows
        return self.contest.simulate(self.contest.values(rows), rows.start)[0].cpu().numpy().astype(np.float64)


def overdispersion(contest: Contest, chi2: float) -> float:
    """Return the reduced chi-squared, at least one."""
    return max(1.0, chi2 / contest.num_samples)


def penalty(contest: Contest, members: Sequence[int]) -> float:
    """Return what an information criterion charges for effects: each parameter the logarithm of the sample size."""
    return math.log(contest.num_samples) * sum(len(contest.candidates[c].columns) for c in members)
