"""Newton models from trees and back, and a Newton solver that steps with these kernels.

Uses: `kernels.tree`, `sim.base`, `sim.trees`, `sim.engine`.
"""
