"""Prior densities of parameters.

Uses: `sim.base`, `sim.trees`, `learn.systems`.
"""
