"""The systems that cases describe (branches, joints, mechanisms) and their unknown parameters.

Uses: `kernels.effects`, `sim.base`, `sim.effects`, `sim.trees`, `sim.engine`, `sim.formats`, `sim.wood`, `learn.cases`.
"""
