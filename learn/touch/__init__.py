"""Touch felt in an arm's joint torques: recordings, features, classifiers, how well they do.

Uses: `kernels.touch`, `sim.base`, `sim.trees`, `sim.arms`, `learn.reports`, `learn.cases`.
"""
