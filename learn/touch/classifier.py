"""Touch in the loop: torques and speeds of all worlds in, probability and flag of contact out, on the device.

A sample takes two launches (features, forest), or one and a network's few tensors; nothing is allocated, copied to the
host or waited for, and both can be captured in a graph.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from typing import Any

import numpy as np
import torch
import warp as wp

from ...kernels.touch.features import FEATURES, RING, FreeRows, features
from ...kernels.touch.forest import LANES, TOGETHER, Node, vote_kernel
from ...sim.base.errors import InputError
from ...sim.base.host import num_threads
from ...sim.base.thread_pool import recorded, together
from .model import TouchModel


class TouchClassifier:
    """Tells contact in all worlds from joint torques, as a robot does that has nothing else to feel with.

    It holds tensors and reads them where they are: write (or let a simulator write) new samples there, then call
    `update`. Torques are those that the model was trained with: a Jaco 2's come without the arm's weight, so of an
    `ArmSimulator` they are ``torque`` less the torque that carries it. Samples should come at the model's rate.

    Attributes:
        model: The model.
        features: Of the last sample, torch view, [worlds, 15 D].
        probability: Of contact, torch view, [worlds].
        flag: 1 where the probability is above the model's threshold, else 0, [worlds]; the one given, if one was.
    """

    def __init__(
        self,
        model: TouchModel,
        torque: torch.Tensor,
        command: torch.Tensor,
        velocity: torch.Tensor,
        restarted: torch.Tensor,
        expected: torch.Tensor | None = None,
        due: torch.Tensor | None = None,
        flag: torch.Tensor | None = None,
    ) -> None:
        """Take a model and the tensors that samples will be in, float32, [worlds, D], on one device.

        Args:
            model: The model, for D joints.
            torque: Joint torques, in the unit of the model's recordings.
            command: Commanded joint speeds [rad/s].
            velocity: Executed ones [rad/s].
            restarted: Worlds whose episode begins with the next sample, which forget their samples, bool, [worlds].
            expected: What the robot's own model expects of the torques; None is zero.
            due: Worlds that have a new sample at an `update`, bool, [worlds]; None is all.
            flag: Where `flag` is written, float32, [worlds]; None takes new memory.

        Raises:
            InputError: The model is for another number of joints.
            ValueError: A tensor has another shape or type.
        """
        if torque.ndim != 2 or torque.shape[1] != model.num_dofs:
            found = f"a model for {model.num_dofs} joints"
            raise InputError("touch", "", found, f"a model for {torque.shape[-1]} joints, as the arm has")
        self.model, self.worlds = model, len(torque)
        expected = torch.zeros_like(torque) if expected is None else expected
        given = (torque, expected, command, velocity)
        if any(t.shape != torque.shape or t.dtype != torch.float32 or not t.is_contiguous() for t in given):
            raise ValueError(f"contiguous float32 tensors of shape {tuple(torque.shape)} are needed")
        due = torch.ones_like(restarted) if due is None else due
        flag = torch.zeros_like(torque[:, 0]) if flag is None else flag
        for name, tensor, kind in (("restarted", restarted, torch.bool), ("due", due, torch.bool),
                                   ("flag", flag, torch.float32)):  # fmt: skip
            if tensor.shape != (self.worlds,) or tensor.dtype != kind:
                raise ValueError(f"{name}: a tensor of {kind} and shape ({self.worlds},) is needed")
        wp.init()  # before the first tensor is handed over
        self._given = [wp.from_torch(t) for t in (*given, restarted, due)]
        self._keep = [*given, restarted, due]
        self._device: Any = self._given[0].device
        self.flag = flag
        self._allocate()
        self._parts = {split: self._prepare(split) for split in (True, False)}

    def _allocate(self) -> None:
        dof, dev = self.model.num_dofs, self._device
        self._ring = wp.zeros((self.worlds, dof, RING), dtype=wp.float64, device=dev)
        self._count = wp.zeros((self.worlds, dof), dtype=int, device=dev)
        self._features = wp.zeros((self.worlds, FEATURES * dof), dtype=float, device=dev)
        self._probability = wp.zeros(self.worlds, dtype=float, device=dev)
        self._flag = wp.from_torch(self.flag)
        self.features: torch.Tensor = wp.to_torch(self._features)
        self.probability: torch.Tensor = wp.to_torch(self._probability)
        self._free = FreeRows()
        self._free.mean = wp.array(self.model.free.mean, dtype=wp.float64, device=dev)
        self._free.noise = wp.array(self.model.free.noise, dtype=wp.float64, device=dev)
        self._network: torch.nn.Module | None = None
        if self.model.kind == "network":
            self._network = self.model.classifier.module(str(self._keep[0].device))
            return
        root, depth, node = self.model.classifier.device_rows(Node)
        kinds = ((root, int), (depth, int), (node, Node))
        self._forest: list[Any] = [wp.array(rows, dtype=kind, device=dev) for rows, kind in kinds]

    def _prepare(self, split: bool) -> Callable[[], None]:
        """Record the launches: on a CPU one for each thread, which a graph capture cannot have."""
        parts = min(num_threads(), self.worlds) if split and self._device.is_cpu else 1
        cuts = np.linspace(0, self.worlds, parts + 1).astype(int).tolist()
        return together([self._recorded(a, b) for a, b in pairwise(cuts)])

    def _recorded(self, first: int, last: int) -> list[Any]:
        dof, block = self.model.num_dofs, 1 if self._device.is_cpu else None
        inputs: list[Any] = [*self._given, self._free, first, self._ring, self._count, self._features]
        out = [recorded(features, (last - first) * dof, inputs, self._device, block)]
        if self._network is None:
            worlds, lanes = (TOGETHER, LANES) if self._device.is_cpu else (1, 1)
            inputs = [self._features, self._given[-1], *self._forest, self.model.threshold, first, last, worlds]
            inputs += [self._probability, self._flag]
            out.append(recorded(vote_kernel(lanes), -(-(last - first) // worlds), inputs, self._device, block))
        return out

    def update(self) -> None:
        """Take the sample that is in the tensors; `probability` and `flag` are then of now."""
        self._parts[not self._device.is_capturing]()
        if self._network is not None:
            self.probability.copy_(self._network(self.features))
            told = (self.probability > self.model.threshold).to(self.flag.dtype)
            self.flag.copy_(torch.where(self._keep[-1], told, self.flag))

    def snapshot(self) -> dict[str, torch.Tensor]:
        """Return what the next samples' features depend on, as views, for a task that resumes to the same bits."""
        return {"touch ring": wp.to_torch(self._ring), "touch count": wp.to_torch(self._count)}
