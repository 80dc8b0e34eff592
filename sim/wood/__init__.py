"""What was learnt of a measured branch (model.yaml, posterior.npz), given to grown trees.

Uses: `sim.base`, `sim.effects`, `sim.trees`, `sim.engine`.
"""
