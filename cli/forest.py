"""``bough forest``: grow trees, write them as files, draw them."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Collection
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from ..sim.base.console import bar, shown, start_warp, tell, warn
from ..sim.base.errors import InputError, check_seed
from ..sim.base.extras import install_hint
from ..sim.base.files import output_folder
from ..sim.base.host import check_memory
from .base.exit_codes import ExitCode

if TYPE_CHECKING:
    from ..sim.trees.tree import Tree
    from ..sim.wood.posterior import SpringPosterior

Format = Literal["mjcf", "urdf", "glb", "usd"]
_SUFFIX = {"mjcf": ".xml", "urdf": ".urdf", "glb": ".glb", "usd": ".usda"}
_ASPECT = 9 / 16


@dataclass(frozen=True)
class Forest:
    """Grow trees by an L-system and write one file per tree, forest.json and a picture, forest.png.

    Springs are relaxed in the pose that is drawn, so under gravity the trees sag a little (2 to 15 mm at order 2).
    Exit code 0: done; 2: bad input, nothing written.

    Attributes:
        out: Folder to write to.
        species: Ta, Tb, Tc or Td; Ta if neither this nor an L-system is given.
        lsystem: L-system file (YAML) to grow instead of a species.
        count: Number of trees.
        order: How often the productions are applied; 2 for a species, else what the L-system file says.
        noise: Standard deviation of every parameter, as a share of it.
        stiffness: Model of the springs: by branching order (rudimentary, if nothing is given), or E pi r^4 / 2 l of a
            beam.
        posterior: posterior.npz of an identified branch, instead of a stiffness model: each tree draws one of its
            particles.
        model: model.yaml of a branch with lengths and radii, such as bough diagnose writes, instead of a stiffness
            model: every tree is of its wood. Its effects are left out, since tree files cannot hold them.
        format: File formats to write for every tree: tree_0000.xml, .urdf, .glb, .usda.
        seed: Seed of the noise; tree i depends on the seed and on i alone.
        picture_width: Width of forest.png [pixels]; 0 draws none.
        leaves: Draw leaves on the outermost links: decoration, as the picture says; nothing of them is simulated.
        json: Print forest.json as JSON instead of a sentence.
    """

    out: Path
    species: str | None = None
    lsystem: Path | None = None
    count: int = 64
    order: int | None = None
    noise: float = 0.1
    stiffness: Literal["rudimentary", "beam"] | None = None
    posterior: Path | None = None
    model: Path | None = None
    format: tuple[Format, ...] = ("mjcf",)
    seed: int = 0
    picture_width: Annotated[int, tyro.conf.arg(metavar="PIXELS")] = 1600
    leaves: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False
    json: bool = False

    def run(self) -> int:
        """Write the forest and say so; return 0."""
        trees = write_forest(self)
        links = _range({t.num_links for t in trees}, "{:d}")
        height = _range({tree_height(t) for t in trees}, "{:.2f}")
        files = (
            [f"tree_*{_SUFFIX[f]}" for f in self.format] + ["forest.json"] + ["forest.png"] * bool(self.picture_width)
        )
        said = f"{len(trees)} trees of {links} links, {height} m tall: {shown(self.out)}/{', '.join(files)}"
        tell(said, self.out / "forest.json", self.json)
        return ExitCode.DONE


def _range(values: Collection[float], form: str) -> str:
    low, high = form.format(min(values)), form.format(max(values))
    return low if low == high else f"{low} to {high}"


_LINK_BYTES = 800
"""Bytes of host memory a link of a tree that is kept until all are drawn."""


def write_forest(options: Forest) -> list[Tree]:
    """Grow and write a forest, whole or not at all; return its trees.

    Raises:
        InputError: An option out of range, a faulty L-system file, posterior or model, a folder that cannot be written,
            a format whose package is missing.
    """
    _check(options)
    options = _settled(options)
    with output_folder(options.out) as folder:
        grow_one = _grower(options)
        trees, described = [], []
        with bar("growing trees", options.count) as advance:
            for i in range(options.count):
                tree, drawn = grow_one(i)
                if i == 0:
                    what = f"{options.count} trees of {tree.num_links} links"
                    check_memory("--count", what, float(options.count * tree.num_links * _LINK_BYTES))
                _write_tree(tree, folder / f"tree_{i:04d}", options.format)
                trees.append(tree)
                described.append(_described(tree, i, options) | drawn)
                advance(1)
        description = {"options": _plain(options), "trees": described}
        (folder / "forest.json").write_text(json.dumps(description, indent=1) + "\n")
        if options.picture_width:
            _draw(trees, folder / "forest.png", options)
    return trees


def _check(options: Forest) -> None:
    def need(ok: bool, option: str, found: object, allowed: str) -> None:
        """Raise `InputError` that names the option unless ``ok``."""
        if not ok:
            raise InputError(option, "", str(found), allowed)

    need(options.count >= 1, "--count", options.count, "1 or more")
    need(options.order is None or options.order >= 0, "--order", options.order, "0 or more")
    need(0.0 <= options.noise <= 1.0, "--noise", options.noise, "0 to 1")
    check_seed("", options.seed)
    need(len(options.format) > 0, "--format", "none", "at least one of mjcf, urdf, glb, usd")
    installed = "usd" not in options.format or find_spec("pxr") is not None
    need(installed, "--format", "usd without the package usd-core", install_hint("usd"))
    width = options.picture_width
    need(width == 0 or 64 <= width <= 8192, "--picture-width", width, "0 for no picture, or 64 to 8192")
    both = options.species is not None and options.lsystem is not None
    need(not both, "--lsystem", f"{options.lsystem} and --species {options.species}", "one of the two")
    given = {f"--{name}": getattr(options, name) for name in ("posterior", "model", "stiffness")}
    chosen = [name for name, value in given.items() if value is not None]
    for other in chosen[1:]:
        need(False, chosen[0], f"{given[chosen[0]]} and {other} {given[other]}", "one of the two")


def _grower(options: Forest) -> Callable[[int], tuple[Tree, dict[str, int]]]:
    """Return the function that grows tree i and says which particle it drew; `species.grow_forest` draws the same."""
    import numpy as np

    from ..sim.trees.lsystem import LSystem
    from ..sim.trees.species import grow_system, species_system

    if options.lsystem is not None:
        system, label = LSystem.from_file(options.lsystem), options.lsystem.stem
    else:
        system = species_system(options.species or "")
        label = system.source
    springs = _springs(options)

    def grow_one(i: int) -> tuple[Tree, dict[str, int]]:
        """Grow tree i from random numbers of its own; return it and the particle that its springs were drawn as."""
        seed = np.random.SeedSequence(options.seed, spawn_key=(i,))
        tree = grow_system(
            system, name=f"{label}_{i:04d}", iterations=options.order, noise=options.noise, seed=seed,
            stiffness=options.stiffness or "beam",
        )  # fmt: skip
        if springs is None:
            return tree, {}
        if options.model is not None:
            return springs.apply(tree, 0), {}
        particle = springs.draw(np.random.SeedSequence(options.seed, spawn_key=(i, 0)))
        return springs.apply(tree, particle), {"particle": particle}

    return grow_one


def _springs(options: Forest) -> SpringPosterior | None:
    """Read what a branch's springs are; say in one line which of its effects the trees will not have."""
    from ..sim.wood.posterior import SpringPosterior

    if options.model is not None:
        found = SpringPosterior.from_model(options.model)
    elif options.posterior is not None:
        found = SpringPosterior.from_file(options.posterior)
    else:
        return None
    if found.left_out:
        effects = ", ".join(found.left_out)
        warn(f"{options.model or options.posterior}: left out: {effects}: trees have springs and dampers alone")
    return found


def _write_tree(tree: Tree, stem: Path, formats: tuple[Format, ...]) -> None:
    from ..sim.formats.export_mesh import to_glb, to_usd
    from ..sim.formats.export_mjcf import to_mjcf
    from ..sim.formats.export_urdf import to_urdf

    path = {name: stem.with_suffix(_SUFFIX[name]) for name in formats}
    if "mjcf" in path:
        path["mjcf"].write_text(to_mjcf(tree))
    if "urdf" in path:
        path["urdf"].write_text(to_urdf(tree))
    if "glb" in path:
        to_glb([tree], path["glb"])
    if "usd" in path:
        to_usd([tree], path["usd"])


def _draw(trees: list[Tree], path: Path, options: Forest) -> None:
    start_warp(torch=False)
    from ..sim.pictures.render import render_forest

    width = options.picture_width
    with bar("drawing forest.png", None):
        height = round(width * _ASPECT)
        render_forest(trees, path, width=width, height=height, leaves=options.leaves, seed=options.seed)


def tree_height(tree: Tree) -> float:
    """Height of a tree's highest capsule end above its base [m], joints at zero."""
    from ..sim.formats.export_mesh import shape_ends

    start, end = shape_ends(tree)
    return float(max(start[:, 2].max(), end[:, 2].max()) - min(start[:, 2].min(), end[:, 2].min()))


def _described(tree: Tree, i: int, options: Forest) -> dict[str, Any]:
    return {
        "name": tree.name,
        "files": [f"tree_{i:04d}{_SUFFIX[f]}" for f in options.format],
        "links": tree.num_links,
        "dofs": tree.num_dofs,
        "height_m": round(tree_height(tree), 6),
        "mass_kg": round(math.fsum(tree.mass), 6),
        "seed": {"entropy": options.seed, "spawn_key": [i]},
    }


def _plain(options: Forest) -> dict[str, Any]:
    """Return the options that decide what the trees are, as JSON can hold them."""
    kept = {k: str(v) if isinstance(v, Path) else v for k, v in asdict(options).items()}
    return {k: v for k, v in kept.items() if k not in ("out", "picture_width", "leaves", "json")}


def _settled(options: Forest) -> Forest:
    """Return the options with the defaults that depend on others.

    Ta of order 2 where there is no L-system file, rudimentary springs where there is neither posterior nor model.
    """
    if options.posterior is None and options.model is None:
        options = replace(options, stiffness=options.stiffness or "rudimentary")
    if options.lsystem is not None:
        return options
    return replace(options, species=options.species or "Ta", order=2 if options.order is None else options.order)
