"""The commands of ``bough``, one file each. Nothing imports them.

Uses: `sim.base`, `sim.effects`, `sim.trees`, `sim.engine`, `sim.formats`, `sim.wood`, `sim.arms`, `sim.pictures`,
`sim.view`, `learn.runs`, `learn.cases`, `learn.systems`, `learn.replay`, `learn.samplers`, `learn.inference`,
`learn.hidden`, `learn.gap`, `learn.exam`, `learn.laws`, `learn.tasks`, `learn.policies`, `learn.touch`,
`learn.view`, `learn.arms`, `learn.thesis.chapter3`, `learn.thesis.chapter5`, `learn.thesis.chapter4`, `cli.base`,
`cli.robots`.
"""
