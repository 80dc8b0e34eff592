"""Grown trees: the four ternary species of the thesis, and any other L-system.

The species are those of Prusinkiewicz and Lindenmayer, The Algorithmic Beauty of Plants, figure 2.8, which the thesis
calls Ta, Tb, Tc and Td::

    axiom  !(1)F(200)/(45)A
    A    -> !(vr)F(50)[&(a)!(1)F(50)A]/(d1)[&(a)!(1)F(50)A]/(d2)[&(a)!(1)F(50)A]
    F(l) -> F(l*lr)
    !(w) -> !(w*vr)

One thing differs from the book: ``!(1)`` at the head of each branch. There a branch keeps the width of the wood it
forks from up to its first internode, so that the cross-section triples at the fork before it falls back to what it was;
here a branch is as thick as that internode from the fork on. With vr = sqrt 3 the cross-section is then preserved at
every fork (Leonardo's rule). Positions and directions are the book's.

The book's y axis (up) is z here: its tropism (x, y, z) becomes (x, -z, y).
"""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from ..base.errors import InputError
from .lsystem import SMALLEST_FACTOR, LSystem, Seed
from .stiffness import StiffnessModel, apply_stiffness
from .tree import Joint, Tree
from .turtle import WOOD_DENSITY, interpret, segments_to_tree


class Ternary(NamedTuple):
    """Parameters of one ternary species: angles in degrees, rates a step, tropism with z up, metres per unit.

    The scale, which is not the book's, makes trees of order 2 saplings 1.7 to 1.8 m tall.
    """

    d1: float
    d2: float
    a: float
    lr: float
    vr: float
    tropism: tuple[float, float, float]
    bending: float
    scale: float


SPECIES = {
    "Ta": Ternary(94.74, 132.63, 18.95, 1.109, 1.732, (0.0, 0.0, -1.0), 0.22, 0.004),
    "Tb": Ternary(137.50, 137.50, 18.95, 1.109, 1.732, (0.0, 0.0, -1.0), 0.14, 0.004),
    "Tc": Ternary(112.50, 157.50, 22.50, 1.790, 1.732, (-0.02, 0.0, -1.0), 0.27, 0.002),
    "Td": Ternary(180.00, 252.00, 36.00, 1.070, 1.732, (-0.61, 0.19, 0.77), 0.40, 0.004),
}

DIAMETER_PER_UNIT = 0.010
"""Default width scale [m]: twigs 10 mm thick on a trunk of 10 mm vr^order (30 mm at order 2)."""


@cache
def species_system(species: str) -> LSystem:
    """L-system of ``Ta``, ``Tb``, ``Tc`` or ``Td``, upper or lower case.

    Raises:
        InputError: No such species.
    """
    name = str(species).capitalize()
    if name not in SPECIES:
        raise InputError("--species", "", repr(species), ", ".join(SPECIES))
    ternary = SPECIES[name]
    branch = "[&(a)!(1)F(50)A]"
    return LSystem(
        "!(1)F(200)/(45)A",
        [f"A -> !(vr)F(50){branch}/(d1){branch}/(d2){branch}", "F(l) -> F(l*lr)", "!(w) -> !(w*vr)"],
        {key: getattr(ternary, key) for key in ("d1", "d2", "a", "lr", "vr")},
        tropism=ternary.tropism,
        bending=ternary.bending,
        scale_m_per_unit=ternary.scale,
        width_m_per_unit=DIAMETER_PER_UNIT,
        source=name,
    )


def grow(
    species: str,
    order: int,
    *,
    noise: float = 0.1,
    seed: Seed = 0,
    name: str | None = None,
    scale: float | None = None,
    width_scale: float = DIAMETER_PER_UNIT,
    density: float = WOOD_DENSITY,
    joint: Joint = Joint.SPHERICAL,
    fixed_base: bool = False,
    stiffness: StiffnessModel = "rudimentary",
) -> Tree:
    """Grow one tree of a ternary species.

    Order n has 2 * 3^n - 1 links: 1, 5, 17, 53, 161 for n = 0 to 4.

    Args:
        species: Ta, Tb, Tc or Td, upper or lower case.
        order: Number of iterations n.
        noise: Standard deviation of the noise relative to each parameter (thesis B.9: 0.1), drawn afresh whenever a
            production is applied (`LSystem.derive`), once a tree for the bending; 0 grows the species itself.
        seed: Seed or generator of the noise; the same seed grows the same tree.
        name: Name of the tree; None for species and order, as in ``Ta_2``.
        scale: Metres per unit of length; None for the species' own, which makes order 2 1.7 to 1.8 m tall (`SPECIES`).
            Tc grows as 1.79^order: at order 4 it needs a wider ``width_scale`` to stand with the beam model.
        width_scale: Metres of diameter per unit of width; the default makes twigs 10 mm thick.
        density: Density of the wood [kg/m^3].
        joint: Kind of the joints.
        fixed_base: Whether the trunk is fixed to the ground instead of turning on it.
        stiffness: Model of the springs, with the defaults of `stiffness.rudimentary` (whose own noise of 1 N m/rad does
            not depend on ``noise``) or `stiffness.beam`; call these on the tree for other values.

    Raises:
        InputError: An unknown species, a negative order, noise outside 0 to 1.
    """
    if order < 0:
        raise InputError("--order", "", str(order), "0 or more")
    system = species_system(species)
    label = name or f"{system.source}_{order}"
    return grow_system(
        system, name=label, iterations=order, noise=noise, seed=seed, scale=scale, width_scale=width_scale,
        density=density, joint=joint, fixed_base=fixed_base, stiffness=stiffness,
    )  # fmt: skip


def grow_system(
    system: LSystem,
    *,
    name: str,
    iterations: int | None = None,
    noise: float = 0.0,
    seed: Seed = 0,
    scale: float | None = None,
    width_scale: float | None = None,
    density: float = WOOD_DENSITY,
    joint: Joint = Joint.SPHERICAL,
    fixed_base: bool = False,
    stiffness: StiffnessModel = "rudimentary",
) -> Tree:
    """Grow one tree of any L-system: derive its string, draw it, make each segment a link, give it springs.

    Args:
        system: The L-system.
        name: Name of the tree.
        iterations: How often the productions are applied; None for the system's own number.
        noise: As for `grow`.
        seed: As for `grow`.
        scale: Metres per unit of length; None for the system's own.
        width_scale: Metres of diameter per unit of width; None for the system's own.
        density: Density of the wood [kg/m^3].
        joint: Kind of the joints.
        fixed_base: Whether links on the ground are fixed to it.
        stiffness: Model of the springs.

    Raises:
        InputError: The string cannot be derived or drawn (`LSystem.derive`, `turtle.interpret`).
    """
    rng = np.random.default_rng(seed)
    modules = system.derive(iterations, seed=rng, noise=noise)
    segments = interpret(
        modules,
        tropism=system.tropism,
        bending=system.bending * max(1.0 + noise * rng.standard_normal(), SMALLEST_FACTOR),
        angle_deg=system.angle_deg,
        source=system.source,
    )
    tree = segments_to_tree(
        segments,
        name=name,
        scale=system.scale_m_per_unit if scale is None else scale,
        width_scale=system.width_m_per_unit if width_scale is None else width_scale,
        density=density,
        joint=joint,
        fixed_base=fixed_base,
    )
    return apply_stiffness(tree, stiffness, rng)


def grow_forest(
    species: str, count: int, order: int, *, noise: float = 0.1, seed: int = 0, **options: object
) -> list[Tree]:
    """Grow ``count`` trees of one species, named Ta_0000, Ta_0001, ...

    Tree i depends on ``seed`` and i alone, not on ``count``. Order 2 takes about 1 ms a tree on one core.

    Args:
        species: Ta, Tb, Tc or Td, upper or lower case.
        count: Number of trees.
        order: Number of iterations n: 2 * 3^n - 1 links, which is 1, 5, 17, 53, 161 for n = 0 to 4.
        noise: Standard deviation of the noise relative to each parameter of the rules, 0 to 1.
        seed: Seed of the forest.
        options: Further arguments of `grow`: scale [m per unit], width_scale [m per unit], density [kg/m^3], joint,
            fixed_base, stiffness (``rudimentary`` or ``beam``).

    Returns:
        One tree each, standing at the origin.

    Raises:
        InputError: ``count`` is below 1, an unknown species, a negative order, noise outside 0 to 1.
    """
    if count < 1:
        raise InputError("--count", "", str(count), "1 or more")
    label = species_system(species).source
    seeds = np.random.SeedSequence(seed).spawn(count)
    return [
        grow(species, order, noise=noise, seed=child, name=f"{label}_{i:04d}", **options)  # type: ignore[arg-type]
        for i, child in enumerate(seeds)
    ]
