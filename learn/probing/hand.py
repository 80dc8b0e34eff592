"""The hand on the branch: goes to the grasp, follows a course of force, lets go, waits until the branch is calm.

A force f* is followed by admittance: with C, how the grasp point gives way [m/N], the hand is to move at

    v = dx(f*)/dt + L C (f* - f),        L = 3 a second,

with x(f) where a force takes the point and C = dx/df, both of typical springs in the bent pose, scaled by what a first
gentle pull shows, and C with the fingers' own. The error of the force fades with L where C is right, and slower or
quicker where it is a few times too small or too large. What the arm cannot follow (a sweep's last seconds) does no
harm: the case takes the force that was measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...sim.arms.arm import Arm, forward_kinematics
from ...sim.arms.statics import statics
from ...sim.base.types import Array
from ..replay.probes import Push
from ..robot.client import RobotClient, RobotError, State
from .raw import OPEN, RawRecording, force_of, place_of
from .structure import Structure

_FOLLOW, _SMOOTH, _AHEAD = 3.0, 0.05, 0.05  # 1/s; s, time constant of the measured force; s, of a course's rate
_FINGERS = 1.0 / 1500.0  # m/N, of fingers that hold
_FASTEST, _BACK = 0.35, 1.0  # m/s of the hand; 1/s at which joints go back to their place at the grasp
_GENTLE, _SLOW = 0.03, 0.02  # m and m/s of the first gentle pull
_OVER, _TIMES = 1.5, 3  # of the force limit, so many ticks in a row: let go
_CALM, _WINDOW, _PATIENCE = 2e-3, 0.5, 40.0  # m between means over a window [s]; s
_SPEED = 0.35  # rad/s between places


class ForceError(RobotError):
    """The branch pulled harder than allowed; the gripper was opened."""


@dataclass(frozen=True)
class Ways:
    """How a branch is pulled.

    Attributes:
        force: Largest force [N].
        reach: Largest displacement of the grasp point [m].
        rate: Sampling rate of the case [Hz]: that of the ticks. The force of a branch let go of falls within 50 ms;
            a case of every second tick misses how.
        samples: Samples of a recording.
    """

    force: float = 10.0
    reach: float = 0.18
    rate: float = 60.0
    samples: int = 219

    @property
    def duration(self) -> float:
        """Length of a recording [s]."""
        return (self.samples - 1) / self.rate


class Hand:
    """An arm's hand on a branch.

    Attributes:
        releases: Whether pulls may let go: the arm has a gripper, and a tag is seen when it is open.
        scale: Of the branch's springs over typical ones, by `feel`.
        share: Of the largest force that pulls take, below one once the branch has pulled harder than allowed.
    """

    def __init__(self, robot: RobotClient, arm: Arm, structure: Structure, ways: Ways) -> None:
        """Take an arm; nothing moves yet."""
        self._robot, self._arm, self._branch, self._ways = robot, arm, structure, ways
        self._grips = bool(np.isfinite(robot.latest.gripper))
        self.releases = self._grips and bool(np.isfinite(robot.latest.tag).all())
        self.scale, self.share = 1.0, 1.0
        self._home = arm.home

    @property
    def largest(self) -> float:
        """Largest force of a pull [N]: what moves the grasp point by the reach, within the limit; its share of that."""
        axis = self._branch.axes[0]
        gives = self._branch.bent(np.zeros(3), self.scale)[1]
        return self.share * min(self._ways.force, self._ways.reach / float(axis @ gives @ axis))

    # ---- going there -------------------------------------------------------------------------------------------------

    def calm(self) -> Array:
        """Wait until the branch hangs still, without a tag for a while; return where the grasp point is [m], [3]."""
        means: list[Array] = []
        window: list[Array] = []
        begin = self._robot.latest.time
        for state in self._resting():
            window.append(place_of(state))
            if len(window) >= 20 * _WINDOW:
                means.append(np.mean(window, axis=0))
                window = []
            recent = np.array(means[-4:])
            still = len(recent) == 4 and float(np.ptp(recent, axis=0).max()) < _CALM
            waited = state.time - begin
            if waited > _PATIENCE or (still and (self.releases or waited > 0.5 * _PATIENCE)):
                break
        return np.asarray(np.mean(means[-4:], axis=0))

    def _resting(self):  # type: ignore[no-untyped-def]
        for state in self._robot.paced(20.0):
            yield state
            self._robot.send(np.zeros(len(state.q)), state)

    def grasp(self) -> State:
        """Go to the calm branch, the gripper open, and close it."""
        robot = self._robot
        at = place_of(robot.latest) if self.releases else self._branch.grasp
        self._home = joints_at(self._arm, at, robot.latest.q)
        robot.move_to(self._home, speed=_SPEED, within=0.003)
        return robot.grip(1.0) if self._grips else robot.latest

    def leave(self) -> None:
        """Open the gripper; what the branch still pulled with is let go of gently first."""
        robot = self._robot
        begin = robot.wait_free().time
        if self._grips and robot.latest.gripper > OPEN:
            self._follow(lambda t: 0.0, np.zeros(3), lambda state: state.time - begin > 1.5)
        robot.halt()
        if self._grips:
            robot.grip(0.0)

    def feel(self) -> float:
        """Pull gently, held, and return how stiff the branch is over one of typical springs; keep it as `scale`."""
        axis, begin = self._branch.axes[0], force_of(self._arm, self._robot.latest)
        start = self._robot.latest
        for state in self._robot.paced():
            self._send(state, _SLOW * axis)
            if (state.hand_position - start.hand_position) @ axis > _GENTLE or self._over(state):
                break
        self._robot.halt()
        forces = []
        for state in self._resting():
            forces.append(force_of(self._arm, state))
            if len(forces) == 20:
                break
        moved = self._robot.latest.hand_position - start.hand_position
        pulled = float(np.linalg.norm(np.mean(forces, axis=0) - begin))
        typical = np.linalg.solve(self._branch.bent(np.zeros(3), 1.0)[1] + _FINGERS * np.eye(3), moved)
        self.scale = float(np.clip(pulled / np.linalg.norm(typical), 0.02, 50.0))
        return self.scale

    # ---- pulling -----------------------------------------------------------------------------------------------------

    def pull(self, push: Push, path: Path) -> None:
        """Grasp, pull and record; the file is whole when this returns.

        Raises:
            ForceError: The branch pulled harder than allowed; the gripper is open, and what was recorded is kept.
            RobotError: The arm was stopped, refused or lost; what was recorded is kept.
            OSError: The recording could not be written; what was is kept.
        """
        self.leave()  # what a process that was killed may have left in the hand
        self.calm()
        self.grasp()
        with RawRecording(path, self._arm) as raw:
            self._robot.listeners.append(raw)
            try:
                self._course(push, raw)
            finally:
                self._robot.listeners.remove(raw)
        self.leave()

    def _course(self, push: Push, raw: RawRecording) -> None:
        begin, duration = self._robot.latest.time, self._ways.duration
        axis, size = push.direction(self._branch.axes), min(push.size, 1.0) * self.largest
        let_go = push.free_from if self.releases else 1.0

        def course(time: float) -> float:
            """Return the share of the largest force at a time [s] on the robot's clock."""
            return float(push.course(np.array(np.clip((time - begin) / duration, 0.0, 1.0))))

        def ended(state: State) -> bool:
            """Return whether it is time to let go; raise where the recording could not be written."""
            raw.check()
            return (state.time - begin) / duration >= let_go

        if let_go > 0.0:
            self._follow(course, size * axis, ended)
        if let_go < 1.0:
            self._robot.ask_gripper(0.0)
        for state in self._robot.paced():
            raw.check()
            self._robot.send(np.zeros(len(state.q)), state)
            if state.time - begin > duration + 1.0 / self._ways.rate:
                break

    def _follow(self, course: Callable[[float], float], largest: Array, ended: Callable[[State], bool]) -> None:
        """Follow a force, the largest times its share at a time, until an end."""
        parts = np.linspace(-1.0, 1.0, 17)
        bent = [self._branch.bent(part * largest, self.scale) for part in parts]
        way, gives = np.array([b[0] for b in bent]), np.array([b[1] for b in bent])
        force, last, over = force_of(self._arm, self._robot.latest), self._robot.latest, 0
        for state in self._robot.paced():
            if ended(state):
                return
            share = 1.0 - float(np.exp(-(state.time - last.time) / _SMOOTH))
            force, last = force + share * (force_of(self._arm, state) - force), state
            over = over + 1 if self._over(state) else 0
            if over >= _TIMES:
                self._let_go(state)
            here, ahead = course(state.time), course(state.time + _AHEAD)
            moving = (_at(parts, way, ahead) - _at(parts, way, here)) / _AHEAD
            compliance = _at(parts, gives, here) + _FINGERS * np.eye(3)
            self._send(state, self._leashed(state, moving + _FOLLOW * compliance @ (here * largest - force)))

    def _over(self, state: State) -> bool:
        return float(np.linalg.norm(force_of(self._arm, state))) > _OVER * self._ways.force

    def _let_go(self, state: State) -> None:
        force = float(np.linalg.norm(force_of(self._arm, state)))
        self._robot.halt()
        if self._grips:
            self._robot.grip(0.0)
        raise ForceError(f"the branch pulls with {force:.1f} N where {self._ways.force:g} N are allowed; let go of it")

    def _leashed(self, state: State, velocity: Array) -> Array:
        """Keep the hand's speed within its own, and its way within the reach: further out only back is left."""
        away = place_of(state) - self._branch.grasp
        distance = float(np.linalg.norm(away))
        if distance > 1.3 * self._ways.reach and velocity @ away > 0.0:
            velocity = velocity - (velocity @ away) / distance**2 * away
        return velocity / max(1.0, float(np.linalg.norm(velocity)) / _FASTEST)

    def _send(self, state: State, velocity: Array) -> None:
        """Move the hand; joints that need not go back to their place at the grasp."""
        jacobian = statics(self._arm, state.q)[1]
        inverse = jacobian.T @ np.linalg.inv(jacobian @ jacobian.T + 1e-4 * np.eye(3))
        spare = _BACK * (self._home - state.q)
        joints = inverse @ velocity + spare - inverse @ (jacobian @ spare)
        most = np.asarray(0.95 * self._arm.velocity_limit)
        self._robot.send(joints / max(1.0, float((np.abs(joints) / most).max())), state)


def _at(parts: Array, table: Array, part: float) -> Array:
    """Return a table's entry at a part, linear in between."""
    place = float(np.interp(part, parts, np.arange(len(parts))))
    low = min(int(place), len(parts) - 2)
    out: Array = table[low] + (place - low) * (table[low + 1] - table[low])
    return out


def joints_at(arm: Arm, place: Array, q: Array) -> Array:
    """Return joint positions [rad], [D], near ``q`` that bring the hand to a place [m], [3].

    Raises:
        RobotError: The arm does not reach it.
    """
    q = np.array(q, dtype=np.float64)
    for _ in range(300):
        left = place - forward_kinematics(arm, q)[2][0]
        if float(np.linalg.norm(left)) < 1e-4:
            return q
        jacobian = statics(arm, q)[1]
        step = left * min(1.0, 0.05 / float(np.linalg.norm(left)))
        q = q + jacobian.T @ np.linalg.solve(jacobian @ jacobian.T + 1e-4 * np.eye(3), step)
        q = np.clip(q, arm.lower + 0.03, arm.upper - 0.03)
    said = " ".join(f"{x:.2f}" for x in place)
    raise RobotError(f"the arm does not reach the branch at {said} m")
