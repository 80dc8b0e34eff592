"""Chapter 5: clearing a power line.

Uses: `sim.base`, `perception`, `learn.runs`, `learn.reports`, `learn.tasks`, `learn.policies`, `learn.thesis.chapter3`,
`learn.thesis.common`.
"""
