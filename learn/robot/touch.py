"""Touch told from a robot's joint torques as they come, at the rate that the model was trained with."""

from __future__ import annotations

import numpy as np

from ...sim.base.types import Array
from ..touch.features import TouchStream
from ..touch.model import TouchModel
from .backend import Sample
from .guard import PERIOD


class Feeler:
    """Tells the probability of touch of one arm."""

    def __init__(self, model: TouchModel) -> None:
        """Take a model for the arm's joints."""
        self._model, self._stream = model, TouchStream(model.free)
        self._next, self._probability = -np.inf, 0.0
        self._commands: list[Array] = []

    def feel(self, now: float, sample: Sample | None, command: Array) -> float:
        """Return the probability of touch, told anew once in a period of the model's rate.

        Args:
            now: Time [s].
            sample: Newest measurement; without one nothing is told anew.
            command: Speeds that the arm was asked for since the last call [rad/s], [D].
        """
        self._commands.append(command)
        if sample is None or not np.isfinite([sample.torque, sample.qd]).all() or now < self._next - PERIOD / 2:
            self._commands = self._commands[-600:]
            return self._probability
        period = 1.0 / self._model.rate
        self._next = (self._next if now - self._next < period else now) + period
        row = self._stream.push(sample.torque, np.mean(self._commands, axis=0), sample.qd)
        self._commands = []
        self._probability = float(self._model.classifier.probability(row[None].astype(np.float32))[0])
        return self._probability
