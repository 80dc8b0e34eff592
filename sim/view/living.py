"""Trees that move on the page: a simulation that runs while it is looked at, with sliders and a pull by mouse."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..base.console import bar
from ..base.types import Array
from ..effects.registry import Setting
from ..trees.outline import outlines
from ..trees.tree import Tree
from .grove import Grove, grove_of, rest_frames, side_by_side
from .player import SPEEDS
from .pull import Pull
from .sliders import LAWS, Sliders, add_sliders
from .wood import Wood

if TYPE_CHECKING:
    from ..engine.simulator import Simulator
    from .page import Page

DT = 1.0 / 240.0
_MOST_STEPS = 24  # a frame: where the machine is slower than the trees, they move slower


@dataclass(frozen=True)
class Planted:
    """Trees to be shown, and the gravity that they stand in.

    Attributes:
        trees: One a world.
        gravity: Acceleration of free fall [m/s^2], shape [3].
        qpos: Where each starts, in MuJoCo's order; the springs' rest if None.
    """

    trees: Sequence[Tree]
    gravity: Array
    qpos: Sequence[Array] | None = None


class Living:
    """A forest that moves.

    Attributes:
        seconds: How long a recording of it is [s].
        time: Simulated time [s].
        simulator: The worlds; None before `start`.
    """

    def __init__(self, page: Page, planted: Planted, *, laws: Sequence[str] = LAWS, device: str | None = None) -> None:
        """Put the trees on the page as they stand, and the controls beside them.

        Args:
            page: Where to.
            planted: The trees.
            laws: Laws that get sliders.
            device: Warp device.

        Raises:
            InputError: A law that a forest cannot have.
        """
        self.page, self.planted, self.device = page, planted, device
        self.seconds, self.time, self._due = 6.0, 0.0, 0.0
        frames = rest_frames(planted.trees)
        self.grove: Grove = grove_of(planted.trees)
        self.grove = self.grove.moved(side_by_side(self.grove, *frames))
        ends = self.grove.ends(*frames)
        low, high = (f(np.concatenate(ends), axis=0) for f in (np.min, np.max))
        self._size = float(np.median([np.ptp(_of(ends, self.grove, w), axis=0).max() for w in _some(planted.trees)]))
        page.title(_what(planted.trees))
        page.ground(low, high)
        self.wood = Wood(page.server.scene, "/wood", ends, self.grove.radius, self.grove.color)
        page.shadows(len(self.grove.world))
        self._add_clock()
        weight = float(np.median([tree.mass.sum() for tree in planted.trees])) * 9.81
        self.pull = Pull(page, self.wood, self.grove, max(0.3 * weight, 0.01) / self._size, self._size)
        self.sliders: Sliders = add_sliders(page, _setting(planted.trees, self._size), laws)
        self.simulator: Simulator | None = None

    def _add_clock(self) -> None:
        gui = self.page.server.gui
        self._moves = gui.add_checkbox("move", True)
        self._speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1 ×")
        self._anew = False
        gui.add_button("Start anew").on_click(lambda _event: setattr(self, "_anew", True))
        self._said = gui.add_text("state", "preparing (the first run compiles kernels)", disabled=True)
        self.page.note("Drag a branch with the mouse: the drag is a force on it.")

    def start(self) -> None:
        """Prepare the simulation; compiles kernels the first time."""
        from ..engine.model import Model
        from ..engine.simulator import Simulator

        with bar("preparing (the first run compiles kernels)", None):
            model = Model(list(self.planted.trees), gravity=self.planted.gravity, device=self.device)
            self.simulator = Simulator(model, dt=DT, effects=self.sliders.names)
            if self.planted.qpos is not None:
                self.simulator.state.set_qpos(list(self.planted.qpos))
                self.simulator.mark_start()
            self.sliders.write(self.simulator)
            self.simulator.step()
            self.simulator.reset()

    def tick(self, seconds: float) -> None:
        """Simulate what real time [s] has gone by and draw where the trees are."""
        if self.simulator is None:
            return
        if self._anew:
            self._anew, self.time = False, 0.0
            self.simulator.reset()
        self.sliders.write(self.simulator)
        self._advance(self.simulator, seconds)
        position, rotation = (part.cpu().numpy() for part in self.simulator.observe())
        self.pull.write(self.simulator, position, rotation)
        self.wood.move(*self.grove.ends(position, rotation))
        self._said.value = self._state()

    def _advance(self, simulator: Simulator, seconds: float) -> None:
        if self._moves.value:
            self._due += seconds * SPEEDS[self._speed.value]
        steps = min(int(self._due / simulator.dt), _MOST_STEPS)
        if steps == _MOST_STEPS:
            self._due = steps * simulator.dt
        for _ in range(steps):
            simulator.step()
        self._due -= steps * simulator.dt
        self.time += steps * simulator.dt

    def _state(self) -> str:
        assert self.simulator is not None
        said = f"{self.time:.1f} s"
        lost = int((self.simulator.state.fault_tick >= 0).sum())
        pull = float(np.linalg.norm(self.pull.force))
        return said + (f", pull {pull:.3g} N" if pull else "") + (f", {lost} frozen: start anew" if lost else "")


def _of(ends: tuple[Array, Array], grove: Grove, world: int) -> Array:
    own = grove.world == world
    return np.concatenate([ends[0][own], ends[1][own]])


def _some(trees: Sequence[Tree]) -> range:
    return range(0, len(trees), max(1, len(trees) // 16))


def _what(trees: Sequence[Tree]) -> str:
    links = sorted({tree.num_links for tree in trees})
    size = f"{links[0]}" if len(links) == 1 else f"{links[0]} to {links[-1]}"
    one = f"{trees[0].name}, {size} link{'s' * (links[0] > 1)}"
    return one if len(trees) == 1 else f"{len(trees)} trees of {size} links"


def _setting(trees: Sequence[Tree], size: float) -> Setting:
    """Return what laws' ranges are multiples of, for a tree in the middle of the forest."""
    tree = trees[len(trees) // 2]
    mass, found = float(tree.mass.sum()), outlines([tree])
    return Setting(
        torque=0.02 * mass * 9.81 * size, angle=0.5, rate=2.0, force=0.1 * mass * 9.81, speed=size, length=size,
        area=max(float(found.area.sum()), 1e-6), mass=mass,
    )  # fmt: skip
