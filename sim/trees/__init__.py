"""Descriptions of trees: grown by rules, fractal, measured, culled; stiffness models and host kinematics.

Uses: `sim.base`.
"""
