"""Sources of pictures and segmenters that do as a test wants, picklable for other processes."""

from __future__ import annotations

import time
from dataclasses import dataclass, field

import numpy as np
from bough.learn.cameras.calibration import Mounted, Rig, plain_rig
from bough.learn.cameras.source import Taken
from bough.sim.cameras.label import Label

SIZE = (24, 32)
LENS = (30.0, 30.0, 15.5, 11.5)
DEPTH = 0.5


def level_rig(count: int = 1) -> Rig:
    """Return cameras at the origin that look along x, z up."""
    rotation = [0.5, -0.5, 0.5, -0.5]
    return plain_rig([Mounted(name=f"c{k}", position_m=[0.0, 0.0, 0.0], rotation=rotation) for k in range(count)])


@dataclass
class Wall:
    """A wall at half a metre, thirty times a second; the upper half is the line's red, the rest is brown."""

    cameras: int = 1
    freeze_at: int = 10**9
    silent_at: int = 10**9
    end_at: int = 10**9
    sizes: tuple = field(default=())

    def __post_init__(self):
        self.sizes = (SIZE,) * self.cameras

    def frames(self):
        """Yield pictures; from ``freeze_at`` on camera 0 repeats one, from ``silent_at`` on nothing comes."""
        random = np.random.default_rng(0)
        colour = np.full((*SIZE, 3), (110, 80, 40), np.uint8)
        colour[: SIZE[0] // 2] = (178, 26, 20)
        held = None
        for number in range(self.end_at):
            while number >= self.silent_at:
                time.sleep(1.0)
            for k in range(self.cameras):
                depth = (DEPTH + 0.001 * random.standard_normal(SIZE)).astype(np.float32)
                if k == 0 and number >= self.freeze_at:
                    held = depth if held is None else held
                    depth = held
                yield Taken(k, time.monotonic(), colour, depth, LENS)
            time.sleep(1 / 30)


@dataclass
class Slow:
    """A segmenter that takes its time: the upper half is the line, the rest branches."""

    seconds: float = 1.0

    def label(self, frame):
        """Return the labels, late."""
        time.sleep(self.seconds)
        out = np.full(frame.depth.shape, Label.BRANCH, np.uint8)
        out[: len(out) // 2] = Label.LINE
        return out


@dataclass
class Carry:
    """A tracker that hands on the labels of the last key frame."""

    kept: object = None

    def begin(self, frame, labels):
        """Keep labels."""
        self.kept = labels

    def label(self, frame):
        """Return them."""
        return self.kept
