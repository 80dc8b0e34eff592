"""Effects that have a name, one file each; importing a file registers its effect.

Installed packages add theirs through the entry points `GROUP`: each names a module that registers effects.

Uses: `kernels.lanes`, `kernels.effects`, `sim.base`.
"""

import warnings
from importlib import import_module

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
    terms_of,
    when_asked,
)

__all__ = ["Effect", "EffectParameter", "Law", "Setting", "effect_of", "effects", "in_setting", "register", "terms_of"]

#: Group of entry points whose modules register effects.
GROUP = "bough_effects"

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
            point.load()
        except Exception as error:  # another's package; without it everything else still works
            who = f"{distribution_of(point)}: effect {point.name}"
            warnings.warn(f"{who} is left out: {fault_of(error)}", stacklevel=2)


when_asked(_load_packages)
