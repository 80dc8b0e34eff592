"""Reading a mechanism from a robot file, whatever its format."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from ..base.errors import InputError

if TYPE_CHECKING:
    from .import_mjcf import Mechanism

ALLOWED = "an MJCF file (.xml, .mjcf) or a URDF file (.urdf)"


def load_mechanism(source: str | Path, allowed: str = ALLOWED) -> Mechanism:
    """Read an MJCF or URDF file, told apart by its suffix.

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

        return load_urdf(source)
    if suffix not in (".xml", ".mjcf"):
        raise InputError(source, "", f"a file that ends in '{suffix}'", allowed)
    from .import_mjcf import load_mjcf

    return load_mjcf(source)
