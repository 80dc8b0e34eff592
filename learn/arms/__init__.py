"""An arm's own gap: recordings of a free arm against a known mechanism with servos, and what the servos' model lacks.

Uses: `sim.base`, `sim.arms`, `learn.cases`, `learn.reports`.
"""
