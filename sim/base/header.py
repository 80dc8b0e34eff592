"""Warp's precompiled header, kept from process to process beside its kernels."""

from __future__ import annotations

import atexit
import os
import shutil
import tempfile
from functools import cache
from hashlib import blake2s
from pathlib import Path

import warp as wp

_SUFFIX = ".pch"


@cache
def share_header() -> None:
    """Fetch what earlier processes have kept, once, and keep what this one makes when it ends."""
    fetch_header()
    atexit.register(keep_header)


def fetch_header() -> None:
    """Give this thread the precompiled headers that earlier processes have kept; Warp must be initialised.

    Warp 1.19 makes one in every process that compiles a kernel for a CPU, which takes 2 s, and a small kernel 0.1 s. It
    looks for it in a folder of the process under a name that tells the compiler's options. Where this Warp has no such
    folder nothing is done.
    """
    own = _own_folder()
    if own is None:
        return
    for kept in _kept_folder().glob(f"*{_SUFFIX}"):
        if not (own / kept.name).exists():
            _copy(kept, own / kept.name)


def keep_header() -> None:
    """Keep the precompiled headers that Warp has made in this thread for later processes."""
    own = _own_folder()
    if own is None:
        return
    folder = _kept_folder()
    for made in own.glob(f"*{_SUFFIX}"):
        kept = folder / made.name
        if not kept.exists() or kept.stat().st_size != made.stat().st_size:  # one that Warp refused was made anew
            _copy(made, kept)


def _own_folder() -> Path | None:
    """Return the folder in which Warp looks for this thread's headers."""
    from warp._src import context  # Warp has no public name for it

    get = getattr(getattr(context, "runtime", None), "get_clang_pch_dir", None)
    return Path(folder) if get and (folder := get()) else None


def _kept_folder() -> Path:
    """Return the folder of headers made by this very installation: a header refuses sources of another place or age."""
    native = Path(wp.__file__).parent / "native"
    ages = sorted((p.name, p.stat().st_mtime_ns) for p in native.glob("*.h"))
    about = blake2s(repr((wp.__version__, str(native), ages)).encode(), digest_size=8).hexdigest()
    return Path(str(wp.config.kernel_cache_dir)) / f"headers-{about}"


def _copy(source: Path, target: Path) -> None:
    """Copy a file whole or not at all; without room or leave there is none, and Warp makes its own."""
    part = None
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        number, part = tempfile.mkstemp(dir=target.parent)
        os.close(number)
        shutil.copyfile(source, part)
        os.replace(part, target)
    except OSError:
        if part is not None:
            Path(part).unlink(missing_ok=True)
