"""Branches that break where the arm bends them too far."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import torch
import warp as wp

from ...kernels.tree.rupture import Springs, rupture_kernels

if TYPE_CHECKING:
    from .arrays import LaneArray
    from .simulator import Simulator


class Rupture:
    """Joints whose springs give way for good once their torque passes a strength; what they carried falls.

    The torque is that of the spring alone, K times the turn from where it is relaxed: a pre-load that holds the grown
    pose bends nothing. A broken joint has neither spring nor pre-load, and a share of its damper.

    Attributes:
        strength: Torque that each joint's spring bears [N m], of a slide the force [N], to be written in place, torch
            view [worlds, links]; infinite at first.
        broken: 1 where a joint is broken, int32 torch view [worlds, links].
    """

    def __init__(self, simulator: Simulator) -> None:
        m = simulator.model
        shape = (m.num_worlds, max(t.num_links for t in m.trees))
        self._strength = wp.full(shape, float("inf"), dtype=float, device=m.device)
        self._broken = wp.zeros(shape, dtype=int, device=m.device)
        self.strength: torch.Tensor = wp.to_torch(self._strength)
        self.broken: torch.Tensor = wp.to_torch(self._broken)
        self._model, self._state, self._damping = m, simulator.state, simulator._damping
        fields = {name: m.arrays[name] for name in ("stiffness", "preload")} | {"damping": simulator._damping}
        self._springs = _springs(fields)
        self._whole = _springs({name: m.field("Vec" if name == "preload" else "Real") for name in fields})
        self._where = (simulator._slot_world, simulator._slot_link)
        self._kernels = rupture_kernels(m.width)
        self.note()

    @property
    def broken_array(self) -> wp.array:
        """Memory of ``broken``."""
        return self._broken

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return views of what the future depends on: which joints are broken, and the springs that they have now."""
        springs = {name: self._model.arrays[name].torch for name in ("stiffness", "preload")}
        return {"broken": self.broken, "damping": self._damping.torch, **springs}

    def note(self) -> None:
        """Take the present springs, dampers and pre-loads as those of whole joints; needed after they have changed.

        Joints that are broken keep what they had when they were whole: `heal` them before theirs are changed.
        """
        self._launch(self._kernels.note, [*self._where, self._springs, self._broken, self._whole])

    def judge(self) -> None:
        """Break the joints whose springs pass their strength."""
        joints = [self._model.kernel.kind, self._state.coordinate.entries(), self._strength]
        self._launch(self._kernels.rupture, [*self._where, *joints, self._springs, self._broken])

    def heal(self, mask: wp.array) -> None:
        """Make the joints of the masked worlds (bool, [worlds]) whole again."""
        self._launch(self._kernels.heal, [mask, *self._where, self._whole, self._springs, self._broken])

    def _launch(self, kernel: Any, inputs: list[Any]) -> None:
        m = self._model
        wp.launch(kernel, dim=(m.groups * m.width, m.places), inputs=inputs, device=m.device)


def _springs(fields: dict[str, LaneArray]) -> Springs:
    """Return the kernels' view of stiffness, damping and preload; the struct keeps their memory."""
    out = Springs()
    for name, field in fields.items():
        setattr(out, name, field.entries())
    return out
