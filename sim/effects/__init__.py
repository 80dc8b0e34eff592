"""Effects that have a name, one file each; importing a file registers its effect.

Uses: `kernels.lanes`, `kernels.effects`, `sim.base`.
"""

from importlib import import_module

from .registry import Effect, EffectParameter, Law, Setting, effect_of, effects, register, terms_of

__all__ = ["Effect", "EffectParameter", "Law", "Setting", "effect_of", "effects", "register", "terms_of"]

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
