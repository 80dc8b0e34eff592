"""Samplers by name: bough's own, and those of installed packages; torch is not needed to know them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Any

from ...sim.base.errors import InputError
from ...sim.base.plugins import Registry

if TYPE_CHECKING:
    from .base import Sampler


@dataclass(frozen=True)
class SamplerKind:
    """A sampler as commands know it.

    Attributes:
        title: What reports call it.
        make: Called with particles [P, D] and, by name, iterations and seed; returns a `Sampler`. Takes ``step_size``
            too where it has one.
        updates: How many it usually needs from the modes: chains must forget their start and mix.
        has_step: Whether it has a step that can be given.
    """

    title: str
    make: Callable[..., Sampler]
    updates: int
    has_step: bool = True


def _own(module: str, name: str) -> Callable[..., Sampler]:
    """Return a class of this folder that is imported when it is called."""

    def make(*particles: Any, **options: Any) -> Sampler:
        """Import the class and make a sampler of it."""
        made: Sampler = getattr(import_module(f".{module}", __package__), name)(*particles, **options)
        return made

    return make


_KINDS = {
    "svgd": SamplerKind("Stein variational gradient descent", _own("svgd", "Svgd"), 24),
    "mh": SamplerKind("Metropolis-Hastings", _own("chains", "MetropolisHastings"), 4000, has_step=False),
    "sgld": SamplerKind("stochastic gradient Langevin dynamics", _own("chains", "Langevin"), 1500),
    "sghmc": SamplerKind("stochastic gradient Hamiltonian Monte Carlo", _own("chains", "Hamiltonian"), 1200),
    "emcee": SamplerKind("emcee's ensemble sampler", _own("emcee_sampler", "Emcee"), 6000, has_step=False),
}

#: Fewest updates of a run, which `bough identify --iterations` asks for too.
LEAST_UPDATES = 10


def _check(kind: SamplerKind, name: str) -> None:
    """Raise `InputError` where a package's sampler cannot be run."""
    if not callable(kind.make):
        raise InputError("sampler", "make", type(kind.make).__name__, "a class or a function that returns a Sampler")
    if type(kind.updates) is not int or kind.updates < LEAST_UPDATES:
        raise InputError("sampler", "updates", str(kind.updates), f"{LEAST_UPDATES} or more")


#: Entry points of the group ``bough_samplers`` name a `SamplerKind`; ``nnsvgd`` is SVGD with a prior of its own.
SAMPLERS = Registry("bough_samplers", "sampler", SamplerKind, _KINDS, reserved=("nnsvgd",), check=_check)
