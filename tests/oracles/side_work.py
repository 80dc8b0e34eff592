"""Work for processes of their own, which find functions by the name of their module."""

import os
import time

from bough.sim.base.errors import InputError
from bough.sim.base.host import num_threads


def told(item, advance):
    """Count as many steps as the item says; return twice the item, the process and the threads that it may take."""
    for _ in range(item):
        advance(1)
    return 2 * item, os.getpid(), num_threads()


def refused(item, advance):
    """Refuse what is asked for."""
    raise InputError("forces.csv", "row 3", f"{item}", "a number")


def gone(item, advance):
    """End the process without a word."""
    os._exit(3)


def slept(item, advance):
    """Sleep so many seconds; return them."""
    time.sleep(item)
    return item


def wrote(item, advance):
    """Write the number of this process to a file, and sleep for ten minutes."""
    item.write_text(f"{os.getpid()}")
    time.sleep(600)
