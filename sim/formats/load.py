"""Reading a mechanism from a robot file, whatever its format."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..base.errors import InputError

if TYPE_CHECKING:
    from .import_mjcf import Mechanism

ALLOWED = "an MJCF file (.xml, .mjcf), a URDF file (.urdf) or a compiled MuJoCo model (.mjb)"


def load_mechanism(source: str | Path, allowed: str = ALLOWED, *, ignore: Sequence[str] = ()) -> Mechanism:
    """Read an MJCF file, a URDF file or a compiled MuJoCo model, told apart by its suffix.

    Args:
        source: The file.
        allowed: What an error says there may be.
        ignore: Words of `bough.sim.formats.omissions` ("limits", "contacts", "actuators" ... or "all") for what may be
            left out of what a `Tree` does not have; `Mechanism.ignored` lists what was.

    Returns:
        Tree, gravity [m/s^2], start coordinates, friction [N m or N] and what was left out.

    Raises:
        InputError: No such file, another suffix (``allowed`` says which there are), or what `load_mjcf` and `load_urdf`
            refuse.
    """
    source = Path(source)
    if not source.exists():
        raise InputError(source, "", "no such file or folder", allowed)
    suffix = source.suffix.lower()
    if suffix == ".urdf":
        from .import_urdf import load_urdf

        return load_urdf(source, ignore)
    if suffix == ".mjb":
        from .import_mujoco import load_mjb

        return load_mjb(source, ignore)
    if suffix not in (".xml", ".mjcf"):
        raise InputError(source, "", f"a file that ends in '{suffix}'", allowed)
    from .import_mjcf import load_mjcf

    return load_mjcf(source, ignore)
