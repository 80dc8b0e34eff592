"""Effects that have a name, one file each; importing a file registers its effect.

Installed packages add theirs through the entry points `GROUP`: each names a module that registers effects.

Uses: `kernels.lanes`, `kernels.effects`, `sim.base`.
"""

import sys
import warnings
from importlib import import_module
from importlib.metadata import EntryPoint

from ..base.errors import InputError
from ..base.plugins import distribution_of, fault_of, points
from .registry import (
    Effect,
    EffectParameter,
    Law,
    Setting,
    effect_of,
    effects,
    in_setting,
    register,
    registered,
    take_back,
    terms_of,
    when_asked,
)

__all__ = ["Effect", "EffectParameter", "Law", "Setting", "effect_of", "effects", "in_setting", "register", "terms_of"]

#: Group of entry points whose modules register effects.
GROUP = "bough_effects"

#: Names of effects by the entry point whose module registered them.
_REGISTERED: dict[str, tuple[str, ...]] = {}

#: In the order in which they act: a sensor's offsets are taken off before its gain.
NAMES = [
    "cubic_stiffness",
    "bilinear_stiffness",
    "dry_friction",
    "hysteresis_boucwen",
    "quadratic_drag",
    "viscoelastic_sls",
    "tip_mass",
    "base_compliance",
    "backlash",
    "plastic_set",
    "partial_rupture",
    "grasp_slip",
    "time_delay",
    "gravity_comp_error",
    "force_bias",
    "force_scale",
    "steady_wind",
    "wind_gust",
    "anisotropic_stiffness",
    "bending_torsion_coupling",
]

for _name in NAMES:
    import_module(f".{_name}", __name__)


def _load_packages() -> None:
    """Import the modules of installed packages, which register their effects; a broken one is left out with a line."""
    for point in points(GROUP):
        try:
            load_package(point)
        except InputError as error:  # another's package; without it everything else still works
            who = f"{distribution_of(point)}: effect {point.name}"
            warnings.warn(f"{who} is left out: {error.found}", stacklevel=2)


def load_package(point: EntryPoint) -> tuple[str, ...]:
    """Import the module of an installed package and return the names of the effects that it registers.

    Raises:
        InputError: It cannot be imported, `register` refuses an effect of it, or it registers none; what it had
            registered is taken back.
    """
    if point.value in _REGISTERED:
        return _REGISTERED[point.value]
    before, known = registered(), point.module in sys.modules
    try:
        point.load()
        names = tuple(name for name in registered() if name not in before)
        if not names and not known:
            raise ValueError("a module that registers no effect")
    except (Exception, SystemExit) as error:
        take_back(name for name in registered() if name not in before)
        sys.modules.pop(point.module, None)
        wanted = "a module that registers effects"
        raise InputError(distribution_of(point), f"effect {point.name}", _fault(error), wanted) from error
    _REGISTERED[point.value] = names
    return names


def _fault(error: BaseException) -> str:
    """Return an error of another's module in one line; that of a refused effect says what was found."""
    return f"{error.place}: {error.found}" if isinstance(error, InputError) else fault_of(error)


when_asked(_load_packages)
