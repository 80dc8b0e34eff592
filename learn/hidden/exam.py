"""Cases of an exam: nothing hidden, one effect, two, or one that is not among the known ones."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np

from .forms import outside_names
from .measurement import HARD, Hard
from .names import NAMES, OUTSIDE

#: Kinds of cases and how many of each in eight: 3 : 3 : 1 : 1, spread so that a short exam has some of each.
MIX: tuple[Literal["null", "single", "pair", "outside"], ...] = (
    "null", "single", "pair", "null", "single", "outside", "null", "single",
)  # fmt: skip
#: Segments of a branch in a hard exam, and how often each number is taken.
SEGMENTS = ((1, 2, 3, 4, 5, 6), (0.15, 0.25, 0.25, 0.15, 0.1, 0.1))
#: Two of these make no pair: they are indistinguishable.
_SAME = ({"force_bias", "gravity_comp_error", "steady_wind"}, {"dry_friction", "hysteresis_boucwen"})


@dataclass(frozen=True)
class Spec:
    """One case of an exam; `options` are the arguments of `hide.hide` beside the folder.

    Attributes:
        kind: What sort of case it is.
        effects: Names hidden.
        outside: Name on no list.
        seed: Seed of the case.
        segments: Number of segments.
        noise: Noise as a fraction of the channels' rms.
        hard: In what the case is harder.
        held_back: Whether forms are drawn of those that are held back.
    """

    kind: Literal["null", "single", "pair", "outside"]
    effects: tuple[str, ...]
    outside: str | None
    seed: int
    segments: int = 3
    noise: float = 0.03
    hard: tuple[Hard, ...] = ()
    held_back: bool = False

    @property
    def options(self) -> dict[str, Any]:
        """Return the arguments for `hide.hide` but the folder."""
        return {key: value for key, value in asdict(self).items() if key != "kind"}


def exam_plan(
    cases: int,
    seed: int,
    *,
    segments: int = 3,
    noise: float = 0.03,
    hard: bool = False,
    held_back: bool = False,
) -> list[Spec]:
    """Return what to hide in each case of an exam; single effects and outside ones go round all names.

    Args:
        cases: Number of cases.
        seed: Seed of the plan and, through it, of every case.
        segments: Number of segments of all branches; in a hard exam it is drawn.
        noise: Noise as a fraction of the channels' rms.
        hard: Whether the cases are harder in all of `measurement.HARD`.
        held_back: Whether they have the forms that are held back; only a hard exam has forms.
    """
    rng, size = np.random.default_rng([seed, 21]), np.random.default_rng([seed, 25])
    hard = hard or held_back
    singles = rng.permutation(NAMES).tolist()
    outsides = rng.permutation(outside_names(held_back) if hard else OUTSIDE).tolist()
    specs: list[Spec] = []
    before = Counter[str]()
    for k in range(cases):
        kind = MIX[k % len(MIX)]
        count = before[kind]
        before[kind] += 1
        names = {"null": (), "single": (singles[count % len(singles)],), "pair": _pair(rng), "outside": ()}[kind]
        other = outsides[count % len(outsides)] if kind == "outside" else None
        spec = Spec(kind, tuple(names), other, int(rng.integers(2**31)), segments, noise)
        if hard:
            drawn = int(size.choice(SEGMENTS[0], p=SEGMENTS[1]))
            spec = replace(spec, segments=drawn, hard=HARD, held_back=held_back)
        specs.append(spec)
    return specs


def _pair(rng: np.random.Generator) -> tuple[str, ...]:
    """Draw two names that differ in principle."""
    while True:
        pair = tuple(rng.choice(NAMES, 2, replace=False).tolist())
        if not any(set(pair) <= same for same in _SAME):
            return pair
