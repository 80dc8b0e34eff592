"""What a killed run leaves, and who may go on with it."""

import pytest
import torch
from bough.learn.runs.checkpoint import Checkpoint, digest
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
