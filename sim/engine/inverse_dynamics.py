"""Efforts that given motions need: inverse dynamics of a batch of worlds."""

from __future__ import annotations

from collections.abc import Sequence

from ...kernels.tree.inverse import inverse_kernels
from ..base.types import Array
from .arrays import LaneArray
from .simulator import Simulator
from .state import State


class InverseDynamics:
    """Finds the joint efforts that give every world of a simulator stated accelerations in its present state.

    Recursive Newton-Euler (`kernels.tree.inverse`) with the model's springs, physical dampers, armature, pre-loads and
    gravity, under the simulator's ``load.force``; its ``load.effort`` is what is asked for and is left out of account.

    Attributes:
        simulator: The worlds.
        acceleration: Joint accelerations, laid out as `State.velocity`: rad/s^2 or m/s^2. `LaneArray` of 3.
        effort: Joint efforts after a call, laid out the same and as `Load.effort`: N m or N. `LaneArray` of 3.
    """

    def __init__(self, simulator: Simulator) -> None:
        m = simulator.model
        self.simulator = simulator
        # states serve as vectors over degrees of freedom: both quantities have the layout and order of a velocity
        self._acceleration, self._effort = State(m), State(m)
        self.acceleration: LaneArray = self._acceleration.velocity
        self.effort: LaneArray = self._effort.velocity
        before = [m.kernel, simulator.state.kernel, simulator.load.kernel, self.acceleration.kernel]
        kernel = inverse_kernels(m.width, m.precision).inverse
        self._launch = simulator._launcher.prepare(kernel, before, [self.effort.kernel])

    def __call__(self) -> LaneArray:
        """Write and return `effort` for the present state, load and `acceleration`."""
        self._launch()
        return self.effort

    def efforts(self, qacc: Array | Sequence[Array]) -> list[Array]:
        """Return one row of efforts a world [N m or N] for ``qacc``, both in the order of MuJoCo's ``qvel``.

        Raises:
            InputError: A ``qacc`` has the wrong length.
        """
        self._acceleration.set_qvel(qacc)
        self()
        return self._effort.qvel()
