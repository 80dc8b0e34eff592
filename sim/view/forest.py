"""Reading what moves: a folder that ``bough forest`` wrote, or one file of a tree."""

from __future__ import annotations

from pathlib import Path

from ..base.console import bar, warn
from ..base.errors import InputError
from ..base.json_file import read_object
from ..formats.load import load_mechanism
from .living import Planted

FILE = "forest.json"
_READ = (".xml", ".urdf")
_WRITTEN = "what bough forest writes"


def read_forest(folder: Path) -> Planted:
    """Read the trees of a folder that ``bough forest`` wrote, from MJCF or URDF.

    Raises:
        InputError: The folder's description or a tree cannot be read, or there is neither format.
    """
    names = _files(folder / FILE)
    found = []
    with bar("reading trees", len(names)) as advance:
        for name in names:
            found.append(load_mechanism(folder / name))
            advance(1)
    return Planted([m.tree for m in found], found[0].gravity, [m.qpos0 for m in found])


def _files(description: Path) -> list[str]:
    try:
        trees = [tree["files"] for tree in read_object(description, _WRITTEN)["trees"]]
    except (KeyError, TypeError):
        raise InputError(description, "", "no description of a forest", _WRITTEN) from None
    chosen = [next((f for f in files if Path(f).suffix in _READ), None) for files in trees]
    if not chosen or None in chosen:
        allowed = "a forest written with --format mjcf or urdf"
        raise InputError(description, "trees", "no tree" if not chosen else "only other formats", allowed)
    return [name for name in chosen if name is not None]


def read_tree(file: Path) -> Planted:
    """Read one tree from MJCF or URDF, to be looked at: what bough does not simulate is left out and named.

    Raises:
        InputError: What `load_mechanism` refuses, or a tree without a shape.
    """
    mechanism = load_mechanism(file, ignore=("all", "friction"))
    for line in mechanism.ignored:
        warn(f"{file}: left out: {line}")
    if not len(mechanism.tree.shape_link):
        raise InputError(file, "", "no capsule, sphere or cylinder", "a tree with a shape to draw")
    return Planted([mechanism.tree], mechanism.gravity, [mechanism.qpos0])
