"""Touch told by a classifier of joint torques, sample by sample as a robot's stream tells them."""

from __future__ import annotations

from pathlib import Path

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ..robot.backend import Sample
from ..robot.client import State
from ..robot.touch import Feeler
from ..touch.model import read_model


class Feel:
    """Tells whether an arm touches something (`learn.robot.touch.Feeler`).

    Attributes:
        threshold: Probability above which it does.
    """

    def __init__(self, path: Path, dofs: int) -> None:
        """Read a model that `bough touch train` wrote.

        Raises:
            InputError: It is none, or one for another number of joints.
        """
        self._model = read_model(path)
        if self._model.num_dofs != dofs:
            raise InputError(path, "", f"a model for {self._model.num_dofs} joints", f"{dofs}, as the arm has")
        self.threshold = self._model.threshold
        self.restart()

    def restart(self) -> None:
        """Forget all samples."""
        self._feeler = Feeler(self._model)

    def told(self, state: State, asked: Array) -> tuple[float, bool]:
        """Take a state and the speeds that were asked for before it; return the probability of touch, and the flag."""
        s = state
        sample = Sample(s.time, s.q, s.qd, s.torque, s.hand_position, s.hand_rotation)
        probability = self._feeler.feel(s.time, sample, asked)
        return probability, probability > self.threshold
