"""Threads that share the work of one world: a warp on a GPU, one thread on a CPU.

The threads of a team run the same code with their own ``thread`` of ``threads``. What loops over parts of a world takes
every threads-th part; what cannot be divided is done by thread 0, or by all of them with the same result. Between what
one thread writes and another reads lies `meet`. On a CPU a step has teams of one, where `meet` is nothing; larger ones
wait for each other by counting, so that a test can run a team on threads of the operating system.
"""

from typing import Any

import warp as wp

__all__ = ["TEAM", "meet"]

#: Threads of a team on a GPU: a warp, which is also a block, so that `meet` is the hardware's own.
TEAM = 32

# gate: threads that have come, and how often all had
_MEET = """
#ifdef __CUDA_ARCH__
__syncwarp();
#else
if (threads > 1) {
    int* come_ = gate.data + 2 * row;
    int* turn_ = come_ + 1;
    int seen_ = __atomic_load_n(turn_, __ATOMIC_ACQUIRE);
    if (__atomic_add_fetch(come_, 1, __ATOMIC_ACQ_REL) == threads) {
        __atomic_store_n(come_, 0, __ATOMIC_RELAXED);
        __atomic_store_n(turn_, seen_ + 1, __ATOMIC_RELEASE);
    } else {
        while (__atomic_load_n(turn_, __ATOMIC_ACQUIRE) == seen_) {
#if defined(__x86_64__)
            __builtin_ia32_pause();
#elif defined(__aarch64__)
            __asm__ volatile("yield");
#endif
        }
    }
}
#endif
"""


@wp.func_native(_MEET)
def _meet(gate: wp.array2d(dtype=int), row: int, threads: int): ...


@wp.func(inline=True)
def meet(row: int, threads: int, p: Any):
    """Wait until all threads of a team are here; what each wrote before, all see from here on.

    ``p.gate`` [rows, 2] is zero at first. All threads of the team must come here, and as often.
    """
    _meet(p.gate, row, threads)
