"""Warp device code for batches of articulated trees; imports nothing but Warp.

- `real`, `algebra`: the scalar types (one world a thread, or 8 and 16 in SIMD lanes) and vectors over them.
- `layout`: the arrays a kernel reads and writes. `articulated`: the dynamics. `step`, `reset`, `observe`: kernels.
- `stability`: how much of a spring must be implicit. `raytrace`: pictures.
- `effects`, `terms`: laws that a branch may obey beside its springs. `rollout`, `inverse`: recorded trajectories.
- `arm`: a serial arm under velocity control. `collide`, `contact*`: whole-arm contact. `rupture`: joints that break.
- `point_cloud`, `embedding`, `nearest`, `cloud_tensors`: perception. `scene`, `task`: placing worlds, judging them.
- `philox`, `lanes`: random numbers that depend on counters alone, world by world and lane by lane.
"""
