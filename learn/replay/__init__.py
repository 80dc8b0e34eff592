"""Recorded trajectories replayed with many sets of parameters; inverse dynamics along them.

Uses: `kernels.tree`, `kernels.effects`, `sim.base`, `sim.effects`, `sim.trees`, `sim.engine`, `sim.pictures`,
`learn.reports`, `learn.cases`, `learn.systems`.
"""
