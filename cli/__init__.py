"""The commands of ``bough``, one file each. Nothing imports them.

Uses: `sim.base`, `sim.effects`, `sim.trees`, `sim.engine`, `sim.formats`, `sim.wood`, `sim.pictures`, `learn.runs`,
`learn.cases`, `learn.systems`, `learn.replay`, `learn.inference`, `learn.hidden`, `learn.gap`, `learn.exam`,
`learn.tasks`, `learn.policies`, `learn.thesis.chapter3`, `learn.thesis.chapter5`.
"""
