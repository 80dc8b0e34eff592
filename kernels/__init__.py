"""Warp device code for batches of articulated trees; imports nothing but Warp.

- `real`, `algebra`: the scalar types (one world a thread, or 8 and 16 in SIMD lanes) and vectors over them.
- `layout`: the arrays a kernel reads and writes. `articulated`: the dynamics. `step`, `reset`, `observe`: kernels.
- `stability`: how much of a spring must be implicit. `raytrace`: pictures.
"""
