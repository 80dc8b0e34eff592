"""Cases of an exam on measured joints: nothing hidden, one law, two, or one that is on no list."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from .hide import ALIKE
from .laws import LAWS, ON_LIST, OUTSIDE
from .rigs import RIGS

Kind = Literal["null", "single", "pair", "outside"]
#: Kinds of cases and how many of each in eight, spread so that a short exam has some of each.
MIX: tuple[Kind, ...] = ("null", "single", "pair", "null", "single", "outside", "null", "single")


@dataclass(frozen=True)
class JointCaseSpec:
    """One case of an exam on joints.

    Attributes:
        kind: What sort of case it is.
        rig: What is measured.
        laws: Labels of what is hidden.
        seed: Of everything random.
    """

    kind: Kind
    rig: str
    laws: tuple[str, ...]
    seed: int

    @property
    def options(self) -> dict[str, Any]:
        """Return the arguments for `hide.hide_joints` but the folder."""
        return {"rig": self.rig, "laws": self.laws, "seed": self.seed}


def joint_plan(cases: int, seed: int) -> list[JointCaseSpec]:
    """Return what to hide in each case; laws and rigs go round."""
    rng = np.random.default_rng([seed, 32])
    singles, outsides = rng.permutation(list(ON_LIST)).tolist(), rng.permutation(list(OUTSIDE)).tolist()
    rigs = rng.permutation(RIGS).tolist()
    specs: list[JointCaseSpec] = []
    before = Counter[str]()
    for k in range(cases):
        kind = MIX[k % len(MIX)]
        count = before[kind]
        before[kind] += 1
        laws: tuple[str, ...] = ()
        if kind == "single":
            laws = (singles[count % len(singles)],)
        elif kind == "outside":
            laws = (outsides[count % len(outsides)],)
        elif kind == "pair":
            laws = _pair(rng)
        shared = [r for r in rigs if all(r in LAWS[label].rigs for label in laws)]
        rig = str(shared[count % len(shared)]) if kind == "null" else str(rng.choice(shared))
        specs.append(JointCaseSpec(kind, rig, laws, int(rng.integers(2**31))))
    return specs


def _pair(rng: np.random.Generator) -> tuple[str, ...]:
    """Draw two laws of different names that are not the same in principle and show on one rig."""
    while True:
        a, b = rng.choice(list(ON_LIST), 2, replace=False).tolist()
        names = LAWS[a].name or "", LAWS[b].name or ""
        alike = names[0] == names[1] or names[1] in ALIKE.get(names[0], ()) or names[0] in ALIKE.get(names[1], ())
        if not alike and set(LAWS[a].rigs) & set(LAWS[b].rigs):
            return a, b
