"""Tasks that policies are trained on: environments whose tensors never leave the device.

Uses: `kernels.tasks`, `kernels.touch`, `sim.base`, `sim.trees`, `sim.formats`, `sim.wood`, `sim.arms`, `sim.scenes`,
`sim.pictures`, `perception`, `learn.runs`, `learn.touch`.
"""
