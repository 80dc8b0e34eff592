"""Pulls that may be proposed, and the fixed set that a proposal is measured against."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from ...sim.base.errors import InputError
from ..replay.probes import PROBES, ArmProbe, Push

#: The first pulls, before anything is known: slow there and back, which rubs and yields, and let go, which swings.
#: Those that tell laws best as they are written did worse on branches whose laws have other forms, and so did the same
#: two between the branch's plane and across it.
FIRST = ("ramp_down", "release_up")
#: The same for an arm that cannot let go.
FIRST_HELD = ("ramp_down", "triangle_across")
#: Pulls that confirm a name which leads: slow ones and plain releases in both planes. Those that tell two laws apart
#: best are where their forms show most, and where what is hidden has the form of neither.
PLAIN = ("triangle_in", "triangle_across", "steps_in", "ramp_diagonal", "release_across")


def menu(releases: bool, only: tuple[str, ...] = ()) -> dict[str, ArmProbe]:
    """Return the pulls that an arm can do, all as long as one recording of a case.

    Args:
        releases: Whether it can let go of the branch and see it swing.
        only: Names to choose from, all there are if empty.

    Raises:
        InputError: A name that no probe has, or that this arm cannot do.
    """
    known = {name: replace(p, pushes=tuple(replace(q, length=1.0) for q in p.pushes))
             for name, p in (PROBES.everything() | _own()).items()
             if releases or all(q.free_from >= 1.0 for q in p.pushes)}  # fmt: skip
    for name in only:
        if name not in known:
            raise InputError("probe", "--pulls", repr(name), ", ".join(known))
    return {name: p for name, p in known.items() if not only or name in only}


def first(pulls: Mapping[str, ArmProbe], done: int, releases: bool) -> str:
    """Return the name of the pull to do while too little is known to propose one."""
    order = [n for n in (FIRST if releases else FIRST_HELD) if n in pulls] + list(pulls)
    return order[done % len(order)]


def left(pulls: Mapping[str, ArmProbe], done: Collection[str]) -> dict[str, ArmProbe]:
    """Return the pulls to choose from: those not done yet, all once all are done.

    Of two models the same pull tells most again and again. Where neither has the form of what is hidden that pull adds
    nothing, and another does.
    """
    return {name: pull for name, pull in pulls.items() if name not in done} or dict(pulls)


def _ramp(t: np.ndarray) -> np.ndarray:
    return np.interp(t, [0.05, 0.25, 0.6, 0.75], [0.0, 1.0, 1.0, 0.0])


def _down_ramp(t: np.ndarray) -> np.ndarray:
    return -_ramp(t)


def _pull(t: np.ndarray) -> np.ndarray:
    return np.interp(t, [0.05, 0.22], [0.0, 1.0])


def _down_pull(t: np.ndarray) -> np.ndarray:
    return -_pull(t)


def _both(t: np.ndarray) -> np.ndarray:
    return np.interp(t, [0.05, 0.28, 0.72, 0.95], [0.0, 1.0, -1.0, 0.0])


def _sweep(t: np.ndarray) -> np.ndarray:
    u = np.clip((t - 0.05) / 0.9, 0.0, 1.0)
    taper = np.minimum(1.0, 8.0 * np.minimum(u, 1.0 - u))
    return np.asarray(taper * np.sin(2.0 * np.pi * (2.0 * u + 6.0 * u * u)))


def _steps(t: np.ndarray) -> np.ndarray:
    knots = [0.05, 0.2, 0.24, 0.38, 0.42, 0.56, 0.63, 0.73, 0.83, 0.9, 0.94]
    return np.interp(t, knots, [0.0, 0.35, 0.35, 0.7, 0.7, 1.0, 1.0, -0.4, -0.4, 0.0, 0.0])


def _own() -> dict[str, ArmProbe]:
    """Return pulls beside the registry's: slow ones and steps of the fixed set, and some between both planes."""
    turned = {
        "ramp_diagonal": ("a ramp between both planes, held, and back", Push((-1.0, 1.0, 0.0), 1.0, 1.0, _ramp)),
        "release_diagonal": ("a pull between both planes, let go", Push((1.0, 1.0, 0.0), 1.0, 1.0, _pull, 0.35)),
        "triangle_diagonal": ("a triangle between both planes, both ways", Push((1.0, 1.0, 0.0), 1.0, 1.0, _both)),
    }
    names = ("ramp_down", "release_up", "steps_in", "release_across")
    straight = dict(zip(names, (FIXED[0], FIXED[1], FIXED[4], FIXED[5]), strict=True))
    return straight | {name: ArmProbe(words, (push,)) for name, (words, push) in turned.items()}


def _fixed() -> tuple[ArmProbe, ...]:
    own = (
        ("a ramp downwards, held, and back", Push(0, 1.0, 1.0, _down_ramp)),
        ("a pull upwards, let go", Push(0, 1.0, 1.0, _pull, 0.35)),
        ("a triangle across, both ways", Push(1, 1.0, 1.0, _both)),
        ("a sweep of frequencies across with a third", Push(1, 1 / 3, 1.0, _sweep)),
        ("steps up and down", Push(0, 1.0, 1.0, _steps)),
        ("a pull across, let go", Push(1, 1.0, 1.0, _pull, 0.35)),
    )
    six = tuple(ArmProbe(words, (push,)) for words, push in own)
    return (*six, six[0], six[1])


#: Six pulls and replicates of the first two: what every exam's case consists of (`learn.hidden.probes.PROFILES`), in
#: the plane of gravity and across it.
FIXED: tuple[ArmProbe, ...] = _fixed()
