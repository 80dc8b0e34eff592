"""From a case to a posterior: target, modes, particles, prediction, `bough identify`.

Uses: `sim.base`, `sim.pictures`, `learn.runs`, `learn.reports`, `learn.cases`, `learn.systems`, `learn.replay`,
`learn.priors`, `learn.samplers`.
"""
