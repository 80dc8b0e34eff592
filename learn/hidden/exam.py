"""Cases of an exam: nothing hidden, one effect, two, or one that is not among the known ones."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from .names import NAMES, OUTSIDE

#: Kinds of cases and how many of each in eight: 3 : 3 : 1 : 1, spread so that a short exam has some of each.
MIX: tuple[Literal["null", "single", "pair", "outside"], ...] = (
    "null", "single", "pair", "null", "single", "outside", "null", "single",
)  # fmt: skip
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
    """

    kind: Literal["null", "single", "pair", "outside"]
    effects: tuple[str, ...]
    outside: str | None
    seed: int
    segments: int = 3
    noise: float = 0.03

    @property
    def options(self) -> dict[str, Any]:
        """Return the arguments for `hide.hide` but the folder."""
        return {key: value for key, value in asdict(self).items() if key != "kind"}


def exam_plan(cases: int, seed: int, *, segments: int = 3, noise: float = 0.03) -> list[Spec]:
    """Return what to hide in each case of an exam; single effects and outside ones go round all names.

    Args:
        cases: Number of cases.
        seed: Seed of the plan and, through it, of every case.
        segments: Number of segments of all branches.
        noise: Noise as a fraction of the channels' rms.
    """
    rng = np.random.default_rng([seed, 21])
    singles, outsides = rng.permutation(NAMES).tolist(), rng.permutation(OUTSIDE).tolist()
    specs: list[Spec] = []
    for k in range(cases):
        kind = MIX[k % len(MIX)]
        count = sum(spec.kind == kind for spec in specs)
        names = {"null": (), "single": (singles[count % len(singles)],), "pair": _pair(rng), "outside": ()}[kind]
        other = outsides[count % len(outsides)] if kind == "outside" else None
        specs.append(Spec(kind, tuple(names), other, int(rng.integers(2**31)), segments, noise))
    return specs


def _pair(rng: np.random.Generator) -> tuple[str, ...]:
    """Draw two names that differ in principle."""
    while True:
        pair = tuple(rng.choice(NAMES, 2, replace=False).tolist())
        if not any(set(pair) <= same for same in _SAME):
            return pair
