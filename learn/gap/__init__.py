"""The gap between simulation and measurement: where it is, what is missing, and what is left once that is added.

Uses: `sim.base`, `sim.effects`, `sim.trees`, `sim.engine`, `learn.runs`, `learn.reports`, `learn.cases`,
`learn.systems`, `learn.replay`, `learn.inference`, `learn.gap.models`,
`learn.gap.gusts`.
"""

#: Change of the motion, as a share of its rms, below which a missing effect is of no interest: what is no effect, such
#: as wood that bends, came to 0.0039 at most in a hundred cases.
TOLERANCE = 0.0055
