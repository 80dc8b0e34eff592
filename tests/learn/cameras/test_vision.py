"""Segmenters with weights: shrunken random models, loaded from a folder as a user's are."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import socket
import time

import numpy as np
import pytest
import torch
from bough.learn.cameras.calibration import Mounted, plain_rig
from bough.learn.cameras.frames import Frame
from bough.learn.cameras.open import open_clouds
from bough.learn.cameras.weights import digests, find_models
from bough.sim.base.errors import InputError
from bough.sim.cameras.label import Label
from oracles.cameras.folder import write_folder

pytest.importorskip("transformers", reason="vision models need the extra vision: pip install -e '.[vision]'")
from bough.learn.cameras.grounded import PROMPTS, Grounded, check_prompts
from bough.learn.cameras.propagate import Propagate, has_tracker
from oracles.cameras.tiny_vision import SIDE, write_weights

HEIGHT, WIDTH = 48, 80
RIG = plain_rig([Mounted(name="one", position_m=[0, 0, 0], rotation=[1, 0, 0, 0])])


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return write_weights(tmp_path_factory.mktemp("weights"))


@pytest.fixture(scope="module")
def grounded(weights):
    return Grounded(weights, RIG, score=0.0)


def frame(seed=0) -> Frame:
    colour = np.random.default_rng(seed).integers(0, 255, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    depth = np.full((HEIGHT, WIDTH), 0.6, np.float32)
    return Frame(0.0, colour, depth, (60.0, 60.0, 39.5, 23.5), np.zeros(3), np.array([1.0, 0, 0, 0]))


def test_boxes_are_those_of_the_library_s_own_post_processing(grounded):
    """Find each box among those that the library makes of the same outputs, to float32's rounding of a pixel."""
    from transformers.image_transforms import center_to_corners_format

    seen, kept = frame(), {}
    handle = grounded._finder.register_forward_hook(lambda _m, _i, output: kept.update(boxes=output.pred_boxes))
    boxes = torch.cat(grounded.boxes(seen))
    handle.remove()
    own = center_to_corners_format(kept["boxes"])[0] * torch.tensor([WIDTH, HEIGHT, WIDTH, HEIGHT])
    assert len(boxes) == 2 * len(own) > 0
    assert float(torch.cdist(boxes, own).amin(dim=1).max()) < 1e-3


def test_texts_have_their_own_tokens(grounded):
    """Score the two texts by the places of their words: [CLS] tree branch . power line cable . [SEP]."""
    assert grounded._of == [[1, 2], [4, 5, 6]]


def test_masks_are_those_of_the_library_s_own_processor(grounded):
    """Cut as the library's processor does around the same boxes: nine of ten pixels alike, its resizing being PIL's."""
    from transformers.models.sam.image_processing_pil_sam import SamImageProcessorPil

    ready = SamImageProcessorPil(size={"longest_edge": SIDE}, pad_size={"height": SIDE, "width": SIDE})
    seen, boxes = frame(), torch.tensor([[5.0, 4.0, 40.0, 30.0], [30.0, 10.0, 78.0, 46.0]])
    given = ready(seen.colour, return_tensors="pt")
    with torch.inference_mode():
        scaled = boxes[None] * (SIDE / WIDTH)
        found = grounded._cutter(pixel_values=given["pixel_values"], input_boxes=scaled, multimask_output=False)
        own = ready.post_process_masks(found.pred_masks, given["original_sizes"], given["reshaped_input_sizes"])[0][
            :, 0
        ]
        ours = grounded._masks(seen, boxes)
    assert ours.shape == own.shape == (2, HEIGHT, WIDTH)
    assert float((ours == own).float().mean()) > 0.9


def test_labels_of_a_picture(grounded, weights):
    """Give every pixel one of three labels, the line before branches; nothing where no box is sure."""
    told = grounded.label(frame())
    assert told.shape == (HEIGHT, WIDTH) and told.dtype == np.uint8
    assert set(np.unique(told)) <= {Label.BACKGROUND, Label.BRANCH, Label.LINE}
    assert not Grounded(weights, RIG, score=1.0).label(frame()).any()


def test_masks_are_carried_on(weights):
    """Carry masks from picture to picture: none before a key frame, none of nothing, memory that does not grow."""
    assert has_tracker(weights)
    tracker = Propagate(weights)
    assert tracker.label(frame()) is None
    tracker.begin(frame(), np.zeros((HEIGHT, WIDTH), np.uint8))
    assert not tracker.label(frame(1)).any()
    labels = np.zeros((HEIGHT, WIDTH), np.uint8)
    labels[10:30, 10:40], labels[5:9, :] = Label.BRANCH, Label.LINE
    tracker.begin(frame(), labels)
    for k in range(30):
        told = tracker.label(frame(k))
        assert told.shape == (HEIGHT, WIDTH) and set(np.unique(told)) <= {0, Label.BRANCH, Label.LINE}
    session = tracker._session
    assert len(session.processed_frames) == 1
    assert all(len(kept["non_cond_frame_outputs"]) <= 24 for kept in session.output_dict_per_obj.values())


def test_nothing_is_fetched(weights, monkeypatch):
    """Load with no network: an address that is asked for would fail the test."""

    def refuse(*_args, **_more):
        raise AssertionError("the network was asked")

    monkeypatch.setattr(socket.socket, "connect", refuse)
    monkeypatch.setattr(socket, "getaddrinfo", refuse)
    Grounded(weights, RIG)
    assert os.environ["HF_HUB_OFFLINE"] == "1"


def test_digests_are_those_of_the_files(weights):
    """Tell SHA-256 of each file of weights."""
    told = digests(weights)
    assert set(told) == {f"{n}/model.safetensors" for n in ("grounding", "masks", "video")}
    for name, digest in told.items():
        assert digest == hashlib.sha256((weights / name).read_bytes()).hexdigest()


def _no_weights(folder):
    (folder / "masks" / "model.safetensors").rename(folder / "masks" / "pytorch_model.bin")


def _brings_code(folder):
    path = folder / "masks" / "config.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"auto_map": {"AutoModel": "evil.Model"}}))


def _twice(folder):
    shutil.copytree(folder / "masks", folder / "masks2")


def _missing(folder):
    shutil.rmtree(folder / "grounding")


def _damaged(folder):
    path = folder / "masks" / "model.safetensors"
    path.write_bytes(path.read_bytes()[:1000])


def _no_words(folder):
    for path in (folder / "grounding").glob("tokenizer*"):
        path.unlink()


@pytest.mark.parametrize("spoil, word", [
    (_no_weights, "pytorch_model.bin"), (_brings_code, "code"), (_twice, "second"), (_missing, "Grounding DINO"),
    (_damaged, "files of the model"), (_no_words, "tokenizer"),
])  # fmt: skip
def test_weights_that_are_not_taken(weights, tmp_path, spoil, word):
    """Refuse pickled weights, code, two of a kind, none, damaged files and a missing tokenizer, in one line."""
    copy = tmp_path / "weights"
    shutil.copytree(weights, copy)
    spoil(copy)
    with pytest.raises(InputError, match=word):
        Grounded(copy, RIG)


def test_a_folder_that_is_none(tmp_path):
    """Refuse a folder that does not exist, and texts that cannot be told apart."""
    with pytest.raises(InputError, match="no such folder"):
        find_models(tmp_path / "none")
    for prompts in (("one",), ("a. b", "c"), ("", "line")):
        with pytest.raises(InputError):
            check_prompts(prompts)
    assert check_prompts(()) == PROMPTS


def test_pictures_become_clouds_through_the_models(weights, tmp_path, capfd):
    """Open a folder with weights as a user would: digests are told, other processes make key frames and clouds."""
    write_folder(tmp_path / "pictures", frames=18000)
    with open_clouds(str(tmp_path / "pictures"), arm=None, weights=weights, limit=60.0) as clouds:
        end = time.monotonic() + 240.0
        while clouds._board.clouds.count == 0 and not clouds._ended() and time.monotonic() < end:
            time.sleep(0.05)
        assert clouds._board.keys[0].count > 0 and clouds._board.clouds.count > 0, clouds.trouble
        assert set(clouds.processes) == {"camera", "segmenter", "clouds"}
    assert capfd.readouterr().err.count("SHA-256") == 3
