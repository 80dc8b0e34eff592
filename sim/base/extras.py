"""How to install an optional part, said so that it works: bough need not be on a package index."""

from __future__ import annotations

import re
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
"""Folder of the package: the checkout where it is installed from one (``pip install -e``)."""


def install_hint(extra: str, root: Path = ROOT) -> str:
    """Return the command that installs an extra, as a user of this installation can give it.

    From a checkout it installs the extra of the checkout; elsewhere the packages that the extra stands for.

    Args:
        extra: Name of the extra in ``pyproject.toml``.
        root: Folder of the package.
    """
    if (root / "pyproject.toml").is_file():
        return f"pip install -e '{root}[{extra}]'"
    return "pip install " + (" ".join(f"'{name}'" for name in _packages(extra)) or f"'bough[{extra}]'")


def _packages(extra: str) -> list[str]:
    """Return requirements of an extra, from what is known of the installed package."""
    try:
        lines = requires("bough") or []
    except PackageNotFoundError:
        return []
    named = [line.partition(";") for line in lines]
    marked = re.compile(rf"""extra\s*==\s*["']{re.escape(extra)}["']""")
    return [name.strip() for name, _, marker in named if marked.search(marker)]
