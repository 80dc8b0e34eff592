"""A module that stands for pyrealsense2: two cameras of constant pictures, one of which may be missing."""

from __future__ import annotations

import types

import numpy as np

SCALE = 1e-4  # m, a D405's depth unit
MISSING = "000"


class _Frame:
    def __init__(self, data):
        self._data = data

    def get_data(self):
        return self._data


class _Pair:
    def __init__(self, level):
        self._level = level

    def get_color_frame(self):
        return _Frame(np.full((480, 848, 3), self._level, np.uint8))

    def get_depth_frame(self):
        return _Frame(np.full((480, 848), 5000 + self._level, np.uint16))


class _Profile:
    def get_device(self):
        return types.SimpleNamespace(first_depth_sensor=lambda: types.SimpleNamespace(get_depth_scale=lambda: SCALE))

    def get_stream(self, stream):
        assert stream == "color"
        lens = types.SimpleNamespace(fx=430.0, fy=431.0, ppx=420.0, ppy=240.0)
        return types.SimpleNamespace(as_video_stream_profile=lambda: types.SimpleNamespace(get_intrinsics=lambda: lens))


class _Config:
    serial = ""

    def enable_device(self, serial):
        self.serial = serial

    def enable_stream(self, stream, width, height, kind, rate):
        assert (width, height, rate) == (848, 480, 30) and (stream, kind) in (("depth", "z16"), ("color", "rgb8"))


class _Pipeline:
    stopped = 0

    def start(self, config):
        if config.serial == MISSING:
            raise RuntimeError("No device connected")
        self._level, self._late = int(config.serial), 1
        return _Profile()

    def wait_for_frames(self, _ms):
        if self._late:
            self._late -= 1
            raise RuntimeError("Frame didn't arrive within 1000")
        return _Pair(self._level)

    def stop(self):
        _Pipeline.stopped += 1


def module() -> types.ModuleType:
    """Return the module."""
    out = types.ModuleType("pyrealsense2")
    out.pipeline, out.config = _Pipeline, _Config
    out.align = lambda _stream: types.SimpleNamespace(process=lambda pair: pair)
    out.stream = types.SimpleNamespace(depth="depth", color="color")
    out.format = types.SimpleNamespace(z16="z16", rgb8="rgb8")
    return out
