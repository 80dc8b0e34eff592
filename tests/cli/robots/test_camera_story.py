"""``bough camera`` from the outside: a recording is looked at, bad input is refused in one line."""

from __future__ import annotations

import json

import numpy as np
import PIL.Image
import pytest
from oracles import json_page
from oracles.cameras.folder import SIZE, write_folder


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recording")
    write_folder(folder)
    return folder


def test_a_recording_is_looked_at(inside, recording, tmp_path):
    """Write masks over colour and the cloud, and tell how many points there are; the arm's dots are on the arm."""
    ran = inside("camera", recording, "--out", tmp_path / "look", "--json")
    assert ran.code == 0, ran.err
    said = json.loads(ran.out)
    json_page.check("camera", said)
    assert said["branches"] > 100 and said["line"] > 30 and 0 < said["cameras"]["side"]["depth"] < 1
    masks = np.asarray(PIL.Image.open(tmp_path / "look" / "masks.png").convert("RGB")).astype(int)
    assert masks.shape == (SIZE[0] + 4, 2 * SIZE[1], 3)
    pictured = np.asarray(PIL.Image.open(recording / "0.png")).astype(int)
    dots = (masks[: SIZE[0], : SIZE[1]] == (255, 0, 200)).all(axis=-1)
    grey = np.ptp(pictured, axis=-1) < 25  # the arm is grey, branch and line are not
    assert dots.sum() > 300 and grey[dots].mean() > 0.97
    assert PIL.Image.open(tmp_path / "look" / "cloud.png").size == (1500, 540)


def test_what_cannot_be_looked_at(inside, recording, tmp_path):
    """Refuse in one line a source that is none, joints of another arm, prompts without weights; write nothing."""
    out = tmp_path / "look"
    inside("camera", "nothing", "--out", out).refused("nothing")
    inside("camera", recording, "--out", out, "--joints", "1", "2").refused("--joints")
    inside("camera", recording, "--out", out, "--prompt", "a", "b").refused("prompt")
    inside("camera", "twin", "--out", out).refused("twin")
    assert not out.exists()
