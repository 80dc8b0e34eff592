"""Recordings of people and robots made into case folders: measured tables, bags.

Uses: `sim.base`, `sim.trees`, `sim.formats`, `sim.arms`, `learn.cases`, `learn.robot`.
"""
