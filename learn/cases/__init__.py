"""Measured cases: reading, checking, noise of their channels.

Uses: `sim.base`, `sim.trees`, `sim.formats`, `sim.arms`.
"""
