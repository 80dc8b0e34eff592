"""Cameras of a simulated world: colour, depth as a stereo camera measures it, labels.

Uses: `kernels.points`, `sim.base`, `sim.arms`, `sim.formats`, `sim.pictures`.
"""
