"""What ``reach`` is made of: policies, observation groups, settings; torch is not needed here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ...sim.arms.servo import Servo
from ...sim.scenes.reach_scene import ReachScene
from .parts import first_columns
from .ppo_settings import PPOSettings, Preset
from .settings import LATER, Rates, check_rates, need

GROUPS = ("proprioceptive", "offset", "touch", "torque", "skin")
"""Groups of observations, those of table B.1 in its order; each can be left out."""

POLICIES = ("pcap", "ppo", "cpo", "ppo+", "cpo+", "ppo-lagrangian", "skin", "pcap-rnn")
"""Policies by what they see and are rewarded for (table B.1): the contact flag, contact, joint torques. The last ones
are not the thesis's: ``ppo-lagrangian`` sees as PCAP does and is rewarded as PPO, under a budget of force; ``skin``
is rewarded as PCAP and feels the net force on every link, as a whole-arm skin would (thesis 6.2.2); ``pcap-rnn`` is
PCAP with a memory (thesis B.6)."""

SEES = {
    "ppo": ("proprioceptive", "offset"), "cpo": ("proprioceptive", "offset"),
    "pcap": ("proprioceptive", "offset", "touch"), "ppo+": ("proprioceptive", "offset", "torque"),
    "cpo+": ("proprioceptive", "offset", "torque"), "ppo-lagrangian": ("proprioceptive", "offset", "touch"),
    "skin": ("proprioceptive", "offset", "skin"), "pcap-rnn": ("proprioceptive", "offset", "touch"),
}  # fmt: skip
"""Groups that each policy sees."""

REWARDED_FOR_CONTACT = ("pcap", "cpo", "cpo+", "skin", "pcap-rnn")
"""Policies whose reward reads contact forces."""

RECURRENT = ("pcap-rnn",)
"""Policies whose networks have a memory."""

UNDER_BUDGET = ("ppo-lagrangian",)
"""Policies that a Lagrange multiplier holds at `ReachSettings.force_budget`."""

CONTROLS = ("nominal", "plai", "s3ec")
"""Laws of control; all take an action as a change of joint speeds."""

RUPTURE_FORCE = 80.0
"""Force above which a control period counts as a rupture in tests [N], whatever a policy is rewarded for: thesis 4.5,
twice its f_u."""

TEST_WORLDS = 300
"""Worlds of a test set: 60 targets in five occlusion patterns."""


@dataclass(frozen=True)
class ReachSettings(Rates):
    """Settings of ``reach``; the defaults are the ``cpu`` preset (`PRESETS`).

    Attributes:
        policy: One of `POLICIES`.
        groups: Names of the observation groups left in, of those that the policy sees.
        scene: Trees, places, targets.
        control: Law of control (`CONTROLS`).
        flag: Source of the flag of touch (`kernels.tasks.reach.FLAGS`): ``threshold`` of the force, or ``classifier``
            of joint torques.
        classifier: File that ``bough touch train`` wrote, for ``flag=classifier``.
        sensor: File that ``bough touch fit`` wrote, which says how torques are told to it; the Jaco 2's if empty.
        policy_rate: Actions a second [Hz]: 10 as on the real arm, or 60.
        control_rate: Speed commands that the arm is given a second [Hz].
        episode_seconds: Step limit, as time [s]: 800 steps of 1/60 s.
        speed_step: Change of a joint's speed that a whole action asks for [rad/s]. The servo's gain times it is the
            torque that an arm at rest pushes with: 32 N m; 10/60 in the author's runs at 60 Hz.
        within: Distance of the hand from the target that is success [m].
        touch_force: Norm of the net contact forces of all links above which the flag is set, f_u [N].
        touch_noise: Standard deviation of the noise on what the flag is set by [N].
        distance_gain, smooth_gain: g_d and g_s of equation 4.3.
        contact_gain: What rewards are times without contact, and what a rupture costs.
        force_budget: What the mean of F may be for policies of `UNDER_BUDGET` [N].
        reward_scale: What the trainer's rewards are times.
        action_delay, observation_delay: Greatest latencies [policy steps], drawn every episode.
        arm: Name of the arm (`sim.arms.registry.ARMS`).
        servo: Its servos, where they are not its own (`sim.arms.servo`); ``bough train --arm-model`` sets them.
    """

    policy: str = "pcap"
    groups: tuple[str, ...] = GROUPS
    scene: ReachScene = field(default_factory=ReachScene)
    control: str = "s3ec"
    flag: str = "threshold"
    classifier: str = ""
    sensor: str = ""
    policy_rate: float = 10.0
    control_rate: float = 60.0
    episode_seconds: float = 800.0 / 60.0
    speed_step: float = 0.4
    within: float = 0.05
    touch_force: float = 40.0
    touch_noise: float = 1.0
    distance_gain: float = 2.0
    smooth_gain: float = 0.01
    contact_gain: float = 1.2
    force_budget: float = field(default=8.0, metadata=LATER)
    reward_scale: float = 0.01
    action_delay: int = 0
    observation_delay: int = 0
    arm: str = field(default="jaco2", metadata=LATER)
    servo: Servo = field(default=(), metadata=LATER)

    def check(self) -> ReachSettings:
        """Return self if a task can be made of it.

        Raises:
            InputError: An unknown policy, law, flag or group, nothing to see, rates that do not divide each other, a
                classifier that the flag does not take, or none where it takes one.
        """
        from ...kernels.tasks.reach import FLAGS

        for name, allowed in (("policy", POLICIES), ("control", CONTROLS), ("flag", tuple(FLAGS))):
            need(getattr(self, name) in allowed, name, str(getattr(self, name)), ", ".join(allowed))
        for name in self.groups:
            need(name in GROUPS, "groups", name, ", ".join(GROUPS))
        need(len(self.seen) > 0, "groups", "none", "at least one of " + ", ".join(SEES[self.policy]))
        check_rates(self.policy_rate, self.control_rate)
        told = self.flag == "classifier"
        need(told == bool(self.classifier), "classifier", self.classifier or "none",
             "a model that bough touch train wrote" if told else "none, or --set flag=classifier as well")  # fmt: skip
        need(told or not self.sensor, "sensor", self.sensor, "none, or --set flag=classifier as well")
        for name in ("episode_seconds", "speed_step", "within", "reward_scale", "touch_force", "force_budget"):
            need(getattr(self, name) > 0.0, name, f"{getattr(self, name):g}", "above zero")
        for name in ("action_delay", "observation_delay"):
            need(getattr(self, name) >= 0, name, str(getattr(self, name)), "0 or more steps")
        return self

    @property
    def seen(self) -> tuple[str, ...]:
        """Observation groups of the policy that are left in."""
        return tuple(name for name in SEES[self.policy] if name in self.groups)

    @property
    def episode_steps(self) -> int:
        """Policy steps of an episode."""
        return max(1, round(self.episode_seconds * self.policy_rate))


def sizes_of(dofs: int) -> Mapping[str, tuple[tuple[str, int], ...]]:
    """Return the features of each group and their columns."""
    return {
        "proprioceptive": (("q", dofs), ("qd", dofs), ("hand", 4)), "offset": (("offset", 3),),
        "touch": (("touch", 1),), "torque": (("torque", dofs),),
        "skin": (("skin", 3 * dofs),),
    }  # fmt: skip


def columns_of(settings: ReachSettings, dofs: int) -> tuple[dict[str, int], int]:
    """Return the first column of every feature left in, and the number of columns: 20 for PCAP, 19 for PPO."""
    return first_columns(feature for group in settings.seen for feature in sizes_of(dofs)[group])


PRESETS = {"cpu": ReachSettings(), "gpu": ReachSettings(policy_rate=60.0, speed_step=10.0 / 60.0)}
"""Settings by size of the machine: 10 Hz with slices of 60 Hz, or 60 Hz; an episode lasts 13.3 s."""

PPO: Mapping[Preset, PPOSettings] = {
    "cpu": PPOSettings(num_envs=512, iterations=300, horizon=24, entropy=0.0, checkpoint_every=10),
    "gpu": PPOSettings(
        num_envs=8192, iterations=1500, horizon=16, epochs=8, mini_batches=16, learning_rate=5e-4, desired_kl=0.008,
        entropy=0.0, value=4.0,
    ),
}  # fmt: skip
"""Numbers of PPO: ``gpu`` are those of the author's runs."""
