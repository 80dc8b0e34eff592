"""What the machine offers: vector registers, cores, devices."""

from __future__ import annotations

import os
import platform
from functools import lru_cache
from pathlib import Path
from typing import Any

from .errors import InputError


@lru_cache(maxsize=1)
def cpu_flags() -> frozenset[str]:
    """Return the instruction-set flags of the processor (empty where the system does not tell)."""
    try:
        text = Path("/proc/cpuinfo").read_text()
    except OSError:
        return frozenset()
    lines = [line for line in text.splitlines() if line.startswith(("flags", "Features"))]
    return frozenset(lines[0].split(":", 1)[1].split()) if lines else frozenset()


def simd_width() -> int:
    """Return how many float32 worlds fill a vector register: 16 with AVX-512, 8 otherwise.

    Eight lanes are two registers on SSE and NEON, and still far ahead of one world a thread.
    """
    return 16 if "avx512f" in cpu_flags() else 8


def lane_width(device: Any, precision: int, num_worlds: int) -> int:
    """Return the worlds a thread for a device: 1 on a GPU, in float64, and for fewer worlds than lanes pay for."""
    if device.is_cuda or precision == 64 or num_worlds < 4:
        return 1
    return 8 if num_worlds <= 8 else simd_width()


def num_cores() -> int:
    """Return the CPU cores this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def num_threads() -> int:
    """Return over how many threads work is split: the cores, or fewer where ``OMP_NUM_THREADS`` says so.

    That variable is how a user, ``torchrun`` or a scheduler shares cores among processes; its first number counts.
    """
    told = os.environ.get("OMP_NUM_THREADS", "").split(",")[0].strip()
    return min(num_cores(), int(told)) if told.isdecimal() and int(told) > 0 else num_cores()


def memory_bytes() -> int:
    """Return the bytes of memory that the machine has."""
    return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def check_memory(place: str, what: str, needed: float, there: int | None = None) -> None:
    """Raise `InputError` where ``what`` (of options named ``place``) needs more bytes than are there.

    Without ``there`` that is the machine's memory.
    """
    there = memory_bytes() if there is None else there
    if not needed <= there:
        found, allowed = f"{what}, about {needed / 2**30:.3g} GiB", f"what fits into {there / 2**30:.1f} GiB"
        raise InputError(place, "", found, allowed)


def describe() -> dict[str, str]:
    """Return processor, vector width, cores and system as short strings."""
    name = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        models = [line.split(":", 1)[1].strip() for line in cpuinfo.read_text().splitlines() if "model name" in line]
        name = models[0] if models else name
    return {"cpu": name, "cores": str(num_cores()), "lanes": str(simd_width()), "system": platform.platform()}
