"""MuJoCo without its log file."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def without_log() -> Iterator[None]:
    """Keep MuJoCo's warnings from the console and from a file MUJOCO_LOG.TXT in the folder where we run."""
    import mujoco  # slow to import

    before = mujoco.get_mju_user_warning()
    mujoco.set_mju_user_warning(lambda _: None)
    try:
        yield
    finally:
        mujoco.set_mju_user_warning(before)
