"""Trained policies on an arm behind `bough robot serve`: observation, loop, log, report; and twins that hold a task.

Uses: `kernels.tasks`, `sim.base`, `sim.arms`, `sim.cameras`, `sim.formats`, `sim.pictures`, `perception`,
`learn.runs`, `learn.reports`, `learn.touch`, `learn.robot`, `learn.cameras`, `learn.tasks`, `learn.policies`.
"""
