"""Scenes: which tree, line and target stand where in every world.

Uses: `kernels.tasks`, `sim.base`, `sim.trees`, `sim.engine`, `sim.formats`, `sim.wood`, `sim.arms`.
"""
