"""Commands of robots, of their cameras, and of what they record: service, recordings made into cases.

Uses: `sim.base`, `sim.engine`, `sim.arms`, `learn.cases`, `learn.robot`, `learn.recordings`, `learn.cameras`,
`learn.touch`, `cli.base`.
"""
