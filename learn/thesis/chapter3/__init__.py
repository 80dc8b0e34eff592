"""Chapter 3: identification of a branch's springs.

Uses: `sim.base`, `learn.runs`, `learn.reports`, `learn.cases`, `learn.systems`, `learn.replay`, `learn.priors`,
`learn.samplers`, `learn.inference`.
"""
