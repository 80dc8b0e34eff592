"""A rod whose bending is known, and a page's controls by their labels."""

import numpy as np
from bough.sim.trees.tree import Joint, Tree


def rod(stiffness: float) -> Tree:
    """Return an upright rod of 1 m on a ball joint, so well damped that it comes to rest within a second."""
    return Tree(
        "rod", ["rod"], [-1], [Joint.SPHERICAL], np.zeros((1, 3)), [[1.0, 0, 0, 0]], mass=[0.3], com=[[0, 0, 0.5]],
        inertia=[np.diag([0.025, 0.025, 1e-4])], stiffness=[stiffness], damping=[0.18 * stiffness], shape_link=[0],
        shape_start=[[0, 0, 0]], shape_end=[[0, 0, 1.0]], shape_radius=[[0.02, 0.015]],
    ).validate()  # fmt: skip


def slider(page, label):
    """Return a control of the page by its label."""
    return next(h for h in page.server.gui._gui_input_handle_from_uuid.values() if h.label == label)
