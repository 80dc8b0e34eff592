"""Looking at a calibration: pictures of a recording or of live cameras, their masks, and the cloud that they give."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ...sim.arms.arm import Arm, forward_kinematics
from ...sim.base.errors import InputError
from ...sim.base.files import output_folder
from ...sim.base.types import Array
from ...sim.cameras.label import Label
from .calibration import Rig
from .clouds import capsules_at, cloud_of, joined
from .frames import Clouds, Frame
from .picture import masked, save_cloud, save_masks
from .source import Source, Taken
from .workers import Segmenter

MOST = 300
"""Pictures that are looked through for one of each camera."""


@dataclass(frozen=True)
class Checked:
    """What was found.

    Attributes:
        clouds: Of one picture of each camera.
        shares: By camera: share of pixels with a depth, and of those with each mask and in the cloud.
    """

    clouds: Clouds
    shares: dict[str, dict[str, float]]


def look(source: Source, rig: Rig, segmenter: Segmenter, arm: Arm | None, q: Array | None, out: Path) -> Checked:
    """Write ``masks.png`` and ``cloud.png`` of the first picture of each camera.

    Args:
        source: Takes the pictures.
        rig: The cameras.
        segmenter: Makes the masks.
        arm: The arm, None for none.
        q: Its joints where the source does not tell them [rad], None for nobody knows.
        out: Folder to write.

    Raises:
        InputError: A camera without a picture, one on the hand of an arm whose joints nobody tells, or as ``source``.
    """
    taken = _first(source, rig)
    own = next((t.q for t in taken if t.q is not None), q)
    if arm is not None and own is not None and len(own) != arm.num_dofs:
        raise InputError("camera", "joints", f"{len(own)} with the pictures", f"{arm.num_dofs}, as the arm has")
    hand = None if arm is None or own is None else forward_kinematics(arm, own)[2]
    body = None if arm is None or own is None else capsules_at(arm, own)
    pictures, parts, shares = [], [], {}
    for t, camera in zip(taken, rig.cameras, strict=True):
        pose = camera.pose(hand)
        if pose is None:
            raise InputError("cameras.yaml", camera.name, "mount: hand, and no joint positions", "joints with pictures")
        frame = Frame(t.time, t.colour, t.depth, t.intrinsics, *pose)
        labels = segmenter.label(frame)
        known = rig.ground is None and np.isfinite(t.ground)
        points = cloud_of(frame, labels, replace(rig, ground=t.ground) if known else rig, body)
        parts.append((t.time, *points))
        pictures.append(masked(frame, labels, body))
        has = frame.depth > 0
        shares[camera.name] = {"depth": float(has.mean()), "cloud": sum(len(p) for p in points) / has.size} | {
            kind.name.lower(): float((labels == kind).mean()) for kind in (Label.BRANCH, Label.LINE)
        }
    clouds = joined(parts, rig.grain)
    with output_folder(out) as folder:
        save_masks(folder / "masks.png", pictures)
        save_cloud(folder / "cloud.png", clouds, rig, arm, own)
    return Checked(clouds, shares)


def _first(source: Source, rig: Rig) -> list[Taken]:
    still = getattr(source, "still", source.frames)
    found: dict[int, Taken] = {}
    pictures: Iterator[Taken] = itertools.islice(still(), MOST)
    for taken in pictures:
        found.setdefault(taken.camera, taken)
        if len(found) == len(rig.cameras):
            break
    for k, camera in enumerate(rig.cameras):
        if k not in found:
            raise InputError(
                "camera", camera.name, f"no picture among the first {MOST}", "a camera that takes pictures"
            )
    return [found[k] for k in range(len(rig.cameras))]


def spread(clouds: Clouds) -> str:
    """Say in words how large clouds are: points, and how far the line reaches [m]."""
    reach = float(np.ptp(clouds.line, axis=0).max()) if len(clouds.line) else 0.0
    return f"{len(clouds.branches)} points on branches, {len(clouds.line)} on the line over {reach:.2f} m"
