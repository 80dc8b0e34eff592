"""How often a diagnosis is right: cases with hidden effects, on branches and on measured joints, graded alike.

Uses: `sim.base`, `learn.runs`, `learn.reports`, `learn.cases`, `learn.hidden`, `learn.hidden.joints`, `learn.gap`.
"""
