"""What acts on the worlds from outside: forces and torques on the links, efforts at the joints."""

from __future__ import annotations

from ...kernels.tree.layout import layout_of
from .arrays import LaneArray
from .model import Model


class Load:
    """One force and torque a link, one effort a joint, written in place and applied by every step until written again.

    Attributes:
        force: Force on every link, world axes [N]. `LaneArray` of 3 over groups and places + 1.
        point: Point that the force acts at, link frame [m].
        torque: Torque on every link beside the force's, world axes [N m]. Replays of recordings (`kernels.effects`
            rollouts) leave it out.
        effort: Joint force beside the pre-load: torque in the link frame [N m] for spherical joints, x for the others
            [N m or N].
    """

    def __init__(self, model: Model) -> None:
        self.force: LaneArray = model.field("Vec")
        self.point: LaneArray = model.field("Vec")
        self.torque: LaneArray = model.field("Vec")
        self.effort: LaneArray = model.field("Vec")
        self.kernel = layout_of(model.width, model.precision).Load()
        self.kernel.force, self.kernel.point = self.force.kernel, self.point.kernel
        self.kernel.torque, self.kernel.effort = self.torque.kernel, self.effort.kernel
