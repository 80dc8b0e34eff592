"""Effects that act in a case: which, where, and which of their parameters are known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np
import torch

from ...kernels.effects.structs import PARAMETERS
from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ...sim.effects import Effect, EffectParameter, Law, Setting, effect_of, effects, in_setting
from ...sim.effects.registry import Form
from ...sim.engine.model import Model
from ..cases.case import BranchCase, JointCase
from ..cases.joints import JointAxis, JointSpec
from .system import Parameter, Write

#: Name under which `Write` knows the kernels' array of effect parameters.
FIELD = "effect"

#: The law by which a trunk that gives way is stiffer in one plane: that of a joint of a branch.
TRUNK_BENDS = "anisotropic_stiffness"


@dataclass(frozen=True)
class Acting:
    """One effect at one place; parameters without a known value are unknown.

    Attributes:
        name: Of the effect.
        joint: Joint that it acts at, 0 nearest the base; None for effects that are not at a joint.
        known: Values of parameters in SI units, by name.
    """

    name: str
    joint: int | None = None
    known: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    @property
    def label(self) -> str:
        """Name and joint, such as ``dry_friction@1``."""
        return self.name if self.joint is None else f"{self.name}@{self.joint}"


@dataclass(frozen=True)
class Entry:
    """One parameter of one acting effect: where it stands in the array, and its value or its column.

    Attributes:
        place: First entry of the parameter's row of joints, in units of the array's stride.
        joint: Joint, or None for place 0.
        spec: What it is.
        known: Value, None where it is inferred.
    """

    place: int
    joint: int | None
    spec: EffectParameter
    known: float | None


class ActingSet:
    """The effects that act in a system.

    Attributes:
        acting: The effects and where they act.
        settings: What is known of every joint.
        laws: Of the effects that act, by name.
        names: Of all effects that can act in such a system: what kernels are built with, so that one kernel serves any
            choice. Empty where none acts.
        form: ``branch`` or ``joint``.
        parameters: Unknowns, in the order of the columns that `write` takes.
        entries: All parameters, in the order of the acting effects.
    """

    def __init__(self, acting: Sequence[Acting], form: Form, settings: Sequence[Setting], source: str = "effects"):
        self.form, self.acting, self.settings = form, tuple(acting), tuple(settings)
        chosen = _ordered(self.acting, source)
        self.laws: dict[str, Law] = {e.name: e.law(form) for e in chosen}
        self.names = tuple(e.name for e in effects() if getattr(e, form) is not None) if chosen else ()
        labels = [a.label for a in self.acting]
        if len(set(labels)) < len(labels):
            twice = next(x for x in labels if labels.count(x) > 1)
            raise InputError(source, "effects", f"'{twice}' a second time", "each effect once at a joint")
        self.entries: list[Entry] = []
        found: list[Parameter] = []
        for a in self.acting:
            self._check(a, len(settings), source)
            setting = settings[a.joint or 0]
            for n, spec in enumerate(self.laws[a.name].parameters):
                known = a.known.get(spec.name)
                self.entries.append(Entry(PARAMETERS * self.names.index(a.name) + n, a.joint, spec, known))
                if known is None:
                    found.append(parameter_of(a, spec, setting))
        self.parameters = tuple(found)
        self._note_entries()

    def _note_entries(self) -> None:
        """Note what calls of every step of a fit ask of the entries, one number each."""
        self._unknown = [n for n, e in enumerate(self.entries) if e.known is None]
        self._known = [0.0 if e.known is None else e.known for e in self.entries]
        self._neutral = [e.spec.neutral for e in self.entries]
        self._rests = [self._rest_of(e) for e in self.entries]
        self._switches = [self._switch_of(e) for e in self.entries]
        self._joints = [len(self.settings) if e.joint is None else e.joint for e in self.entries]

    def _check(self, a: Acting, joints: int, source: str) -> None:
        law = self.laws[a.name]
        place = f"effect {a.label}"
        if law.per_joint and not (a.joint is not None and 0 <= a.joint < joints):
            raise InputError(source, place, f"joint {a.joint}", f"a joint, 0 to {joints - 1}")
        if not law.per_joint and a.joint is not None:
            raise InputError(source, place, f"joint {a.joint}", "no joint: it acts on the whole branch")
        names = [p.name for p in law.parameters]
        for name, value in a.known.items():
            if name not in names:
                raise InputError(source, place, f"parameter '{name}'", f"one of {', '.join(names)}")
            if not np.isfinite(value):
                raise InputError(source, place, f"{name} {value}", "a finite number")

    def has(self, kind: str) -> bool:
        """Return whether an effect of a kind acts."""
        return any(law.kind == kind for law in self.laws.values())

    @property
    def persists(self) -> bool:
        """Whether what one recording leaves behind is there in the next."""
        return any(law.persistent for law in self.laws.values())

    @property
    def settles(self) -> bool:
        """Whether the rest pose differs from the given pose."""
        return any(law.settles for law in self.laws.values())

    def neutral(self) -> list[float]:
        """Return the neutral value of each of the array's rows; rows that no parameter uses are zero."""
        out = [0.0] * (PARAMETERS * len(self.names))
        for n, name in enumerate(self.names):
            for k, spec in enumerate(effect_of(name).law(self.form).parameters):
                out[PARAMETERS * n + k] = spec.neutral
        return out

    def values(self, columns: torch.Tensor) -> torch.Tensor:
        """Return the values of all entries [sets, entries] from the unknowns' columns [sets, n]; not to be written."""
        if len(self._unknown) == len(self.entries):  # in a search nothing is known
            return columns
        out = columns.new_tensor(self._known).repeat(len(columns), 1)
        out[:, self._unknown] = columns
        return out

    def write(self, columns: torch.Tensor, model: Model, write: Write, links: Sequence[int]) -> None:
        """Write the unknowns [sets, n] and what is known; ``links`` holds the link that each joint moves."""
        stride, place = model.places + 1, [int(model.link_place[n]) for n in links]
        at = [stride * e.place + (0 if e.joint is None else place[e.joint]) for e in self.entries]
        if at:
            write(FIELD, at, 0, self.values(columns))

    def marks(self, columns: torch.Tensor) -> torch.Tensor:
        """Return 2 for every set that rests under a load, 1 for one that rests where a memory left it, else 0, [sets].

        The others rest in the given pose.
        """
        return (self._changed(columns) * columns.new_tensor(self._rests)).amax(1)

    def _rest_of(self, entry: Entry) -> int:
        """Return how a branch rests elsewhere where an entry is not neutral: a load, or the share of what remembers."""
        law = self.laws[self.names[entry.place // PARAMETERS]]
        return 2 if entry.spec.name in law.settles else int(law.lasting and entry.place % PARAMETERS == 0)

    def switched_on(self, columns: torch.Tensor) -> torch.Tensor:
        """Return whether some parameter of each effect is not neutral, [sets, names]; a trunk's plane is a law."""
        return self._some(columns, self._switches, len(self.names))

    def bent(self, columns: torch.Tensor) -> torch.Tensor:
        """Return whether an effect of one joint has a parameter that is not neutral there, [sets, joints]."""
        count = len(self.settings)
        return self._some(columns, self._joints, count + 1)[:, :count]

    def _some(self, columns: torch.Tensor, of: Sequence[int], count: int) -> torch.Tensor:
        """Return whether some entry of each of ``count`` kinds is not neutral, [sets, count]; ``of``: every entry's."""
        kinds = torch.tensor(of, dtype=torch.long, device=columns.device)
        counts = columns.new_zeros(len(columns), count, dtype=torch.long)
        return counts.index_add_(1, kinds, self._changed(columns).long()) > 0

    def changes(self, parameter: str, columns: torch.Tensor) -> torch.Tensor:
        """Return whether some effect's parameter of a name is not neutral, [sets]."""
        own = [n for n, entry in enumerate(self.entries) if entry.spec.name == parameter]
        return self._changed(columns)[:, own].any(1)

    def _switch_of(self, entry: Entry) -> int:
        """Return the place among the names of the law that an entry switches on."""
        own = self.names[entry.place // PARAMETERS]
        return self.names.index(TRUNK_BENDS if (own, entry.spec.name) == ("base_compliance", "relative") else own)

    def _changed(self, columns: torch.Tensor) -> torch.Tensor:
        """Return which entries are not neutral, [sets, entries]."""
        return self.values(columns) != columns.new_tensor(self._neutral)

    def place(self, name: str, parameter: str) -> int:
        """Return where a parameter's row of joints begins in the array, in units of its stride."""
        own = [p.name for p in effect_of(name).law(self.form).parameters]
        return PARAMETERS * self.names.index(name) + own.index(parameter)

    def value(self, name: str, parameter: str, columns: torch.Tensor) -> torch.Tensor:
        """Return a parameter of an effect that acts once, [sets]."""
        row = self.place(name, parameter)
        own = next(n for n, e in enumerate(self.entries) if e.place == row)
        return self.values(columns)[:, own]


def _ordered(acting: Sequence[Acting], source: str) -> list[Effect]:
    wanted = {effect_of(a.name, source).name for a in acting}
    return [e for e in effects() if e.name in wanted]


def parameter_of(a: Acting, spec: EffectParameter, setting: Setting) -> Parameter:
    """Return the unknown of an effect's parameter, its box relative to the setting."""
    low, high = in_setting(spec.low, setting), in_setting(spec.high, setting)
    typical = None if spec.typical is None else min(max(in_setting(spec.typical, setting), low), high)
    return Parameter(f"{a.label} {spec.name}", unit_at(spec.unit, setting.slides), low, high, typical, spec.scale)


def unit_at(unit: str, slides: bool) -> str:
    """Return a registry's unit as it is at a joint: along a slide metres stand for radians and N for N m."""
    if " or " in unit:
        return unit.split(" or ")[slides]
    return unit.replace("N m", "N").replace("rad", "m") if slides else unit


def branch_settings(case: BranchCase) -> list[Setting]:
    """Return what is known of every joint of a measured branch, base first."""
    force = max(float(np.linalg.norm(t.force, axis=1).max()) for t in case.trajectories)
    moved = max(float(np.linalg.norm(t.displacement, axis=1).max()) for t in case.trajectories)
    speed = max(float(np.linalg.norm(t.velocity, axis=1).max()) for t in case.trajectories)
    reach = case.length[: case.grasp_segment].sum() + case.grasp_distance
    below = np.cumsum(case.length) - case.length
    last = case.trajectories[-1]
    out = []
    for i in range(case.num_segments):
        lever = max(reach - below[i], 0.5 * float(case.length[i]))
        out.append(
            Setting(
                torque=max(force, 1e-9) * float(lever), angle=max(moved, 1e-6) / float(reach),
                rate=max(speed, 1e-6) / float(reach), force=max(force, 1e-9), speed=max(speed, 1e-6),
                area=float((case.length * case.radius.sum(axis=1)).sum()), mass=float(case.mass.sum()),
                length=float(case.length[case.grasp_segment]), gravity=case.gravity or 9.81, dt=case.dt,
                start=case.trajectories[0].t_start, end=last.t_start + float(last.t[-1]), duration=float(last.t[-1]),
                moments=_moments(case),
            )
        )  # fmt: skip
    return out


def _moments(case: BranchCase) -> tuple[float, ...]:
    """Candidate times of permanent changes of a branch: denser in the first recording."""
    first = (0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.6, 0.8)
    shares = [first] + [(0.05, 0.12, 0.25, 0.4, 0.65)] * (len(case.trajectories) - 1)
    return tuple(t.t_start + s * float(t.t[-1]) for t, own in zip(case.trajectories, shares, strict=True) for s in own)


def joint_settings(case: JointCase, carried: Sequence[float]) -> list[Setting]:
    """Return what is known of every joint; ``carried`` holds the inertia at each, nominal.

    Where nothing drives a joint its torque is what its inertia needs at the accelerations seen.
    """
    duration = max(float(t.t[-1]) for t in case.trajectories)
    start = min(t.t_start for t in case.trajectories)
    out = []
    for joint, inertia in zip(case.joints, carried, strict=True):
        angle, rate, acceleration = _motion(case, joint)
        torque = inertia * acceleration
        for c, item in enumerate(case.inputs):
            if item.joint == joint.name:
                torque = max(float(np.abs(t.effort[:, c]).max()) for t in case.trajectories)
        out.append(Setting(torque=torque, angle=angle, rate=rate, force=torque, dt=case.dt, start=start,
                           end=start + duration, duration=duration, slides=joint.type == "prismatic"))  # fmt: skip
    return out


def _motion(case: JointCase, joint: JointAxis) -> tuple[float, float, float]:
    """Largest angle, rate and acceleration of a joint; unmeasured ones are derived from measured ones."""
    series: dict[str, list[Array]] = {
        o.quantity: [t.output[:, c] for t in case.trajectories]
        for c, o in enumerate(case.outputs)
        if o.joint == joint.name
    }
    if "position" in series:
        series["position"] = [x - _rest(joint, series["position"]) for x in series["position"]]
    share: dict[str, float] = dict.fromkeys(series, 1.0)
    if "position" in series and "velocity" not in series:
        series["velocity"], share["velocity"] = [np.diff(x) / case.dt for x in series["position"]], 0.99  # of noise
    for quantity, derivative in (("velocity", "acceleration"), ("position", "velocity")):
        if quantity not in series and derivative in series:
            series[quantity], share[quantity] = [integral(x, case.dt) for x in series[derivative]], 1.0
    found = {q: max(*(float(np.quantile(np.abs(x), share[q])) for x in s), 1e-9) for q, s in series.items()}
    rate = found.get("velocity", 1.0)
    angle = found.get("position", rate)
    return angle, rate, found.get("acceleration", rate * rate / angle)


def _rest(joint: JointAxis, positions: Sequence[Array]) -> float:
    """Return where a joint rests: its spring's zero, else where gravity pulls it, else the mean of its positions."""
    if not isinstance(joint, JointSpec) or joint.stiffness != 0.0:
        return 0.0
    zero = None if joint.gravity_torque is None else joint.gravity_torque.zero_angle  # None too where it is not known
    return float(np.concatenate(positions).mean()) if zero is None else zero


def integral(x: Array, dt: float) -> Array:
    """Return the integral [N] of samples over time, without what is slower than a fifth of the median frequency.

    Drift of a sensor, and the ends of a recording that do not meet, integrate to any size; what a joint swings by
    does not. Half of the power is below the median frequency.
    """
    frequency, spectrum = np.fft.rfftfreq(len(x), dt), np.fft.rfft(x - x.mean())
    power = np.cumsum(np.abs(spectrum) ** 2)
    keep = frequency > 0.2 * frequency[np.searchsorted(power, 0.5 * power[-1])]
    spectrum[keep] /= 2j * np.pi * frequency[keep]
    spectrum[~keep] = 0.0
    return np.fft.irfft(spectrum, len(x))
