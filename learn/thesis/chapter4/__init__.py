"""Chapter 4: reaching gently by touch.

Uses: `sim.base`, `sim.trees`, `sim.scenes`, `learn.runs`, `learn.reports`, `learn.touch`, `learn.tasks`,
`learn.policies`, `learn.thesis.common`.
"""
