"""Gusts of any course in time: whether a branch sways untouched, and the course that every recording shows.

Uses: `sim.base`, `sim.effects`, `learn.cases`, `learn.systems`, `learn.replay`, `learn.gap.models`.
"""
