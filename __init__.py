"""bough: thousands of articulated trees in parallel, their springs, and the physics a model of them lacks.

Rooms, each importing only from those before it:

- ``bough.kernels``: Warp device code, usable alone in any Warp simulation.
- ``bough.sim``: trees, models, states, the simulator, files in and out, the Newton bridge.
- ``bough.perception``: point clouds, embeddings, occlusion, touch.
- ``bough.learn``: cases, inference, reports.

Units are SI (m, kg, s, rad, N) and quaternions are ``w, x, y, z`` everywhere.
"""

from .version import __version__

__all__ = ["__version__"]
