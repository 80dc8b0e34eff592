"""Springs and dampers of a grown tree from what was inferred of a measured branch, or from a model of it.

A particle of the posterior holds K and D of every joint of the branch. The beam model (thesis, equation 4.2) turns them
into two properties of wood at R radii: the effective Young's modulus E_i = 2 K_i l_i / (pi r_i^4) and the relaxation
time tau_i = D_i / K_i, with length l_i and mean radius r_i of segment i. Each link of a tree takes E and tau at its own
radius, linear in log radius between the segments and constant outside them, and the beam model turns them back into K
and D with the link's length and radius. One particle makes one tree, so that the correlations between the joints of
the branch survive within a tree and the spread over a forest is the posterior's. A ``model.yaml`` is taken as a
posterior of one particle.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..base.archive import read_arrays
from ..base.errors import InputError
from ..base.types import Array
from ..trees.stiffness import beam, beam_size
from ..trees.tree import Tree

if TYPE_CHECKING:
    from .branch_file import BranchFile

#: A particle's wood in plain numbers, by rising radius: radius [m], Young's modulus [Pa], relaxation time [s].
Wood = tuple[tuple[float, float, float], ...]

_UNIT = {"stiffness": "N m/rad", "damping": "N m s/rad"}
_GEOMETRY = ("segment_name", "segment_length_m", "segment_radius_m")


@dataclass(frozen=True)
class SpringPosterior:
    """Properties of the wood of a branch, P particles at N radii.

    Attributes:
        radius: Different mean radii of the segments, rising [m], shape [N].
        young: Effective Young's modulus [Pa], shape [P, N].
        relaxation: Relaxation time D / K [s], shape [P, N].
        left_out: Effects that the file has beside springs and dampers, such as ``dry_friction@1``: a tree has none.
    """

    radius: Array
    young: Array
    relaxation: Array
    left_out: tuple[str, ...] = ()

    @classmethod
    def from_file(cls, path: str | Path) -> SpringPosterior:
        """Read the ``posterior.npz`` that ``bough identify`` or ``bough diagnose`` writes for a branch.

        Used are names [n], units [n] and particles [P, n] (SI), where a parameter is ``stiffness`` or ``damping`` of a
        segment (``stiffness child``) or of all joints (``stiffness``), and segment_name [R], segment_length_m [R],
        segment_radius_m [R, 2]. Other parameters and arrays are left alone; those of effects are named in ``left_out``.

        Raises:
            InputError: The file is missing or no such archive; there is no geometry (the posterior of joints measured
                directly), no stiffness or damping of a segment; shapes do not fit; a number is not finite or not
                positive.
        """
        file = Path(path)
        data = read_arrays(file, "the posterior.npz that bough identify writes")
        names, length, radius = _geometry(file, data)
        stiffness = np.stack([_values(file, data, "stiffness", name) for name in names], axis=1)
        damping = np.stack([_values(file, data, "damping", name) for name in names], axis=1)
        return cls.from_springs(length, radius, stiffness, damping, _effects(data["names"].tolist()))

    @classmethod
    def from_model(cls, path: str | Path) -> SpringPosterior:
        """Read a ``model.yaml`` (`branch_file`), one particle; its effects are named in ``left_out``.

        Raises:
            InputError: The file is faulty, does not give the segments' sizes, or has a joint without a damper.
        """
        from .branch_file import read_branch_file

        return cls.from_branch(read_branch_file(path), path)

    @classmethod
    def from_branch(cls, file: BranchFile, path: str | Path) -> SpringPosterior:
        """Return what `from_model` returns, of a file that has been read from ``path``.

        Springs fitted beside effects that the diagnosis does not claim are a guess too: a Python warning says so.

        Raises:
            InputError: It does not give the segments' sizes, or has a joint without a damper.
        """
        if file.sizes is None:
            allowed = "length_m, radius_base_m, radius_tip_m of every segment, as bough diagnose writes them"
            raise InputError(path, "segments", "no length_m", allowed)
        stiffness = np.array([[s.stiffness_Nmprad for s in file.segments]])
        damping = np.array([[s.damping_Nmsprad for s in file.segments]])
        names = [s.name for s in file.segments]
        if not file.claimed:
            warnings.warn(f"{path}: springs beside effects that the diagnosis does not claim", stacklevel=2)
        _check_numbers(Path(path), "segments", damping, lambda i: f"{names[i[1]]} damping_Nmsprad")
        length, *radius = np.array(file.sizes).T
        return cls.from_springs(length, np.mean(radius, axis=0), stiffness, damping, [e.label for e in file.effects])

    @classmethod
    def from_springs(
        cls, length: Array, radius: Array, stiffness: Array, damping: Array, left_out: Sequence[str] = ()
    ) -> SpringPosterior:
        """Return the wood of segments of given length and mean radius [m], shapes [R].

        Args:
            length: Of the segments.
            radius: Of the segments.
            stiffness: K [N m/rad], shape [P, R].
            damping: D [N m s/rad], shape [P, R].
            left_out: See the class.
        """
        young = 2.0 * stiffness * length / (np.pi * radius**4)
        distinct, group = np.unique(radius, return_inverse=True)
        mean = np.equal.outer(group, np.arange(len(distinct))) / np.bincount(group)
        return cls(distinct, young @ mean, (damping / stiffness) @ mean, tuple(left_out))

    @classmethod
    def from_wood(cls, wood: Wood) -> SpringPosterior:
        """Return the posterior of one particle that `wood` told."""
        radius, young, relaxation = np.array(wood, np.float64).T
        return cls(radius, young[None], relaxation[None])

    def wood(self, particle: int = 0) -> Wood:
        """Return one particle in plain numbers, to be kept in settings; `from_wood` gives it back to the bit."""
        rows = zip(self.radius, self.young[particle], self.relaxation[particle], strict=True)
        return tuple((float(radius), float(young), float(relaxation)) for radius, young, relaxation in rows)

    def draw(self, seed: np.random.SeedSequence | int) -> int:
        """Draw the index of a particle, all equally likely."""
        return int(np.random.default_rng(seed).integers(len(self.young)))

    def apply(self, tree: Tree, particle: int) -> Tree:
        """Return the tree with one particle's springs and dampers; fixed and prismatic joints keep their values.

        A tree whose links have the branch's lengths and radii gets the particle's K and D; segments of the same mean
        radius share the mean of their E and tau.

        Raises:
            InputError: Names a turning link that has no capsule of positive length.
        """
        radius = beam_size(tree)[0]
        at = np.log(np.where(radius > 0.0, radius, self.radius[0]))
        young, relaxation = (np.interp(at, np.log(self.radius), v[particle]) for v in (self.young, self.relaxation))
        return beam(tree, young, relaxation)


def _array(file: Path, data: dict[str, np.ndarray], name: str, shape: tuple[int | None, ...], kind: str) -> Any:
    """Return an array of the given kind (numbers or text); None in ``shape`` stands for any length above zero."""
    if name not in data:
        raise InputError(file, name, f"only {', '.join(data) or 'an empty archive'}", f"an array {name}")
    array = data[name]
    right = array.ndim == len(shape) and all(
        found == wanted or (wanted is None and found > 0) for found, wanted in zip(array.shape, shape, strict=True)
    )
    if not right:
        wanted = ", ".join("1 or more" if n is None else str(n) for n in shape)
        raise InputError(file, name, f"shape {list(array.shape)}", f"shape [{wanted}]")
    if array.dtype.kind not in {"numbers": "fiu", "text": "U"}[kind]:
        raise InputError(file, name, f"entries of type {array.dtype}", kind)
    return array


def _geometry(file: Path, data: dict[str, np.ndarray]) -> tuple[list[str], Array, Array]:
    """Return names, lengths [R] and mean radii [R] of the segments."""
    missing = [name for name in _GEOMETRY if name not in data]
    if missing:
        allowed = "the posterior of a branch (branch-gap-case/1), which has segments with lengths and radii"
        raise InputError(file, missing[0], "no such array", allowed)
    names = _array(file, data, "segment_name", (None,), "text").tolist()
    length = _array(file, data, "segment_length_m", (len(names),), "numbers").astype(np.float64)
    radius = _array(file, data, "segment_radius_m", (len(names), 2), "numbers").astype(np.float64)
    _check_numbers(file, "segment_length_m", length, lambda i: names[i[0]])
    _check_numbers(file, "segment_radius_m", radius, lambda i: names[i[0]])
    return names, length, radius.mean(axis=1)


def _values(file: Path, data: dict[str, np.ndarray], kind: str, segment: str) -> Array:
    """Return a segment's stiffness or damping in every particle, shape [P]."""
    names = _array(file, data, "names", (None,), "text").tolist()
    units = _array(file, data, "units", (len(names),), "text").tolist()
    particles = _array(file, data, "particles", (None, len(names)), "numbers")
    column = [i for i, name in enumerate(names) if name in (f"{kind} {segment}", kind)]
    if len(column) != 1:
        found = "no such parameter" if not column else " and ".join(names[i] for i in column)
        raise InputError(file, f"names, {kind} of segment {segment}", found, f"one '{kind} {segment}' or '{kind}'")
    if units[column[0]] != _UNIT[kind]:
        raise InputError(file, f"units, {names[column[0]]}", repr(units[column[0]]), _UNIT[kind])
    values: Array = particles[:, column[0]].astype(np.float64)
    _check_numbers(file, "particles", values, lambda i: f"particle {i[0]}, {names[column[0]]}")
    return values


def _effects(names: Sequence[str]) -> list[str]:
    """Return the effects among the parameters, each once: ``dry_friction@1`` of ``dry_friction@1 torque_Nm``."""
    labels = list(dict.fromkeys(name.split(" ")[0] for name in names if name.split(" ")[0] not in _UNIT))
    if not labels:
        return []
    from ..effects import effects  # Warp, which springs alone do not need

    known = {e.name for e in effects()}
    return [label for label in labels if label.split("@")[0] in known]


def _check_numbers(file: Path, name: str, values: Array, place: Callable[[tuple[int, ...]], str]) -> None:
    """Raise `InputError` for the first value that is not finite and positive; ``place`` names it by its index."""
    bad = np.argwhere(~(np.isfinite(values) & (values > 0.0)))
    if len(bad):
        index = tuple(bad[0].tolist())
        raise InputError(file, f"{name}, {place(index)}", f"{values[index]:g}", "finite numbers above 0")
