"""Arms by name: bough's own, and those of installed packages."""

from __future__ import annotations

from ..base.plugins import Registry
from .arm import Arm
from .jaco2 import jaco2

#: Entry points of the group ``bough_arms`` name an `Arm`, or a function that returns one.
ARMS = Registry("bough_arms", "arm", Arm, {"jaco2": jaco2, "jaco2_spherical": lambda: jaco2("spherical")})
