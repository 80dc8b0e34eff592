"""Warp's precompiled header serves later processes."""

import errno
import json
import os
import shutil
import subprocess
import sys

import pytest
from bough.sim.base import header

NAME = "builtin_o2.pch"
PROGRAM = """
import json, os
import warp as wp
from bough.sim.base.header import fetch_header, keep_header

wp.config.log_level = wp.LOG_WARNING
wp.init()

@wp.kernel(module="unique", enable_backward=False)
def fill(number: float, out: wp.array(dtype=float)):
    out[wp.tid()] = number + float(NUMBER)

fetch_header()
folder = wp._src.context.runtime.get_clang_pch_dir()
before = {name: os.stat(os.path.join(folder, name)).st_mtime_ns for name in os.listdir(folder)}
out = wp.full(3, -1.0, dtype=float, device="cpu")
wp.launch(fill, 3, inputs=[2.0, out], device="cpu")
after = {name: os.stat(os.path.join(folder, name)).st_mtime_ns for name in os.listdir(folder)}
keep_header()
print(json.dumps({"before": before, "after": after, "out": out.list()}))
"""


@pytest.fixture
def folders(tmp_path, monkeypatch):
    """Two folders in the place of Warp's own and of the kept one."""
    own, kept = tmp_path / "own", tmp_path / "cache" / "kept"
    own.mkdir()
    monkeypatch.setattr(header, "_own_folder", lambda: own)
    monkeypatch.setattr(header, "_kept_folder", lambda: kept)
    return own, kept


def test_a_second_process_compiles_with_the_first_one_s_header(tmp_path):
    """Warp makes a header where it finds none; what it finds it leaves as it is, and the kernel is right."""
    told = []
    for number in (1, 2):  # a number of its own each, so that both compile
        program = tmp_path / f"fill_{number}.py"
        program.write_text(PROGRAM.replace("NUMBER", str(number)))
        done = subprocess.run(
            [sys.executable, program], env=os.environ | {"WARP_CACHE_PATH": str(tmp_path / "cache")},
            capture_output=True, text=True, check=True,
        )  # fmt: skip
        told.append(json.loads(done.stdout.splitlines()[-1]))
        assert told[-1]["out"] == [2.0 + number] * 3
    assert told[0]["before"] == {} and len(told[0]["after"]) == 1
    assert told[1]["before"] == told[1]["after"] and [*told[1]["before"]] == [*told[0]["after"]]


def test_what_warp_refused_is_replaced(folders):
    """A broken header is made anew by Warp, in its own folder; what is kept is then the new one."""
    own, kept = folders
    (own / NAME).write_bytes(b"whole header")
    header.keep_header()
    (kept / NAME).write_bytes(b"who")
    header.keep_header()
    assert [p.name for p in kept.iterdir()] == [NAME] and (kept / NAME).read_bytes() == b"whole header"


def test_what_warp_has_is_left_alone(folders):
    own, kept = folders
    kept.mkdir(parents=True)
    (kept / NAME).write_bytes(b"kept")
    (own / NAME).write_bytes(b"own")
    header.fetch_header()
    assert (own / NAME).read_bytes() == b"own"


def test_without_room_nothing_is_kept(folders, monkeypatch):
    own, kept = folders
    (own / NAME).write_bytes(b"whole header")

    def full(source, target):
        with open(target, "wb") as file:
            file.write(b"who")
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(shutil, "copyfile", full)
    header.keep_header()
    assert [*kept.iterdir()] == []


def test_another_installation_has_a_folder_of_its_own(monkeypatch, tmp_path):
    """A header refuses sources of another place or age, so the folder's name follows both."""
    names = {header._kept_folder()}
    (tmp_path / "native").mkdir()
    (tmp_path / "native" / "builtin.h").write_text("")
    monkeypatch.setattr(header.wp, "__file__", str(tmp_path / "__init__.py"))
    names.add(header._kept_folder())
    os.utime(tmp_path / "native" / "builtin.h", (1, 1))
    names.add(header._kept_folder())
    assert len(names) == 3
