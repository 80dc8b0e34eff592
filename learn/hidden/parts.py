"""Parts of a hidden effect: a change of the rig, a law at every step, a sensor fault."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .branch import Array, Branch
from .rig import Rig, Trunk

#: Density of air for wind without drag of still air [kg/m^3].
AIR = 1.2


class Now:
    """State of N rigs at one time step: what laws read and what they add.

    Attributes:
        rig: The rig, one model for all.
        time: Absolute clock [s], shape [N].
        step: Step [s].
        force: Force of the arm [N], shape [N, 3].
        push: Force added at the grasp point [N], shape [N, 3].
        couple: Torque added to the link that is held, world axes [N m], shape [N, 3].
        torque: Torques added at all degrees of freedom [N m], shape [N, nv].
        wash: Forces added at the centres of all bodies [N], shape [N, bodies, 3].
    """

    def __init__(self, rig: Rig, datas: list[Any], step: float) -> None:
        self.rig, self.datas, self.step = rig, datas, step
        self.time, self.force = np.zeros(len(datas)), np.zeros((len(datas), 3))
        self.push, self.couple = np.zeros((len(datas), 3)), np.zeros((len(datas), 3))
        self.torque = np.zeros((len(datas), rig.model.nv))
        self.wash = np.zeros((len(datas), rig.model.nbody, 3))
        self._origin = rig.data.sensordata[:3].copy()
        self._poses = [[d.qpos[4 * j : 4 * j + 4] for d in datas] for j in rig.joints]
        self._rates = [[d.qvel[3 * j : 3 * j + 3] for d in datas] for j in rig.joints]

    def angle(self, segment: int) -> Array:
        """Rotation vector of a segment's joint from rest, in the segment's frame [rad], shape [N, 3]."""
        pose = np.array(self._poses[segment])
        turn = pose[:, 1:]
        size = np.sqrt((turn * turn).sum(axis=1))
        ratio = 2 * np.arctan2(size, pose[:, 0]) / np.maximum(size, 1e-12)
        return np.asarray((turn * ratio[:, None]) @ self.rig.frames[segment].T)

    def rate(self, segment: int) -> Array:
        """Angular velocity of a segment's joint, in the segment's frame [rad/s], shape [N, 3]."""
        return np.asarray(np.array(self._rates[segment]) @ self.rig.frames[segment].T)

    def twist(self, segment: int, torque: Array) -> None:
        """Add a torque at a segment's joint, in the segment's frame [N m], shape [N, 3]."""
        first = 3 * int(self.rig.joints[segment])
        self.torque[:, first : first + 3] += torque @ self.rig.frames[segment]

    def preload(self, segment: int) -> Array:
        """Torque that carries the weight at a segment's joint in the calm pose, in its frame [N m], shape [3]."""
        first = 3 * int(self.rig.joints[segment])
        return np.asarray(self.rig.frames[segment] @ self.rig.data.qfrc_bias[first : first + 3])

    def clear(self) -> None:
        """Take away what the laws have added."""
        for added in (self.push, self.couple, self.torque, self.wash):
            added.fill(0.0)

    @property
    def moved(self) -> Array:
        """Displacement of the grasp point from its calm rest position [m], shape [N, 3]."""
        return np.array([d.sensordata[:3] for d in self.datas]) - self._origin

    @property
    def velocity(self) -> Array:
        """Velocity of the grasp point [m/s], shape [N, 3]."""
        return np.array([d.sensordata[3:6] for d in self.datas])

    @property
    def grip_axis(self) -> Array:
        """Direction of the held segment, world axes, shape [N, 3]."""
        held, axis = self.rig.held, self.rig.frames[-1, 2]
        return np.array([d.xmat[held].reshape(3, 3) @ axis for d in self.datas])

    @property
    def grip_spin(self) -> Array:
        """Angular velocity of the held link, world axes [rad/s], shape [N, 3]."""
        return np.array([d.cvel[self.rig.held, :3] for d in self.datas])


class Law:
    """A law that acts at every step; without memory unless it says so.

    Attributes:
        lasting: What it remembers is damage and stays from one recording to the next.
        setting: Its damage leaves the branch at rest elsewhere.
        fading: What it remembers is gone when the branch rests.
    """

    lasting = False
    setting = False
    fading = False

    def begin(self, now: Now) -> None:
        """Start a recording: fading memory is reset."""

    def act(self, now: Now) -> None:
        """Add to ``now.push``, ``now.couple``, ``now.wash`` or, by `Now.twist`, torques."""

    def beside(self, now: Now) -> Array | float:
        """Where the point that is held lies from the marked one [m], and how it moves there [m/s], shape [N, 6]."""
        return 0.0

    def gust(self, time: Array) -> Array | None:
        """Velocity of the air beside the steady wind at these times [m/s], shape [N, 3], if it blows at all."""
        return None


@dataclass(frozen=True)
class Readings:
    """What the sensors say about N recordings of T samples.

    Attributes:
        time: Since the recording's start [s], shape [T].
        force: Of the arm on the branch [N], shape [N, T, 3].
        moved: Displacement [m], shape [N, T, 3].
        velocity: [m/s], shape [N, T, 3].
        turn: Rotation of the held link from rest, unit quaternions w, x, y, z, shape [N, T, 4].
    """

    time: Array
    force: Array
    moved: Array
    velocity: Array
    turn: Array

    def but(self, **changes: Array) -> Readings:
        """Return the readings with some of them changed."""
        return replace(self, **changes)


@dataclass(frozen=True)
class Part:
    """One effect, ready to be put into the rig; every field but the parameters may be left at nothing.

    Attributes:
        params: Its parameters by name, for the answer.
        joint: Segment at whose lower end it acts, None where it has no place.
        law: Makes the law that acts in the steps, fresh for every run.
        sense: What it does to the readings.
        density: Density of the fluid that the branch moves in [kg/m^3].
        wind: Steady velocity of the air [m/s], shape [3].
        trunk: A base that gives way.
        tip_mass: Extra mass at the tip [kg].
        twig: More masses that move with the tip, see `rig.build`.
        settled: The branch rests where its law brings it.
    """

    params: Mapping[str, Any]
    joint: int | None = None
    law: Callable[[], Law] | None = None
    sense: Callable[[Readings], Readings] | None = None
    density: float = 0.0
    wind: Array | None = None
    trunk: Trunk | None = None
    tip_mass: float = 0.0
    twig: tuple[tuple[Array, float], ...] = ()
    settled: bool = False

    @property
    def moves(self) -> bool:
        """Return whether the branch moves otherwise, not only the sensors."""
        return self.sense is None


@dataclass(frozen=True)
class Scale:
    """What the branch does without the effect; sizes of effects are drawn relative to it.

    Attributes:
        branch: The branch.
        angle: Largest angle of each joint [rad], shape [R].
        rate: Largest angular velocity of each joint [rad/s], shape [R].
        force: Largest force [N].
        moved: Largest displacement [m].
        speed: Largest velocity of the grasp point [m/s].
        pushes: Directions of the forces, shape [N, 3].
        clock: Start of each recording on the absolute clock [s], shape [N].
        duration: Of a recording [s].
        samples: Of a recording.
    """

    branch: Branch
    angle: Array
    rate: Array
    force: float
    moved: float
    speed: float
    pushes: Array
    clock: Array
    duration: float
    samples: int

    @property
    def sample_time(self) -> float:
        """Time between samples [s]."""
        return self.duration / (self.samples - 1)

    def torque(self, joint: int) -> float:
        """Largest torque of a joint's spring beyond its pre-load [N m]."""
        return float(self.branch.stiffness[joint] * self.angle[joint])


@dataclass(frozen=True)
class Draft:
    """An effect whose shape is drawn and whose strength is still open.

    Attributes:
        make: Strength to part; strengths are positive numbers.
        low: Least strength.
        start: Strength to try first.
        high: Greatest strength.
    """

    make: Callable[[float], Part]
    low: float
    start: float
    high: float


#: Draws an effect's shape: random numbers, what the branch does, the joint to act at.
Recipe = Callable[[np.random.Generator, Scale, int], Draft]
