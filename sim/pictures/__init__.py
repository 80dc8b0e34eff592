"""Pictures of trees and figures of motions.

Uses: `kernels.points`, `sim.base`, `sim.trees`, `sim.engine`, `sim.formats`.
"""
