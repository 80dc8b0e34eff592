"""Dynamics of articulated trees: memory layout, the step, stability, momentum, inverse dynamics, reset, replay.

Uses: `kernels.lanes`.
"""
