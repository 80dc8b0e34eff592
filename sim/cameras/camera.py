"""Several cameras that look at one world, in one batch."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ...kernels.points import camera as kernels
from ...kernels.points import raytrace
from ..base.errors import InputError
from ..formats.export_mesh import linear_light
from ..pictures.tracer import Ground, Sunlight, develop, lamp
from .label import Label
from .pinhole import Pinhole
from .stereo import StereoDepth
from .world import World

GROUND = Ground(color=(0.30, 0.31, 0.27), tile=0.5, contrast=0.1)
"""What cameras see below; its height is the world's."""


@dataclass(frozen=True)
class Shot:
    """What K cameras saw.

    Attributes:
        colour: sRGB, uint8 [K, H, W, 3].
        depth: As measured [m], float32 [K, H, W]; 0 where there is none.
        true_depth: As it is [m], float32 [K, H, W]; 0 for the sky.
        label: `Label` of what each pixel shows, uint8 [K, H, W].
    """

    colour: NDArray[np.uint8]
    depth: NDArray[np.float32]
    true_depth: NDArray[np.float32]
    label: NDArray[np.uint8]


class Cameras:
    """K cameras of one size, which may be elsewhere at every shot.

    Attributes:
        stereo: How they measure depth.
    """

    def __init__(
        self, width: int, height: int, *, stereo: StereoDepth | None = None, light: Sunlight | None = None,
        seed: int = 0, threads: int = 1, device: str = "cpu",
    ) -> None:  # fmt: skip
        """Load the kernels.

        Args:
            width: Of the pictures [pixels].
            height: Likewise.
            stereo: How depth is measured; None takes a D405.
            light: Sun and sky; None takes an overcast day, whose light comes from all around.
            seed: Seed of the noise; every shot draws anew.
            threads: Host threads that share the rows.
            device: Warp device.
        """
        self.stereo, self._size = StereoDepth() if stereo is None else stereo, (height, width)
        self._device, self._seed, self._shots = wp.get_device(device), int(seed), 0
        self._lamp = lamp(light or Sunlight(sun=(1.2, 1.15, 1.05), zenith=(0.9, 0.95, 1.0), horizon=(0.8, 0.85, 0.9),
                                            elevation=60.0), GROUND, self._device)  # fmt: skip
        self._pool = ThreadPoolExecutor(threads) if threads > 1 else None
        self._threads = threads
        wp.load_module(kernels, device=self._device)

    def shoot(self, world: World, cameras: Sequence[Pinhole]) -> Shot:
        """Return what cameras see of a world.

        Raises:
            InputError: A camera of another size, or none.
        """
        height, width = self._size
        for camera in cameras:
            if (camera.height, camera.width) != self._size:
                found = f"{camera.width} x {camera.height} pixels"
                raise InputError("camera", "size", found, f"{width} x {height}, that of the batch")
        if not cameras:
            raise InputError("camera", "", "no camera", "one or more")
        shape = (len(cameras), height, width)
        looked = self._look(world.cones_first(), cameras, shape)
        depth = wp.empty(shape, dtype=float, device=self._device)
        self._shots += 1
        seed = int(np.random.SeedSequence([self._seed, self._shots]).generate_state(1)[0] >> 1)
        wp.launch(kernels.measure, shape, [self.stereo.kernel, seed, *looked[1:3]], [depth], device=self._device)
        colour = develop(looked[0].numpy())
        return Shot(colour, depth.numpy(), looked[1].numpy(), looked[3].numpy())

    def _look(self, world: World, cameras: Sequence[Pinhole], shape: tuple[int, int, int]) -> list[Any]:
        solids, _tree = self._solids(world)
        labels = np.append(world.label, np.repeat(np.uint8(Label.BACKGROUND), 2))
        eyes: Any = wp.array([c.kernel for c in cameras], dtype=kernels.Eye, device=self._device)
        kinds = (wp.vec3, float, float, wp.uint8)
        out = [wp.empty(shape, dtype=kind, device=self._device) for kind in kinds]
        baseline = self.stereo.baseline if self.stereo.graze[1] > 0.0 else 0.0
        there: Any = wp.array(labels, dtype=wp.uint8, device=self._device)
        inputs = [solids, self._lamp, eyes, there, baseline]
        wp.launch(kernels.look, shape, inputs, out, device=self._device)
        return out

    def _solids(self, world: World) -> tuple[Any, wp.Bvh]:
        """Return the kernel's solids, and the tree of their boxes, which lives as long as somebody holds it."""

        def there(values: Any, kind: type) -> wp.array:
            """Return float32 values as an array of a Warp type on the device."""
            return wp.array(np.ascontiguousarray(values, np.float32), dtype=kind, device=self._device)

        out, s = raytrace.Solids(), world.solids
        out.start = there(np.column_stack([s.start, s.radius[:, 0]]), wp.vec4)
        out.end = there(np.column_stack([s.end, s.radius[:, 1]]), wp.vec4)
        out.side = there(s.side, wp.vec3)
        out.color = there(np.column_stack([linear_light(s.color), s.through]), wp.vec4)
        out.ground, out.ground_color = world.ground, wp.vec3(*GROUND.color)
        out.tile, out.contrast = GROUND.tile, GROUND.contrast
        low, high = s.boxes()
        tree = wp.Bvh(there(low, wp.vec3), there(high, wp.vec3), constructor="sah" if self._device.is_cpu else None)
        out.seen = tree.id
        return out, tree
