"""Cameras of a simulated world: colour, depth as a stereo camera measures it, labels.

Uses: `kernels.points`, `sim.base`, `sim.formats`, `sim.pictures`.
"""
