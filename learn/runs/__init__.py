"""What long runs share: checkpoints, run folders, threads, processes.

Uses: `sim.base`.
"""
