"""Measured joints with effects hidden in them: chains of links integrated here, laws in several published forms each.

Nothing of ``bough.sim.effects`` or of the kernels is imported; the form that a law has here is rarely the registry's.

Uses: ``sim.base``.
"""
