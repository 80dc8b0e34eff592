"""What a pixel can show."""

from enum import IntEnum


class Label(IntEnum):
    """What a pixel shows."""

    BACKGROUND = 0
    BRANCH = 1
    LINE = 2
    ROBOT = 3
    LEAF = 4
