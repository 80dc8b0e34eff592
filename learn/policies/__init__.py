"""Training, testing and filming policies.

Uses: `sim.base`, `sim.wood`, `learn.runs`, `learn.reports`, `learn.tasks`.
"""
