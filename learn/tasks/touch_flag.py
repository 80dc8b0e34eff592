"""The flag of touch of a task, from joint torques: a sensor and a trained classifier in the loop, on the device."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np
import torch
import warp as wp

from ...kernels.touch import tell as kernels
from ...sim.arms.simulator import ArmSimulator
from ...sim.base.errors import InputError
from ...sim.base.thread_pool import Launches, recorded
from ..touch.classifier import TouchClassifier
from ..touch.model import TouchModel, read_model
from ..touch.sensor import JACO2, TorqueSensor, read_sensor

#: Most that a model's rate may be off a whole part of the control rate: recorded clocks are off by less.
_OFF = 0.05


def read_classifier(path: Path, dofs: int, control_rate: float) -> tuple[TouchModel, int]:
    """Read a model of `bough touch train`; return it and the control periods from one of its samples to the next.

    Args:
        path: Its file.
        dofs: Joints of the arm.
        control_rate: Control periods a second [Hz].

    Raises:
        InputError: It is no model, one of other features, of another number of joints, or of a rate that is no whole
            part of the control rate.
    """
    model = read_model(path)
    if model.num_dofs != dofs:
        raise InputError(path, "joints", str(model.num_dofs), f"{dofs}, as the arm has")
    every = max(1, round(control_rate / model.rate))
    if abs(control_rate / every / model.rate - 1.0) > _OFF:
        allowed = f"{control_rate:g} Hz, the control rate, or a whole part of it"
        raise InputError(path, "rate", f"{model.rate:g} Hz", allowed)
    return model, every


def read_told_by(path: str, dofs: int) -> TorqueSensor:
    """Return the sensor in a file, or the Jaco 2's where none is named.

    Raises:
        InputError: The file is no sensor, or one of another number of joints; or there is none for this arm.
    """
    if path:
        return read_sensor(Path(path), dofs)
    if len(JACO2.offset) != dofs:
        raise InputError("task", "sensor", "none", f"a sensor.json for an arm of {dofs} joints")
    return JACO2


class TouchFlag:
    """Takes samples of joint torques at the model's rate and writes whether they tell contact.

    Torques come as a driver tells them: without the arm's weight, with the sensor's friction, noise and drift. Where an
    episode begins a world forgets its samples and has no contact. Nothing is allocated or copied to the host in a step.

    Attributes:
        classifier: What tells contact.
        every: Control periods from one sample to the next.
    """

    def __init__(
        self, simulator: ArmSimulator, model: TouchModel, sensor: TorqueSensor, *, clock: Any, key: Any,
        periods: int, every: int, control_rate: float, flag: wp.array,
    ) -> None:  # fmt: skip
        """Allocate everything and record the launches.

        Args:
            simulator: Worlds of an arm.
            model: The classifier.
            sensor: How torques and speeds are told.
            clock: `kernels.tasks.parts.Clock` of the worlds.
            key: Of random numbers.
            periods: Control periods of a policy step.
            every: Control periods from one sample to the next.
            control_rate: Control periods a second [Hz].
            flag: Where the flag is written, float32 [worlds].
        """
        self.every, self._periods, self._device = every, periods, simulator.model.device
        shape = tuple(simulator.q.shape)
        self._told = _told(shape, self._device)
        views = {name: wp.to_torch(getattr(self._told, name)) for name in self._told._cls.vars}
        self.classifier = TouchClassifier(model, views["torque"], views["command"], views["velocity"],
                                          views["restarted"], due=views["due"], flag=wp.to_torch(flag))  # fmt: skip
        self._model = _digest(model, self._device)
        self._tensors = {f"touch told {name}": view for name, view in views.items()} | self.classifier.snapshot()
        _, arm, work = simulator._arm.kernel
        self._weight: wp.array = wp.array(ptr=work.weight.ptr, shape=shape, dtype=wp.float32, device=self._device)
        given = [arm.torque, self._weight, arm.qd, arm.target, clock, key,
                 _device_sensor(sensor, every / control_rate, self._device)]  # fmt: skip
        self._tell = [Launches([recorded(kernels.tell, shape[0], [*given, k, periods, every, self._told, flag],
                                         self._device)]) for k in range(periods)]  # fmt: skip

    def take(self, period: int) -> None:
        """Take note of a control period of the policy step, from 0, and tell contact where a sample is due."""
        self._tell[period]()
        if (period + 1) % math.gcd(self.every, self._periods) == 0:
            self.classifier.update()

    def tensors(self) -> dict[str, torch.Tensor]:
        """Return all that the future depends on, as views by name, and the digest of the model (`same_model`)."""
        return self._tensors | {"touch model": self._model}

    def same_model(self, snapshot: dict[str, torch.Tensor]) -> bool:
        """Return whether a snapshot is of a task with the same model."""
        kept = snapshot.get("touch model")
        return kept is not None and torch.equal(kept.to(self._model.device), self._model)


def _told(shape: tuple[int, ...], device: Any) -> Any:
    out: Any = kernels.Told()
    struct: Any = kernels.Told
    for name, kind in struct.vars.items():
        size = shape if kind.type.ndim == 2 else shape[0]
        setattr(out, name, wp.zeros(size, dtype=kind.type.dtype, device=device))
    return out


def _device_sensor(sensor: TorqueSensor, seconds: float, device: Any) -> Any:
    """Return a sensor's numbers on the device, with so many seconds from one sample to the next."""
    out: Any = kernels.Sensor()
    for name in ("offset", "dry", "viscous", "still", "moving", "drift", "torque_quantum", "speed_quantum"):
        setattr(out, name, wp.array(list(getattr(sensor, name)), dtype=wp.float32, device=device))
    keep = np.exp(-seconds / np.array(sensor.drift_time))
    out.keep = wp.array(keep.astype(np.float32), dtype=wp.float32, device=device)
    return out


def _digest(model: TouchModel, device: Any) -> torch.Tensor:
    """Return 32 bytes that stand for a model's numbers, uint8 [32]."""
    found = hashlib.sha256(repr((model.kind, model.rate, model.threshold)).encode())
    parts = vars(model.classifier).values()
    flat = [a for part in parts for a in (part if isinstance(part, tuple) else (part,))]
    for array in (model.free.mean, model.free.noise, *flat):
        found.update(np.ascontiguousarray(array).tobytes())
    return torch.tensor(list(found.digest()), dtype=torch.uint8, device=wp.device_to_torch(device))
