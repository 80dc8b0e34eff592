"""How a kernel is compiled for a CPU so that its step is no function call.

Clang inlines a function below a threshold of its size. The step of a replay lies above Warp's, so that structs of some
fifty arrays are copied at each call and addresses are found anew.
"""

import warp as wp

__all__ = ["inlined"]

#: Above every function of ours: the largest, a step with all laws, lies between 20 and 50 thousand.
THRESHOLD = 100_000


def inlined() -> dict[str, str]:
    """Return the module options of a kernel whose functions are all inlined on a CPU; results keep their bits.

    They follow the flags that Warp is set to (``wp.config.cpu_compiler_flags``); of two of a kind the last counts.
    """
    flags = wp.config.cpu_compiler_flags
    own = f"-mllvm=-inline-threshold={THRESHOLD} -mllvm=-inline-cold-callsite-threshold={THRESHOLD}"
    return {"cpu_compiler_flags": f"{'-march=native' if flags is None else flags} {own}"}
