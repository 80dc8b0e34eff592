"""Tasks as Gymnasium environments: the same worlds in the same memory, behind Gymnasium's interface.

Uses: `sim.base`, `learn.tasks`.
"""
