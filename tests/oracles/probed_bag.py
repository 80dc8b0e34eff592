"""A Jaco 2 that moves a branch, as ROS bags record it: kinematics, gravity and Jacobian are C MuJoCo's."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np
from bough.sim.arms.jaco2 import jaco2
from oracles.mujoco_arm import compiled
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

EPOCH = 1_700_000_000_000_000_000
SPRING = np.array([220.0, 180.0, 150.0])  # N/m, along the world's axes


@dataclass(frozen=True)
class Probed:
    """What truly happens, at times ``t`` [s].

    ``hand`` and ``force`` (of the arm on the branch) are in world axes, ``turn`` are rotation matrices of the hand.
    """

    t: np.ndarray
    q: np.ndarray
    hand: np.ndarray
    turn: np.ndarray
    force: np.ndarray
    effort: np.ndarray


def probe(seconds: float = 6.0, rate: float = 60.0) -> Probed:
    """Move the hand slowly out and back twice; a linear spring holds it back."""
    arm = jaco2()
    model, data = compiled(arm, servo=False, contact=False)
    body = model.body(arm.tree.link_name[arm.end_link]).id
    t = np.arange(int(seconds * rate)) / rate
    shape = np.sin(np.pi * t / seconds) ** 2 * (1.0 + 0.5 * np.sin(2 * np.pi * 0.6 * t))
    q = arm.home + shape[:, None] * np.array([0.10, 0.06, -0.08, 0.02, 0.0, 0.03])
    hand, turn, effort, force = [], [], [], []
    for row in q:
        data.qpos[:6] = row
        mujoco.mj_forward(model, data)
        hand.append(data.xpos[body] + data.xmat[body].reshape(3, 3) @ arm.end_position)
        turn.append(data.xmat[body].reshape(3, 3).copy())
        force.append(SPRING * (hand[-1] - hand[0]))
        jacobian = np.zeros((3, model.nv))
        mujoco.mj_jac(model, data, jacobian, None, hand[-1], body)
        effort.append(data.qfrc_bias + jacobian.T @ force[-1])
    return Probed(t, q, *(np.array(x) for x in (hand, turn, force, effort)))


def probe_hold(p: Probed) -> np.ndarray:
    """Return MuJoCo's torques that hold the arm against gravity, [T, 6]."""
    model, data = compiled(jaco2(), servo=False, contact=False)
    out = []
    for row in p.q:
        data.qpos[:6] = row
        mujoco.mj_forward(model, data)
        out.append(data.qfrc_bias.copy())
    return np.array(out)


class Bag:
    """Writes messages in any order into a bag: ``.bag`` for ROS 1, ``.mcap`` or ``.db3`` (a folder) for ROS 2."""

    def __init__(self, path: Path) -> None:
        self.path, self.one = path, path.suffix == ".bag"
        self.store = get_typestore(Stores.ROS1_NOETIC if self.one else Stores.ROS2_HUMBLE)
        self.rows: list[tuple[int, str, str, object]] = []

    def type(self, name: str):
        """Return the class of a message type."""
        return self.store.types[name]

    def header(self, time: float, frame: str = "world"):
        """Return a header with a clock's time [s]."""
        stamp = EPOCH + round(time * 1e9)
        time = self.type("builtin_interfaces/msg/Time")(stamp // 10**9, stamp % 10**9)
        own = self.type("std_msgs/msg/Header")
        return own(seq=0, stamp=time, frame_id=frame) if self.one else own(stamp=time, frame_id=frame)

    def vector(self, kind: str, values):
        """Return a Vector3, Point or Quaternion (w, x, y, z given)."""
        values = [float(v) for v in (np.roll(values, -1) if kind == "Quaternion" else values)]
        return self.type(f"geometry_msgs/msg/{kind}")(*values)

    def add(self, time: float, topic: str, name: str, message: object) -> None:
        """Add a message that arrives at a time [s]."""
        self.rows.append((EPOCH + round(time * 1e9), topic, name, message))

    def joints(self, p: Probed, *, efforts: bool = True, topic: str = "/j2n6s300_driver/out/joint_state") -> None:
        """Add joint states, fingers included, as Kinova's driver does."""
        own = self.type("sensor_msgs/msg/JointState")
        names = [*(f"j2n6s300_joint_{k + 1}" for k in range(6)), "j2n6s300_joint_finger_1"]
        for t, q, e in zip(p.t, p.q, p.effort, strict=True):
            state = own(self.header(t), names, np.append(q, 1.0), np.zeros(7), np.append(e, 0.0) if efforts else e[:0])
            self.add(t, topic, "sensor_msgs/msg/JointState", state)

    def tag(self, p: Probed, *, ahead: float, rate: float = 30.0, late: float = 0.0) -> None:
        """Add poses of a tag beside the hand, from a camera whose clock is ahead of the arm's by so much [s]."""
        own, pose = self.type("geometry_msgs/msg/PoseStamped"), self.type("geometry_msgs/msg/Pose")
        for t in np.arange(0.0, p.t[-1], 1 / rate):
            at = [np.interp(t, p.t, c) for c in (p.hand + np.array([0.3, -0.2, 0.1])).T]
            turn = self.vector("Quaternion", [1, 0, 0, 0])
            message = own(self.header(t + ahead, "map"), pose(self.vector("Point", at), turn))
            self.add(t + late, "/tag", "geometry_msgs/msg/PoseStamped", message)

    def frames(self, p: Probed, *, rate: float = 30.0) -> None:
        """Add TF: a tag in a camera that stands still in the world, turned by half a turn about z and moved."""
        turned, step, own = (self.type(f"{n}") for n in ("tf2_msgs/msg/TFMessage", "geometry_msgs/msg/TransformStamped",
                                                          "geometry_msgs/msg/Transform"))  # fmt: skip
        half = self.vector("Quaternion", [0, 0, 0, 1])
        camera = step(self.header(0, "world"), "camera", own(self.vector("Vector3", [1, 2, 3]), half))
        self.add(0.0, "/tf_static", "tf2_msgs/msg/TFMessage", turned([camera]))
        for t in np.arange(0.0, p.t[-1], 1 / rate):
            at = np.array([np.interp(t, p.t, c) for c in p.hand.T]) - [1, 2, 3]
            seen = own(self.vector("Vector3", at * [-1, -1, 1]), half)
            self.add(t, "/tf", "tf2_msgs/msg/TFMessage", turned([step(self.header(t, "camera"), "tag_7", seen)]))

    def wrench(self, p: Probed, *, frame: str, rate: float = 50.0, ahead: float = 0.0) -> None:
        """Add what a wrist sensor reads: the force of the branch on the hand, in the hand's axes or the world's."""
        own, wrench = self.type("geometry_msgs/msg/WrenchStamped"), self.type("geometry_msgs/msg/Wrench")
        rows = p.force if frame == "world" else np.einsum("tji,tj->ti", p.turn, p.force)
        for t in np.arange(0.0, p.t[-1], 1 / rate):
            f = self.vector("Vector3", [-np.interp(t, p.t, c) for c in rows.T])
            message = own(self.header(t + ahead, frame), wrench(f, self.vector("Vector3", [0, 0, 0])))
            self.add(t, "/ft", "geometry_msgs/msg/WrenchStamped", message)

    def scale(self, p: Probed, along: np.ndarray, *, rate: float = 20.0) -> None:
        """Add a hanging scale's reading in kilograms: the force along a line."""
        own = self.type("std_msgs/msg/Float64")
        for t in np.arange(0.0, p.t[-1], 1 / rate):
            self.add(t, "/scale", "std_msgs/msg/Float64", own(float(np.interp(t, p.t, p.force @ along) / 9.80665)))

    def write(self) -> Path:
        """Write the bag; return what a user gives to a command."""
        if self.one:
            with Writer1(self.path) as writer:
                self._all(writer, self.store.serialize_ros1)
            return self.path
        plugin = StoragePlugin.MCAP if self.path.suffix == ".mcap" else StoragePlugin.SQLITE3
        folder = self.path.with_suffix("")
        with Writer2(folder, version=9, storage_plugin=plugin) as writer:
            self._all(writer, self.store.serialize_cdr)
        return folder if plugin == StoragePlugin.SQLITE3 else next(folder.glob("*.mcap"))

    def _all(self, writer, serialize) -> None:
        topics = {}
        for stamp, topic, name, message in sorted(self.rows, key=lambda row: row[0]):
            if topic not in topics:
                topics[topic] = writer.add_connection(topic, name, typestore=self.store)
            writer.write(topics[topic], stamp, serialize(message, name))
