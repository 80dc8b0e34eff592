"""Which priors a name stands for."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import torch

from ...sim.base.errors import InputError
from ..systems.branch import BranchSystem
from ..systems.system import System
from .earlier import read_earlier
from .learnt import GeometryPrior, InequalityPrior, chain_pairs
from .prior import Normal, Prior, Product, box_prior

NAMES = ("box", "inequality", "geometry", "lognormal")
#: Standard deviation of the log-normal prior: a factor of ten either way lies within two of them.
LOGNORMAL_SIGMA = float(np.log(10.0) / 2.0)


def make_prior(names: Sequence[str], system: System) -> Prior:
    """Return the product of the smooth box, which always holds, and what the names add.

    Args:
        names: Of ``box``, ``inequality`` (a child's spring and damper below its parent's), ``geometry`` (what grown
            trees say of parent and child), ``lognormal`` (about the typical values, a factor of ten within two
            deviations), or the path of an earlier case's ``posterior.npz``.
        system: What the unknowns belong to.

    Raises:
        InputError: A name is none of these, or does not fit the system.
    """
    return Product([box_prior(system.parameters), *(_one(name, system) for name in names if name != "box")])


def _one(name: str, system: System) -> Prior:
    if name == "lognormal":
        centre = torch.tensor([p.start for p in system.parameters], dtype=torch.float64)
        wide = [LOGNORMAL_SIGMA if p.scale == "log" else (p.high - p.low) / 4.0 for p in system.parameters]
        return Normal(centre, torch.tensor(wide, dtype=torch.float64))
    if name in ("inequality", "geometry"):
        pairs = chain_pairs([p.name for p in system.parameters]) if isinstance(system, BranchSystem) else []
        if not pairs:
            raise InputError(
                "--prior", name, "no parent and child with springs of their own", "a branch of two segments"
            )
        return InequalityPrior(pairs) if name == "inequality" else _geometry(pairs, system)
    if name.endswith(".npz"):
        return read_earlier(Path(name), system.parameters)
    raise InputError("--prior", name, "no prior of that name", f"{', '.join(NAMES)}, or a posterior.npz")


def _geometry(pairs: Sequence[tuple[int, int]], system: System) -> Prior:
    """Take every pair's radius and length ratio from the branch: pairs run base first, springs then dampers."""
    assert isinstance(system, BranchSystem)
    radius, length = system.branch.radius.mean(axis=1), system.branch.length
    ratios = [np.tile(x[1:] / x[:-1], len(pairs) // (len(x) - 1)) for x in (radius, length)]
    return GeometryPrior(pairs, *(x.tolist() for x in ratios))
