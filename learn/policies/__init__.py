"""Training, testing and filming policies.

Uses: `sim.base`, `sim.wood`, `sim.arms`, `learn.runs`, `learn.reports`, `learn.tasks`.
"""
