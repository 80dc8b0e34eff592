"""The HTML page of a result, and its figures.

Uses: `sim.base`.
"""
