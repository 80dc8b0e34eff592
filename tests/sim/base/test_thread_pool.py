"""Launches on several threads: what they write, who may call, what happens when nobody calls for a while."""

import gc
import os
import threading
import time

import numpy as np
import pytest
import warp as wp
from bough.sim.base import thread_pool
from bough.sim.base.thread_pool import PATIENCE, Job, Launches, together


@wp.kernel(module="unique")
def add_to(value: int, turns: int, sum_in_out: wp.array(dtype=int)):
    """Add a value so many times, to take as long."""
    for _k in range(turns):
        sum_in_out[wp.tid()] = sum_in_out[wp.tid()] + value


def parts_of(count, *, launches=1, turns=1):
    """Return lists of launches, part k adding k + 1 to an array of its own, and the arrays."""
    arrays = [wp.zeros(3, dtype=int, device="cpu") for _ in range(count)]

    def record(k):
        return wp.launch(add_to, dim=3, inputs=[k + 1, turns], outputs=[arrays[k]], device="cpu", record_cmd=True)

    return [[record(k) for _ in range(launches)] for k in range(count)], arrays


@pytest.mark.parametrize("count", [1, 2, 3, 9])
def test_all_parts_run_once_a_call(count):
    """Run as many lists as there are threads, fewer, or more than there are cores; in turn where there are too many."""
    parts, arrays = parts_of(count, launches=4)
    run = together(parts)
    for _ in range(50):
        run()
    for k, a in enumerate(arrays):
        np.testing.assert_array_equal(a.numpy(), 50 * 4 * (k + 1))


def test_launches_of_a_list_keep_their_order():
    """Double and add by turns: any other order gives another number."""

    @wp.kernel(module="unique")
    def double(x_in_out: wp.array(dtype=int)):
        x_in_out[0] = (2 * x_in_out[0]) % 1000003

    arrays = [wp.zeros(1, dtype=int, device="cpu") for _ in range(2)]
    parts = [
        [wp.launch(double, dim=1, inputs=[a], device="cpu", record_cmd=True),
         wp.launch(add_to, dim=1, inputs=[1, 1], outputs=[a], device="cpu", record_cmd=True)] for a in arrays
    ]  # fmt: skip
    run, expected = together(parts), 0
    for _ in range(300):
        run()
        expected = 2 * expected % 1000003 + 1
    assert [int(a.numpy()[0]) for a in arrays] == [expected, expected]


def test_threads_that_fell_asleep_are_woken():
    """Call after pauses about as long as threads wait, on both sides of it."""
    parts, arrays = parts_of(2)
    run = together(parts)
    for pause in np.linspace(0.0, 4.0, 60) * PATIENCE:
        run()
        time.sleep(pause)
    assert arrays[1].numpy().tolist() == [120] * 3


def test_a_part_that_takes_longer_is_waited_for():
    """Return when the slowest is done, also when it takes much longer than the caller looks out for it."""
    short = parts_of(1)[0][0]
    array = wp.zeros(1, dtype=int, device="cpu")
    turns = 40_000_000
    long = wp.launch(add_to, dim=1, inputs=[1, turns], outputs=[array], device="cpu", record_cmd=True)
    together([short, [long]])()
    assert array.numpy()[0] == turns


def test_callers_at_the_same_time():
    """Call from four threads at once: all parts of all callers run."""
    made = [parts_of(2, turns=200) for _ in range(4)]

    def call(parts):
        run = together(parts)
        for _ in range(100):
            run()

    callers = [threading.Thread(target=call, args=(parts,)) for parts, _ in made]
    for t in callers:
        t.start()
    for t in callers:
        t.join()
    for _, arrays in made:
        assert [a.numpy()[0] for a in arrays] == [20_000, 40_000]


def test_arrays_live_as_long_as_their_launches():
    """Write into arrays that nobody else keeps."""
    run, lists = together(parts_of(2, launches=8)[0]), Launches(parts_of(1, launches=8)[0][0])
    gc.collect()
    spoilt = [wp.full(3, 7, dtype=int, device="cpu") for _ in range(50)]  # memory that was given back would be theirs
    for _ in range(20):
        run()
        lists()
    assert all((a.numpy() == 7).all() for a in spoilt)


def test_launches_in_turn_are_recorded_by_a_graph():
    """Run at once outside a capture; inside one, be replayed with it."""
    parts, arrays = parts_of(1, launches=3)
    launches = Launches(parts[0])
    launches()
    with wp.ScopedCapture(device="cpu") as scope:
        launches()
    before = int(arrays[0].numpy()[0])
    wp.capture_launch(scope.graph)
    assert int(arrays[0].numpy()[0]) == before + 3 and before >= 3


def test_idle_threads_sleep():
    """Take no processor time a while after the last call."""
    run = together(parts_of(2)[0])
    run()
    time.sleep(0.05)
    before = time.process_time()
    time.sleep(0.3)
    assert time.process_time() - before < 0.1


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork on this system")
def test_a_forked_process_has_threads_of_its_own():
    """Run in a child whose parent's threads it did not inherit."""
    parts, arrays = parts_of(2)
    run = together(parts)
    run()
    child = os.fork()
    if child == 0:
        run()
        os._exit(0 if arrays[1].numpy().tolist() == [4] * 3 else 1)
    deadline = time.monotonic() + 60
    status = os.waitpid(child, os.WNOHANG)
    while status[0] == 0 and time.monotonic() < deadline:
        time.sleep(0.05)
        status = os.waitpid(child, os.WNOHANG)
    if status[0] == 0:
        os.kill(child, 9)
    assert status == (child, 0)


def test_an_interrupt_waits_for_the_threads(monkeypatch):
    """Raise Ctrl-C only when no thread works on the caller's memory any more."""
    parts, arrays = parts_of(2, turns=20_000_000)
    sleep, calls = time.sleep, []

    def interrupted(seconds):
        calls.append(seconds)
        if len(calls) == 1:
            raise KeyboardInterrupt
        sleep(seconds)

    quick, _ = parts_of(1)
    run = together([quick[0], parts[1]])
    monkeypatch.setattr(thread_pool.time, "sleep", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run()
    assert len(calls) > 1 and arrays[1].numpy()[0] == 40_000_000


def test_threads_take_launches_of_single_items_alone():
    """Refuse launches in blocks, whose kernels are called otherwise."""
    blocks = parts_of(1)[0][0][0]
    blocks.block_dim = 4  # as of a kernel with tiles; Warp gives others 1 on a CPU, whatever they are launched with
    with pytest.raises(ValueError, match=r"add_to: block_dim 4, where threads take 1"):
        Job([blocks])
