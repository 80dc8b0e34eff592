"""Effects that have a name: what the model may lack, as terms that the simulator can carry.

A row says what an effect is called, what it does in a branch (``branch``) and at joints measured directly (``joint``),
where the law is from, what it looks like in data, what it is mistaken for and which probe tells them apart. `register`
adds one; a file that defines a law and registers it is all that a new effect needs.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from ...kernels.effects.structs import PARAMETERS
from ...kernels.effects.terms import Term
from ..base.errors import InputError

Kind = Literal["joint", "link", "force", "time_delay", "grasp_slip", "tip_mass", "base_compliance"]
Form = Literal["branch", "joint"]


@dataclass(frozen=True)
class Setting:
    """What is known of a joint or a branch before anything is fitted; boxes of priors are multiples of it.

    Attributes:
        torque: Torque (or force, at a slide) that the input makes at the joint [N m or N].
        angle: Angle (or way) that the joint turns at most [rad or m].
        rate: Rate of the joint at most [rad/s or m/s].
        force: Largest force of the arm [N], or effort at a driven joint.
        speed: Largest speed of the grasp point [m/s].
        area: Projected area of the branch, length times diameter [m^2].
        mass: Mass of the branch [kg].
        length: Length of the segment that is held [m].
        gravity: Gravity [m/s^2].
        dt: Sampling step [s].
        start, end: First and last moment of the recordings on the absolute clock [s].
        duration: Length of the longest recording [s].
        moments: Some moments inside every recording, on the absolute clock [s].
        slides: Whether the joint slides: metres and newtons stand for radians and newton metres.
    """

    torque: float = 1.0
    angle: float = 1.0
    rate: float = 1.0
    force: float = 1.0
    speed: float = 1.0
    area: float = 1.0
    mass: float = 1.0
    length: float = 1.0
    gravity: float = 9.81
    dt: float = 0.02
    start: float = 0.0
    end: float = 1.0
    duration: float = 1.0
    moments: tuple[float, ...] = (0.5,)
    slides: bool = False

    @property
    def stiffness(self) -> float:
        """Spring that the input would turn by the angle seen."""
        return self.torque / self.angle


Bound = float | Callable[[Setting], float]


def in_setting(bound: Bound, setting: Setting) -> float:
    """Return an end of a box, a typical value or a reach as a number."""
    return float(bound(setting) if callable(bound) else bound)


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect.

    Attributes:
        name: With its unit as a suffix, such as ``torque_Nm``.
        unit: SI unit; ``1`` for a share.
        low, high: Box of the prior, numbers or functions of the `Setting`.
        neutral: Value at which the effect, or this part of it, is off.
        scale: ``log`` (positive) or ``linear``.
        typical: Where a search may begin; None takes the middle of the box on its scale.
        tries: How many values a search for unknown effects looks at, or the values themselves. None: it moves a
            parameter about its neutral value where the box allows, and looks at three values of any other.
        reach: Change of the value (of its logarithm) over which the response is about linear, for searches; None takes
            half the box, or one for a logarithm.
        optional: Whether a file may leave it out; it is neutral then.
        plausible: Least and largest value that nature or a sensor has, beyond which a fitted effect stands in for
            another; None where none is known. The effect's file says where the numbers are from.
        of_each: Whether with it the law takes a number of every recording from what was measured, so that a model pays
            for it once for each.
        becomes, below: Names of the effects that the law turns into where the value is larger than the box, and
            smaller; empty for none.
        read_off: Whether the value is the size of what was read off the recordings themselves, so that no search moves
            it: it is neutral where nothing was.
        becomes_from: How far up the box, as a share of it on its own scale, the law is as good as the one that it
            becomes, where that one explains as much.
        aside: Whether it is along y, where a planar case has nothing: no search of one moves it.
    """

    name: str
    unit: str
    low: Bound
    high: Bound
    neutral: float = 0.0
    scale: Literal["log", "linear"] = "linear"
    typical: Bound | None = None
    tries: int | Callable[[Setting], Sequence[float]] | None = None
    reach: Bound | None = None
    optional: bool = False
    plausible: tuple[float, float] | None = None
    of_each: bool = False
    becomes: str = ""
    below: str = ""
    becomes_from: float = 1.0
    read_off: bool = False
    aside: bool = False


#: Share of the twist that a law at a ball joint sees, and of the torque about it that it gives.
TWIST_SHARE = EffectParameter("twist", "1", 0.0, 1.0, neutral=1.0, tries=lambda s: [1.0], optional=True)


def kept_share(neutral: float) -> EffectParameter:
    """Return the share of a law's memory that outlasts a recording, and where nothing is said ``neutral``.

    What becomes of a branch between two recordings is not recorded: what holds it may stay, or creep back.
    """
    return EffectParameter("kept", "1", 0.0, 1.0, neutral=neutral, tries=lambda s: [neutral], optional=True)


def moment_parameter(before: float, *, neutral: float | None = None) -> EffectParameter:
    """Return the moment on the clock at which an effect happens, up to ``before`` [s] before the recordings.

    With a ``neutral`` one a file may leave it out, and a search begins where it lies before all; else at `moments`.
    """
    return EffectParameter(
        "moment_s", "s", lambda s: s.start - before, lambda s: s.end, neutral or 0.0,
        tries=lambda s: s.moments if neutral is None else [s.start - before],
        reach=lambda s: 0.25 * s.duration, optional=neutral is not None,
    )  # fmt: skip


def axes_across(*, circle: bool, count: int) -> list[float]:
    """Return angles of ``count`` axes across a segment [rad], evenly around the whole circle or around half."""
    end = 2.0 * math.pi if circle else math.pi
    return [k * end / count for k in range(count)]


def axis_parameter(*, circle: bool, tries: int) -> EffectParameter:
    """Return the angle of an axis across a segment, which a search may turn past either end of what it looks at.

    Args:
        circle: Whether opposite axes differ, so that it is looked at around the whole circle, else around half.
        tries: Axes that a search looks at.
    """
    end = 2.0 * math.pi if circle else math.pi
    axes = axes_across(circle=circle, count=tries)
    return EffectParameter(
        "axis_rad", "rad", -math.pi, end + math.pi, typical=0.5 * math.pi, tries=lambda s: axes, reach=1.0
    )


@dataclass(frozen=True)
class Law:
    """How an effect acts in one form of case.

    Attributes:
        kind: ``joint``, ``link`` or ``force`` for a law (`kernels.effects.terms`), else what the replay does itself.
        parameters: In the order of the law's ``p.a``, ``p.b``, ...
        law: Device function of the three kinds.
        per_joint: Whether every joint has its own.
        memory, persistent: See `kernels.effects.terms.Term`.
        settles: Names of the parameters that are neutral where a branch rests in its given pose; empty where it does so
            whatever they are.
        precedes: Whether it acts by the clock, and so has moved a branch before a recording begins.
        active: Whether it may give energy, as a gust does; every other law takes energy or gives back what it stored.
        holds: Device function ``holds(j, p, r)`` of a law at a joint that keeps a branch off its rest, as dry friction
            or a play does: of the torque ``r.torque`` what it holds, and the memory, if any, with which it does
            (`kernels.effects.held`).
        strains: Device function ``strains(j, p, r)`` of what a law of another kind does at joints as well.
        mirror: Of values of the parameters other ones, and by what the joint's spring is to be multiplied: the same
            motion in the plane in which the law acts, and another motion across it. A search that has ended on the
            wrong side is led to the other; None where there is none.
        further: Values of all parameters at which a search looks beside what it tries of each with each.
        moment: Name of the parameter that is the moment on the clock at which the effect happens, once and for good;
            empty where it has none.
        strengths: Names of the parameters that are all neutral where the effect does nothing. Empty: those that may
            have either sign if the first is one of them, else the first alone.
        keeps: Name of the parameter that is the share of a persistent memory which outlasts a recording; empty where
            all of it does.
        follows: Whether the torque at a joint follows its angle at rest, by the stiffness that the law returns.
        throughout: Whether wood has it along a whole branch, so that every joint may have its own.
        spatial: Whether a planar case shows nothing of it: what bends in one plane has one stiffness, and no twist.
    """

    kind: Kind
    parameters: tuple[EffectParameter, ...]
    law: Any = None
    per_joint: bool = True
    memory: int = 0
    persistent: bool = False
    settles: tuple[str, ...] = ()
    precedes: bool = False
    active: bool = False
    holds: Any = None
    strains: Any = None
    mirror: Callable[[Sequence[float]], tuple[Sequence[float], float]] | None = None
    further: Callable[[Setting], Sequence[tuple[float, ...]]] | None = None
    moment: str = ""
    strengths: tuple[str, ...] = ()
    keeps: str = ""
    follows: bool = False
    throughout: bool = False
    spatial: bool = False

    @property
    def lasting(self) -> bool:
        """Whether what outlasts a recording is a joint's, so that a branch rests elsewhere: a grip moves no joint."""
        return self.persistent and self.kind == "joint"


@dataclass(frozen=True)
class Effect:
    """A named effect.

    Attributes:
        name: One word, lower case.
        summary: Its law in a sentence.
        source: Where the law is from.
        signature: What it looks like in measurements.
        mistaken_for: Names of effects that it is easily taken for.
        probe: What tells them apart.
        branch, joint: How it acts in either form of case; None where it does not.
        plain: What the model lacks in words that need no book, such as ``air drag``; the name where it is empty.
        alike: Names of effects that are the same in principle at one joint: a limit of this one, or what it is a limit
            of.
    """

    name: str
    summary: str
    source: str
    signature: str
    mistaken_for: tuple[str, ...]
    probe: str
    branch: Law | None = None
    joint: Law | None = None
    plain: str = ""
    alike: tuple[str, ...] = ()

    def law(self, form: Form) -> Law:
        """Return how the effect acts in a form of case.

        Raises:
            InputError: It does not.
        """
        found = self.branch if form == "branch" else self.joint
        if found is None:
            allowed = ", ".join(e.name for e in effects() if getattr(e, form) is not None)
            raise InputError("effects", self.name, f"an effect that a {form} case cannot have", allowed)
        return found


_ROWS: dict[str, Effect] = {}
_WAITING: list[Callable[[], None]] = []


def when_asked(load: Callable[[], None]) -> None:
    """Have effects registered by ``load`` before effects are first asked for, or another is registered."""
    _WAITING.append(load)


def _rows() -> dict[str, Effect]:
    """Return all effects by name, those that waited among them."""
    while _WAITING:
        _WAITING.pop(0)()
    return _ROWS


def register(effect: Effect) -> Effect:
    """Add an effect to those that every command knows and return it.

    Raises:
        InputError: Another effect has its name, the name is not one lower-case word, or it has no law, or one that
            cannot be.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]*", effect.name):
        raise InputError("effects", effect.name, "the name", "lower-case letters, digits and _")
    if effect.name in _rows():
        raise InputError("effects", effect.name, "the name a second time", "each effect once")
    laws = [law for law in (effect.branch, effect.joint) if law is not None]
    if not laws:
        raise InputError("effects", effect.name, "no law", "a law for branches, for joints or for both")
    for law in laws:
        _check(law, effect.name)
    _ROWS[effect.name] = effect
    return effect


def _check(law: Law, name: str) -> None:
    """Raise `InputError` for a law with too few or too many parameters, without a function, or that holds nothing."""
    names = [p.name for p in law.parameters]
    if not 1 <= len(set(names)) == len(names) <= PARAMETERS:
        raise InputError("effects", name, f"parameters {names}", f"1 to {PARAMETERS} of different names")
    for what in ("strengths", "settles"):
        if not set(getattr(law, what)) <= set(names):
            raise InputError("effects", name, f"{what} {list(getattr(law, what))}", f"some of {', '.join(names)}")
    if (law.law is None) == (law.kind in ("joint", "link", "force")):
        raise InputError("effects", name, f"kind {law.kind} and law {law.law}", "a law with its kind")
    if law.holds is not None and law.kind != "joint":
        raise InputError("effects", name, f"holds with kind {law.kind}", "a law at a joint")


def registered() -> tuple[str, ...]:
    """Return the names registered so far, without those of packages that still wait."""
    return tuple(_ROWS)


def take_back(names: Iterable[str]) -> None:
    """Forget effects, such as those that a module registered before it failed."""
    for name in tuple(names):
        del _ROWS[name]


def effects() -> tuple[Effect, ...]:
    """Return all effects in the order in which they were registered, which is the order in which they act."""
    return tuple(_rows().values())


def effect_of(name: str, source: str = "effects") -> Effect:
    """Return the effect of a name.

    Raises:
        InputError: There is none; ``source`` says where the name was read.
    """
    rows = _rows()
    if name not in rows:
        raise InputError(source, "effects", f"'{name}'", f"one of {', '.join(rows)}")
    return rows[name]


def terms_of(names: tuple[str, ...], form: Form) -> tuple[Term, ...]:
    """Return the kernel terms of some effects, in the order of the registry, whatever the order of the names."""
    chosen = [e for e in effects() if e.name in names]
    return tuple(_term(e.name, slot, e.law(form)) for slot, e in enumerate(chosen))


def _term(name: str, slot: int, law: Law) -> Term:
    fades = [p.name for p in law.parameters].index(law.keeps) if law.keeps else -1
    return Term(
        name, law.kind, law.law, slot, law.per_joint, law.memory, law.persistent, law.holds, law.precedes, law.strains,
        fades, law.follows,
    )  # fmt: skip
