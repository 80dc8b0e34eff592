"""Recorded trajectories replayed with many sets of parameters; inverse dynamics along them.

Uses: `kernels.tree`, `kernels.effects`, `sim.base`, `sim.effects`, `sim.engine`, `sim.pictures`, `learn.cases`,
`learn.systems`.
"""
