"""Sources of clouds by what a user types: ``twin``, ``realsense:SERIAL``, a folder, a bag."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ...sim.arms.arm import Arm
from ...sim.base.errors import InputError, shortened
from ...sim.cameras.pinhole import looking
from .calibration import Mounted, Rig, plain_rig, read_rig
from .colours import ByColour
from .pipeline import LIMIT, CameraClouds
from .source import Source, TwinSource
from .weights import digests, import_transformers
from .workers import Segmenter

#: Name of each camera of a twin, where it is, and what it looks at: ahead, to the side and above the arm's base [m].
TWIN_CAMERAS = tuple((name, np.array(place), np.array(seen)) for name, place, seen in (
    ("left", (0.1, 0.6, 0.75), (0.5, 0.0, 0.55)),
    ("right", (0.1, -0.6, 0.75), (0.5, 0.0, 0.55)),
    ("low", (0.0, 0.9, 0.0), (0.6, 0.0, -0.3)),
))  # fmt: skip
SPECS = "twin, realsense:SERIAL[,SERIAL...], a folder with cameras.yaml and frames.csv, or a ROS bag"


def open_clouds(
    spec: str, *, arm: Arm | None, url: str | None = None, token: str | None = None, certificate: Path | None = None,
    calibration: Path | None = None, weights: Path | None = None, prompts: Sequence[str] = (), limit: float = LIMIT,
) -> CameraClouds:  # fmt: skip
    """Open cameras and return their clouds; pictures begin to come some seconds later.

    Args:
        spec: Which cameras (`SPECS`).
        arm: The arm that is cut out of what they see; its joints are told by `CameraClouds.tell`. None for none.
        url: Of the twin's service, for ``twin``.
        token: What its clients say.
        certificate: PEM file that vouches for it.
        calibration: ``cameras.yaml``; None for the one in a folder, and for `twin_rig`.
        weights: Folder with the weights of a segmenter (`learn.cameras.grounded`); None for one that goes by colour.
        prompts: What it looks for as branches and as the line, two texts; empty for its own.
        limit: Greatest age of clouds [s].

    Raises:
        InputError: No such cameras, a calibration or weights that cannot be read, or an extra that is not installed.
    """
    if not 0 < limit < 3600:
        raise InputError("camera", "limit", f"{limit}", "seconds above zero")
    source, rig = open_source(spec, url=url, token=token, certificate=certificate, calibration=calibration)
    make = segmenter_of(rig, weights, prompts)
    if weights is None:
        return CameraClouds(source, rig, arm, limit=limit, segmenter=make)
    from .propagate import Propagate, has_tracker

    tracker = partial(Propagate, weights) if has_tracker(weights) else None
    return CameraClouds(source, rig, arm, limit=limit, segmenter=make, keyed=True, tracker=tracker)


def segmenter_of(rig: Rig, weights: Path | None, prompts: Sequence[str]) -> Callable[[], Segmenter]:
    """Return what makes a segmenter, by colour or with weights, whose SHA-256 are printed on stderr.

    Raises:
        InputError: Weights that cannot be used, prompts without weights, or an extra that is not installed.
    """
    if weights is None:
        if prompts:
            raise InputError("camera", "prompt", shortened(list(prompts)), "prompts for the weights of a segmenter")
        return partial(ByColour, rig)
    import_transformers()
    from .grounded import Grounded, check_prompts

    check_prompts(tuple(prompts))
    for file, digest in digests(weights).items():
        print(f"{file}: SHA-256 {digest}", file=sys.stderr, flush=True)
    return partial(Grounded, weights, rig, tuple(prompts))


def open_source(
    spec: str, *, url: str | None = None, token: str | None = None, certificate: Path | None = None,
    calibration: Path | None = None,
) -> tuple[Source, Rig]:  # fmt: skip
    """Return the source of pictures of a text, and its cameras; see `open_clouds`.

    Raises:
        InputError: As `open_clouds`.
    """
    kind, _, rest = spec.partition(":")
    if spec == "twin":
        if url is None:
            raise InputError("camera", "twin", "no service", "the address of bough robot serve --backend twin")
        rig = twin_rig() if calibration is None else read_rig(calibration)
        return TwinSource(url, rig, token=token, certificate=None if certificate is None else str(certificate)), rig
    if kind == "realsense":
        from .realsense import RealSenseSource

        if calibration is None:
            raise InputError("camera", "--calibration", "none", "cameras.yaml, which says where the cameras are")
        rig = read_rig(calibration)
        return RealSenseSource(rig, tuple(rest.split(","))), rig
    path = Path(spec)
    if not path.exists():
        raise InputError("camera", "", f"{shortened(spec)}", SPECS)
    return _recorded(path, calibration)


def _recorded(path: Path, calibration: Path | None) -> tuple[Source, Rig]:
    if path.is_dir() and (path / "frames.csv").exists():
        from .folder import FolderSource

        rig = read_rig(path / "cameras.yaml" if calibration is None else calibration)
        return FolderSource(path, rig), rig
    from .bag import BagSource

    if calibration is None:
        raise InputError(path, "--calibration", "none", "cameras.yaml, which names the topics of each camera")
    rig = read_rig(calibration)
    return BagSource(path, rig), rig


def twin_rig(bearing: float = -0.785) -> Rig:
    """Return three D405s about a twin's arm: two at its sides, which look at what is before it, and a low one.

    The two see the crown and the line; the low one sees the trunk, without which the cloud of all branches is another
    one than in training (`benchmarks/robots/cameras.py`).

    Args:
        bearing: Direction from the base to what is looked at, counted from x towards y [rad]; the default is where the
            Jaco 2 faces at home.
    """
    ahead = np.array([np.cos(bearing), np.sin(bearing), 0.0])
    frame = np.array([ahead, [-ahead[1], ahead[0], 0.0], [0.0, 0.0, 1.0]])  # ahead, side, up
    cameras = []
    for name, place, seen in TWIN_CAMERAS:
        rotation: Any = list(looking(place @ frame, seen @ frame))
        cameras.append(Mounted(name=name, position_m=(place @ frame).tolist(), rotation=rotation))
    rig = plain_rig(cameras)
    return replace(rig, box_low=np.array([*rig.box_low[:2], -1.6]))  # trees of a twin begin below its arm
