"""What robots sense: clouds of points, their kernel mean embeddings, occlusion, nearness.

- `embed`, `occlusion`: of any torch clouds. `sensor`: of a simulator's worlds, straight into the observation.
- `frequencies`: of the random Fourier features. `taichi_kernels`: the stateless ones for Taichi-based simulators; needs
  the extra ``taichi``.

Uses: `kernels.lanes`, `kernels.points`, `sim.base`, `sim.engine`.
"""

from .embedding import embed, occlusion

__all__ = ["embed", "occlusion"]
