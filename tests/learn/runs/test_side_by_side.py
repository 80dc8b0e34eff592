"""Work in processes of their own: every result once, every step counted, errors as they are, nobody waited for."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from bough.learn.runs.side_by_side import side_by_side, usual_jobs
from bough.sim.base.errors import InputError
from bough.sim.base.host import num_threads
from oracles.side_work import gone, refused, slept, told


@pytest.mark.parametrize("jobs", [1, 2])
def test_every_item_comes_once_and_steps_add_up(monkeypatch, jobs):
    """Two jobs share four threads; one job takes all, in this process and in order."""
    monkeypatch.setattr("bough.sim.base.host.num_cores", lambda: 4)
    monkeypatch.setenv("OMP_NUM_THREADS", "4")
    steps = []
    came = list(side_by_side(told, [3, 1, 2], jobs, steps.append))
    assert sorted(twice for twice, _, _ in came) == [2, 4, 6] and sum(steps) == 6
    assert os.environ["OMP_NUM_THREADS"] == "4"
    if jobs == 1:
        assert came == [(2 * k, os.getpid(), 4) for k in (3, 1, 2)]
    else:  # a worker has as many cores as this machine
        assert os.getpid() not in {process for _, process, _ in came}
        assert {threads for _, _, threads in came} == {min(2, len(os.sched_getaffinity(0)))}


@pytest.mark.parametrize("jobs", [1, 2])
def test_bad_input_is_told_as_it_was_found(jobs):
    """One line, whichever process finds it."""
    with pytest.raises(InputError) as caught:
        list(side_by_side(refused, ["x"] * 3, jobs, print))
    assert str(caught.value) == "forces.csv: row 3: found x; allowed: a number"


def test_a_killed_process_ends_all():
    """What it did never comes; a pool that waits for it would hang for ever."""
    with pytest.raises(ChildProcessError, match="goes on"):
        list(side_by_side(gone, [1, 2], 2, print))


def test_whoever_stops_waits_for_nobody():
    """Leave after the first result, as Ctrl-C does: processes at work are ended, here one of ten minutes."""
    results = side_by_side(slept, [0, 600], 2, print)
    assert next(results) == 0
    began = time.monotonic()
    results.close()
    assert time.monotonic() - began < 60.0


def test_workers_end_with_a_parent_that_is_killed(tmp_path):
    """Kill the process that waits for two workers at work: both are gone soon, before they write what is not theirs."""
    program = f"""
from pathlib import Path
from bough.learn.runs.side_by_side import side_by_side
from oracles.side_work import wrote
if __name__ == "__main__":
    list(side_by_side(wrote, [Path({str(tmp_path)!r}) / n for n in "ab"], 2, print))
"""
    (tmp_path / "program.py").write_text(program)
    path = os.pathsep.join([str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH", "")])
    parent = subprocess.Popen([sys.executable, tmp_path / "program.py"], env=os.environ | {"PYTHONPATH": path})
    files = [tmp_path / name for name in "ab"]
    assert waited(lambda: all(f.exists() and f.read_text() for f in files), 60.0)
    parent.kill()
    parent.wait()
    workers = [int(f.read_text()) for f in files]
    assert waited(lambda: not any(alive(w) for w in workers), 20.0)


def waited(holds, seconds):
    """Return whether something comes true in time."""
    end = time.monotonic() + seconds
    while time.monotonic() < end and not holds():
        time.sleep(0.1)
    return holds()


def alive(process):
    """Return whether a process is there, and not a zombie that nobody has taken leave of."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False


def test_a_cpu_has_a_job_a_thread_and_a_gpu_one(monkeypatch):
    """At most four on a CPU: each takes memory."""
    monkeypatch.setattr("bough.sim.base.host.num_cores", lambda: 64)
    monkeypatch.setenv("OMP_NUM_THREADS", "3")
    assert num_threads() == 3 == usual_jobs("cpu") and usual_jobs("cuda:0") == 1
    monkeypatch.delenv("OMP_NUM_THREADS")
    assert usual_jobs("cpu") == 4
