"""Branches that break where the arm bends them too far."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
import warp as wp

from ..kernels.rupture import rupture_kernels

if TYPE_CHECKING:
    from .simulator import Simulator


class Rupture:
    """Joints whose springs give way for good once their torque passes a strength; what they carried falls.

    Attributes:
        strength: Torque that each ball joint bears [N m], to be written in place, torch view [worlds, links]; infinite
            at first.
        broken: 1 where a joint is broken, int32 torch view [worlds, links].
    """

    def __init__(self, simulator: Simulator) -> None:
        m = simulator.model
        shape = (m.num_worlds, max(t.num_links for t in m.trees))
        self._strength = wp.full(shape, float("inf"), dtype=float, device=m.device)
        self._broken = wp.zeros(shape, dtype=int, device=m.device)
        self.strength: torch.Tensor = wp.to_torch(self._strength)
        self.broken: torch.Tensor = wp.to_torch(self._broken)
        self._model, self._state = m, simulator.state
        self._stiffness, self._damping = m.arrays["stiffness"], simulator._damping
        self._whole, self._damped = m.field("Real"), m.field("Real")
        self._where = (simulator._slot_world, simulator._slot_link)
        self.note()

    def note(self) -> None:
        """Take the present springs and dampers as those of whole joints; needed after they have changed."""
        self._whole.torch.copy_(self._stiffness.torch)
        self._damped.torch.copy_(self._damping.torch)

    def judge(self) -> None:
        """Break the joints whose springs pass their strength."""
        fields = [self._stiffness.entries(), self._damping.entries()]
        inputs = [*self._where, self._state.coordinate.entries(), self._strength, *fields, self._broken]
        self._launch(rupture_kernels(self._model.width)[0], inputs)

    def heal(self, mask: wp.array) -> None:
        """Make the joints of the masked worlds (bool, [worlds]) whole again."""
        stored = [self._whole.entries(), self._damped.entries()]
        fields = [self._stiffness.entries(), self._damping.entries()]
        self._launch(rupture_kernels(self._model.width)[1], [mask, *self._where, *stored, *fields, self._broken])

    def _launch(self, kernel: Any, inputs: list[Any]) -> None:
        m = self._model
        wp.launch(kernel, dim=(m.groups * m.width, m.places), inputs=inputs, device=m.device)
