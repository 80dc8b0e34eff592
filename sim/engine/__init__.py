"""Model, state and simulator: descriptions become arrays, and worlds step.

Uses: `kernels.lanes`, `kernels.tree`, `kernels.effects`, `sim.base`, `sim.effects`, `sim.trees`.
"""
