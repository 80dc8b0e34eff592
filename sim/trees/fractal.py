"""Area-preserving fractal trees and chains of coupled branches, after chapter 3 of the thesis.

At every fork the radii obey r^p = sum of the children's r_i^p; p = 2 preserves the cross-section (Leonardo's rule;
Minamino and Tateno 2014).
"""

from __future__ import annotations

import numpy as np

from ..base.errors import InputError
from .lsystem import SMALLEST_FACTOR, Seed
from .stiffness import StiffnessModel, apply_stiffness, rudimentary
from .tree import Joint, Tree
from .turtle import WOOD_DENSITY, Module, interpret, segments_to_tree

MAX_LINKS = 100_000


def grow_fractal(
    levels: int,
    *,
    children: int = 2,
    length: float = 0.6,
    radius: float = 0.015,
    length_ratio: float = 0.75,
    exponent: float = 2.0,
    fork_angle_deg: float = 30.0,
    roll_deg: float = 90.0,
    noise: float = 0.1,
    seed: Seed = 0,
    name: str = "fractal",
    density: float = WOOD_DENSITY,
    joint: Joint = Joint.SPHERICAL,
    fixed_base: bool = False,
    stiffness: StiffnessModel = "rudimentary",
) -> Tree:
    """Grow a tree in which every branch ends in a fork of the same kind.

    One branch is one link; R levels with k children have 1 + k + ... + k^(R - 1) links.

    Args:
        levels: Number of levels R, 1 for the trunk alone.
        children: Branches at each fork k, evenly spaced about the parent's axis.
        length: Length of the trunk [m].
        radius: Radius of the trunk [m].
        length_ratio: Length of a branch over its parent's.
        exponent: Exponent p of the radii at forks.
        fork_angle_deg: Angle between a branch and its parent's axis [degrees].
        roll_deg: Turn of each fork about the parent's axis against the fork before [degrees].
        noise: Standard deviation of Gaussian noise, relative, on each branch's length, fork angle, roll and share of
            the fork's cross-section; shares are divided by their sum, so that forks obey the exponent all the same.
            No factor falls below 0.1.
        seed: Seed or generator of the noise.
        name: Name of the tree.
        density: Density of the wood [kg/m^3].
        joint: Kind of the joints.
        fixed_base: Whether the trunk is fixed to the ground.
        stiffness: Model of the springs.

    Raises:
        InputError: A parameter is out of range, or more than 100,000 links would grow.
    """
    _require_whole(name, levels=levels, children=children)
    _require_positive(name, length=length, radius=radius, length_ratio=length_ratio, exponent=exponent, density=density)
    if not 0.0 <= noise <= 1.0:
        raise InputError(name, "noise", f"{noise:g}", "0 to 1")
    links = levels if children == 1 else (children ** min(levels, 60) - 1) // (children - 1)
    if links > MAX_LINKS:
        raise InputError(name, "levels", f"{levels} levels of {children} children", f"at most {MAX_LINKS} links")
    rng = np.random.default_rng(seed)

    def vary(count: int) -> np.ndarray:
        """Draw factors 1 + noise x N(0, 1), none below `SMALLEST_FACTOR`."""
        return np.maximum(1.0 + noise * rng.standard_normal(count), SMALLEST_FACTOR)

    def branch(level: int, long: float, thick: float) -> list[Module]:
        """Return the modules of a branch of this length and radius [m] and of all that it bears."""
        out: list[Module] = [("!", (2.0 * thick,)), ("F", (long,))]
        if level + 1 == levels:
            return out
        share = vary(children)
        radii = thick * (share / share.sum()) ** (1.0 / exponent)
        turns, forks, lengths = vary(children), vary(children), vary(children)
        for i in range(children):
            roll = roll_deg * turns[i] + i * 360.0 / children
            inner = branch(level + 1, long * length_ratio * lengths[i], radii[i])
            out += [("[", ()), ("/", (roll,)), ("&", (fork_angle_deg * forks[i],)), *inner, ("]", ())]
        return out

    modules = branch(0, length * vary(1)[0], radius)
    tree = segments_to_tree(
        interpret(modules, source=name), name=name, density=density, joint=joint, fixed_base=fixed_base
    )
    return apply_stiffness(tree, stiffness, rng)


def grow_chain(
    branches: int,
    *,
    length: float = 0.6,
    radius: float = 0.015,
    length_ratio: float = 0.75,
    radius_ratio: float = 0.5**0.5,
    fork_angle_deg: float = 30.0,
    name: str = "chain",
    density: float = WOOD_DENSITY,
    joint: Joint = Joint.REVOLUTE,
    fixed_base: bool = False,
) -> Tree:
    """Grow R coupled branches, each on the tip of the one before: trunk, parent, child, as chapter 3 identifies them.

    All lie in the plane x = 0; revolute joints, the default, turn in it. Springs are the rudimentary model's without
    noise.

    Args:
        branches: Number of branches R.
        length: Length of the first [m].
        radius: Radius of the first [m].
        length_ratio: Length of a branch over its parent's.
        radius_ratio: Radius of a branch over its parent's; the default is one of two even children (Leonardo's rule).
        fork_angle_deg: Angle between a branch and its parent [degrees].
        name: Name of the tree.
        density: Density of the wood [kg/m^3].
        joint: Kind of the joints.
        fixed_base: Whether the first branch is fixed to the ground.

    Raises:
        InputError: A parameter is out of range.
    """
    _require_whole(name, branches=branches)
    _require_positive(
        name, length=length, radius=radius, length_ratio=length_ratio, radius_ratio=radius_ratio, density=density
    )
    modules: list[Module] = []
    for i in range(branches):
        fork: list[Module] = [("[", ()), ("&", (fork_angle_deg,))] if i else []
        modules += [*fork, ("!", (2.0 * radius * radius_ratio**i,)), ("F", (length * length_ratio**i,))]
    segments = interpret([*modules, *[("]", ())] * (branches - 1)], source=name)
    tree = segments_to_tree(segments, name=name, density=density, joint=joint, fixed_base=fixed_base)
    return rudimentary(tree, sigma=0.0)


def _require_whole(name: str, **values: int) -> None:
    for place, value in values.items():
        if value < 1:
            raise InputError(name, place, str(value), "1 or more")


def _require_positive(name: str, **values: float) -> None:
    for place, value in values.items():
        if not 0.0 < value < float("inf"):
            raise InputError(name, place, f"{value:g}", "a finite number above 0")
