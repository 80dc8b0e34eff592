"""Commands of robots, of their cameras, of policies on them, and of what they record: recordings made into cases.

Uses: `sim.base`, `sim.engine`, `sim.arms`, `learn.cases`, `learn.touch`, `learn.robot`, `learn.recordings`,
`learn.cameras`, `learn.tasks`, `learn.policies`, `learn.deploy`, `cli.base`.
"""
