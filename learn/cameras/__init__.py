"""Cameras: frames, masks, clouds of points for a policy, and the processes between them.

Uses: `sim.base`, `sim.arms`, `sim.cameras`.
"""
