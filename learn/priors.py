"""Which priors a name stands for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from ..sim.errors import InputError
from .plant import Plant
from .plant_branch import BranchPlant
from .prior import Normal, Prior, Product, box_prior
from .prior_earlier import read_earlier
from .prior_learnt import GeometryPrior, InequalityPrior, chain_pairs

NAMES = ("box", "inequality", "geometry", "lognormal")
#: Standard deviation of the log-normal prior: a factor of ten either way lies within two of them.
LOGNORMAL_SIGMA = float(np.log(10.0) / 2.0)


def make_prior(names: Sequence[str], plant: Plant) -> Prior:
    """Return the product of the smooth box, which always holds, and what the names add.

    Args:
        names: Of ``box``, ``inequality`` (a child's spring and damper below its parent's), ``geometry`` (what grown
            trees say of parent and child), ``lognormal`` (about the typical values, a factor of ten within two
            deviations), or the path of an earlier case's ``posterior.npz``.
        plant: What the unknowns belong to.

    Raises:
        InputError: A name is none of these, or does not fit the plant.
    """
    return Product([box_prior(plant.parameters), *(_one(name, plant) for name in names if name != "box")])


def _one(name: str, plant: Plant) -> Prior:
    if name == "lognormal":
        centre = torch.tensor([p.start for p in plant.parameters], dtype=torch.float64)
        wide = [LOGNORMAL_SIGMA if p.scale == "log" else (p.high - p.low) / 4.0 for p in plant.parameters]
        return Normal(centre, torch.tensor(wide, dtype=torch.float64))
    if name in ("inequality", "geometry"):
        pairs = chain_pairs([p.name for p in plant.parameters]) if isinstance(plant, BranchPlant) else []
        if not pairs:
            raise InputError(
                "--prior", name, "no parent and child with springs of their own", "a branch of two segments"
            )
        return InequalityPrior(pairs) if name == "inequality" else _geometry(pairs, plant)
    if name.endswith(".npz"):
        return read_earlier(Path(name), plant.parameters)
    raise InputError("--prior", name, "no prior of that name", f"{', '.join(NAMES)}, or a posterior.npz")


def _geometry(pairs: Sequence[tuple[int, int]], plant: Plant) -> Prior:
    """Take every pair's radius and length ratio from the branch: pairs run base first, springs then dampers."""
    assert isinstance(plant, BranchPlant)
    radius, length = plant.branch.radius.mean(axis=1), plant.branch.length
    ratios = [np.tile(x[1:] / x[:-1], len(pairs) // (len(x) - 1)) for x in (radius, length)]
    return GeometryPrior(pairs, *(x.tolist() for x in ratios))
