"""Contact of an arm, branches, a line and the ground: finding contacts, solving them together, the step.

Uses: `kernels.lanes`, `kernels.tree`, `kernels.effects`.
"""
