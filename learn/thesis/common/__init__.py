"""What chapters share: trainings side by side, their tables and page, means over seeds.

Uses: `sim.base`, `learn.runs`, `learn.reports`, `learn.tasks`, `learn.policies`.
"""
