"""Measured cases with effects hidden in them, by a simulator and laws that share nothing with bough's own.

C MuJoCo with three times as many links as any model that is fitted. Nothing of ``bough.sim.effects`` or of the kernels
is imported; ``docs/hide.md`` states every law.

Uses: `sim.base`.
"""

from .exam import Spec, exam_plan
from .hide import hide
from .names import NAMES, OUTSIDE

__all__ = ["NAMES", "OUTSIDE", "Spec", "exam_plan", "hide"]
