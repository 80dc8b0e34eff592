"""How many threads torch's small operations take."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import torch


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch's host operations on one thread inside the block.

    Matrices of a hundred rows gain nothing from more, and beside another program their threads wait for one another: an
    eigenvalue problem of 10 ms then took 2.5 s.
    """
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
