"""Forms of every effect's law, and which of them are held back.

The plain form of an effect is the one that its name in `names.RECIPES` stands for. The others are ranked by the hash of
their name: the first half of every effect's is held back, so that no one has chosen which, and a new form cannot be put
where one would like it. What is held back is only seen by ``bough exam --held-back``; `docs/hide.md` says when.
"""

from __future__ import annotations

from hashlib import sha256

import numpy as np

from . import air_forms, elastic_forms, grip_forms, memory_forms, outside_laws
from .names import OUTSIDE, RECIPES
from .parts import Recipe

#: Effect to form to recipe; the plain ones are not among them.
FORMS: dict[str, dict[str, Recipe]] = {
    **elastic_forms.FORMS, **memory_forms.FORMS, **air_forms.FORMS, **grip_forms.FORMS,
}  # fmt: skip
#: Name of the form that an effect has if none is chosen.
PLAIN = "plain"


def _ranked(names: tuple[str, ...], effect: str) -> list[str]:
    return sorted(names, key=lambda form: sha256(f"{effect}/{form}".encode()).hexdigest())


def held_back(effect: str) -> tuple[str, ...]:
    """Return the forms of an effect that are held back: the first half by hash, the larger one if it is odd."""
    ranked = _ranked(tuple(FORMS.get(effect, {})), effect)
    return tuple(ranked[: (len(ranked) + 1) // 2])


def practice(effect: str) -> tuple[str, ...]:
    """Return the forms of an effect that are not held back, the plain one first."""
    kept = held_back(effect)
    return (PLAIN, *(form for form in FORMS.get(effect, {}) if form not in kept))


def outside_names(held: bool) -> tuple[str, ...]:
    """Return the effects on no list that an exam with forms hides: practice or held back, as with forms."""
    ranked = _ranked(tuple(outside_laws.MORE), "outside")
    kept = ranked[: (len(ranked) + 1) // 2]
    return tuple(kept) if held else (*OUTSIDE, *(name for name in outside_laws.MORE if name not in kept))


def recipe(effect: str, form: str = PLAIN) -> Recipe:
    """Return what draws an effect in a form.

    Raises:
        KeyError: The effect has no such form.
    """
    if form != PLAIN:
        return FORMS[effect][form]
    return RECIPES[effect] if effect in RECIPES else outside_laws.MORE[effect]


def draw(effect: str, rng: np.random.Generator, held: bool) -> str:
    """Draw a form: of those held back, or else of those that are not; effects on no list have the plain one only."""
    if effect not in FORMS:
        return PLAIN
    return str(rng.choice(held_back(effect) if held else practice(effect)))
