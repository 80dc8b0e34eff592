"""The twin of a branch to be measured: a Jaco 2 that grasps it, an unknown branch in another simulator than bough.

The branch is MuJoCo's with three times as many links as a model of it has, and with effects hidden in it by
`learn.hidden`. The hand holds it as two rubber fingers do: with a force and without a moment,

    f = k (h + o - x) + c (h' - x'),

h the hand, x the grasp point, o what lay between them when the gripper closed. The branch moves under f, and the arm's
joints carry J' f, which the guard sees; the arm's motion does not give way to f, since its joints are geared 160 to 1
and their drives hold speed. Beside its joints the arm tells what a robot that measures branches has: a force sensor at
the wrist, and a camera that follows a tag at the grasp point. The hand meets nothing but the grasp point.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ...sim.arms.arm import Arm, forward_kinematics
from ...sim.arms.statics import statics
from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ..hidden import forms
from ..hidden.branch import TRUNK_PIVOT, Branch, random_branch
from ..hidden.drive import Live
from ..hidden.names import NAMES
from ..hidden.parts import Part
from ..hidden.probes import Experiment
from ..hidden.sizing import Bench, strength
from .backend import Sample

GRASP = np.array([0.25, -0.35, 0.5])
"""Where the grasp point is at rest, in the arm's base frame [m]: within 28 cm around it the arm reaches everything."""

FORCE_NOISE, TAG_NOISE, TORQUE_NOISE = 0.08, 1.5e-3, 0.05
"""Standard deviations: a wrist's force sensor [N], a tag half a metre before a camera [m], a joint's torque [N m]."""

_GRIP, _RUBBER = 1500.0, 12.0  # k [N/m], c [N s/m]: fingers that give 5 mm at 8 N
_CLOSES = 1.25  # of its way a second: a Jaco's fingers need about 0.8 s
_HOLDS, _LOSES = 0.9, 0.85  # shares of the way from which fingers hold, and below which they have lost it: 40 ms
_NEAR = 0.06  # m from the hand within which fingers find the branch
_SERVO = 0.01  # s, time constant of the joints' speed
_MOST = 0.1  # s at once: a loop that stood for longer loses time instead of hurrying after it
_REACH, _SIZING = 0.15, (20.0, 110)  # of the pushes that a hidden effect is sized by; their rate [Hz] and samples


@dataclass(frozen=True)
class Hiding:
    """An effect to hide.

    Attributes:
        name: One of `twin_effects`.
        joint: Where it acts, 0 nearest the base; drawn if None.
        size: Rms change of displacement that it makes in the pushes of an exam, over the rms of the displacement.
    """

    name: str
    joint: int | None = None
    size: float = 0.2


def twin_effects() -> tuple[str, ...]:
    """Return the names of effects that a twin can hide: those of branch, air and trunk, not those of sensors."""
    return tuple(name for name in NAMES if name not in _OF_SENSORS)


_OF_SENSORS = ("grasp_slip", "force_bias", "force_scale", "time_delay", "gravity_comp_error")


def read_hidings(words: Sequence[str], segments: int) -> list[Hiding]:
    """Read effects to hide, ``NAME[:joint=J][,size=S]``.

    Raises:
        InputError: Another form, a name that a twin cannot hide, a joint or a size that cannot be.
    """
    return [_hiding(word, segments) for word in words]


def _hiding(word: str, segments: int) -> Hiding:
    name, _, rest = word.partition(":")
    if name not in twin_effects():
        raise InputError("--effect", "", f"'{name}'", ", ".join(twin_effects()))
    given: dict[str, Any] = {}
    for part in filter(None, rest.split(",")):
        key, _, text = part.partition("=")
        try:
            given[key] = {"joint": int, "size": float}[key](text)
        except (KeyError, ValueError):
            raise InputError("--effect", name, f"'{part}'", "joint=J, size=S") from None
    found = Hiding(name, **given)
    if found.joint is not None and not 0 <= found.joint < segments:
        raise InputError("--effect", name, f"joint={found.joint}", f"0 to {segments - 1}, counted from the base")
    if not 0.01 <= found.size <= 1.0:
        raise InputError("--effect", name, f"size={found.size:g}", "0.01 to 1")
    return found


def hidden_parts(seed: int, segments: int, hidings: Sequence[Hiding]) -> tuple[Branch, list[tuple[Hiding, Part]]]:
    """Return the branch of a seed and its hidden effects, as strong as they are to be.

    Raises:
        InputError: An effect that leaves this branch's motion not finite.
    """
    branch = random_branch(np.random.default_rng(seed), segments)
    if not hidings:
        return branch, []
    experiment = Experiment(seed, segments, *_SIZING, _REACH)
    experiment.branch = experiment.measured = branch
    bench, out, rng = Bench(experiment, {"sub": 3, "wood": 0.08}), [], np.random.default_rng([seed, 22])
    scale = bench.scale()
    for hiding in hidings:
        joint = int(rng.integers(segments)) if hiding.joint is None else hiding.joint
        part, found = strength(bench, forms.recipe(hiding.name)(rng, scale, joint), hiding.size)
        if not np.isfinite(found):
            allowed = "another seed or a smaller size"
            raise InputError("--effect", hiding.name, "a branch that leaves the finite", allowed)
        out.append((Hiding(hiding.name, part.joint, found), part))
    return branch, out


class BranchTwin:
    """A simulated arm that grasps a branch (`learn.robot.backend.Backend` with a gripper).

    Attributes:
        num_dofs: Number of joints.
        branch: What is before it; springs and effects are its secret.
        hidden: Effects that are hidden in it, with the size that they have.
    """

    def __init__(
        self, arm: Arm, *, seed: int = 0, segments: int = 3, hidings: Sequence[Hiding] = (), noise: float = 1.0
    ) -> None:
        """Draw a branch, hide effects in it, and put the arm at home, its gripper open.

        Args:
            arm: The arm.
            seed: Of branch, effects and noise.
            segments: Of the branch.
            hidings: Effects to hide.
            noise: Of the sensors, times `FORCE_NOISE`, `TAG_NOISE` and `TORQUE_NOISE`.
        """
        self.num_dofs, self._arm, self._noise = arm.num_dofs, arm, noise
        self.branch, parts = hidden_parts(seed, segments, hidings)
        self.hidden = [hiding for hiding, _ in parts]
        self._live = Live(self.branch, [part for _, part in parts])
        self._rng = np.random.default_rng([seed, 23])
        self._q, self._qd, self._target = arm.home.copy(), np.zeros(arm.num_dofs), np.zeros(arm.num_dofs)
        self._gripper = self._asked = 0.0
        self._offset: Array | None = None
        self._force = np.zeros(3)
        self._until: float | None = None
        self._see_hand()

    def _see_hand(self) -> None:
        """Note where the hand is, how it is turned, and how it moves with the joints."""
        self._at, self._turn = forward_kinematics(self._arm, self._q)[2]
        self._jacobian = statics(self._arm, self._q)[1]

    def read(self, now: float) -> Sample:
        """Bring the world to ``now`` [s] and measure.

        Raises:
            RuntimeError: The branch left the finite.
        """
        elapsed = 0.0 if self._until is None else now - self._until
        steps = round(min(elapsed, _MOST) / self._live.step)
        self._until = now if self._until is None or elapsed > _MOST else self._until + steps * self._live.step
        if steps:
            self._move(steps)
        if self._live.astray:
            raise RuntimeError("the simulated branch left the finite")
        return self._sample(now)

    def _move(self, steps: int) -> None:
        """Move arm, fingers and branch on; the hand's way in between is that of the Jacobian."""
        step = self._live.step
        hand, jacobian = self._at, self._jacobian
        time = step * np.arange(1, steps + 1)[:, None]
        fading = np.exp(-time / _SERVO)
        rates = self._target + (self._qd - self._target) * fading
        turned = self._target * time + (self._qd - self._target) * _SERVO * (1.0 - fading)
        path, speed = hand + turned @ jacobian.T, rates @ jacobian.T
        self._q, self._qd = self._q + turned[-1], rates[-1]
        for at, moving in zip(path, speed, strict=True):
            self._fingers(at, step)
            self._live.advance(self._grasping(at, moving))
        self._see_hand()

    def _fingers(self, hand: Array, step: float) -> None:
        self._gripper += float(np.clip(self._asked - self._gripper, -_CLOSES * step, _CLOSES * step))
        if self._gripper < _LOSES:
            self._offset = None
        elif self._gripper > _HOLDS and self._offset is None and np.linalg.norm(self._tag - hand) < _NEAR:
            self._offset = self._tag - hand

    def _grasping(self, hand: Array, moving: Array) -> Array:
        """Return the force of the hand on the branch [N], [3]."""
        if self._offset is None:
            self._force = np.zeros(3)
        else:
            stretched = hand + self._offset - self._tag
            held = float(np.clip((self._gripper - _LOSES) / (_HOLDS - _LOSES), 0.0, 1.0))
            self._force = held * (_GRIP * stretched + _RUBBER * (moving - self._live.velocity))
        return self._force

    @property
    def _tag(self) -> Array:
        return GRASP + self._live.moved

    def _sample(self, now: float) -> Sample:
        drawn = self._rng.normal(size=6 + self.num_dofs)
        torque = self._force @ self._jacobian + self._noise * TORQUE_NOISE * drawn[6:]
        return Sample(now, self._q.copy(), self._qd.copy(), torque, self._at, self._turn, self._gripper,
                      self._force + self._noise * FORCE_NOISE * drawn[:3],
                      self._tag + self._noise * TAG_NOISE * drawn[3:6])  # fmt: skip

    def send(self, velocity: Array) -> None:
        """Ask the servos for joint speeds [rad/s], [D]."""
        self._target = np.array(velocity, dtype=np.float64)

    def grip(self, closed: float) -> None:
        """Ask the fingers to close so far, 0 to 1."""
        self._asked = closed

    def close(self) -> None:
        """Let the world stand as it is."""

    def structure(self) -> dict[str, Any]:
        """Return what a tape measure tells of the branch: `meta.yaml` of a case without recordings."""
        b = self.branch
        names = b.names or [f"segment_{k + 1}" for k in range(len(b.length))]
        rows = zip(names, b.length, b.radius_base, b.radius_tip, b.elevation, b.azimuth, b.mass().tolist(), strict=True)
        keys = ("name", "length_m", "radius_base_m", "radius_tip_m", "elevation_deg", "azimuth_deg", "mass_kg")
        base = GRASP - b.grasp()
        return {
            "format": "branch-gap-case/1", "gravity_mps2": b.gravity, "planar": False, "density_kgpm3": b.density,
            "base_position_m": [round(float(x), 6) for x in base], "trunk_pivot_below_base_m": TRUNK_PIVOT,
            "segments": [dict(zip(keys, row, strict=True)) for row in rows],
            "grasp": {"segment": names[-1], "distance_from_lower_end_m": b.grasp_distance},
        }  # fmt: skip

    def write_structure(self, path: Path) -> None:
        """Write `structure` as the file that ``bough probe --branch`` reads."""
        path.write_text(yaml.safe_dump(self.structure(), sort_keys=False))
