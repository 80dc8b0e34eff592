"""A policy at work on the page: arm, branches and target, what is seen, what touches, and the reward's terms."""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from ...sim.base.types import Array
from ...sim.view.legend import css, swatch
from ...sim.view.player import SPEEDS
from ...sim.view.wood import Wood
from ..tasks import picture

if TYPE_CHECKING:
    from ...sim.view.page import Page
    from ..policies.evaluate import Policy
    from ..tasks.assembled import AssembledTask

_CLOUDS = {"arm": (0.20, 0.44, 0.80), "target": (0.80, 0.18, 0.14), "branches": (0.20, 0.55, 0.25)}
_FORCE = (0.93, 0.55, 0.10)
CLEARING = ("occlusion", "cleared", "effort", "margin")
"""What is plotted of clearing tasks: the occlusion score and the three terms of the reward (eq. 5.9)."""
OTHERS = ("reward", "force / 80 N")
"""What is plotted of other tasks: the reward, and the strongest contact force on the arm as a share of rupture."""
_KEPT = 150
_PER_NEWTON = 0.02  # length of an arrow [m/N]
_LEAST = 0.2  # forces below are left out [N]
_PLOT = ((90, 90, 90), (40, 130, 80), (200, 60, 40), (60, 100, 200))


class PolicyScene:
    """One world of a task in which a policy acts, episode after episode.

    Attributes:
        seconds: How long a recording of it is [s].
        task: The task; its first world is shown.
    """

    def __init__(self, page: Page, task: AssembledTask, policy: Policy, name: str) -> None:
        self.page, self.task, self.policy = page, task, policy
        self.seconds = min(12.0, float(task.max_episode_length) * task.step_seconds)
        self._observations, self._sensor = task.get_observations(), getattr(task, "sensor", None)
        self._sees = self._sensor is not None
        self._due, self._time, self._episodes, self._cleared = 0.0, 0.0, 0, 0
        self._rows: deque[tuple[float, ...]] = deque(maxlen=_KEPT)
        page.title(f"{task.name}, {name}")
        start, end, _, _ = self._solids()
        page.ground(np.minimum(start, end).min(axis=0), np.maximum(start, end).max(axis=0))
        page.post("/post", np.zeros(3), 0.03)
        self._add_controls(page)
        self._add_clouds(page)
        self._wood = self._grow()
        self._draw()

    def _add_controls(self, page: Page) -> None:
        gui = page.server.gui
        page.note(f"{swatch(np.array(picture.ARM))} arm, {swatch(target_of(self.task)[3][0])} target, "
                  f"{swatch(np.array(_FORCE))} contact forces, {100 * _PER_NEWTON:g} cm a newton")  # fmt: skip
        if self._sees:
            page.note("points seen: " + ", ".join(f"{swatch(np.array(c))} {n}" for n, c in _CLOUDS.items()))
        self._moves = gui.add_checkbox("move", True)
        self._speed = gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1 ×")
        self._points = gui.add_checkbox("points", self._sees, visible=self._sees)
        self._said = gui.add_text("now", "", disabled=True)
        axis, names = {"show": True}, CLEARING if self._sees else OTHERS
        series: Any = ({"label": "s"}, *({"label": n, "stroke": css(np.array(c) / 255.0), "width": 2}
                                         for n, c in zip(names, _PLOT, strict=False)))  # fmt: skip
        self._plot = gui.add_uplot(self._data(), series, height=240, title="what is rewarded",
                                   scales={"x": {"time": False}}, axes=(axis, axis))  # fmt: skip

    def _add_clouds(self, page: Page) -> None:
        scene, nothing = page.server.scene, np.zeros((1, 3), np.float32)
        self._clouds = [
            scene.add_point_cloud(f"/clouds/{name}", nothing, color, point_size=0.008, point_shape="circle",
                                  precision="float32") for name, color in _CLOUDS.items()
        ]  # fmt: skip
        self._arrows = scene.add_arrows("/forces", np.zeros((1, 2, 3)), _FORCE, shaft_radius=0.006,
                                        head_radius=0.016, head_length=0.04, visible=False)  # fmt: skip

    def _solids(self) -> tuple[Array, Array, Array, Array]:
        """Return what is there now: starts, ends [S, 3] in m, radii [S, 2] and colours [S, 3]."""
        start, end, radius, color = picture.capsules_of(self.task.simulator, 0)
        used = radius > 0.0
        own = start[used], end[used], np.repeat(radius[used, None], 2, axis=1), color[used]
        parts = zip(own, target_of(self.task), strict=True)
        return tuple(np.concatenate(pair) for pair in parts)  # type: ignore[return-value]

    def _grow(self) -> Wood:
        start, end, radius, color = self._solids()
        return Wood(self.page.server.scene, "/wood", (start, end), radius, color)

    def tick(self, seconds: float) -> None:
        """Act for the policy steps that real time [s] has room for, and draw."""
        if self._moves.value:
            self._due += seconds * SPEEDS[self._speed.value]
        if self._due < self.task.step_seconds:
            return
        self._due = min(self._due - self.task.step_seconds, self.task.step_seconds)
        self._step()
        self._draw()

    def _step(self) -> None:
        self._time += self.task.step_seconds
        self._rows.append((self._time, *terms(self.task)))
        with torch.inference_mode():
            self._observations, _, dones, extras = self.task.step(self.policy(self._observations))
            if hasattr(self.policy, "reset"):  # a trained network forgets the episode that is over
                self.policy.reset(dones)
        if bool(dones[0] > 0):
            self._episodes += 1
            self._cleared += int(extras["log"]["success"][0] > 0)
            self._wood = self._grow()  # the next world has branches of its own

    def _draw(self) -> None:
        start, end, _, _ = self._solids()
        self._wood.move(start, end)
        self._show_clouds()
        self._show_forces()
        self._plot.data = self._data()
        now = terms(self.task)
        self._said.value = f"reward {sum(now[1:]) if self._sees else now[0]:.2f}"
        if self._episodes:
            self._said.value += f", cleared {self._cleared} of {self._episodes}"

    def _show_clouds(self) -> None:
        for handle in self._clouds:
            handle.visible = self._points.value
        if self._points.value and self._sensor is not None:
            points = self._sensor.clouds()[0][0].cpu().numpy()
            for handle, cloud in zip(self._clouds, points, strict=True):
                handle.points = cloud.T.copy()

    def _show_forces(self) -> None:
        at, force = contacts(self.task)
        self._arrows.visible = len(at) > 0
        if len(at):
            self._arrows.points = np.stack([at, at + _PER_NEWTON * force], axis=1).astype(np.float32)

    def _data(self) -> tuple[Any, ...]:
        rows = np.array(self._rows or [(0.0, *terms(self.task))])
        return tuple(np.ascontiguousarray(column) for column in rows.T)


def target_of(task: AssembledTask) -> tuple[Array, Array, Array, Array]:
    """Return the target of the first world: of clearing the axes to be cleared, of reaching a ball; as capsules."""
    scene, places = getattr(task, "scene", None), getattr(task, "places", None)
    if scene is not None:
        start, end = (np.atleast_2d(a.numpy()[0]).astype(np.float64) for a in (scene.target.start, scene.target.end))
        size, color = task.simulator.line.radius, picture.LINE
    else:
        start = places.target[:1].cpu().numpy().astype(np.float64)  # type: ignore[union-attr]
        end, size, color = start + np.array([0.0, 0.0, 1e-4]), 0.4 * float(task.cfg.within), picture.TARGET
    return start, end, np.full((len(start), 2), size), np.tile(color, (len(start), 1))


def terms(task: AssembledTask) -> tuple[float, ...]:
    """Return what is plotted of the first world, as `CLEARING` or `OTHERS` name it.

    Of clearing the occlusion h and the reward's terms 1 / (1 + h^2)^2, effort and margin (eq. 5.9).
    """
    sensor = getattr(task, "sensor", None)
    if sensor is None:
        return float(task.reward[0]), float(task.simulator.arm_force[0].norm(dim=-1).max()) / 80.0
    h, speed = float(sensor.occlusion[0]), task.simulator.qd[0]
    effort = -float((speed * speed).sum()) / 100.0
    return h, 1.0 / (1.0 + h * h) ** 2, effort, 0.4 * (1.0 - float(sensor.breach[0]))


def contacts(task: AssembledTask) -> tuple[Array, Array]:
    """Return middles of the branches that are pushed in the first world, [N, 3] in m, and forces [N, 3] in N."""
    sim = task.simulator
    count, first = len(sim.model.trees[0].shape_link), sim.capsules.num_arm
    start, end = (a.numpy()[0, first : first + count] for a in (sim.capsules.start, sim.capsules.end))
    force = sim.branch_force[0, :count].cpu().numpy()
    felt = np.linalg.norm(force, axis=1) > _LEAST
    return 0.5 * (start + end)[felt], force[felt]
