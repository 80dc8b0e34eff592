"""What a diagnosis holds: everything that the verdict file and the report are made of."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ..cases.case import BranchCase, JointCase
from . import TOLERANCE

if TYPE_CHECKING:
    from ..inference.posterior import Posterior
    from ..replay.recording import Recording
    from ..systems.acting import Acting

VerdictName = Literal["none", "effects", "unknown"]


@dataclass(frozen=True)
class Settings:
    """How to diagnose.

    Attributes:
        effects: Names that may be tried; empty for all that the case can show.
        tolerance: Change of the motion, as a share of its rms, below which a missing effect is of no interest.
        max_effects: Most effects that are named together.
        seed: Of every random number used.
        particles: Of the posterior of base and effects; 0 takes intervals from the curvature at the fit.
    """

    effects: tuple[str, ...] = ()
    tolerance: float = TOLERANCE
    max_effects: int = 2
    seed: int = 0
    particles: int = 64

    def check(self) -> None:
        """Raise `InputError` for numbers that cannot be and names that no effect has."""
        if not 0.0 <= self.tolerance < 1.0:
            raise InputError("diagnose", "--tolerance", f"{self.tolerance:g}", "a share of the motion, 0 to 1")
        if not 1 <= self.max_effects <= 4:
            raise InputError("diagnose", "--max-effects", str(self.max_effects), "1 to 4")
        if self.seed < 0:
            raise InputError("diagnose", "--seed", str(self.seed), "0 or more")
        from ...sim.effects import effect_of

        for name in self.effects:
            effect_of(name, "--effects")


@dataclass(frozen=True)
class Interval:
    """Median and 95 % interval of a parameter in SI units."""

    median: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Rival:
    """A model that was fitted, for the ranking.

    Attributes:
        effects: Labels of its effects, such as ``dry_friction@1``; empty for the base.
        misfit: Squares left per measured number; one for a perfect model.
        behind: By how much its information criterion is behind the best model's.
        explained: Share of the base model's excess over the noise that it explains.
        left_out: Squares left per number in trajectories that it was not fitted to, None where that was not tried.
    """

    effects: tuple[str, ...]
    misfit: float
    behind: float
    explained: float
    left_out: float | None = None


@dataclass(frozen=True)
class Gap:
    """Held-out rms misfit of the main channels before and after repair, and what a perfect model would leave."""

    base: float
    repaired: float
    noise_floor: float
    unit: str
    test: tuple[int, ...] = ()


@dataclass(frozen=True)
class Share:
    """One part of the misfit: what it is a part by, which part, its rms over the noise (one: noise alone)."""

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
        heat: Misfit over noise by trajectory and time window, shape [R, W]; NaN past a recording's end.
        edges: Edges of the windows [s], shape [W + 1].
        shares: The misfit by phase, direction, amplitude, speed and joint.
        torque: Residual torque at the joints that would close the gap, rms over each recording [N m], shape [R, J].
    """

    trajectories: tuple[int, ...]
    windows: tuple[tuple[int, float, float], ...]
    joints: tuple[int, ...]
    regime: str
    heat: Array
    edges: Array
    shares: tuple[Share, ...]
    torque: Array | None = None


@dataclass
class Diagnosis:
    """What was found.

    Attributes:
        verdict: ``none``, ``effects`` or ``unknown``.
        sentence: The verdict in one sentence for a person.
        effects: Effects named, base joint first.
        parameters: Of each named effect, by parameter name.
        alternatives: For each named effect, the names that this data cannot tell from it.
        nearest: For ``unknown`` the closest name, not claimed; else None.
        ranking: Base and rivals, best first.
        explained: Share of the base's excess that the best model explains.
        base_misfit: Squares left per measured number by the base model.
        motion: Rms of the motion in units of the noise.
        p_null: Family-wise p-value of the best candidate under the base model.
        base_output, best_output: Simulated channels of all recordings, shape [R, T, C].
        base_values, best_values: Parameter values by name, of base and best model.
        posterior: Of base and effects together, None where nothing was named.
        next_experiment: What to probe next.
        seconds: Wall time of each stage.
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
    base_misfit: float
    motion: float
    p_null: float
    base_output: Array
    best_output: Array
    base_values: dict[str, float]
    best_values: dict[str, float]
    next_experiment: str
    posterior: Posterior | None = None
    world_steps: int = 0
    seconds: dict[str, float] = field(default_factory=dict)

    def verdict_file(self) -> dict[str, Any]:
        """Return what ``verdict.json`` holds, as CASE_FORMAT states it."""
        named = [
            {"name": a.name, "joint": a.joint,
             "parameters": {n: {"median": i.median, "low": i.low, "high": i.high, "unit": i.unit}
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
            "gap": {"base": self.gap.base, "repaired": self.gap.repaired, "noise_floor": self.gap.noise_floor,
                    "unit": self.gap.unit},
            "p_null": self.p_null, "next_experiment": self.next_experiment, "sentence": self.sentence,
            "explained": self.explained,
        }  # fmt: skip
