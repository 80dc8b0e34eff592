"""The thesis's simulated set-up (3.4.1, table A.1): a planar branch, pushes along gravity, published loss, scores."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import torch

from ...cases.case import BranchCase
from ...inference.target import Loss, Target
from ...priors.learnt import InequalityPrior, chain_pairs
from ...priors.prior import Prior, Product, box_prior
from ...replay.recording import Recording, recordings
from ...replay.simulated_case import Experiment, random_branch, write_simulated_case
from ...samplers.mixture import Mixture, scott_bandwidth
from ...systems.branch import Unknowns
from ...systems.choose import system_of

BOX = (5.0, 200.0)
"""Search range of stiffness [N m/rad] and damping [N m s/rad] (table A.1)."""
KT = 0.01
SAMPLES = 120
TRAINING, UNSEEN = 5, 25
PUSH = Experiment(samples=SAMPLES, rate=50.0, noise=0.0, vertical=True, deflection=0.4, planar=True)
UNKNOWNS = Unknowns(joints="revolute", box=(f"stiffness={BOX[0]:g}:{BOX[1]:g}", f"damping={BOX[0]:g}:{BOX[1]:g}"))
#: What Levenberg-Marquardt, which needs a Gaussian density, takes for the error of displacement [m], velocity [m/s].
CLIMB = torch.tensor([1e-3, 0.0, 1e-3, 1e-2, 0.0, 1e-2], dtype=torch.float64)
DISPLACEMENT = [0, 2]


@dataclass(frozen=True)
class Scores:
    """How a set of particles does, as table 3.1 measures it.

    Attributes:
        width: Mean width of the 95 % interval of the displacement of unseen trajectories [m].
        outside: Share of true points outside it.
        nll: Mean over the particles of the training loss over kT, without the prior.
        spread: Standard deviation of the log of every parameter, shape [n].
    """

    width: float
    outside: float
    nll: float
    spread: tuple[float, ...]


def draw_springs(rng: np.random.Generator, segments: int) -> dict[str, np.ndarray]:
    """Draw true stiffnesses and dampers uniformly from the box, falling from the base to the tip, shapes [R]."""
    return {kind: np.sort(rng.uniform(*BOX, segments))[::-1].copy() for kind in ("stiffness", "damping")}


def interval_of(unseen: Target, theta: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Return the ends of the 95 % interval of the displacement in a planar target's recordings, [N, T, 2] each.

    By kernel density over the particles' simulations at every time step (Scott), nothing added for a sensor.
    """
    clean = unseen.predict(theta)[..., DISPLACEMENT]
    # at the first sample all worlds are at rest: a density needs some width
    mixture = Mixture(clean, (scott_bandwidth(clean) + 1e-9).expand_as(clean))
    return mixture.quantile(0.025), mixture.quantile(0.975)


class Bench:
    """One simulated branch with its training and unseen trajectories, noise-free.

    Attributes:
        case: The case as written and read back.
        truth: Logarithms of the true stiffnesses and dampers, shape [2 R].
        train, unseen: Recordings to learn from and to predict.

    Args:
        folder: Where the case is written.
        seed: Of geometry, springs and pushes.
        segments: R.
        unseen: Number of unseen trajectories.
    """

    def __init__(self, folder: Path, seed: int, *, segments: int = 3, unseen: int = UNSEEN) -> None:
        rng = np.random.default_rng([seed, segments])
        meta = random_branch(rng, segments, planar=True)
        springs = draw_springs(rng, segments)
        self.case: BranchCase = write_simulated_case(
            folder, meta, springs, PUSH, trajectories=TRAINING + unseen, seed=seed, unknowns=UNKNOWNS
        )
        self.truth = torch.tensor(np.log(np.concatenate([springs["stiffness"], springs["damping"]])))
        every = recordings(self.case)
        self.train, self.unseen = every[:TRAINING], every[TRAINING:]
        self.system = system_of(self.case, UNKNOWNS)

    def target(
        self, eta: float | None = None, kt: float = KT, chosen: Sequence[Recording] | None = None,
        loss: Loss = "published",
    ) -> Target:  # fmt: skip
        """Return the log posterior, with the inequality prior of sharpness ``eta`` or, where None, the box alone."""
        box = box_prior(self.system.parameters)
        names = [p.name for p in self.system.parameters]
        prior: Prior = box if eta is None else Product([box, InequalityPrior(chain_pairs(names), eta)])
        used = self.train if chosen is None else chosen
        return Target(self.case, used, CLIMB, unknowns=UNKNOWNS, prior=prior, loss=loss, temperature=kt)

    @cached_property
    def _unseen(self) -> Target:
        return self.target(chosen=self.unseen)

    @cached_property
    def _training(self) -> Target:
        return self.target()

    def uniform(self, count: int, seed: int) -> torch.Tensor:
        """Return start positions drawn uniformly from the box in logarithms, shape [P, 2 R]."""
        low, high = (end.cpu() for end in self._training.box)
        generator = torch.Generator().manual_seed(seed)
        return (low + (high - low) * torch.rand(count, len(low), generator=generator, dtype=torch.float64)).to(
            self._training.place
        )

    def predictive(self, theta: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return the ends of the 95 % interval of the displacement of the unseen trajectories, [N, T, 2] each."""
        return interval_of(self._unseen, theta)

    @property
    def displacement(self) -> torch.Tensor:
        """True displacement of the unseen trajectories [m], shape [N, T, 2]."""
        return self._unseen.measured[..., DISPLACEMENT]

    def score(self, theta: torch.Tensor, kt: float = KT) -> Scores:
        """Score particles, vectors [P, 2 R] of the target."""
        low, high = self.predictive(theta)
        truth, training = self.displacement, self._training
        nothing = theta.new_zeros(len(theta), 0)
        loss = -training.log_likelihood(training.predict(theta), nothing) * training.temperature
        return Scores(
            float((high - low).mean()),
            float(((truth < low) | (truth > high)).double().mean()),
            float(loss.mean() / kt),
            tuple(theta.std(0).tolist()),
        )
