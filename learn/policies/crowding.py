"""Contacts that found no room in a task's worlds: what a table says beside what a policy reached."""

from __future__ import annotations

from ..tasks.task import Task


def contacts_without_room(task: Task) -> int:
    """Return the contacts that a task's worlds had no room for since they were made, 0 where nothing touches.

    A look from the host at numbers of the device.
    """
    simulator = getattr(task, "simulator", None)  # a task need not be one of an arm among branches
    return int(getattr(simulator, "without_room", 0))
