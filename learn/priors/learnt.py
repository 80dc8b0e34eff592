"""Priors learnt by a one-hidden-layer network: a child below its parent, and what grown trees say of the two.

Both are the regressor of thesis eq. 3.16 on pairs of free coordinates: logarithms of stiffnesses or dampers. Each is
trained once a process, in float64 and from a fixed seed, and copied into every prior that uses it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from functools import cache
from itertools import pairwise, product

import numpy as np
import torch

from ...sim.base.types import Array
from ...sim.trees.fractal import grow_fractal
from ...sim.trees.species import SPECIES, grow_forest
from ...sim.trees.stiffness import beam, beam_size
from ...sim.trees.tree import Tree
from .prior import Prior

POSITION = 25.0
"""Free coordinates that the regressors are trained for reach from minus to plus this: 1e-11 to 1e11 in SI units."""

DIFFERENCE = 12.0
"""Largest difference of child and parent that the regressors are trained for, either way."""

SCATTER = 0.5
"""Deviation of a branch's log stiffness about the beam model's, an assumption: its wood's modulus varies 1.6-fold."""

NEGATIVES = 8
"""Pairs of uniform difference for each grown pair."""

JITTER = 0.05
"""Deviation of the noise on each training difference of the inequality: it rounds the kink of eq. 3.17 off."""


def chain_pairs(names: Sequence[str]) -> list[tuple[int, int]]:
    """Return (parent, child) indices of successive stiffnesses, then of successive dampers, of a chain of branches.

    Args:
        names: Names of the parameters, such as ``stiffness parent``, ``damping child``, each kind from the base to the
            tip. Other kinds are passed over, and so is a kind with one parameter, which all branches share.
    """
    kinds = [[i for i, name in enumerate(names) if name.split()[0] == kind] for kind in ("stiffness", "damping")]
    return [pair for kind in kinds for pair in pairwise(kind)]


class Regressor(torch.nn.Module):
    """Concave network of one hidden layer (thesis eq. 3.16): y' = w0 + sum_k w_k s(w_k0 + w_k . x), all w_k negative.

    s is the softplus: far from all training data y' goes on in straight lines, and its gradient does not vanish where
    it penalises. Negative w_k make it concave (Amos et al. 2017, Input Convex Neural Networks), so that exp(y') has one
    mode.

    Args:
        signs: For each input, whether y' must fall (-1) or rise (1) with it everywhere, or is free to do either (0).
        hidden: Number of hidden units.
        generator: Of the weights to begin with.
    """

    signs: torch.Tensor

    def __init__(self, signs: Sequence[int], hidden: int, generator: torch.Generator) -> None:
        super().__init__()
        self.register_buffer("signs", torch.tensor(signs, dtype=torch.float64))
        start = torch.randn(hidden, len(signs) + 1, generator=generator, dtype=torch.float64)
        # units begin as functions of the difference, (parent, child) being the first two inputs
        start[:, 1] = start[:, 0].abs()
        start[:, 0] = -start[:, 1]
        self.inner = torch.nn.Parameter(start[:, :-1].clone())
        self.shift = torch.nn.Parameter(start[:, -1].clone())
        self.outer = torch.nn.Parameter(torch.full((hidden,), -float(np.log(hidden)), dtype=torch.float64))
        self.constant = torch.nn.Parameter(torch.zeros((), dtype=torch.float64))

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Return y' [...] of inputs [..., i]."""
        weights = torch.where(self.signs == 0.0, self.inner, -self.signs * self.inner.abs())
        units = torch.nn.functional.softplus(inputs @ weights.T + self.shift)
        return self.constant - units @ self.outer.exp()


class InequalityPrior(Prior):
    """A child's parameter is below its parent's: log p = -eta (child - parent) where it is not (eq. 3.17), else 0.

    The function is learnt, not written down: a `Regressor` fitted to eq. 3.17 for eta = 1 and scaled, since eq. 3.17
    is linear in eta. Differences are those of free coordinates, so that of two stiffnesses the ratio counts, whatever
    their unit; the thesis takes them in N m/rad. Densities of several pairs are multiplied.

    Args:
        pairs: Indices (parent, child) in theta.
        eta: Fall of the log density per unit of violation, above 0.
    """

    parent: torch.Tensor
    child: torch.Tensor

    def __init__(self, pairs: Sequence[tuple[int, int]], eta: float = 10.0) -> None:
        super().__init__()
        _register_pairs(self, pairs)
        self.eta = eta
        self.regressor = deepcopy(_inequality_regressor())

    def forward(self, theta: torch.Tensor) -> torch.Tensor:
        """Return the log density, shape [...]."""
        inputs = torch.stack([theta[..., self.parent], theta[..., self.child]], -1)
        return self.eta * self.regressor(inputs).sum(-1)


class GeometryPrior(Prior):
    """What grown trees say of a child's stiffness and its parent's, given how thick and long the two are.

    log p is the logit of a `Regressor` that tells pairs of neighbouring branches of grown trees from pairs with the
    same geometry and any difference of stiffness (noise-contrastive estimation, Gutmann and Hyvarinen 2012): the log
    density of the difference, up to a constant. Its inputs are log stiffnesses of parent and child and log ratios of
    radius and length. Stiffness follows the beam model, K = E pi r^4 / (2 l) (thesis eq. 4.2), times log-normal scatter
    of deviation `SCATTER` for each branch. What all branches of a tree share, such as the modulus, is left open, so
    that it holds for dampers in proportion to stiffness as well. Tails are exponential, not Gaussian: grown trees do
    not reach there. Densities of several pairs are multiplied as if the pairs were independent.

    Args:
        pairs: Indices (parent, child) in theta.
        radius_ratio: Mean radius of each child over its parent's, shape [pairs].
        length_ratio: Length of each child over its parent's, shape [pairs].

    Raises:
        ValueError: A ratio is not positive, or there are not as many as pairs.
    """

    parent: torch.Tensor
    child: torch.Tensor
    geometry: torch.Tensor

    def __init__(
        self, pairs: Sequence[tuple[int, int]], radius_ratio: Sequence[float], length_ratio: Sequence[float]
    ) -> None:
        super().__init__()
        _register_pairs(self, pairs)
        ratios = torch.tensor([[*radius_ratio], [*length_ratio]], dtype=torch.float64)
        if ratios.shape[1] != len(pairs) or not bool((ratios > 0.0).all()):
            raise ValueError(f"ratios {ratios.tolist()}; allowed: {len(pairs)} of each, above 0 (not logarithms)")
        self.register_buffer("geometry", ratios.T.log())
        self.regressor = deepcopy(_geometry_regressor())

    def forward(self, theta: torch.Tensor) -> torch.Tensor:
        """Return the log density, shape [...]."""
        pair = torch.stack([theta[..., self.parent], theta[..., self.child]], -1)
        return self.regressor(torch.cat([pair, self.geometry.expand_as(pair)], -1)).sum(-1)


def _register_pairs(prior: Prior, pairs: Sequence[tuple[int, int]]) -> None:
    index = torch.tensor(pairs, dtype=torch.int64).reshape(len(pairs), 2)
    prior.register_buffer("parent", index[:, 0])
    prior.register_buffer("child", index[:, 1])


@cache
@torch.enable_grad()
def _inequality_regressor() -> Regressor:
    """Fit eq. 3.17 for eta = 1 by least squares; half of the differences lie about its kink."""
    generator = torch.Generator().manual_seed(0)
    count = 2048
    middle = POSITION * _uniform(count, generator)
    difference = DIFFERENCE * _uniform(count, generator)
    difference[::2] *= 1.0 / DIFFERENCE
    inputs = torch.stack([middle - 0.5 * difference, middle + 0.5 * difference], -1)
    seen = difference + JITTER * torch.randn(count, generator=generator, dtype=torch.float64)
    target = -seen.clamp(min=0.0)
    regressor = Regressor((1, -1), 8, generator)
    return _train(regressor, lambda: ((regressor(inputs) - target) ** 2).mean())


def branch_pairs(tree: Tree) -> tuple[Array, Array, Array]:
    """Return log ratios, child over parent, of stiffness, radius and length for all N pairs of a tree of beams.

    The three arrays have shape [N]; radius and length are those of `sim.trees.stiffness.beam`.

    Raises:
        InputError: Names a turning link that has no capsule of positive length.
    """
    child = np.flatnonzero(tree.parent >= 0)
    parent = tree.parent[child]
    stiffness, radius, length = (np.log(x[child] / x[parent]) for x in (beam(tree).stiffness, *beam_size(tree)))
    return stiffness, radius, length


def grown_pairs(seed: int) -> tuple[Array, Array, Array]:
    """Return `branch_pairs` of 4 trees of each species and of 48 fractals with one to four children at each fork."""
    rng = np.random.default_rng(seed)
    trees = [tree for name in SPECIES for tree in grow_forest(name, 4, 3, seed=int(rng.integers(2**32)))]
    # forks on both sides of Leonardo's rule, which is exponent 2
    for children, exponent, ratio in product(range(1, 5), (1.8, 2.0, 2.3), (0.5, 0.7, 0.9, 1.1)):
        levels = 20 if children == 1 else 2  # about as many pairs from a chain as from the bushes
        trees.append(
            grow_fractal(levels, children=children, exponent=exponent, length_ratio=ratio, seed=rng, radius=0.03)
        )
    stiffness, radius, length = np.concatenate([branch_pairs(tree) for tree in trees], axis=1)
    return stiffness, radius, length


@cache
@torch.enable_grad()
def _geometry_regressor() -> Regressor:
    """Tell grown pairs, each with several draws of the scatter, from uniform differences, by logistic regression."""
    generator = torch.Generator().manual_seed(0)
    stiffness, *geometry = (torch.from_numpy(x).repeat(4) for x in grown_pairs(0))
    ratios = torch.stack(geometry, -1)
    scatter = SCATTER * torch.randn(2, len(ratios), generator=generator, dtype=torch.float64)
    grown = _geometry_inputs(stiffness + scatter[0] - scatter[1], ratios, generator)
    copies = ratios.repeat(NEGATIVES, 1)
    other = _geometry_inputs(DIFFERENCE * _uniform(len(copies), generator), copies, generator)
    regressor = Regressor((0, 0, 0, 0), 12, generator)

    def loss() -> torch.Tensor:
        """Return the logistic loss: mean softplus(-logit) of grown pairs plus mean softplus(logit) of others."""
        softplus = torch.nn.functional.softplus
        # each negative counts 1 / NEGATIVES, so that the logit is the log density against the uniform one
        return softplus(-regressor(grown)).mean() + softplus(regressor(other)).mean()

    return _train(regressor, loss)


def _geometry_inputs(difference: torch.Tensor, ratios: torch.Tensor, generator: torch.Generator) -> torch.Tensor:
    middle = POSITION * _uniform(len(difference), generator)
    return torch.cat([torch.stack([middle - 0.5 * difference, middle + 0.5 * difference], -1), ratios], -1)


def _uniform(count: int, generator: torch.Generator) -> torch.Tensor:
    return 2.0 * torch.rand(count, generator=generator, dtype=torch.float64) - 1.0


@contextmanager
def _one_thread() -> Iterator[None]:
    """Compute on one thread: as fast for networks this small, and to the same bits whatever the number of cores."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


@_one_thread()
def _train(regressor: Regressor, loss: Callable[[], torch.Tensor]) -> Regressor:
    optimiser = torch.optim.LBFGS(regressor.parameters(), max_iter=150, history_size=20, line_search_fn="strong_wolfe")

    def closure() -> torch.Tensor:
        """Return the loss with its gradient in the regressor's parameters, as LBFGS asks for it."""
        optimiser.zero_grad()
        value = loss()
        value.backward()
        return value

    optimiser.step(closure)
    return regressor.requires_grad_(False)
