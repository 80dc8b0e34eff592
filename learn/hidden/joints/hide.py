"""A measured case of joints with hidden laws: drawn, sized, read by real sensors, written with its answer beside it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ....sim.base.errors import InputError
from .laws import LAWS, OUTSIDE, Entry, Scale
from .rig import Array, Law, Motion, move
from .rigs import RUNS, Rig, draw_rig

Random = np.random.Generator
#: Sizes of effects: rms change of what is compared over its rms; log-uniform between these.
SIZES = (0.05, 0.30)
#: Draws until a motion is sane, and the most by which laws may enlarge its angles, rates and efforts.
DRAWS, WILD = 10, 3.0
#: Strengths that are tried, and steps of the fit that says how visible a law is.
TRIES, STEPS = 7, 3
#: Change of a logarithm over which that fit takes its slopes.
NUDGE = 0.02
#: Rms change of a fitted model's output that an eye still sees, as a share of its rms.
FAINT = 0.01
#: Names that are the same in principle: friction is the limit of a loop that yields at once, a set with kinematic
#: hardening one of elastic sliders.
ALIKE = {
    "dry_friction": ("hysteresis_boucwen",),
    "hysteresis_boucwen": ("plastic_set",),
    "plastic_set": ("hysteresis_boucwen",),
}


@dataclass(frozen=True)
class Hidden:
    """A law as it is hidden.

    Attributes:
        label: Its key in `LAWS`.
        entry: How it was drawn.
        joint: Where.
        strength: How strong.
        scale: Of its joint.
        law: None for a fault of the sensor.
        size: Rms change over rms.
    """

    label: str
    entry: Entry
    joint: int
    strength: float
    scale: Scale
    law: Law | None
    size: float

    @property
    def params(self) -> dict[str, float]:
        """The registry's parameters that are known of it."""
        return self.entry.truth(self.law, self.strength, self.scale) if self.entry.truth else {}


def hide_joints(folder: str | Path, *, rig: str, laws: Sequence[str], seed: int) -> dict[str, Any]:
    """Write a case folder of a kind of rig with hidden laws, and its answer beside it; return the answer.

    Raises:
        InputError: No draw of `DRAWS` moves sanely with these laws.
    """
    for draw in range(DRAWS):
        rng = np.random.default_rng([seed, 31, draw] if draw else [seed, 31])
        drawn, hidden, motion = _drawn(rig, laws, rng)
        if motion is not None:
            break
    else:
        found = f"no finite motion of a {rig} in {DRAWS} draws"
        raise InputError(Path(folder), " and ".join(laws) or "nothing hidden", found, "another seed, rig or law")
    effort = _read(drawn, motion, hidden)
    gap = _visible(drawn, motion, effort, hidden) if hidden else 0.0
    tables, noise = _sensed(drawn, motion.angle, effort, rng)
    answer = _answer(drawn, hidden, gap, noise, seed)
    _write(Path(folder), drawn, tables, answer)
    return answer


def _drawn(kind: str, laws: Sequence[str], rng: Random) -> tuple[Rig, list[Hidden], Motion | None]:
    """Draw a rig with hidden laws; return it with its motion, None if that is not `sane`."""
    rig = draw_rig(kind, rng)
    with np.errstate(all="ignore"):
        plain = rig.move([], fine=rig.steps[0])
        hidden = [_sized(rig, plain, label, rng) for label in laws] if sane(plain, plain) else []
        try:
            motion = rig.move([h.law for h in hidden if h.law is not None], fine=rig.steps[1])
        except np.linalg.LinAlgError:
            return rig, hidden, None
    return rig, hidden, motion if len(hidden) == len(laws) and sane(motion, plain) else None


def sane(motion: Motion, plain: Motion) -> bool:
    """Return whether a motion is finite, within two turns, and its numbers within `WILD` of those without the laws."""
    for x, own in ((motion.angle, plain.angle), (motion.rate, plain.rate), (motion.effort, plain.effort)):
        if not np.isfinite(x).all() or np.sqrt(np.mean(x**2)) > WILD * np.sqrt(np.mean(own**2)):
            return False
    return bool(np.isfinite(motion.law).all() and np.abs(motion.angle).max() < 4.0 * np.pi)


# ---- how strong -----------------------------------------------------------------------------------------------------


def _sized(rig: Rig, plain: Motion, label: str, rng: Random) -> Hidden:
    """Draw a law at a joint, of a strength that makes the wanted change, or comes nearest."""
    entry, joint = LAWS[label], int(rng.integers(rig.chain.count))
    target = float(np.exp(rng.uniform(*np.log(SIZES))))
    scale = _scale(rig, plain, joint)
    law = entry.draw(rng, scale, joint) if entry.draw else None
    if law is None:
        strength = _fault(rig, plain, label, joint, target)
        return Hidden(label, entry, joint, strength, scale, None, target)
    tried = np.geomspace(*entry.strengths, TRIES)
    sizes = _sizes(rig, plain, law, tried)
    strength, size = _between(tried, sizes, target)
    law.strength = np.full(RUNS, strength)
    return Hidden(label, entry, joint, strength, scale, law, size)


def _between(tried: Array, sizes: Array, target: float) -> tuple[float, float]:
    """Return the least strength whose size is the target, between those tried, or the one that comes nearest."""
    size = np.log(np.where(np.isfinite(sizes), np.maximum(sizes, 1e-9), np.inf) / target)
    for k in range(len(tried) - 1):
        if size[k] <= 0.0 <= size[k + 1] and np.isfinite(size[k + 1]):
            share = -size[k] / max(size[k + 1] - size[k], 1e-9)
            return float(tried[k] * (tried[k + 1] / tried[k]) ** share), target
    near = int(np.argmin(np.abs(size)))
    return float(tried[near]), float(sizes[near])


def _scale(rig: Rig, plain: Motion, joint: int) -> Scale:
    angle, rate = (float(np.abs(x[..., joint]).max()) for x in (plain.angle, plain.rate))
    inertia = float(rig.chain.inertia(np.zeros((1, rig.chain.count)))[0, joint])
    stiffness = float(rig.chain.stiffness[joint]) or float(rig.chain.weight[joint])
    torque = float(np.abs(plain.effort[..., joint]).max()) or stiffness * angle
    return Scale(stiffness, inertia, angle, rate, torque, rig.seconds)


def _sizes(rig: Rig, plain: Motion, law: Law, strengths: Array) -> Array:
    """Return the change that each strength makes [strengths]."""
    law.strength = np.repeat(strengths, RUNS)
    with np.errstate(all="ignore"):
        try:
            motion = rig.move([law], copies=len(strengths), fine=rig.steps[0])
        except np.linalg.LinAlgError:
            return np.full(len(strengths), np.inf)
    runs = motion.angle.shape[0], len(strengths), RUNS, rig.chain.count
    if rig.replayed:
        apart = motion.angle.reshape(runs) - plain.angle[:, None]
        return np.sqrt((apart**2).mean(axis=(0, 2, 3))) / plain.angle.std()
    given, effort = (x.reshape(runs)[..., law.joint] for x in (motion.law, motion.effort))
    return np.sqrt((given**2).mean(axis=(0, 2)) / (effort**2).mean(axis=(0, 2)))


def _fault(rig: Rig, plain: Motion, label: str, joint: int, target: float) -> float:
    """Return the strength of a sensor's fault: its share, or its lag in samples."""
    if label == "scaled":
        return target
    rate = float(plain.rate[..., joint].std() / plain.angle[..., joint].std())
    return float(np.clip(target / rate * rig.rate, 0.3, 3.0))


def _read(rig: Rig, motion: Motion, hidden: Sequence[Hidden]) -> Array:
    """Return efforts as their sensor has them, without noise [T, R, n]."""
    effort = motion.effort.copy()
    for h in hidden:
        if h.label == "scaled":
            effort[..., h.joint] *= 1.0 + h.strength
        if h.label == "late":  # all channels of a recorder are late together
            ahead = motion.time - h.strength / rig.rate
            for r in range(RUNS):
                for j in range(rig.chain.count):
                    effort[:, r, j] = np.interp(ahead, motion.time, effort[:, r, j])
    return effort


# ---- how visible ----------------------------------------------------------------------------------------------------


def _visible(rig: Rig, motion: Motion, effort: Array, hidden: Sequence[Hidden]) -> float:
    """Return what the best base model leaves, over the rms of what is compared."""
    return _left_of_motion(rig, motion, effort) if rig.replayed else _left_of_torque(rig, motion, hidden)


def _left_of_torque(rig: Rig, motion: Motion, hidden: Sequence[Hidden]) -> float:
    """Regress what the laws give on accelerations, weights or angles, the rate and a constant, joint by joint."""
    step = motion.time[1] - motion.time[0]
    gained = np.gradient(motion.rate, step, axis=0)
    theta = np.cumsum(motion.angle, axis=2)
    worst = 0.0
    for joint in {h.joint for h in hidden}:
        held = np.sin(theta) if rig.chain.weight.any() else motion.angle * rig.chain.stiffness
        columns = [gained, held, motion.rate[..., joint : joint + 1], np.ones_like(gained[..., :1])]
        rows = np.concatenate(columns, axis=2).reshape(-1, 2 * motion.angle.shape[2] + 2)
        given = motion.law[..., joint].ravel()
        left = given - rows @ np.linalg.lstsq(rows, given, rcond=None)[0]
        worst = max(worst, float(left.std() / motion.effort[..., joint].std()))
    return worst


def _left_of_motion(rig: Rig, motion: Motion, effort: Array) -> float:
    """Fit springs, dampers and weights of a replay by Gauss and Newton, and return what is left of the motion."""
    names = ("stiffness", "damping") if rig.chain.stiffness.any() else ("mass", "damping")
    best = np.inf
    unknown: Array = np.zeros(len(names) * rig.chain.count)
    with np.errstate(all="ignore"):  # a step that goes too far is found out by its numbers
        for _ in range(STEPS):
            unknown, left = _improved(rig, motion, effort, names, unknown)
            best = min(best, left)
            if not np.isfinite(unknown).all():
                break
    return best / float(motion.angle.std())


def _improved(rig: Rig, motion: Motion, effort: Array, names: Sequence[str], unknown: Array) -> tuple[Array, float]:
    """Return unknowns after a step of Gauss and Newton, and the rms residual before it [rad]."""
    base = _replayed(rig, motion, effort, names, unknown)
    residual = (motion.angle - base).ravel()
    if not np.isfinite(residual).all():
        return unknown * np.nan, np.inf
    columns = []
    for k in range(len(unknown)):
        moved = unknown.copy()
        moved[k] += NUDGE
        columns.append((_replayed(rig, motion, effort, names, moved) - base).ravel() / NUDGE)
    slopes = np.nan_to_num(np.array(columns).T)
    step: Array = np.linalg.lstsq(slopes, residual, rcond=None)[0]
    return unknown + np.clip(step, -0.5, 0.5), float(residual.std())


def _replayed(rig: Rig, motion: Motion, effort: Array, names: Sequence[str], unknown: Array) -> Array:
    """Return the angles [T, R, n] of a chain with changed numbers under recorded efforts."""
    factor = np.exp(unknown).reshape(len(names), -1)
    chain = replace(rig.chain, **{n: getattr(rig.chain, n) * f for n, f in zip(names, factor, strict=True)})
    if "mass" in names:  # the inertia is given, the weight is not
        own = rig.chain
        chain = replace(chain, central=own.central + own.mass * own.reach**2 * (1.0 - factor[0]))
    step = 1.0 / rig.rate

    def recorded(time: float, q: Array, v: Array) -> Array:
        """Return the recorded efforts at a time [s], straight between samples, [R, n]."""
        k = min(int(time / step), len(effort) - 2)
        share = min(time / step - k, 1.0)
        return (1.0 - share) * effort[k] + share * effort[k + 1]

    fine = rig.steps[0]
    return move(chain, rig.start, np.zeros_like(rig.start), recorded, [], seconds=rig.seconds, step=step / fine,
                every=fine).angle  # fmt: skip


# ---- sensors and files ----------------------------------------------------------------------------------------------


def _sensed(rig: Rig, angle: Array, effort: Array, rng: Random) -> tuple[list[Array], float]:
    """Return the columns of each recording as encoders and current sensors give them, and the angles' noise share."""
    share = float(10.0 ** rng.uniform(-3.6, -2.6))
    scale = angle.std(axis=(0, 1))
    counts = 2.0 ** rng.integers(12, 19)
    quantum = min(2 * np.pi / counts, 0.004 * float(scale.min()))
    seen = angle + share * scale * rng.standard_normal(angle.shape)
    seen = np.round(seen / quantum) * quantum
    loud = float(10.0 ** (rng.uniform(-3.7, -3.0) if rig.replayed else rng.uniform(-2.5, -1.8)))
    size = effort.std(axis=(0, 1))
    felt = effort + loud * size * rng.standard_normal(effort.shape)
    bit = np.maximum(np.abs(effort).max(axis=(0, 1)) / 2**14, 1e-300)
    felt = np.round(felt / bit) * bit
    time = np.arange(len(angle)) / rig.rate
    tables = [np.column_stack([time, *seen[:, r].T, *felt[:, r].T]) for r in range(RUNS)]
    noise = np.sqrt(share**2 + (quantum / scale.min()) ** 2 / 12)
    return tables, float(noise if rig.replayed else np.hypot(noise, loud))


def _answer(rig: Rig, hidden: Sequence[Hidden], gap: float, noise: float, seed: int) -> dict[str, Any]:
    names = [h.entry.name for h in hidden if h.entry.name]
    return {
        "null": not hidden, "out_of_library": any(h.label in OUTSIDE for h in hidden), "rig": rig.kind, "seed": seed,
        "effects": [{"name": h.entry.name, "joint": h.joint, "law": h.label, "params": h.params}
                    for h in hidden if h.entry.name],
        "outside": [h.label for h in hidden if h.entry.name is None],
        "equivalents": {n: [o for o in ALIKE[n] if o not in names] for n in names if n in ALIKE},
        "size_raw": {h.label: round(h.size, 4) for h in hidden}, "visible_gap": round(gap, 5), "noise": noise,
        "rate": rig.rate, "weak": names if hidden and gap < max(noise, FAINT) else [],
    }  # fmt: skip


def _write(folder: Path, rig: Rig, tables: Sequence[Array], answer: dict[str, Any]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    count = rig.chain.count
    driven = rig.kind != "swing"
    names = ["time_s", *(f"q{j}_rad" for j in range(count)), *(f"u{j}_Nm" for j in range(count))]
    described, files = rig.mechanism()
    for name, text in files.items():
        (folder / name).write_text(text)
    inputs = [{"joint": f"joint{j}", "column": f"u{j}_Nm", "scale": 1.0, "hold": "linear"} for j in range(count)]
    meta = {
        "format": "joint-gap-case/1", "name": folder.name, **described, "input": inputs if driven else None,
        "outputs": [{"joint": f"joint{j}", "quantity": "position", "column": f"q{j}_rad", "scale": 1.0}
                    for j in range(count)],
        "trajectories": [{"file": f"run_{r + 1}.csv", "t_start_s": 100.0 * r} for r in range(len(tables))],
    }  # fmt: skip
    if rig.kind in ("sprung", "links", "spring"):
        meta["fit"] = "torque" if rig.kind == "sprung" else "replay"
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta, sort_keys=False))
    for r, table in enumerate(tables):
        np.savetxt(folder / f"run_{r + 1}.csv", table, fmt="%.9g", delimiter=",", header=",".join(names), comments="")
    Path(f"{folder}_answer.json").write_text(json.dumps(answer, indent=1) + "\n")
