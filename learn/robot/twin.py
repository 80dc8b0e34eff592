"""The twin: bough's own arm among branches in real time, for everything that a real arm is too dear for."""

from __future__ import annotations

import time
from collections.abc import Mapping

import numpy as np
import torch
import warp as wp

from ...sim.arms.arm import Arm
from ...sim.arms.simulator import ArmSimulator, Contacts
from ...sim.base.types import Array
from ...sim.cameras.described import Scene, arm_world, packed
from ...sim.scenes.reach_scene import ReachPlaces, ReachScene, grow_reach_trees
from ..touch.record import carrying_torque
from .backend import Sample

_STEPS = 240  # a second
_MOST = 24  # steps at once: a loop that stood for longer loses time instead of hurrying after it


class Twin:
    """A simulated arm before a tree (`learn.robot.backend.Backend`), on one world of the CPU.

    Torques are told as the arm's driver tells them, without what carries its weight. A hidden effect is a law that the
    branches obey and that a model of them may lack (`sim.effects`).

    Attributes:
        num_dofs: Number of joints.
        simulator: The world.
    """

    def __init__(
        self, arm: Arm, *, seed: int = 0, away: float = 0.0, effects: Mapping[str, Mapping[str, float]] | None = None
    ) -> None:
        """Grow a tree, place it before the arm, and put the arm at home.

        Args:
            arm: The arm.
            seed: Of the tree and its place.
            away: How much further off the tree stands [m]; 10 leaves the arm alone.
            effects: Parameters of hidden effects in SI units, by effect and parameter.

        Raises:
            InputError: An effect that trees cannot have.
        """
        self.num_dofs, self._arm = arm.num_dofs, arm
        scene, effects = ReachScene(away=away), {} if effects is None else effects
        trees = grow_reach_trees(scene, arm, 1, seed=seed, domain="training")
        self.simulator = ArmSimulator(trees, arm, contacts=Contacts(), dt=1.0 / _STEPS, device="cpu", threads=1,
                                      effects=tuple(effects))  # fmt: skip
        for name, parameters in effects.items():
            for parameter, value in parameters.items():
                self.simulator.effects.fill(name, parameter, value)
        places = ReachPlaces(self.simulator, trees, scene, seed=seed, domain="training")
        places.place(wp.array([True], dtype=wp.bool, device="cpu"), wp.zeros(1, dtype=int, device="cpu"))
        self.simulator.reset()
        self._until: float | None = None
        self._ground = float(places.root[0, 2])
        for count in range(1, 9):  # prepared now, so that no tick has to wait for it
            self.simulator.step(count)

    def read(self, now: float) -> Sample:
        """Bring the world to ``now`` [s] and measure.

        Raises:
            RuntimeError: The world was lost.
        """
        until = now if self._until is None else self._until
        steps = int((now - until) * _STEPS)
        self._until = until + steps / _STEPS if steps <= _MOST else now
        if steps:
            self.simulator.step(min(steps, _MOST))
        if self.simulator.faults():
            raise RuntimeError("the simulated world left the finite")
        sim = self.simulator
        q, qd, torque, at, turn = (
            x[0].numpy().astype(np.float64) for x in (sim.q, sim.qd, sim.torque, sim.end_position, sim.end_rotation)
        )
        return Sample(now, q, qd, torque - carrying_torque(self._arm, q), at, turn)

    def scene(self) -> bytes:
        """Return the world as it is, for cameras in another process (`sim.cameras.described`)."""
        sim, age = self.simulator, 0.0 if self._until is None else time.monotonic() - self._until
        hand, turn = (x[0].numpy().astype(np.float64) for x in (sim.end_position, sim.end_rotation))
        return packed(Scene(arm_world(sim, 0, self._ground), age, hand, turn))

    def send(self, velocity: Array) -> None:
        """Ask the servos for joint speeds [rad/s], [D]."""
        self.simulator.target[0] = torch.from_numpy(velocity.astype(np.float32))

    def close(self) -> None:
        """Let the world stand as it is."""
