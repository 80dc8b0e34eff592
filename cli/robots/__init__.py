"""Commands of robots and of what they record: service, recordings made into cases.

Uses: `sim.base`, `sim.engine`, `sim.arms`, `learn.cases`, `learn.robot`, `learn.recordings`, `learn.touch`, `cli.base`.
"""
