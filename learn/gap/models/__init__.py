"""Many models of one case, fitted side by side: candidate effects, the batch, its fits, the scan, the search's levels.

Uses: `sim.base`, `sim.effects`, `sim.formats`, `learn.cases`, `learn.systems`, `learn.replay`.
"""
