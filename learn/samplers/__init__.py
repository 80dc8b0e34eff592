"""Samplers of one interface, SVGD among them, and their diagnostics.

Uses: `sim.base`.
"""
