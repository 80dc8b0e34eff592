"""How to identify: everything that can be refused before torch and Warp are there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, get_args

from ...sim.base.errors import InputError, check_seed
from ..samplers.registry import SAMPLERS

if TYPE_CHECKING:
    from ..systems.acting import Acting
    from ..systems.branch import Joints, Kind, Unknowns
    from .target import Loss


@dataclass(frozen=True)
class Settings:
    """How to identify.

    Attributes:
        particles: Particles of SVGD, chains of the other samplers.
        iterations: Updates of the sampler.
        seed: Of every random number used.
        method: Sampler (`samplers.registry.SAMPLERS`); ``nnsvgd`` is SVGD with the inequality prior.
        prior: What is known beforehand, see `priors.choose.make_prior`; the box always holds.
        joints, infer, shared, box: Of a branch, what is unknown, see `systems.branch.Unknowns`.
        cv: Folds of a cross-validation over the trajectories; 0 holds some out once.
        loss: Likelihood, see `Target`.
        temperature: Of the published loss, kT.
        effects: Effects that act; parameters that they leave open are inferred too.
    """

    particles: int = 64
    iterations: int = 24
    seed: int = 0
    method: str = "svgd"
    prior: tuple[str, ...] = ()
    joints: Joints = "spherical"
    infer: tuple[Kind, ...] = ("stiffness", "damping")
    shared: tuple[Kind, ...] = ()
    box: tuple[str, ...] = ()
    cv: int = 0
    loss: Loss = "gaussian"
    temperature: float = 0.01
    effects: tuple[Acting, ...] = ()

    @property
    def unknowns(self) -> Unknowns:
        """What is unknown."""
        from ..systems.branch import Unknowns

        return Unknowns(self.joints, self.infer, self.shared, self.box, self.effects)

    @property
    def priors(self) -> tuple[str, ...]:
        """Priors, the one that the method brings included."""
        extra = ("inequality",) if self.method == "nnsvgd" and "inequality" not in self.prior else ()
        return (*self.prior, *extra)

    @property
    def sampler(self) -> str:
        """Name of the sampler."""
        return _sampler_of(self.method)

    @property
    def trainings(self) -> int:
        """How often a posterior is inferred."""
        return self.cv + 1

    def check(self) -> None:
        """Raise `InputError` for numbers that cannot be, and for samplers that there are not."""
        check_seed("identify", self.seed)
        SAMPLERS.of(self.sampler, "identify", "--method")
        for name, low in (("particles", 8), ("iterations", 10)):
            if getattr(self, name) < low:
                raise InputError("identify", f"--{name}", str(getattr(self, name)), f"{low} or more")
        if self.cv < 0 or self.cv == 1:
            raise InputError("identify", "--cv", str(self.cv), "2 or more folds, or 0 for none")
        if not 0.0 < self.temperature < math.inf:
            raise InputError("identify", "--temperature", f"{self.temperature:g}", "a number above 0")
        for name, kinds in (("infer", self.infer), ("shared", self.shared)):
            if len(set(kinds)) < len(kinds) or (name == "infer" and not kinds):
                from ..systems.branch import Kind

                allowed = f"one or more of {', '.join(get_args(Kind))}, each once"
                raise InputError("identify", f"--{name}", " ".join(kinds) or "nothing", allowed)
        for kind in self.shared:
            if kind not in self.infer:
                raise InputError("identify", "--shared", kind, f"one of what is inferred: {', '.join(self.infer)}")


def _sampler_of(method: str) -> str:
    return "svgd" if method == "nnsvgd" else method


def default_iterations(method: str) -> int:
    """Return how many updates a sampler usually needs from the modes.

    Raises:
        InputError: There is no such sampler.
    """
    return SAMPLERS.of(_sampler_of(method), "identify", "--method").updates
