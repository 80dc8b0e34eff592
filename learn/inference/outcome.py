"""What came out of an identification."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...sim.base.types import Array
from ..cases.case import BranchCase, JointCase
from ..cases.noise import NoiseEstimate
from .posterior import Posterior
from .predict import Prediction
from .settings import Settings


@dataclass
class Outcome:
    """Everything a report is made of.

    Attributes:
        train, test: Indices of the trajectories learnt from and held out; with folds all of them are both.
        seconds: Wall time of each stage.
        world_steps: World-steps simulated for learning.
    """

    case: BranchCase | JointCase
    settings: Settings
    noise: NoiseEstimate
    sigma: Array
    train: list[int]
    test: list[int]
    posterior: Posterior
    prediction: Prediction
    world_steps: int = 0
    seconds: dict[str, float] = field(default_factory=dict)

    @property
    def noise_floor(self) -> float:
        """Misfit that a perfect model would leave, in the main channels' unit."""
        return float(np.sqrt(np.mean(self.sigma[list(self.prediction.main)] ** 2)))

    @property
    def ratio(self) -> float:
        """Held-out misfit over the noise."""
        return self.prediction.rms / self.noise_floor
