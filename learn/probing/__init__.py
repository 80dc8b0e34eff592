"""Experiments that run themselves: pull a branch, diagnose what was measured, pull what tells most next.

Uses: `sim.base`, `sim.arms`, `sim.trees`, `learn.runs`, `learn.cases`, `learn.systems`, `learn.replay`,
`learn.gap`, `learn.gap.models`, `learn.robot`, `learn.recordings`.
"""
