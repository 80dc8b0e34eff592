"""Effects in words, ``NAME:PARAMETER=VALUE[,PARAMETER=VALUE...]``, as commands' ``--effect`` takes them."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ..base.errors import InputError
from ..effects import EffectParameter
from .forest_effects import forest_laws, forest_terms

OPTION = "--effect"


def read_effects(words: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return the values [SI units] of parameters by effect and parameter.

    Raises:
        InputError: Another form, an effect or a parameter that does not exist or is given twice, no finite number, or a
            negative one of a quantity that has none.
    """
    out: dict[str, dict[str, float]] = {}
    for word in words:
        name, colon, rest = word.partition(":")
        if not (colon and rest):
            raise InputError(OPTION, "", f"'{word}'", "NAME:PARAMETER=VALUE[,PARAMETER=VALUE...]")
        forest_terms([name], OPTION)
        specs = {p.name: p for p in forest_laws()[name].parameters if not p.read_off}
        for part in rest.split(","):
            spec, value = _parameter(name, specs, part)
            if spec.name in out.setdefault(name, {}):
                raise InputError(OPTION, name, f"{spec.name} a second time", "each parameter once")
            out[name][spec.name] = value
    return out


def _parameter(name: str, specs: dict[str, EffectParameter], part: str) -> tuple[EffectParameter, float]:
    """Return the parameter and the value of ``PARAMETER=VALUE``."""
    key, _, text = part.partition("=")
    if key not in specs:
        raise InputError(OPTION, name, f"parameter '{key}'", ", ".join(f"{p.name} [{p.unit}]" for p in specs.values()))
    spec = specs[key]
    allowed = "0 or more" if spec.scale == "log" else "a finite number"
    allowed += "" if spec.unit == "1" else f", in {spec.unit} and without the unit"
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or (spec.scale == "log" and value < 0.0):
        raise InputError(OPTION, f"{name}: {key}", f"'{text}'", allowed)
    return spec, value
