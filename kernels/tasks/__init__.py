"""Kernels of tasks: rewards, observations and measures as parts that are composed, control, placing scenes.

Uses: `kernels.lanes`.
"""
