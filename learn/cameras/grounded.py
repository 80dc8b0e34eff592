"""Masks from a text: Grounding DINO finds boxes, SAM-HQ what is in them (Liu et al. 2023; Ke et al. 2023).

Pictures are made ready here and not by the library's processors, which want torchvision: resized, their mean taken off.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch.nn.functional import interpolate, pad

from ...sim.base.errors import InputError
from ...sim.cameras.label import Label
from .calibration import Rig
from .colours import Labels
from .frames import Frame
from .weights import colours, find_models, import_transformers, load

PROMPTS = ("tree branch", "power line cable")
"""What is looked for as branches and as the line."""

SCORE = 0.25
"""Least score of a box: the default of Grounding DINO's own post-processing."""

_SHORT, _LONG = 800, 1333  # pixels of the sides that Grounding DINO was trained with
_MOST = 24  # boxes of a text
_MASK = 0.0  # logit


def picture(colour: Any, height: int, width: int, mean: Any, deviation: Any) -> torch.Tensor:
    """Return a picture uint8 [H, W, 3] in another size with its mean taken off, float32 [1, 3, height, width]."""
    pixels = torch.from_numpy(np.ascontiguousarray(colour)).permute(2, 0, 1)[None].float() / 255.0
    pixels = interpolate(pixels, (height, width), mode="bilinear", antialias=True, align_corners=False)
    return (pixels - torch.from_numpy(mean)[:, None, None]) / torch.from_numpy(deviation)[:, None, None]


class Grounded:
    """Tells branches and line in a picture by texts (`learn.cameras.workers.Segmenter`)."""

    def __init__(self, weights: Path, rig: Rig, prompts: tuple[str, ...] = (), *, score: float = SCORE) -> None:
        """Load the models on one thread.

        Args:
            weights: Folder with a folder for each model (`learn.cameras.weights.find_models`).
            rig: What counts in a picture.
            prompts: What is a branch and what the line; empty for `PROMPTS`.
            score: Least score of a box.

        Raises:
            InputError: The library is missing, or the weights cannot be used.
        """
        self._prompts, self._rig, self._score = check_prompts(prompts), rig, score
        found = find_models(weights)
        library = import_transformers()
        torch.set_num_threads(1)  # the arm's loop has the other cores
        self._finder = load(library.GroundingDinoForObjectDetection, found["grounding-dino"])
        self._cutter = load(library.SamHQModel, found["sam_hq"])
        self._colours = [colours(found[kind]) for kind in ("grounding-dino", "sam_hq")]
        words = _tokenizer(library, found["grounding-dino"])
        text = "".join(f"{p}. " for p in self._prompts).strip()
        self._words = dict(words([text], return_tensors="pt"))
        self._of = _token_prompts(self._words["input_ids"][0].tolist(), words)

    @torch.inference_mode()
    def label(self, frame: Frame) -> Labels:
        """Return `Label` of each pixel, [H, W]: BACKGROUND, BRANCH or LINE, the line before the branches."""
        out = np.zeros(frame.depth.shape, np.uint8)
        boxes = self.boxes(frame)
        masks = self._masks(frame, torch.cat(boxes)) if any(len(b) for b in boxes) else None
        if masks is not None:
            cut = len(boxes[0])
            for kind, part in ((Label.BRANCH, masks[:cut]), (Label.LINE, masks[cut:])):
                out[part.any(dim=0).numpy()] = kind
        return out

    @torch.inference_mode()
    def boxes(self, frame: Frame) -> list[torch.Tensor]:
        """Return the boxes of each text [B, 4]: left, top, right, bottom [pixels], best first."""
        height, width = frame.depth.shape
        scale = min(_SHORT / min(height, width), _LONG / max(height, width))
        pixels = picture(frame.colour, round(height * scale), round(width * scale), *self._colours[0])
        found = self._finder(pixel_values=pixels, **self._words)
        scores = found.logits[0].sigmoid()
        middle, size = found.pred_boxes[0, :, :2], found.pred_boxes[0, :, 2:]
        corners = torch.cat([middle - size / 2, middle + size / 2], dim=1) * torch.tensor([width, height] * 2)
        out = []
        for tokens in self._of:
            best = scores[:, tokens].amax(dim=1)
            order = best.argsort(descending=True)[:_MOST]
            out.append(corners[order[best[order] > self._score]])
        return out

    def _masks(self, frame: Frame, boxes: torch.Tensor) -> torch.Tensor:
        """Return masks of boxes, bool [B, H, W]."""
        (height, width), side = frame.depth.shape, int(self._cutter.config.vision_config.image_size)
        scale = side / max(height, width)
        size = round(height * scale), round(width * scale)
        pixels = pad(picture(frame.colour, *size, *self._colours[1]), (0, side - size[1], 0, side - size[0]))
        found = self._cutter(pixel_values=pixels, input_boxes=boxes[None] * scale, multimask_output=False)
        masks = interpolate(found.pred_masks[0], (side, side), mode="bilinear", align_corners=False)
        masks = interpolate(masks[..., : size[0], : size[1]], (height, width), mode="bilinear", align_corners=False)
        return masks[:, 0] > _MASK


def check_prompts(prompts: tuple[str, ...]) -> tuple[str, ...]:
    """Return two texts.

    Raises:
        InputError: There is another number, or one has a full stop, which parts them, or no letter.
    """
    chosen = prompts or PROMPTS
    if len(chosen) != 2 or any("." in p or not any(c.isalpha() for c in p) or len(p) > 60 for p in chosen):
        raise InputError("camera", "prompt", f"{list(prompts)}", "two short texts without a full stop: branches, line")
    return tuple(p.lower().strip() for p in chosen)


def _tokenizer(library: Any, folder: Path) -> Any:
    """Return the tokenizer beside the weights.

    Raises:
        InputError: There is none, or it cannot be read.
    """
    allowed = "tokenizer.json or vocab.txt beside the weights"
    if not any((folder / name).is_file() for name in ("tokenizer.json", "vocab.txt")):
        raise InputError(folder, "", "no tokenizer", allowed)
    try:
        return library.AutoTokenizer.from_pretrained(folder, local_files_only=True, trust_remote_code=False)
    except Exception as error:  # whatever a damaged file makes the library raise
        raise InputError(folder, "", f"a tokenizer that cannot be read ({type(error).__name__})", allowed) from None


def _token_prompts(tokens: list[int], words: Any) -> list[list[int]]:
    """Return the places of each text's tokens."""
    out: list[list[int]] = [[]]
    for place, token in enumerate(tokens):
        if token in words.all_special_ids and token != words.unk_token_id:
            continue
        if words.convert_ids_to_tokens(token) == ".":
            out.append([])
        else:
            out[-1].append(place)
    return [places for places in out if places]
