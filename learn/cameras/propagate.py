"""Masks carried from a key frame to the pictures after it by SAM 2's memory (Ravi et al. 2024), fast enough to follow.

The library's EdgeTAM, which would be faster, has a backbone of the timm library, which wants torchvision.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn.functional import interpolate

from ...sim.cameras.label import Label
from .colours import Labels
from .frames import Frame
from .grounded import picture
from .weights import colours, find_models, import_transformers, load

_OBJECTS = (Label.BRANCH, Label.LINE)
_REMEMBERED = 24  # pictures: more than the model's memory of masks and of pointers to objects


def has_tracker(weights: Path) -> bool:
    """Tell whether a folder of weights has a video model.

    Raises:
        InputError: As `learn.cameras.weights.find_models`.
    """
    return "sam2_video" in find_models(weights)


@lru_cache(maxsize=1)
def _model(weights: Path) -> Any:
    """Load the model once for all cameras of a process."""
    torch.set_num_threads(1)
    return load(import_transformers().Sam2VideoModel, find_models(weights)["sam2_video"])


class Propagate:
    """Carries masks on (`learn.cameras.workers.Tracker`)."""

    def __init__(self, weights: Path) -> None:
        """Load the model.

        Raises:
            InputError: The library is missing, or the weights cannot be used.
        """
        self._model, self._colours = _model(weights), colours(find_models(weights)["sam2_video"])
        self._session: Any = None
        self._number, self._kinds = 0, list(_OBJECTS)

    @torch.inference_mode()
    def begin(self, frame: Frame, labels: Labels) -> None:
        """Take a key frame and its masks; what was remembered before is forgotten."""
        from transformers.models.sam2_video.modeling_sam2_video import Sam2VideoInferenceSession

        height, width = frame.depth.shape
        self._session = Sam2VideoInferenceSession(video_height=height, video_width=width, dtype=torch.float32)
        self._kinds = [kind for kind in _OBJECTS if (labels == kind).any()]
        self._number, side = 0, int(self._model.config.image_size)
        for kind in self._kinds:
            mask = torch.from_numpy((labels == kind).astype(np.float32))[None, None]
            mask = interpolate(mask, (side, side), mode="bilinear", antialias=True, align_corners=False)
            index = self._session.obj_id_to_idx(int(kind))
            self._session.add_mask_inputs(index, 0, (mask >= 0.5).float())
        self._session.obj_with_new_inputs = [int(kind) for kind in self._kinds]
        if self._kinds:
            self._see(frame)

    @torch.inference_mode()
    def label(self, frame: Frame) -> Labels | None:
        """Return `Label` of each pixel of a later picture, [H, W]; None before the first key frame."""
        if self._session is None:
            return None
        out = np.zeros(frame.depth.shape, np.uint8)
        if self._kinds:
            masks = interpolate(self._see(frame), frame.depth.shape, mode="bilinear", align_corners=False)
            for kind, mask in zip(self._kinds, masks[:, 0] > 0.0, strict=True):
                out[mask.numpy()] = kind
        return out

    def _see(self, frame: Frame) -> torch.Tensor:
        """Return logits of masks [objects, 1, h, w] of the next picture, and forget what is long ago."""
        side, session = int(self._model.config.image_size), self._session
        pixels = picture(frame.colour, side, side, *self._colours)
        found = self._model(inference_session=session, frame=pixels, frame_idx=self._number)
        for old in [n for n in session.processed_frames if n < self._number]:
            del session.processed_frames[old]
        for kept in session.output_dict_per_obj.values():
            kept["non_cond_frame_outputs"].pop(self._number - _REMEMBERED, None)
        self._number += 1
        masks: torch.Tensor = found.pred_masks
        return masks
