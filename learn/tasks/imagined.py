"""A task's worlds several times over, in which actions are tried before one is taken."""

from __future__ import annotations

from typing import Any

import torch
import warp as wp

from ...kernels.tasks.parts import Clock
from ...sim.arms.copies import WorldCopies
from .assembled import AssembledTask, asking


class ImaginedWorlds:
    """Copies of a task's worlds that take policy steps without rewards, observations or ends.

    What the servos are asked for, latencies among it, and physics are the task's own; flags, measures and noise are
    not there. Copies of world w are w * count to w * count + count - 1.

    Attributes:
        simulator: The copies.
        force: Norm of the net contact forces of all links, its mean over the control periods of the last step [N],
            [worlds * count].
        hard: Share of those periods in which it was above the limit, [worlds * count].
    """

    def __init__(self, task: AssembledTask, count: int, limit: float) -> None:
        """Make the copies.

        Args:
            task: The task whose worlds are copied.
            count: Copies of every world.
            limit: Force above which a control period is counted by ``hard`` [N].

        Raises:
            InputError: The count is below one.
        """
        self._task, self._limit = task, limit
        self._copies = WorldCopies(task.simulator, count)
        self.simulator = self._copies.simulator
        worlds = task.num_envs * count
        self._actions, self._waiting = (self._like(task._warp[name], worlds) for name in ("actions", "waiting"))
        self._clock: Any = Clock()
        for name in ("clock", "action_delay"):  # all of it that servos are asked by
            theirs = getattr(task._clock, name)
            mine = self._like(theirs, worlds)
            setattr(self._clock, name, mine)
            self._copies.carry(wp.to_torch(mine), wp.to_torch(theirs), 0)
        self._copies.carry(wp.to_torch(self._waiting), wp.to_torch(task._warp["waiting"]), 1)
        self._periods = asking(self.simulator, task.pace, self._actions, self._clock, self._waiting)
        self.force, self.hard = torch.zeros((2, worlds), device=self.simulator.q.device)

    def take(self) -> None:
        """Bring all copies to the present state of their worlds."""
        self._copies.take()

    def step(self, actions: torch.Tensor) -> None:
        """Act for one policy step, [worlds * count, dof]; write `force` and `hard`."""
        wp.to_torch(self._actions).copy_(actions)
        self.force.zero_()
        self.hard.zero_()
        for ask in self._periods:
            ask()
            self.simulator.step(self._task.pace.period_steps)
            force = self.simulator.arm_force.square().sum((1, 2)).sqrt()
            self.force += force / len(self._periods)
            self.hard += (force > self._limit) / len(self._periods)
        wp.to_torch(self._clock.clock).add_(1)

    def _like(self, array: wp.array, worlds: int) -> wp.array:
        """Return memory for so many worlds of what the task has, [.., worlds, dof] or [worlds]."""
        shape = (worlds,) if array.ndim == 1 else (*array.shape[:-2], worlds, array.shape[-1])
        made: wp.array = wp.zeros(shape, dtype=array.dtype, device=array.device)
        return made
