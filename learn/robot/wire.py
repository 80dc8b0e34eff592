"""What goes over the network: messages of clients, read strictly, and what they are told.

Names of the published service (github.com/jayadeepj/pcap, its HTTP service): ``robot_dof_pos``, ``robot_dof_vel``,
``robot_dof_torque``, ``hand_pos``, ``hand_rot`` (x, y, z, w), ``error``, ``message``.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ...sim.base.types import Array
from .log import Tick

LARGEST = 4096
"""Bytes of a message at most."""

FIELDS = {"velocity": "robot_dof_vel", "position": "robot_dof_pos", "gripper": "robot_gripper"}
"""Field of a command by its kind."""

Kind = Literal["velocity", "position", "gripper"]
Whole = Annotated[int, Field(ge=0, lt=2**53)]
Name = Annotated[str, Field(min_length=1, max_length=40, pattern=r"^[\w.-]+$")]


class _Message(BaseModel):
    # strict: no text for numbers, no true for 1
    model_config = ConfigDict(strict=True, extra="forbid")


class Ask(_Message):
    """A command: joint speeds or joint positions, and who asks.

    Attributes:
        robot_dof_vel: Joint speeds [rad/s].
        robot_dof_pos: Joint positions to go to [rad].
        robot_gripper: How far the gripper is to be closed, 0 to 1.
        seq: Number that grows from command to command.
        tick: Number of the tick that it answers.
        controller: Name of one of several clients on a machine (HTTP alone: a WebSocket is its own name).
    """

    robot_dof_vel: list[float] | None = Field(None, max_length=64)
    robot_dof_pos: list[float] | None = Field(None, max_length=64)
    robot_gripper: float | None = None
    seq: Whole | None = None
    tick: Whole | None = None
    controller: Name | None = None

    @property
    def kind(self) -> Kind | None:
        """What is asked for, None where it is more than one thing or none."""
        asked = [kind for kind, values in self._asked.items() if values is not None]
        return asked[0] if len(asked) == 1 else None

    @property
    def values(self) -> Array:
        """The numbers, [D], or [1] for the gripper."""
        assert self.kind is not None
        return np.array(self._asked[self.kind], dtype=np.float64)

    @property
    def _asked(self) -> dict[Kind, list[float] | None]:
        gripper = None if self.robot_gripper is None else [self.robot_gripper]
        return {"velocity": self.robot_dof_vel, "position": self.robot_dof_pos, "gripper": gripper}


class Rearm(_Message):
    """Re-arm the stop of a number."""

    stop: Whole


class Episode(_Message):
    """Begin the scene of a number on a twin."""

    number: Annotated[int, Field(ge=0, lt=2**31)]


class UnreadableError(ValueError):
    """A message that is none; its text says why."""


def read(kind: type[Any], data: bytes) -> Any:
    """Read a message of a kind.

    Raises:
        UnreadableError: It is no JSON, or no such message; text is all that an error repeats of it.
    """
    try:
        return kind.model_validate_json(data)
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        place = ".".join(str(part)[:40] for part in first["loc"])
        raise UnreadableError(f"{place}: {first['msg']}" if place else str(first["msg"])) from None


def _numbers(values: Array) -> list[float | None]:
    return [float(x) if math.isfinite(x) else None for x in values]


def packed(arrays: Mapping[str, Array]) -> bytes:
    """Return arrays as bytes: a line of JSON with their types and shapes, then their numbers."""
    head = {name: [np.asarray(a).dtype.str, list(np.shape(a))] for name, a in arrays.items()}
    return json.dumps(head).encode() + b"\n" + b"".join(np.ascontiguousarray(a).tobytes() for a in arrays.values())


def unpacked(data: bytes) -> dict[str, Array]:
    """Return the arrays of `packed`.

    Raises:
        ValueError: It is something else.
    """
    head, _, rest = data.partition(b"\n")
    out, at = {}, 0
    try:
        for name, (kind, shape) in json.loads(head).items():
            dtype = np.dtype(str(kind))
            if dtype.kind not in "fiub":
                raise ValueError(f"numbers of type {dtype}")
            count = math.prod(shape)
            out[name] = np.frombuffer(rest, dtype, count, at).reshape(shape).copy()
            at += count * dtype.itemsize
    except (TypeError, AttributeError) as error:
        raise ValueError(str(error)) from None
    return out


def metrics(tick: Tick) -> dict[str, Any]:
    """Return a tick as the published service tells it."""
    w, x, y, z = _numbers(tick.hand_rotation)
    return {
        "robot_dof_pos": _numbers(tick.q), "robot_dof_vel": _numbers(tick.qd),
        "robot_dof_torque": _numbers(tick.torque), "hand_pos": _numbers(tick.hand_position), "hand_rot": [x, y, z, w],
    }  # fmt: skip


def streamed(tick: Tick) -> str:
    """Return a tick as the stream tells it: the published fields and what the guard does."""
    more = {
        "tick": tick.number, "time_s": round(tick.time, 6), "asked": _numbers(tick.asked), "sent": _numbers(tick.sent),
        "touch": tick.touch, "state": tick.state, "stop": tick.stop, "cause": tick.cause,
        "controller": tick.controller, "seq": tick.sequence, "refused": tick.refused, "last_refusal": tick.last_refusal,
    }  # fmt: skip
    return json.dumps(metrics(tick) | more | _sensed(tick))


def _sensed(tick: Tick) -> dict[str, Any]:
    """Return what only some arms measure: a gripper, a force at the hand, a tag."""
    out: dict[str, Any] = {} if math.isnan(tick.gripper) else {"robot_gripper": tick.gripper}
    for name, values in (("hand_force", tick.force), ("tag_pos", tick.tag)):
        if np.isfinite(values).all():
            out[name] = _numbers(values)
    return out
