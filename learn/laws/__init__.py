"""What a law must keep to be an effect: read from its file, asked along motions, neutral, and recovered from data.

Uses: `kernels.effects`, `sim.base`, `sim.effects`, `learn.cases`, `learn.systems`, `learn.replay`, `learn.inference`.
"""

from .checks import Finding, check_law
from .load import law_from, not_compiled

__all__ = ["Finding", "check_law", "law_from", "not_compiled"]
