"""What CPU threads do between Python's turns: wait for a list of recorded launches, run it, and say so.

To wake a thread that sleeps takes 0.2 to 1 ms on a virtual machine, and one that waits in Python fights for the
interpreter; so threads wait here for a while, without the interpreter, before they sleep. Addresses are of kernels as
Warp compiles them for CPUs, ``kernel(bounds, arguments)``.

A job is [count, (kernel, bounds, arguments) x count], int64. ``words`` holds a row a thread, far apart in memory:
``words[k, POSTED]`` jobs posted, ``words[k, JOB]`` the address of the newest, ``words[k, DONE]`` jobs done.
"""

import warp as wp

__all__ = ["DONE", "JOB", "POSTED", "WORDS", "follow", "lead"]

POSTED, JOB, DONE, WORDS = 0, 1, 16, 32

_RUN = """
#ifndef __CUDA_ARCH__
typedef void (*Kernel)(void*, void*);
const long long* job_ = (const long long*)job;
for (long long k_ = 0; k_ < job_[0]; ++k_)
    ((Kernel)job_[3 * k_ + 1])((void*)job_[3 * k_ + 2], (void*)job_[3 * k_ + 3]);
#endif
"""

# whether POSTED and DONE differ (while_equal), or are equal, within so many looks
_AWAIT = """
#ifdef __CUDA_ARCH__
return false;
#else
long long* a_ = (long long*)words.data + row * 32;
for (long long k_ = 0; k_ < turns; ++k_) {
    bool same_ = __atomic_load_n(a_, __ATOMIC_ACQUIRE) == __atomic_load_n(a_ + 16, __ATOMIC_ACQUIRE);
    if (same_ != while_equal) return true;
#if defined(__x86_64__)
    __builtin_ia32_pause();
#elif defined(__aarch64__)
    __asm__ volatile("yield");
#endif
}
return false;
#endif
"""

_FINISH = """
#ifndef __CUDA_ARCH__
long long* a_ = (long long*)words.data + row * 32;
__atomic_store_n(a_ + 16, posted, __ATOMIC_RELEASE);
#endif
"""


@wp.func_native(_RUN)
def _run(job: wp.int64): ...


@wp.func_native(_AWAIT)
def _await(words: wp.array2d(dtype=wp.int64), row: int, while_equal: bool, turns: wp.int64) -> bool: ...


@wp.func_native(_FINISH)
def _finish(words: wp.array2d(dtype=wp.int64), row: int, posted: wp.int64): ...


@wp.kernel(enable_backward=False, module="unique")
def follow(words: wp.array2d(dtype=wp.int64), row: int, turns: wp.int64):
    """Run what is posted to a row; return when nothing was for ``turns`` looks."""
    while _await(words, row, True, turns):
        posted = words[row, POSTED]
        _run(words[row, JOB])
        _finish(words, row, posted)


@wp.kernel(enable_backward=False, module="unique")
def lead(words: wp.array2d(dtype=wp.int64), rows: int, own: wp.array(dtype=wp.int64), turns: wp.int64):
    """Run the caller's own job, then look for the others' end, ``turns`` times at most."""
    _run(own[0])
    for row in range(rows):
        if not _await(words, row, False, turns):
            return
