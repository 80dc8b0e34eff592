"""Intel RealSense cameras through pyrealsense2, which is imported only here and only when a camera is opened."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np

from ...sim.base.errors import InputError
from ...sim.cameras.stereo import D405_HEIGHT, D405_WIDTH
from .calibration import Rig, check_names
from .source import RATE, Taken

_WAIT = 1000  # ms for a picture


class RealSenseSource:
    """Cameras by their serial numbers, which are their names in the rig (`learn.cameras.source.Source`).

    Depth is registered to colour by the camera's library. A picture's time is when it came here, less nothing: the
    delay within the camera is not known to it, so that clouds are somewhat older than they are said to be.
    """

    def __init__(self, rig: Rig, serials: tuple[str, ...]) -> None:
        """Take the cameras; they are opened by `frames`.

        Raises:
            InputError: A serial number that the rig does not name, or a camera of the rig that is not given.
        """
        check_names(rig, "cameras.yaml", list(serials))
        if len(serials) != len(rig.cameras):
            found = f"{len(serials)} serial numbers for {len(rig.cameras)} cameras"
            raise InputError("camera", "realsense", found, "realsense:SERIAL[,SERIAL...], one for each camera")
        self._rig = rig
        self.sizes = ((D405_HEIGHT, D405_WIDTH),) * len(rig.cameras)

    def frames(self) -> Iterator[Taken]:
        """Yield pictures as they come.

        Raises:
            InputError: pyrealsense2 is not installed, or a camera cannot be opened.
        """
        try:
            import pyrealsense2 as rs
        except ImportError:
            raise InputError("camera", "realsense", "no pyrealsense2", "pip install pyrealsense2") from None
        opened = [self._opened(rs, camera.name) for camera in self._rig.cameras]
        align = rs.align(rs.stream.color)
        try:
            while True:
                for k, (pipeline, scale, lens) in enumerate(opened):
                    try:
                        pair = align.process(pipeline.wait_for_frames(_WAIT))
                    except RuntimeError:  # none came in time: the others go on, and this one's clouds grow old
                        continue
                    at, colour, depth = time.monotonic(), pair.get_color_frame(), pair.get_depth_frame()
                    if colour and depth:
                        metres = np.asarray(depth.get_data()).astype(np.float32) * np.float32(scale)
                        yield Taken(k, at, np.asarray(colour.get_data()).copy(), metres, lens)
        finally:
            for pipeline, _, _ in opened:
                pipeline.stop()

    def _opened(self, rs: Any, serial: str) -> tuple[Any, float, tuple[float, float, float, float]]:
        pipeline, config = rs.pipeline(), rs.config()
        config.enable_device(serial)
        config.enable_stream(rs.stream.depth, D405_WIDTH, D405_HEIGHT, rs.format.z16, round(RATE))
        config.enable_stream(rs.stream.color, D405_WIDTH, D405_HEIGHT, rs.format.rgb8, round(RATE))
        try:
            profile = pipeline.start(config)
        except RuntimeError as error:
            raise InputError("camera", f"realsense:{serial}", str(error), "a camera that is connected") from None
        scale = float(profile.get_device().first_depth_sensor().get_depth_scale())
        lens = profile.get_stream(rs.stream.color).as_video_stream_profile().get_intrinsics()
        return pipeline, scale, (float(lens.fx), float(lens.fy), float(lens.ppx), float(lens.ppy))
