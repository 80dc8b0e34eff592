"""A drag with the mouse on a branch, which becomes a force on it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from ..base.rotation import quat_conjugate, quat_rotate
from ..base.types import Array

if TYPE_CHECKING:
    from ..engine.simulator import Simulator
    from .grove import Grove
    from .page import Page
    from .wood import Wood

_COLOR = (214, 60, 40)
_NONE = np.array([[[0.0, 0.0, -1.0e4], [0.0, 0.0, -1.0e4 + 1.0]]], np.float32)


@dataclass
class _Held:
    """What is held: the capsule, where on the page it was grasped [m], where the mouse is now [m]."""

    capsule: int
    grasped: Array
    mouse: Array
    local: Array | None = None  # the point in the body's frame, once the loop has seen the body


class Pull:
    """Forces of a drag: the way of the mouse since it was pressed, times newtons a metre.

    The force does not depend on where the branch goes meanwhile, so that no twig is too light for it.

    Attributes:
        force: On the page's axes [N], shape [3].
    """

    def __init__(self, page: Page, wood: Wood, grove: Grove, stiffness: float, size: float) -> None:
        """Listen to drags on the wood.

        Args:
            page: Where the controls go.
            wood: What can be dragged.
            grove: What the wood was made of.
            stiffness: Newtons a metre of drag at first.
            size: Size of the trees, for the arrow [m].
        """
        self._grove, self.force = grove, np.zeros(3)
        self._held: _Held | None = None
        self._loaded: tuple[int, int, int] | None = None
        self._strength = page.server.gui.add_number("pull [N per m of drag]", float(f"{stiffness:.2g}"), min=0.0,
                                                    step=float(f"{stiffness / 10:.1g}"))  # fmt: skip
        self._arrow = page.server.scene.add_arrows("/pull", _NONE, _COLOR, shaft_radius=0.008 * size,
                                                   head_radius=0.022 * size, head_length=0.05 * size)  # fmt: skip
        for handle, members in (*zip(wood.rods, wood.members, strict=True), (wood.balls, None)):
            handle.on_drag("left")(self._listener(members))

    def _listener(self, members: Any) -> Any:
        async def listen(event: Any) -> None:  # async: starts and ends come in their order
            """Take hold of the capsule where a drag starts, follow the mouse, and let go at the end."""
            if event.phase == "end" or event.instance_index is None:
                self._held = None
            elif event.phase == "start" or self._held is None:
                capsule = event.instance_index if members is None else int(members[event.instance_index])
                self._held = _Held(capsule, np.array(event.start_position), np.array(event.end_position))
            else:
                self._held.mouse = np.array(event.end_position)

        return listen

    def write(self, simulator: Simulator, position: Array, rotation: Array) -> None:
        """Give the simulator the force, or none, and draw it; frames [W, B, 3] in m and [W, B, 4] as they are now."""
        held = self._held
        if held is None:
            self._release(simulator)
            return
        world, body = int(self._grove.world[held.capsule]), int(self._grove.body[held.capsule])
        at, turn = position[world, body] + self._grove.place[world], rotation[world, body]
        if held.local is None:
            held.local = quat_rotate(quat_conjugate(turn), held.grasped - at)
        self.force = float(self._strength.value) * (held.mouse - held.grasped)
        self._load(simulator, world, body, held.local)
        point = at + quat_rotate(turn, held.local)
        self._arrow.points = np.array([[point, point + held.mouse - held.grasped]], np.float32)

    def _load(self, simulator: Simulator, world: int, body: int, local: Array) -> None:
        model, load = simulator.model, simulator.load
        link = int(model.first_link[world]) + body
        group, lane = divmod(int(model.world_slot[world]), model.width)
        place = (group, lane, int(model.link_place[link]))
        if self._loaded not in (None, place):
            load.force.torch[self._loaded] = 0.0
        for field, value in ((load.force, self.force), (load.point, model.links.in_link_frame(link, local))):
            row = field.torch[place]
            row.copy_(torch.as_tensor(np.ravel(value), dtype=row.dtype))
        self._loaded = place

    def _release(self, simulator: Simulator) -> None:
        if self._loaded is not None:
            simulator.load.force.torch[self._loaded] = 0.0
            self._loaded, self.force = None, np.zeros(3)
            self._arrow.points = _NONE
