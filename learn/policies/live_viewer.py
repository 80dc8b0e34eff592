"""Watching a policy as it acts, in a window of Newton's viewer."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
import warp as wp

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ..tasks import picture

if TYPE_CHECKING:
    from ..tasks.powerline import Powerline
    from .evaluate import Policy

_MATERIAL = (0.7, 0.0, 0.0, 0.0)  # roughness, metallic, checker, texture


def open_viewer() -> Any:
    """Return Newton's OpenGL viewer with a window.

    Raises:
        InputError: pyglet is not installed, or there is no screen that it can open a window on.
    """
    try:
        import pyglet  # noqa: F401
    except ModuleNotFoundError:
        raise InputError("play", "--viewer", "no pyglet", "pip install 'bough[viewer]', or --out for a film") from None
    from newton.viewer import ViewerGL

    try:
        return ViewerGL()
    except Exception as error:  # each of pyglet's platforms has classes of its own, and Newton raises Exception itself
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        allowed = "a screen with OpenGL 3.3 or newer, or --out for a film"
        raise InputError("play", "--viewer", f"no window ({first})", allowed) from None


class Shown:
    """The capsules of a task's first world as a viewer takes them: arm, branches and target.

    Args:
        task: The task.
        viewer: Any of Newton's viewers.
    """

    def __init__(self, task: Powerline, viewer: Any) -> None:
        self.task, self.viewer = task, viewer
        view = picture.view_of(task.simulator, task.scene, 0)
        pitch, yaw = angles(np.subtract(view.target, view.position))
        viewer.set_camera(wp.vec3(*view.position), pitch, yaw)
        self.look()

    def look(self) -> None:
        """Take the capsules from where they are now."""
        start, end, radius, color = picture.solids(self.task.simulator, self.task.scene, 0)
        used = radius > 0.0
        transforms, scales = instances(start[used], end[used], radius[used])
        device = self.viewer.device
        self._xforms: Any = wp.array(transforms.astype(np.float32), dtype=wp.transform, device=device)
        self._scales: Any = wp.array(scales.astype(np.float32), dtype=wp.vec3, device=device)
        self._colors: Any = wp.array(color[used].astype(np.float32), dtype=wp.vec3, device=device)
        materials = np.tile(np.array(_MATERIAL, np.float32), (len(scales), 1))
        self._materials: Any = wp.array(materials, dtype=wp.vec4, device=device)

    def draw(self, seconds: float) -> None:
        """Draw a frame, and let the window see to mouse and keys.

        Args:
            seconds: Simulated time since the start [s].
        """
        self.viewer.begin_frame(seconds)
        self.viewer.log_capsules("capsules", "", self._xforms, self._scales, self._colors, self._materials)
        self.viewer.end_frame()


def instances(start: Array, end: Array, radius: Array) -> tuple[Array, Array]:
    """Return capsules as transforms of a capsule along z.

    Args:
        start: Starts of the axes [m], shape [S, 3].
        end: Ends of the axes [m], shape [S, 3].
        radius: Radii [m], shape [S].

    Returns:
        Positions [m] and quaternions x y z w, shape [S, 7]; radius, radius and half the length of the axis [m], [S, 3].
    """
    axis = end - start
    length = np.linalg.norm(axis, axis=1)
    direction = np.where(length[:, None] > 0.0, axis / np.maximum(length, 1e-12)[:, None], [0.0, 0.0, 1.0])
    # half-way rotation from z: (z x d, 1 + z.d), and about x where d points down
    turn = np.column_stack([-direction[:, 1], direction[:, 0], np.zeros(len(axis)), 1.0 + direction[:, 2]])
    turn[direction[:, 2] < -1.0 + 1e-9] = (1.0, 0.0, 0.0, 0.0)
    turn /= np.linalg.norm(turn, axis=1, keepdims=True)
    return np.column_stack([(start + end) / 2.0, turn]), np.column_stack([radius, radius, length / 2.0])


def angles(direction: Array) -> tuple[float, float]:
    """Return pitch and yaw of a camera that looks along a direction, z up [deg]."""
    x, y, z = np.asarray(direction) / np.linalg.norm(direction)
    return float(np.degrees(np.arcsin(z))), float(np.degrees(np.arctan2(y, x)))


@torch.inference_mode()
def watch(task: Powerline, policy: Policy, viewer: Any, *, steps: int | None = None) -> int:
    """Let a policy act in real time until the window is closed; return the policy steps done.

    The world starts anew whenever its episode ends; the viewer's own pause and single step work.

    Args:
        task: The task; its first world is shown.
        policy: Who acts.
        viewer: Any of Newton's viewers; it is closed at the end.
        steps: Most policy steps; no limit if None.
    """
    shown, observations, done = Shown(task, viewer), task.get_observations(), 0
    due = time.perf_counter()
    try:
        while viewer.is_running() and (steps is None or done < steps):
            now = time.perf_counter()
            if now >= due and viewer.should_step():
                observations, _, _, _ = task.step(policy(observations))
                done, due = done + 1, max(due + task.step_seconds, now)
                shown.look()
            shown.draw(done * task.step_seconds)
    finally:
        viewer.close()
    return done
