"""Records of a diagnosis: everything that the verdict file and the report are made of."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from ...sim.base.errors import InputError, check_seed
from ...sim.base.types import Array
from ..cases.case import BranchCase, JointCase
from . import TOLERANCE

if TYPE_CHECKING:
    from ..inference.posterior import Posterior
    from ..replay.recording import Recording
    from ..systems.acting import Acting
    from ..systems.model_file import Model

VerdictName = Literal["none", "effects", "unknown"]
#: End of its box that a parameter is at, None where it is inside.
Bound = Literal["low", "high"] | None


@dataclass(frozen=True)
class Settings:
    """How to diagnose.

    Attributes:
        effects: Names of candidate effects; empty for all that the case can show.
        tolerance: Change of the motion, as a share of its rms, below which a missing effect is of no interest.
        max_effects: Most effects that are named together; one law at many joints of an arm or a branch counts once.
        seed: Seed of all random numbers.
        particles: Particles of the joint posterior of base and effects; 0 uses the curvature at the fit instead.
        fit: Replay or torque for joints measured directly; None chooses, see `learn.replay.choice`.
    """

    effects: tuple[str, ...] = ()
    tolerance: float = TOLERANCE
    max_effects: int = 2
    seed: int = 0
    particles: int = 64
    fit: Literal["replay", "torque"] | None = None

    def check(self) -> None:
        """Raise `InputError` for numbers that cannot be and names that no effect has."""
        if not 0.0 <= self.tolerance < 1.0:
            raise InputError("diagnose", "--tolerance", f"{self.tolerance:g}", "a share of the motion, 0 to 1")
        if not 1 <= self.max_effects <= 4:
            raise InputError("diagnose", "--max-effects", str(self.max_effects), "1 to 4")
        check_seed("diagnose", self.seed)
        from ...sim.effects import effect_of

        for name in self.effects:
            effect_of(name, "--effects")


@dataclass(frozen=True)
class Interval:
    """Median and 95 % interval of a parameter in SI units, and the end of its box that it is at."""

    median: float
    low: float
    high: float
    unit: str
    at_bound: Bound = None


@dataclass(frozen=True)
class Rival:
    """A fitted model in the ranking.

    Attributes:
        effects: Labels of its effects, such as ``dry_friction@1``; empty for the base model.
        reduced_chi2: Reduced chi-squared; one for a perfect model.
        delta: Its information criterion minus the preferred model's.
        explained: Share of the base model's excess chi-squared that it explains.
        cross_validated: Reduced chi-squared in recordings left out of its fit, None where that was not computed.
    """

    effects: tuple[str, ...]
    reduced_chi2: float
    delta: float
    explained: float
    cross_validated: float | None = None


def joints_of(labels: Sequence[str]) -> dict[str, list[str]]:
    """Return the effects that labels such as ``dry_friction@1`` name, each once, with the joints that they have."""
    joints: dict[str, list[str]] = {}
    for label in labels:
        name, at, joint = label.partition("@")
        joints.setdefault(name, []).extend([joint] if at else [])
    return joints


def together(labels: Sequence[str]) -> str:
    """Return the labels of a model's effects in one, such as ``dry_friction@0, 1 + time_delay``; empty for none."""
    return " + ".join(f"{name}@{', '.join(own)}" if own else name for name, own in joints_of(labels).items())


@dataclass(frozen=True)
class Gap:
    """Held-out RMSE of the main channels by base and repaired model, and the noise floor; recordings held out.

    ``in_noise`` is the repaired model's over the base's with every channel in units of its own noise; NaN if unknown.
    """

    base: float
    repaired: float
    noise_floor: float
    unit: str
    test: tuple[int, ...] = ()
    in_noise: float = math.nan


@dataclass(frozen=True)
class Share:
    """Rms normalised residual of one part of the data: kind of part, its name, the rms (one: noise alone), samples."""

    by: str
    part: str
    ratio: float
    samples: int


@dataclass(frozen=True)
class Where:
    """Where the base model is wrong.

    Attributes:
        trajectories: Indices of the worst trajectories.
        windows: Their worst windows, (trajectory, start, end) [s].
        joints: Joints with the largest residual torque, worst first; empty where it was not computed.
        regime: A phrase such as ``while the gripper is open, at large amplitude``.
        heat: Rms normalised residual by trajectory and time window, shape [R, W]; NaN past a recording's end.
        edges: Edges of the windows [s], shape [W + 1].
        shares: Rms normalised residual by phase, direction, amplitude, speed and joint.
        torque: Residual torque at the joints, rms over each recording [N m], shape [R, J].
        of_motion: Rms residual as a share of the motion's rms by trajectory and time window, as ``heat``.
    """

    trajectories: tuple[int, ...]
    windows: tuple[tuple[int, float, float], ...]
    joints: tuple[int, ...]
    regime: str
    heat: Array
    edges: Array
    shares: tuple[Share, ...]
    torque: Array | None = None
    of_motion: Array = field(default_factory=lambda: np.zeros((0, 0)))


@dataclass(frozen=True)
class Geometry:
    """What nuisances of a branch's geometry and mountings have to do with a misfit.

    Beside the named effects they are no further off than `nuisance.FARTHEST`; beside the base model, where nothing is
    named, by any amount.

    Attributes:
        share: What they explain, as a share of the motion's rms.
        furthest: The number that is furthest from what the file says, and by how many deviations, in words.
        chance: Probability that any of so many numbers is so far off if they are as certain as they are taken to be.
        instead: The number that is furthest off where the base model with geometry that is off by any amount leaves
            less than the preferred model; empty where it does not.
    """

    share: float = 0.0
    furthest: str = ""
    chance: float = 1.0
    instead: str = ""


@dataclass
class Diagnosis:
    """Result of a diagnosis.

    Attributes:
        verdict: ``none``, ``effects`` or ``unknown``.
        sentence: The verdict in one sentence for a person, and what is to be known with it.
        effects: Named effects, base joint first.
        parameters: Of each named effect, by parameter name.
        alternatives: For each named effect, the names that these data cannot tell from it.
        nearest: For ``unknown`` the closest name, not claimed; else None.
        ranking: Base and rivals, best first.
        explained: Share of the base model's excess chi-squared that the preferred model explains.
        base_reduced_chi2: Reduced chi-squared of the base model.
        motion: Rms of the motion in units of the noise.
        p_null: Family-wise p-value of the best candidate under the base model.
        base_output, best_output: Channels simulated by base and repaired model, shape [R, T, C].
        base_values, best_values: Parameter values by name, of base and repaired model.
        model: The repaired model as it is written; its values are ``best_values``.
        implausible: Parameters of named effects with a value that nature does not have.
        posterior: Joint posterior of base and effects, None where nothing was named.
        next_experiment: What to probe next.
        seconds: Wall time of each stage.
        tried: Labels of the effects in the repaired model, claimed or not; empty where it is the base model.
        size: Change of the motion that the preferred model makes, as a share of the motion's rms.
        swing: Rms of the held-out main channels about their means, in the gap's unit; of torques that of all
            recordings about the mean of all.
        scatter: Rms by which repeats of one experiment scatter in the main channels, in the gap's unit; None where
            nothing was repeated.
        unusable: Why the data cannot support a verdict, with the missing probe; None where they can.
        not_understood: Which results contradict each other (`consistent`).
        remarks: What the data leave open beside the verdict, a sentence each.
        memoryless: For ``unknown`` the share of what is left of torques that is a function of angle and rate alone, if
            it is a large one, else zero (`models.memoryless`).
        fit: Of joints measured directly: replay or torque, why, and whether the other way can be asked for.
        geometry: What nuisances of a branch's geometry and mountings have to do with the misfit.
        ahead: Whether named effects predict experiments left out better than the base model does, beside nuisances that
            explain more than the tolerance; the gap is without these.
        unstable: What changes the verdict, such as ``a filter of 25 Hz names backlash``; empty if nothing does. For
            ``none`` what half of the rate or a part of the recordings names, and all of them make small.
        may_be_off: For ``unknown`` the labels of tried effects whose interval reaches where they do nothing.
        stretched: For ``unknown`` the labels of those that go as far as their boxes allow, see `decide.at_an_end`.
        nested: Whether no model that was fitted leaves more than one that it contains, see `models.nested`.
    """

    case: BranchCase | JointCase
    settings: Settings
    recordings: list[Recording]
    sigma: Array
    verdict: VerdictName
    sentence: str
    effects: tuple[Acting, ...]
    parameters: dict[str, dict[str, Interval]]
    alternatives: dict[str, tuple[str, ...]]
    nearest: str | None
    where: Where
    gap: Gap
    ranking: tuple[Rival, ...]
    explained: float
    base_reduced_chi2: float
    motion: float
    p_null: float
    base_output: Array
    best_output: Array
    base_values: dict[str, float]
    best_values: dict[str, float]
    next_experiment: str
    model: Model | None = None
    implausible: tuple[str, ...] = ()
    posterior: Posterior | None = None
    world_steps: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    tried: tuple[str, ...] = ()
    size: float = 0.0
    swing: float = 1.0
    scatter: float | None = None
    unusable: str | None = None
    not_understood: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    memoryless: float = 0.0
    fit: dict[str, str] = field(default_factory=dict)
    unstable: tuple[str, ...] = ()
    may_be_off: tuple[str, ...] = ()
    stretched: tuple[str, ...] = ()
    geometry: Geometry = field(default_factory=Geometry)
    ahead: bool = False
    nested: bool = True

    @property
    def held_out(self) -> bool:
        """Whether the gap is that of recordings which the fit has not seen; a single recording has been."""
        return len(self.case.trajectories) > 1

    def verdict_file(self) -> dict[str, Any]:
        """Return what ``verdict.json`` holds, as CASE_FORMAT states it."""
        named = [
            {"name": a.name, "joint": a.joint,
             "parameters": {n: {"median": i.median, "low": i.low, "high": i.high, "unit": i.unit,
                                "at_bound": i.at_bound}
                            for n, i in self.parameters.get(a.label, {}).items()}}
            for a in self.effects
        ]  # fmt: skip
        return {
            "case": self.case.name, "verdict": self.verdict, "effects": named,
            "alternatives": {k: list(v) for k, v in self.alternatives.items()}, "nearest": self.nearest,
            "where": {
                "trajectories": [t + 1 for t in self.where.trajectories],
                "windows_s": [[round(a, 4), round(b, 4)] for _, a, b in self.where.windows],
                "joints": list(self.where.joints), "regime": self.where.regime,
            },
            "gap": {"base": finite(self.gap.base), "repaired": finite(self.gap.repaired),
                    "noise_floor": finite(self.gap.noise_floor), "unit": self.gap.unit, "held_out": self.held_out,
                    "motion": self.swing, "replicate_scatter": self.scatter},
            "p_null": finite(self.p_null), "next_experiment": self.next_experiment, "sentence": self.sentence,
            "explained": finite(self.explained), "not_understood": list(self.not_understood),
            "remarks": list(self.remarks), "implausible": list(self.implausible), "fit": self.fit,
            "unstable": list(self.unstable), "may_be_off": list(self.may_be_off),
            "stretched": list(self.stretched), "nested": self.nested,
        }  # fmt: skip


def finite(x: float) -> float | None:
    """Return a number as JSON can hold it: None where a simulation diverged."""
    return x if math.isfinite(x) else None
