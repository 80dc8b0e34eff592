"""What a killed run leaves, and who may go on with it."""

import hashlib
import os
import tracemalloc

import pytest
import torch
from bough.learn.runs.checkpoint import Checkpoint, digest
from bough.learn.runs.state import packed
from bough.sim.base.errors import InputError


def test_states_come_back_as_they_were(tmp_path):
    """Give back tensors and numbers bit by bit, and nothing for a name never saved."""
    keep = Checkpoint(tmp_path / "run", "key")
    assert keep.open(resume=False) is False
    state = {"x": torch.tensor([1.0, 2.0**-60], dtype=torch.float64), "n": 3, "none": None}
    keep.save("a", state)
    again = Checkpoint(tmp_path / "run", "key")
    assert again.open(resume=True) is True
    found = again.load("a")
    assert (found["x"] == state["x"]).all() and found["n"] == 3 and found["none"] is None
    assert again.load("b") is None
    again.close()
    assert not (tmp_path / "run").exists()


def test_another_run_is_refused_and_a_fresh_one_forgets(tmp_path):
    """Refuse to resume with another key; without --resume begin anew."""
    first = Checkpoint(tmp_path / "run", "key")
    first.open(resume=False)
    first.save("a", {"n": 1})
    with pytest.raises(InputError, match="other settings"):
        Checkpoint(tmp_path / "run", "other").open(resume=True)
    fresh = Checkpoint(tmp_path / "run", "other")
    assert fresh.open(resume=False) is False
    assert fresh.load("a") is None


def test_work_is_counted_over_all_processes_of_a_run(tmp_path):
    """Add what killed processes had counted when they last wrote, and nothing of what they did after."""
    done, earlier = [0, 0, 0], []
    for process in range(3):
        keep = Checkpoint(tmp_path / "run", "key")
        keep.open(resume=True)
        earlier.append(keep.earlier)
        keep.count = lambda n=process: done[n]
        for name, work in (("modes", 100), ("particles", 250)):
            done[process] = work
            keep.save(name, {"x": torch.zeros(2)})
        done[process] = 400  # killed here
        assert set(keep.load("modes")) == {"x"}
    assert earlier == [0, 250, 500]


@pytest.mark.parametrize("clock", [5.0, 1e7])
def test_states_are_not_written_too_often(tmp_path, monkeypatch, clock):
    """A state is due at once, also on a machine that was started seconds ago, then only after a while."""
    monkeypatch.setattr("time.monotonic", lambda: clock)
    keep = Checkpoint(tmp_path / "run", "key", every=3600.0)
    keep.open(resume=False)
    assert keep.due("a")
    keep.save("a", {})
    assert not keep.due("a") and keep.due("b")
    assert not Checkpoint().due("a")


def test_digest_depends_on_files_and_settings(tmp_path):
    """Change with any byte of any file, with a name, with a setting."""
    (tmp_path / "a.csv").write_text("1")
    base = digest(tmp_path, "s")
    assert digest(tmp_path, "s") == base and digest(tmp_path, "t") != base
    (tmp_path / "a.csv").write_text("2")
    changed = digest(tmp_path, "s")
    (tmp_path / "a.csv").rename(tmp_path / "b.csv")
    assert len({base, changed, digest(tmp_path, "s")}) == 3


def rewritten(file, state):
    """Put another state in a file's place, with the digest that it would have."""
    data = packed(state)
    file.write_bytes(hashlib.sha256(data).digest() + data)


def turned(file):
    """Turn one bit in the middle of a file over."""
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 4
    file.write_bytes(data)


def piped(file):
    """Put a pipe in a file's place."""
    file.unlink()
    os.mkfifo(file)


class Runs:
    """What a pickle can do when it is loaded."""

    def __reduce__(self):
        return (open, ("executed", "w"))


SPOILT = {
    "garbage": (lambda f: f.write_bytes(b"garbage" * 100), "a damaged state"),
    "nothing": (lambda f: f.write_bytes(b""), "a damaged state"),
    "half": (lambda f: f.write_bytes(f.read_bytes()[: f.stat().st_size // 2]), "a damaged state"),
    "a bit": (turned, "a damaged state"),
    "plain torch": (lambda f: torch.save({"x": 1}, f), "a damaged state"),
    "a list": (lambda f: rewritten(f, [1.0, 2.0]), r"not a state .* \(list\)"),
    "a tensor": (lambda f: rewritten(f, torch.zeros(3)), r"not a state .* \(Tensor\)"),
    "code": (lambda f: rewritten(f, {"x": Runs()}), "not a state"),
    "a pipe": (piped, "a device or a pipe"),
    "a folder": (lambda f: (f.unlink(), f.mkdir()), "a folder"),
}


@pytest.mark.parametrize("kind", SPOILT)
def test_damaged_states_are_refused_and_left_alone(tmp_path, kind):
    """Name the file in one line as soon as a run is to go on, run nothing of it; a run begun anew removes it."""
    keep = Checkpoint(tmp_path / "run", "key")
    keep.open(resume=False)
    keep.save("modes", {"x": torch.zeros(100)})
    spoil, words = SPOILT[kind]
    file = tmp_path / "run" / "modes"
    spoil(file)
    with pytest.raises(InputError, match=rf"run/modes: found {words}") as error:
        Checkpoint(tmp_path / "run", "key").open(resume=True)
    assert "\n" not in str(error.value) and file.exists() and not (tmp_path / "executed").exists()
    assert keep.open(resume=False) is False and not file.exists()


def test_a_damaged_key_is_another_run(tmp_path):
    """Refuse a key that is no text, or a pipe, as that of another run."""
    keep = Checkpoint(tmp_path / "run", "key")
    keep.open(resume=False)
    (tmp_path / "run" / "key").write_bytes(b"\xff\x00")
    with pytest.raises(InputError, match="other settings"):
        keep.open(resume=True)
    piped(tmp_path / "run" / "key")
    with pytest.raises(InputError, match="a device or a pipe"):
        keep.open(resume=True)


def test_a_large_file_of_a_case_is_read_in_parts(tmp_path):
    """Take no more memory than a part of it, and give the digest of all of it."""
    (tmp_path / "a.bag").write_bytes(b"x" * (5 << 20))
    tracemalloc.start()
    found = digest(tmp_path)
    most = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    whole = hashlib.sha256(b"a.bag\0" + b"x" * (5 << 20) + b"()")
    assert found == whole.hexdigest() and most < 3 << 20
