"""The result of an identification."""

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
        train, test: Indices of training and held-out trajectories; with cross-validation all are both.
        seconds: Wall time of each stage.
        world_steps: World-steps simulated for inference.
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
        """Noise floor: held-out RMSE of a perfect model, in the main channels' unit."""
        return float(np.sqrt(np.mean(self.sigma[list(self.prediction.main)] ** 2)))

    @property
    def ratio(self) -> float:
        """Held-out RMSE over the noise floor."""
        return self.prediction.rms / self.noise_floor
