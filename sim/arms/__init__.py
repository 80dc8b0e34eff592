"""Serial arms: descriptions, the Jaco 2, URDF, and the simulator of an arm among branches.

Uses: `kernels.effects`, `kernels.tree`, `kernels.contact`, `sim.base`, `sim.trees`, `sim.engine`,
`sim.formats`.
"""
