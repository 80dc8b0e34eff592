"""Files in and out: MJCF, URDF, meshes.

Uses: `sim.base`, `sim.trees`, `sim.engine`, `sim.newton`.
"""
