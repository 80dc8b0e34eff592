"""Effects that have a name, one file each; importing a file registers its effect."""

from . import cubic_stiffness as _cubic_stiffness  # noqa: F401, I001
from . import bilinear_stiffness as _bilinear_stiffness  # noqa: F401, I001
from . import dry_friction as _dry_friction  # noqa: F401, I001
from . import hysteresis_boucwen as _hysteresis_boucwen  # noqa: F401, I001
from . import quadratic_drag as _quadratic_drag  # noqa: F401, I001
from . import viscoelastic_sls as _viscoelastic_sls  # noqa: F401, I001
from . import tip_mass as _tip_mass  # noqa: F401, I001
from . import base_compliance as _base_compliance  # noqa: F401, I001
from . import backlash as _backlash  # noqa: F401, I001
from . import plastic_set as _plastic_set  # noqa: F401, I001
from . import partial_rupture as _partial_rupture  # noqa: F401, I001
from . import grasp_slip as _grasp_slip  # noqa: F401, I001
from . import time_delay as _time_delay  # noqa: F401, I001
from . import gravity_comp_error as _gravity_comp_error  # noqa: F401, I001
from . import force_bias as _force_bias  # noqa: F401, I001
from . import force_scale as _force_scale  # noqa: F401, I001
from . import steady_wind as _steady_wind  # noqa: F401, I001
from . import wind_gust as _wind_gust  # noqa: F401, I001
from . import anisotropic_stiffness as _anisotropic_stiffness  # noqa: F401, I001
from . import bending_torsion_coupling as _bending_torsion_coupling  # noqa: F401, I001
from .registry import Effect, EffectParameter, Law, Setting, effect_of, effects, register, terms_of

__all__ = ["Effect", "EffectParameter", "Law", "Setting", "effect_of", "effects", "register", "terms_of"]
