"""Kernels of tasks: placing a scene, rewards, observations.

Uses: `kernels.lanes`.
"""
