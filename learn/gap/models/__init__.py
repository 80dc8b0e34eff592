"""Many models of one case, fitted side by side: candidate effects, the batch, its fits, the scan, the search's levels.

Uses: `sim.base`, `sim.effects`, `learn.cases`, `learn.systems`, `learn.replay`.
"""
