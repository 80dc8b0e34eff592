"""Names of hidden effects, and which of them are indistinguishable in principle."""

from __future__ import annotations

from collections.abc import Sequence

from . import joint_laws, outside_laws, sensor_laws, world_laws
from .parts import Recipe

#: Names of the case format's list, in its order.
NAMES = (
    "cubic_stiffness", "bilinear_stiffness", "dry_friction", "hysteresis_boucwen", "quadratic_drag",
    "viscoelastic_sls", "tip_mass", "base_compliance", "backlash", "plastic_set", "partial_rupture", "grasp_slip",
    "force_bias", "force_scale", "time_delay", "steady_wind", "wind_gust", "gravity_comp_error",
    "anisotropic_stiffness", "bending_torsion_coupling",
)  # fmt: skip
#: Effects that are not among the known ones.
OUTSIDE = tuple(outside_laws.RECIPES)
#: All of them.
RECIPES: dict[str, Recipe] = {
    **joint_laws.RECIPES, **world_laws.RECIPES, **sensor_laws.RECIPES, **outside_laws.RECIPES,
}  # fmt: skip

#: One gripper, turned little, held most of the time: a constant force is a bias, a tool's weight or, but for the rows
#: with the gripper open, a wind. Friction is the limit of Bouc and Wen's loop whose yield angle goes to zero.
_ALIKE = {
    "force_bias": ("gravity_comp_error", "steady_wind"),
    "gravity_comp_error": ("force_bias",),
    "steady_wind": ("force_bias",),
    "dry_friction": ("hysteresis_boucwen",),
}


def equivalents(names: Sequence[str]) -> dict[str, list[str]]:
    """Return the names that are indistinguishable in principle from the hidden ones."""
    return {name: [other for other in _ALIKE[name] if other not in names] for name in names if name in _ALIKE}
