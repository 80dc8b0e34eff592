"""The folder of a probing, spoilt: one line that names the file and the field."""

import json
import os

import pytest
from bough.learn.probing.folder import Folder
from bough.learn.probing.rounds import Finding
from bough.sim.base.errors import InputError

PLAN = {"pull": "steps", "words": "slow steps", "recordings": 2, "why": "a first look"}
ZERO = {"rest_m": [0.1, 0.2, 0.3], "stiffness_scale": 1.0}
FOUND = Finding(2, "effects", ("dry_friction@1",), ("dry_friction",), (), 3.0, 0.01).as_json()
FILES = {
    "settings.json": (lambda folder: folder.begin({}, resume=True), {}),
    "zero.json": (lambda folder: folder.zero, ZERO),
    "plan_1.json": (lambda folder: folder.plan(1), PLAN),
    "round_1.json": (lambda folder: folder.finding(1), FOUND),
}
BROKEN = {
    "no json": (lambda p: p.write_text("{"), "line 1: found text that is not JSON"),
    "nothing": (lambda p: p.write_text(""), "line 1: found text that is not JSON"),
    "no fields": (lambda p: p.write_text("[1]"), "found JSON without fields"),
    "deep": (lambda p: p.write_text("[" * 100_000), "(found JSON that is nested too deeply|line 1: found text)"),
    "digits": (lambda p: p.write_text("9" * 5000), "found a number of too many digits"),
    "bytes": (lambda p: p.write_bytes(b"\xff"), "byte 0: found bytes that are not UTF-8"),
    "pipe": (os.mkfifo, "found a device or a pipe"),
    "folder": (lambda p: p.mkdir(), "found a folder"),
}


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("kind", BROKEN)
def test_files_that_are_none(tmp_path, name, kind):
    """Name the file, and its line where there is one."""
    spoil, words = BROKEN[kind]
    spoil(tmp_path / name)
    with pytest.raises(InputError, match=rf"{name}: {words}"):
        FILES[name][0](Folder(tmp_path))


@pytest.mark.parametrize(
    ("name", "change", "words"),
    [
        *(("plan_1.json", {key: ...}, f"{key}: found no such key") for key in PLAN),
        ("plan_1.json", {"pull": 3}, "pull: found 3"),
        ("plan_1.json", {"recordings": 0}, "recordings: found 0; allowed: greater than or equal to 1"),
        ("plan_1.json", {"recordings": "2"}, "recordings: found '2'"),
        *(("zero.json", {key: ...}, f"{key}: found no such key") for key in ZERO),
        ("zero.json", {"rest_m": [0.0, 1.0]}, "rest_m: found"),
        ("zero.json", {"rest_m": [0.0, 1.0, "x"]}, r"rest_m\.2: found 'x'"),
        ("zero.json", {"rest_m": [0.0, 1.0, float("nan")]}, r"rest_m\.2: found"),
        ("zero.json", {"stiffness_scale": 0.0}, "stiffness_scale: found 0.0"),
        ("zero.json", {"share": 2.0}, "share: found 2.0"),
        ("round_1.json", {"recordings": ...}, "recordings: found no such key"),
        ("round_1.json", {"verdict": ...}, "verdict: found no such key"),
        ("round_1.json", {"names": "dry_friction"}, "names: found 'dry_friction'"),
        ("round_1.json", {"names": [3]}, r"names\.0: found 3"),
        ("round_1.json", {"lead": "3"}, "lead: found '3'"),
        ("round_1.json", {"power": [1]}, "power: found"),
    ],
)
def test_fields_that_are_none(tmp_path, name, change, words):
    """Name the field that is missing or of another type."""
    read, good = FILES[name]
    (tmp_path / name).write_text(json.dumps(good))
    assert read(Folder(tmp_path)) is not None
    (tmp_path / name).write_text(json.dumps({k: v for k, v in {**good, **change}.items() if v is not ...}))
    with pytest.raises(InputError, match=rf"{name}: {words}"):
        read(Folder(tmp_path))
