"""What a clearing task is made of: names, observation groups and settings."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any

from ...perception.sensor import SensorSettings
from ...sim.arms.servo import Servo
from ...sim.base.errors import InputError
from ...sim.scenes.scene import Range, SceneSettings, Target
from ...sim.wood.effects import WoodEffects
from ...sim.wood.posterior import Wood
from .parts import first_columns

TARGETS = {
    "powerline": Target(),
    "exposure": Target(length=(0.0, 0.0), clearance=0.06, rounded=True, radius=0.03),
    "inspection": Target(length=(0.25, 0.35), clearance=0.02, strips=4, width=0.2, radius=0.01),
}
"""Targets of the tasks: a power line's slice, a fruit, a panel seen as four strips around a rail."""

GROUPS = ("proprioceptive", "kme", "touch", "local", "occlusion")
"""Groups of observations, in the order of table 5.1; each can be left out."""

FEATURES = {
    "proprioceptive": ("q", "qd", "hand"),
    "kme": ("wbr", "zbr", "clr", "rob"),
    "touch": ("touch",),
    "local": ("distances", "breach"),
    "occlusion": ("occlusion",),
}
"""Features of each group, in the order of their columns."""

LATER = {"later": True}
"""Metadata of settings that an older run may lack; their default is what it had."""

STEP_RATE = 240.0
"""Physics steps a second [Hz]."""


class Rates:
    """How often a task acts [Hz], for settings that have these numbers."""

    policy_rate: float
    control_rate: float

    @property
    def control_periods(self) -> int:
        """Control periods of a policy step."""
        return round(self.control_rate / self.policy_rate)

    @property
    def period_steps(self) -> int:
        """Physics steps of a control period."""
        return round(STEP_RATE / self.control_rate)


@dataclass(frozen=True)
class TaskSettings(Rates):
    """Settings of a task; the defaults are the ``cpu`` preset (`PRESETS`).

    Attributes:
        groups: Names of the observation groups left in (`GROUPS`).
        scene: Ranges of trees, places and dynamics. Target, ``near`` and ``points`` are set by the task.
        sensor: Clouds and scores. Shape and clearance are set by the task.
        policy_rate: Actions a second [Hz] (thesis: 10 in chapter 4, 60 in chapter 5).
        control_rate: Speed commands that the arm is given a second [Hz] (thesis 4: 60): control_rate / policy_rate of
            them lead in equal slices from one action to the next, the last one being the action.
        episode_steps: Policy steps of an episode (thesis 5.5: 1000 at 60 Hz).
        success_steps: Steps without occlusion in a row that count as success (thesis 5.5: 10).
        touch_force: Net force on a link that counts as touch [N] (thesis 4: 40).
        touch_noise: Standard deviation of the noise on that force [N] (thesis 4: 1).
        max_noise: Range of d_max, three standard deviations of the noise on points [m], drawn every episode (thesis
            5.5.1: 0.005 to 0.04).
        action_delay: Greatest latency of actions [policy steps], drawn every episode.
        observation_delay: Greatest latency of observations [policy steps], drawn every episode.
        arm: Name of the arm (`sim.arms.registry.ARMS`).
        servo: Its servos, where they are not its own (`sim.arms.servo`); ``bough train --arm-model`` sets them.
    """

    groups: tuple[str, ...] = GROUPS
    scene: SceneSettings = field(default_factory=SceneSettings)
    sensor: SensorSettings = field(default_factory=SensorSettings)
    policy_rate: float = 10.0
    control_rate: float = 60.0
    episode_steps: int = 120
    success_steps: int = 10
    touch_force: float = 40.0
    touch_noise: float = 1.0
    max_noise: Range = (0.005, 0.005)
    action_delay: int = 0
    observation_delay: int = 0
    arm: str = field(default="jaco2", metadata=LATER)
    servo: Servo = field(default=(), metadata=LATER)

    def check(self) -> TaskSettings:
        """Return self if a task can be made of it.

        Raises:
            InputError: An unknown or missing group, rates that do not divide each other, a number out of range.
        """
        for name in self.groups:
            need(name in GROUPS, "groups", name, ", ".join(GROUPS))
        need(len(self.groups) > 0, "groups", "none", "at least one of " + ", ".join(GROUPS))
        check_rates(self.policy_rate, self.control_rate)
        for name in ("episode_steps", "success_steps"):
            need(getattr(self, name) >= 1, name, str(getattr(self, name)), "1 or more steps")
        for name in ("action_delay", "observation_delay"):
            need(getattr(self, name) >= 0, name, str(getattr(self, name)), "0 or more steps")
        low, high = self.max_noise
        need(0.0 <= low <= high, "max_noise", f"{low:g} to {high:g} m", "a range from 0 or more")
        return self

    @property
    def physics_steps(self) -> int:
        """Physics steps of a policy step."""
        return self.control_periods * self.period_steps

    def of(self, name: str) -> TaskSettings:
        """Return the settings with a task's target, and with scene and sensor agreeing on the clouds."""
        target = TARGETS[name]
        sensor = replace(self.sensor, clearance=target.clearance, rounded=target.rounded)
        scene = replace(self.scene, target=target, near=sensor.threshold, points=sensor.points)
        return replace(self, scene=scene, sensor=sensor)


def sizes_of(settings: TaskSettings, dofs: int) -> dict[str, int]:
    """Return the number of columns of every feature."""
    sizes = {"q": dofs, "qd": dofs, "hand": 4, "touch": 1, "distances": 5, "breach": 1, "occlusion": 1}
    return sizes | dict.fromkeys(FEATURES["kme"], 2 * settings.sensor.features)


def columns_of(settings: TaskSettings, dofs: int) -> tuple[dict[str, int], int]:
    """Return the first column of every feature left in, and the number of columns: 88 with all groups and 6 joints."""
    size = sizes_of(settings, dofs)
    return first_columns((name, size[name]) for g in GROUPS if g in settings.groups for name in FEATURES[g])


def of_wood(settings: Any, wood: Wood, effects: WoodEffects) -> Any:
    """Return a task's settings with trees of the wood of a measured branch, and the effects found in it."""
    return replace(settings, scene=replace(settings.scene, wood=wood, effects=effects))


def all_scenes(settings: TaskSettings) -> TaskSettings:
    """Return the settings without the rules that leave out what one arm can hardly clear."""
    return replace(settings, scene=replace(settings.scene, feasible=False, branches=1))


def check_name(name: str) -> None:
    """Raise `InputError` for a task that does not exist."""
    need(name in TARGETS, "", name, ", ".join(TARGETS))


def check_rates(policy_rate: float, control_rate: float) -> None:
    """Raise `InputError` for rates that do not divide each other [Hz]."""
    for name, fast, slow in (
        ("policy_rate", control_rate, policy_rate), ("control_rate", STEP_RATE, control_rate),
    ):  # fmt: skip
        whole = slow > 0 and abs(fast / slow - round(fast / slow)) < 1e-9
        need(whole, name, f"{slow:g} Hz", f"a whole part of {fast:g} Hz")


def need(ok: bool, place: str, found: str, allowed: str) -> None:
    """Raise `InputError` for a setting of a task that cannot be."""
    if not ok:
        raise InputError("task", place, found, allowed)


PRESETS = {
    "cpu": TaskSettings(),
    "gpu": TaskSettings(
        scene=SceneSettings(order=3, distance=(0.45, 0.75), bearing=20.0, pairs=(150.0, 1500.0)),
        policy_rate=60.0, episode_steps=1000, max_noise=(0.005, 0.02), action_delay=2, observation_delay=2,
    ),
}  # fmt: skip
"""Settings by size of the machine: trees of 17 links at 10 Hz for 12 s, or of 40 links at 60 Hz for 17 s."""
