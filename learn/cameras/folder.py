"""Pictures in a folder: ``frames.csv`` with a line for each, ``cameras.yaml`` beside it.

    time_s,camera,colour,depth,q1_rad,q2_rad,...
    0.000,left,left_0000.png,left_0000.npz,4.80,2.92,...

Colour is a PNG or JPEG; depth is an NPZ or NPY of metres (in an NPZ under ``depth``), or a PNG of 16 bits of
millimetres. Joint positions may be left out.
"""

from __future__ import annotations

import csv
import io
import math
import time
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import PIL.Image
from numpy.typing import NDArray

from ...sim.base.archive import read_array, read_arrays
from ...sim.base.errors import InputError, shortened
from ...sim.base.files import check_regular, read_text
from ...sim.base.types import Array
from .calibration import Rig
from .source import Taken

LARGEST = 64 << 20
"""Bytes of a picture's file at most."""

_MOST = 4096  # pixels each way


@dataclass(frozen=True)
class _Line:
    time: float
    camera: int
    colour: Path
    depth: Path
    q: Array | None


class FolderSource:
    """Plays the pictures of a folder at the pace at which they were taken (`learn.cameras.source.Source`)."""

    def __init__(self, folder: Path, rig: Rig) -> None:
        """Read the list and the first picture of each camera.

        Raises:
            InputError: The list or a picture cannot be read, or a camera has no intrinsics or no picture.
        """
        self._folder, self._rig = folder, rig
        self._lines = _read_list(folder, rig)
        sizes = []
        for k, camera in enumerate(rig.cameras):
            if camera.intrinsics_px is None:
                raise InputError(folder, camera.name, "no intrinsics_px in cameras.yaml", "fx, fy, cx, cy [pixels]")
            first = next((line for line in self._lines if line.camera == k), None)
            if first is None:
                raise InputError(folder / "frames.csv", "camera", f"no picture of {camera.name}", "one of each camera")
            height, width = read_depth(first.depth).shape
            sizes.append((height, width))
        self.sizes = tuple(sizes)

    def __len__(self) -> int:
        """Return the number of pictures."""
        return len(self._lines)

    def frames(self) -> Iterator[Taken]:
        """Yield the pictures, the first one now.

        Raises:
            InputError: A picture cannot be read, or has another size than the first of its camera.
        """
        begun = time.monotonic()
        for line in self._lines:
            time.sleep(max(0.0, begun + line.time - self._lines[0].time - time.monotonic()))
            yield self._taken(line, begun + line.time - self._lines[0].time)

    def still(self) -> Iterator[Taken]:
        """Yield the pictures at their own times [s], without waiting.

        Raises:
            InputError: As `frames`.
        """
        for line in self._lines:
            yield self._taken(line, line.time)

    def _taken(self, line: _Line, at: float) -> Taken:
        colour, depth = read_colour(line.colour), read_depth(line.depth)
        size = self.sizes[line.camera]
        for path, found in ((line.colour, colour.shape[:2]), (line.depth, depth.shape)):
            if found != size:
                raise InputError(path, "", f"{found[1]} x {found[0]} pixels", f"{size[1]} x {size[0]}")
        given = self._rig.cameras[line.camera].intrinsics_px
        assert given is not None
        return Taken(line.camera, at, colour, depth, (given[0], given[1], given[2], given[3]), line.q)


def _read_list(folder: Path, rig: Rig) -> list[_Line]:
    path = folder / "frames.csv"
    rows = csv.DictReader(io.StringIO(read_text(path)))
    names, columns = [c.name for c in rig.cameras], list(rows.fieldnames or [])
    joints = [c for c in columns if c.startswith("q") and c.endswith("_rad")]
    wanted = ["time_s", "camera", "colour", "depth", *(f"q{k + 1}_rad" for k in range(len(joints)))]
    if columns != wanted:
        raise InputError(path, "header", ",".join(columns)[:80], "time_s,camera,colour,depth[,q1_rad,...]")
    out = [_read_line(folder, path, n, row, names, joints) for n, row in enumerate(rows, start=2)]
    if not out or any(b.time < a.time for a, b in pairwise(out)):
        raise InputError(path, "time_s", "no pictures, or times that go back", "pictures in the order of their times")
    return out


def _read_line(
    folder: Path, path: Path, number: int, row: dict[str, str], names: list[str], joints: list[str]
) -> _Line:  # fmt: skip
    if row["camera"] not in names:
        raise InputError(path, f"line {number}", f"camera {shortened(row['camera'])}", ", ".join(names))
    try:
        numbers = [float(row[c]) for c in ("time_s", *joints)]
    except (TypeError, ValueError):
        numbers = [math.nan]
    if not all(math.isfinite(x) for x in numbers):
        raise InputError(path, f"line {number}", "a time or a joint position that is no number", "finite numbers")
    colour, depth = (folder / (row[c] or "") for c in ("colour", "depth"))
    for file in (colour, depth):
        if folder.resolve() not in file.resolve().parents or not file.is_file():
            raise InputError(path, f"line {number}", f"no file {shortened(file.name)}", "files in the folder")
    return _Line(numbers[0], names.index(row["camera"]), colour, depth, np.array(numbers[1:]) if joints else None)


def read_colour(path: Path) -> NDArray[np.uint8]:
    """Read a picture as sRGB, uint8 [H, W, 3].

    Raises:
        InputError: It is no picture, or too large.
    """
    check_regular(path, LARGEST)
    try:
        with PIL.Image.open(path) as picture:
            _check_size(path, picture.height, picture.width)
            return np.asarray(picture.convert("RGB"))
    except (OSError, ValueError, PIL.Image.DecompressionBombError) as error:
        raise InputError(path, "", shortened(str(error)), "a PNG or JPEG") from None


def read_depth(path: Path) -> NDArray[np.float32]:
    """Read depths [m], float32 [H, W]; what is no number or not above zero becomes 0.

    Raises:
        InputError: It is no picture of depths.
    """
    depth = _picture(path) if path.suffix == ".png" else _array(path)
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(0.0))


_DEPTHS = "depths as 16-bit PNG [mm], NPZ or NPY [m]"


def _picture(path: Path) -> NDArray[np.float32]:
    check_regular(path, LARGEST)
    try:
        with PIL.Image.open(path) as picture:
            _check_size(path, picture.height, picture.width)
            if picture.mode not in ("I;16", "I"):
                raise ValueError(f"a picture of mode {picture.mode}")
            return np.asarray(picture, np.float32) / np.float32(1000.0)
    except InputError:
        raise
    except (OSError, ValueError, PIL.Image.DecompressionBombError) as error:
        raise InputError(path, "", shortened(str(error)), _DEPTHS) from None


def _array(path: Path) -> NDArray[np.float32]:
    packed = path.suffix == ".npz"
    depth = read_arrays(path, _DEPTHS, ("depth",), LARGEST)["depth"] if packed else read_array(path, _DEPTHS, LARGEST)
    if depth.ndim != 2 or depth.dtype.kind != "f":
        raise InputError(path, "", f"numbers of type {depth.dtype} and shape {depth.shape}", _DEPTHS)
    _check_size(path, *depth.shape)
    return depth.astype(np.float32)


def _check_size(path: Path, height: int, width: int) -> None:
    if not (0 < height <= _MOST and 0 < width <= _MOST):
        raise InputError(path, "", f"{width} x {height} pixels", f"1 to {_MOST} each way")
