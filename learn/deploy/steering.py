"""What servos are asked for from one action to the next: the control law of training, of one world, by its kernel."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
import warp as wp

from ...kernels.tasks.control import LAWS, drive
from ...kernels.tasks.parts import Clock
from ...sim.arms.arm import Arm
from ...sim.base.types import Array
from ..tasks.assembled import Pace


class Steering:
    """Turns an action, once a policy step, into joint speeds, once a control period (equations 4.4 and 4.5).

    Attributes:
        period: Number of the control period to come in its policy step; 0 where an action is due.
        asked: Speeds that were asked for last [rad/s], [D].
    """

    def __init__(self, arm: Arm, pace: Pace) -> None:
        """Take an arm and the pace of a task."""
        self.pace, dofs = pace, arm.num_dofs
        struct: Any = Clock
        self._clock: Any = struct()
        for name, kind in struct.vars.items():
            setattr(self._clock, name, wp.zeros(1, dtype=kind.type.dtype, device="cpu"))
        self._limit: Any = wp.array(arm.velocity_limit.astype(np.float32), dtype=wp.float32, device="cpu")
        shapes = {"action": (1, dofs), "speed": (1, dofs), "waiting": (2, 1, dofs), "target": (1, dofs)}
        rows = {name: wp.zeros(shape, dtype=wp.float32, device="cpu") for name, shape in shapes.items()}
        self._rows: dict[str, Any] = rows
        self._views = {name: wp.to_torch(array) for name, array in rows.items()}
        self._count = wp.to_torch(self._clock.clock)
        self.restart()

    def restart(self) -> None:
        """Begin an episode: no action waits, and nothing was asked for."""
        for view in self._views.values():
            view.zero_()
        self.period = 0

    @property
    def asked(self) -> Array:
        """Speeds that were asked for last [rad/s], [D]."""
        return np.asarray(self._views["target"][0].numpy().astype(np.float64))

    def act(self, action: torch.Tensor) -> None:
        """Take the action of the policy step that begins now, [1, D], each of -1 to 1."""
        self._views["action"].copy_(action)
        self.period = 0

    def ask(self, speed: Array) -> Array:
        """Return the joint speeds of the control period that begins now [rad/s], [D].

        Args:
            speed: Measured joint speeds [rad/s], [D].
        """
        self._views["speed"][0] = torch.as_tensor(speed, dtype=torch.float32)
        r, p = self._rows, self.pace
        inputs = [r["action"], self._limit, r["speed"], LAWS.index(p.law), self.period, p.control_periods, p.speed_step,
                  self._clock, r["waiting"], r["target"]]  # fmt: skip
        wp.launch(drive, 1, inputs, device="cpu")
        self.period += 1
        if self.period == p.control_periods:
            self.period = 0
            self._count += 1
        return self.asked
