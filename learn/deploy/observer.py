"""What a policy sees on a robot: the observation of its training, by the kernels of its task, of one world.

Joints and hand come from the arm's measurements, the robot's cloud from its capsules at the measured joints, the
branches' from a camera. The line's cloud is drawn on the line that was fitted to what a camera sees of it, as in
training it is drawn on the line that is there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
import warp as wp

from ...kernels.tasks import parts as kernels
from ...perception.seen import SeenSensor, resampled
from ...sim.arms.arm import Arm
from ...sim.arms.arrays import arm_capsules
from ...sim.base.types import Array
from ..cameras.frames import Clouds
from ..robot.client import State
from ..tasks.powerline import SENSED
from ..touch.record import carrying_torque
from .line import LineFit
from .plan import Plan

FELT = 1.0e3
"""Force that stands for a touch that was told, above any threshold on forces [N]."""


@dataclass
class _Shapes:
    """Capsules or axes, as a sensor takes them."""

    start: Any
    end: Any
    radius: Any = None
    num_arm: int = 0


class Observer:
    """Writes the observation of one policy from what a robot tells.

    Attributes:
        observation: What the policy sees, [1, columns], written by `observe`.
        columns: First column of every feature.
        line: The line as it was seen, for clearing tasks.
    """

    def __init__(self, plan: Plan, arm: Arm, *, seed: int = 0) -> None:
        """Allocate everything.

        Args:
            plan: What the policy was trained for.
            arm: The arm.
            seed: Of points that are drawn, and of noise.
        """
        self.plan, self._arm, self._seed = plan, arm, seed
        self.columns, width = plan.parts.columns_of_features()
        self._observation: Any = wp.zeros((1, width), dtype=wp.float32, device="cpu")
        self.observation: torch.Tensor = wp.to_torch(self._observation)
        self._feel = plan.parts.kernels().feel
        self._make_view()
        self._make_own()
        self.line = LineFit()
        self._sensor = self._make_sensor() if plan.seeing else None
        self.restart()

    def _make_view(self) -> None:
        dofs = self._arm.num_dofs
        v: Any = kernels.View()
        v.clock = kernels.Clock()
        for name, kind in v.clock._cls.vars.items():
            setattr(v.clock, name, wp.zeros(1, dtype=kind.type.dtype, device="cpu"))
        for name, kind in (("q", wp.float32), ("qd", wp.float32), ("torque", wp.float32), ("target", wp.float32),
                           ("force", wp.vec3)):  # fmt: skip
            setattr(v, name, wp.zeros((1, dofs), dtype=kind, device="cpu"))
        v.hand, v.turn = wp.zeros(1, dtype=wp.vec3, device="cpu"), wp.zeros(1, dtype=wp.vec4, device="cpu")
        v.key = wp.vec2ui(*np.random.SeedSequence(self._seed).generate_state(2).tolist())
        self._view = v
        names = ("q", "qd", "torque", "target", "force", "hand", "turn")
        self._state = {name: wp.to_torch(getattr(v, name)) for name in names}
        self._age, self._clock = wp.to_torch(v.clock.age), wp.to_torch(v.clock.clock)

    def _make_own(self) -> None:
        self._own: Any = self.plan.parts.own()
        for name, kind in self._own._cls.vars.items():
            if name in self.plan.parts.numbers:
                setattr(self._own, name, self.plan.parts.numbers[name])
            else:
                setattr(self._own, name, wp.zeros((1,) * kind.type.ndim, dtype=kind.type.dtype, device="cpu"))
        self._memory = {name: wp.to_torch(getattr(self._own, name)) for name in ("told", "felt", "target")
                        if name in self.plan.parts.arrays}  # fmt: skip

    def _make_sensor(self) -> SeenSensor:
        radius = np.concatenate([self._arm.base_radius, self._arm.tree.shape_radius.mean(axis=1)])
        count = len(radius)
        ends = [wp.zeros((1, count), dtype=wp.vec3, device="cpu") for _ in range(2)]
        self._capsules = [wp.to_torch(a) for a in ends]
        thick: Any = wp.array(radius[None].astype(np.float32), dtype=wp.float32, device="cpu")
        axis = [wp.zeros(1, dtype=wp.vec3, device="cpu") for _ in range(2)]
        self._axis = [wp.to_torch(a) for a in axis]
        settings = self.plan.settings
        capsules, target = _Shapes(ends[0], ends[1], thick, count), _Shapes(axis[0], axis[1])
        sensor = SeenSensor(capsules, target, self._view.hand, settings.sensor, seed=self._seed)
        sensor.max_noise.fill_(settings.max_noise[0])
        sensor.bind(self._observation, {f: self.columns[f] for f in SENSED if f in self.columns})
        return sensor

    # ---- what is told ------------------------------------------------------------------------------------------------

    def restart(self) -> None:
        """Begin an episode: what was seen, felt and counted before is forgotten."""
        self._age.zero_()
        self.line.forget()
        self._branches = np.zeros((0, 3))
        self._state["force"].zero_()
        for tensor in (self._memory[name] for name in ("told", "felt") if name in self._memory):
            tensor.zero_()

    def aim(self, target: Array) -> None:
        """Say where the hand is to go [m], [3]."""
        self._memory["target"][0] = torch.as_tensor(target, dtype=torch.float32)

    def touched(self, flag: bool) -> None:
        """Take the word of a classifier of joint torques, or of a person, for whether the arm touches something."""
        if "told" in self._memory:
            self._memory["told"].fill_(float(flag))
        self._state["force"].zero_()
        self._state["force"][0, 0, 0] = FELT * flag

    def pushed(self, force: Array, mean: float) -> None:
        """Take true forces, which only a twin knows.

        Args:
            force: Net contact force on every link in the base frame [N], [D, 3].
            mean: Norm of all of them, its mean over the last three control periods [N].
        """
        self._state["force"][0] = torch.as_tensor(force, dtype=torch.float32)
        if "felt" in self._memory:
            self._memory["felt"].fill_(mean)

    def look(self, clouds: Clouds) -> None:
        """Take what was seen last; the line is fitted to all that was seen of it since the episode began."""
        self.line.add(clouds.line.astype(np.float64))
        rng = np.random.default_rng([self._seed, int(self._clock[0])])
        self._branches = resampled(clouds.branches.astype(np.float64), self.plan.settings.sensor.points, rng)

    def observe(self, state: State) -> torch.Tensor:
        """Write and return what the policy sees as a policy step begins."""
        told = {"q": state.q, "qd": state.qd, "hand": state.hand_position, "turn": state.hand_rotation}
        if "torque" in self.columns:
            told["torque"] = state.torque + carrying_torque(self._arm, state.q)
        for name, value in told.items():
            self._state[name][0] = torch.as_tensor(value, dtype=torch.float32)
        if self._sensor is not None:
            self._sense(self._sensor, state.q)
        inputs = [self._view, self._own, self._observation]
        wp.launch(self._feel, 1, inputs, device="cpu")
        self._age += 1
        self._clock += 1
        return self.observation

    def _sense(self, sensor: SeenSensor, q: Array) -> None:
        for tensor, ends in zip(self._capsules, arm_capsules(self._arm, q), strict=True):
            tensor[0] = torch.as_tensor(ends, dtype=torch.float32)
        for tensor, end in zip(self._axis, self.line.ends, strict=True):
            tensor[0] = torch.as_tensor(end, dtype=torch.float32)
        sensor.see(0, self._branches)
        sensor.update()

    def seen(self, feature: str) -> float:
        """Return the first number of a feature as it was last observed; NaN where the policy does not see it."""
        return float(self.observation[0, self.columns[feature]]) if feature in self.columns else np.nan
