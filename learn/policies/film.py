"""Forms that a film can have."""

from typing import Literal

#: ``gif``, one animation, or ``png``, a folder of numbered pictures.
Film = Literal["gif", "png"]
