"""Commands of robots and their cameras, policies on arms, recordings made into cases.

Uses: `sim.base`, `sim.engine`, `sim.arms`, `learn.cases`, `learn.gap`, `learn.touch`, `learn.robot`,
`learn.recordings`, `learn.cameras`, `learn.tasks`, `learn.policies`, `learn.probing`, `learn.deploy`, `cli.base`.
"""
