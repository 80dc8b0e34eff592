"""Cases, posteriors and policies on a page in the browser.

Uses: `sim.base`, `sim.trees`, `sim.view`, `learn.cases`, `learn.systems`, `learn.priors`, `learn.replay`,
`learn.tasks`, `learn.policies`.
"""
