"""Candidate effects: which effects may act where, and the parameter values at which they are tested."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import compress, product
from typing import Literal

import numpy as np

from ....sim.base.errors import InputError
from ....sim.effects import Effect, EffectParameter, Law, Setting, effect_of, effects
from ....sim.formats.import_mjcf import MEASURED, load_mjcf
from ...cases.case import BranchCase, JointCase
from ...cases.joints import JointSpec
from ...replay.equation_error import fits_torque
from ...systems.acting import Acting
from ...systems.system import Parameter

#: Largest factor by which a simulated response is extrapolated to another strength.
FURTHEST = 4.0
#: Number of grid values of a parameter where the registry does not say.
TRIES = 3


@dataclass(frozen=True)
class Candidate:
    """A candidate effect: one effect at one place.

    Attributes:
        acting: Which effect and where.
        columns: Indices of its parameters among all parameters.
        law: How the effect acts in this form of case.
    """

    acting: Acting
    columns: tuple[int, ...]
    law: Law

    @property
    def specs(self) -> tuple[EffectParameter, ...]:
        """Entries in the registry of its parameters that are not known."""
        return tuple(p for p in self.law.parameters if p.name not in self.acting.known)

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.acting.name


@dataclass(frozen=True)
class Probe:
    """A parameter point at which a candidate is tested.

    Attributes:
        candidate: Index of the candidate.
        values: Values in SI units, one per parameter.
        moved: Entries that are moved one by one, giving a linear response about ``values``; empty where the effect at
            ``values`` is itself the response.
    """

    candidate: int
    values: tuple[float, ...]
    moved: tuple[int, ...] = ()


def names_for(case: BranchCase | JointCase, wanted: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the names of the effects that can be tested on a case: all, or those that are wanted.

    Raises:
        InputError: A wanted name is unknown or cannot act in such a case.
    """
    for name in wanted:
        if not _possible(effect_of(name, "--effects"), case):
            allowed = ", ".join(e.name for e in effects() if _possible(e, case))
            raise InputError("--effects", name, "an effect that this case cannot show", allowed)
    return tuple(e.name for e in effects() if _possible(e, case) and (not wanted or e.name in wanted))


def _possible(effect: Effect, case: BranchCase | JointCase) -> bool:
    if isinstance(case, BranchCase):
        law = effect.branch
        movable = case.trunk_pivot_below_base is not None
        if law is None or (case.planar and law.spatial):
            return False
        return law.kind != "base_compliance" or movable
    law = effect.joint
    if law is None or (fits_torque(case) and law.kind != "joint"):
        return False
    if needs_spring(law) and not any(springs(case)):
        return False
    return law.kind == "joint" or bool(case.inputs)


def needs_spring(law: Law) -> bool:
    """Return whether a law is a share of the joint's spring, so that it is nothing where there is none."""
    return law.law is not None and "stiffness" in law.law.func.__code__.co_names


def springs(case: BranchCase | JointCase) -> list[bool]:
    """Return for every joint whether it may have a spring: one that is unknown, or known and not zero."""
    if isinstance(case, BranchCase):
        return [True] * case.num_segments
    if case.mjcf is None:
        return [not isinstance(j, JointSpec) or j.stiffness != 0.0 for j in case.joints]
    tree = load_mjcf(case.mjcf, MEASURED).tree
    unknown = [{"stiffness", f"stiffness {j.name}"} & set(case.unknown) for j in case.joints]
    return [bool(u) or float(tree.stiffness[j.link]) != 0.0 for u, j in zip(unknown, case.joints, strict=True)]


def everywhere(case: BranchCase | JointCase, names: Iterable[str]) -> tuple[Acting, ...]:
    """Return every effect at every place where it can act, without what no search of such a case moves.

    That is what only a course read off can make it do, and what is along y in a planar case.
    """
    form: Literal["branch", "joint"] = "branch" if isinstance(case, BranchCase) else "joint"
    sprung = springs(case)
    out: list[Acting] = []
    for name in names:
        law = effect_of(name).law(form)
        joints = [j for j, spring in enumerate(sprung) if spring or not needs_spring(law)]
        off = {p.name: p.neutral for p in law.parameters if p.read_off or (p.aside and _planar(case))}
        out += [Acting(name, j, off) for j in joints] if law.per_joint else [Acting(name, None, off)]
    return tuple(out)


def _planar(case: BranchCase | JointCase) -> bool:
    return isinstance(case, BranchCase) and case.planar


def probes_of(index: int, candidate: Candidate, parameters: Sequence[Parameter], setting: Setting) -> list[Probe]:
    """Return the points at which a candidate is tested.

    An effect whose first parameter passes through its neutral value is linearised about it, in all such parameters;
    otherwise the effect itself is simulated. The other parameters take the values of a grid, and `Law.further` ones.
    Empty for effects with a frequency, for which see `frequencies`.
    """
    if any(s.unit == "Hz" for s in candidate.specs):
        return []
    through = [passes_neutral(s, p) for s, p in zip(candidate.specs, parameters, strict=True)]
    moved = tuple(k for k, on in enumerate(through) if on and through[0])
    grids = [
        [s.neutral] if on else grid(s, p, setting)
        for s, p, on in zip(candidate.specs, parameters, through, strict=True)
    ]
    return [Probe(index, values, moved) for values in (*product(*grids), *_further(candidate, setting))]


def _further(candidate: Candidate, setting: Setting) -> list[tuple[float, ...]]:
    """Return the values of a candidate's parameters, without known ones, at which a search looks besides."""
    kept = [p.name not in candidate.acting.known for p in candidate.law.parameters]
    every = candidate.law.further(setting) if candidate.law.further else ()
    return list(dict.fromkeys(tuple(compress(values, kept)) for values in every))


def passes_neutral(spec: EffectParameter, parameter: Parameter) -> bool:
    """Return whether a parameter can lie on both sides of its neutral value."""
    return spec.tries is None and parameter.low < spec.neutral < parameter.high


def grid(spec: EffectParameter, parameter: Parameter, setting: Setting) -> list[float]:
    """Return the registry's grid values, or ``tries`` values inside a parameter's box, evenly on its scale."""
    if callable(spec.tries):
        return [float(x) for x in spec.tries(setting)]
    count = spec.tries or TRIES
    ends = parameter.free(parameter.low), parameter.free(parameter.high)
    share = (np.arange(count) + 0.5) / count
    free = ends[0] + share * (ends[1] - ends[0])
    return [float(np.exp(x) if parameter.scale == "log" else x) for x in free]
