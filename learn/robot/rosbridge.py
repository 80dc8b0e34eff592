"""A robot behind rosbridge (roslibpy): Kinova's ROS 1 driver, or ros2_control.

What is said to each (github.com/Kinovarobotics/kinova-ros, and the forward command and joint state controllers of
ros2_controllers):

    kinova         /NAME_driver/out/joint_state  sensor_msgs/JointState, fingers left out
                   /NAME_driver/in/joint_velocity  kinova_msgs/JointVelocity, joint1 ... jointD in degrees a second
    ros2_control   /joint_states  sensor_msgs/msg/JointState, joints by their names
                   /forward_velocity_controller/commands  std_msgs/msg/Float64MultiArray, rad/s

Kinova's driver stands still by itself when commands stay out. A forward command controller does not: give it a watchdog
(``command_timeout``, or the hardware's own) before a person comes near.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from ...sim.arms.arm import Arm, forward_kinematics
from ...sim.base.errors import InputError
from ...sim.base.extras import install_hint
from ...sim.base.types import Array
from .backend import Sample

Driver = Literal["kinova", "ros2_control"]
_PATIENCE = 5.0  # s to connect


@dataclass(frozen=True)
class Topics:
    """Where a driver tells its state and takes commands.

    Attributes:
        state, command: Names of the topics.
        state_type, command_type: Types of their messages.
    """

    state: str
    state_type: str
    command: str
    command_type: str


def topics_of(driver: Driver, name: str) -> Topics:
    """Return a driver's topics; ``name`` is the robot's in Kinova's driver, such as j2n6s300."""
    if driver == "kinova":
        return Topics(f"/{name}_driver/out/joint_state", "sensor_msgs/JointState",
                      f"/{name}_driver/in/joint_velocity", "kinova_msgs/JointVelocity")  # fmt: skip
    return Topics("/joint_states", "sensor_msgs/msg/JointState", "/forward_velocity_controller/commands",
                  "std_msgs/msg/Float64MultiArray")  # fmt: skip


def command_of(driver: Driver, velocity: Array) -> dict[str, Any]:
    """Return the message that asks for joint speeds [rad/s], [D]."""
    if driver == "kinova":
        return {f"joint{k}": math.degrees(v) for k, v in enumerate(velocity.tolist(), start=1)}
    return {"layout": {"dim": [], "data_offset": 0}, "data": velocity.tolist()}


class StateReader:
    """Turns joint states into measurements.

    Attributes:
        sample: The newest, None before the first.
        fault: What was wrong with the last state, "" for nothing.
    """

    def __init__(self, arm: Arm, joints: Sequence[str]) -> None:
        """Take the arm, D joints, and their names; none for the first D that are no fingers."""
        self._arm, self._joints = arm, tuple(joints)
        self._stamp: Any = None
        self.sample: Sample | None = None
        self.fault = ""

    def take(self, message: Mapping[str, Any], now: float) -> None:
        """Take a ``sensor_msgs/JointState`` that came at ``now`` [s].

        A state with the stamp of the one before is the old one said again: it makes no measurement younger.
        """
        try:
            stamp = message["header"]["stamp"]
            if stamp == self._stamp:
                return
            q, qd, torque = self._numbers(message)
        except (KeyError, TypeError, IndexError, ValueError, AttributeError) as error:
            self.fault = f"a joint state that cannot be read ({type(error).__name__}: {error})"
            return
        _, _, (at, turn) = forward_kinematics(self._arm, q)
        self._stamp, self.fault = stamp, ""
        self.sample = Sample(now, q, qd, torque, at, turn)

    def _numbers(self, message: Mapping[str, Any]) -> tuple[Array, Array, Array]:
        names = [str(name) for name in message["name"]]
        wanted = self._joints or [name for name in names if "finger" not in name][: self._arm.num_dofs]
        places = [names.index(name) for name in wanted]
        if len(places) != self._arm.num_dofs:
            raise ValueError(f"{len(places)} joints, {self._arm.num_dofs} are needed")
        q, qd, torque = (
            np.array([float(message[key][k]) for k in places]) for key in ("position", "velocity", "effort")
        )
        return q, qd, torque


class RosBridge:
    """A robot behind rosbridge (`learn.robot.backend.Backend`).

    A connection that is lost makes measurements old, which stops the arm; roslibpy connects again by itself, but the
    stop stays until it is re-armed, and nothing that was to be sent meanwhile is sent afterwards.

    Attributes:
        num_dofs: Number of joints.
    """

    def __init__(
        self, arm: Arm, host: str, port: int, driver: Driver, *, name: str = "j2n6s300", joints: Sequence[str] = ()
    ) -> None:
        """Connect.

        Args:
            arm: Description of the robot.
            host: Of rosbridge.
            port: Of rosbridge.
            driver: What is behind it.
            name: The robot's in Kinova's driver.
            joints: Names of the joints in joint states; none for the first D that are no fingers.

        Raises:
            InputError: roslibpy is not installed, names are too few or too many, or nobody answers.
        """
        try:
            import roslibpy
        except ModuleNotFoundError:
            raise InputError("robot serve", "--backend", "no roslibpy", install_hint("robot")) from None
        if joints and len(joints) != arm.num_dofs:
            raise InputError("robot serve", "--joints", f"{len(joints)} names", f"{arm.num_dofs}")
        self.num_dofs, self._driver = arm.num_dofs, driver
        self._reader = StateReader(arm, joints)
        topics = topics_of(driver, name)
        self._ros = roslibpy.Ros(host=host, port=port)
        try:
            self._ros.run(timeout=_PATIENCE)
        except Exception as error:  # roslibpy raises its own and Twisted's
            found = f"{host}:{port}, where nobody answers ({type(error).__name__})"
            raise InputError("robot serve", "--rosbridge", found, "host:port of a rosbridge that runs") from None
        self._state = roslibpy.Topic(self._ros, topics.state, topics.state_type, queue_length=1)
        # nothing is latched or queued: an old speed must never be sent again
        self._command = roslibpy.Topic(self._ros, topics.command, topics.command_type, queue_size=1)
        self._command.advertise()
        self._state.subscribe(lambda message: self._reader.take(message, time.monotonic()))

    def read(self, now: float) -> Sample | None:
        """Return the newest measurement.

        Raises:
            ConnectionError: There is no connection, or joint states cannot be read.
        """
        if not self._ros.is_connected:
            raise ConnectionError("no connection to rosbridge")
        if self._reader.fault:
            raise ConnectionError(self._reader.fault)
        return self._reader.sample

    def send(self, velocity: Array) -> None:
        """Publish joint speeds; roslibpy would keep them for the next connection, so without one nothing is sent.

        Raises:
            ConnectionError: There is no connection.
        """
        if not self._ros.is_connected:
            raise ConnectionError("no connection to rosbridge")
        self._command.publish(command_of(self._driver, velocity))

    def close(self) -> None:
        """Close the connection."""
        self._ros.close()
