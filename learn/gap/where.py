"""Where a model is wrong: normalised residuals by recording and time, by phase of the probe, and by joint.

The normalised residual is measured minus simulated, divided by the standard deviation of the noise. Its rms is one
where only noise is left. A part stands out if its rms is at least `CONTRAST` times that of the rest of its kind.

A good sensor's noise says nothing of what a model can reach: beside an encoder's 45 nm every residual is a thousand
times too large. What is drawn is therefore the residual as a share of the motion, and where an experiment was repeated,
the scatter of its repeats.

The residual torque of a branch's joints is quasi-static: an extra torque tau_i turns joint i by tau_i / K_i and moves
the grasp point by that angle times its lever arm in the rest pose. Inertia, and gravity's share in the stiffness, are
neglected. The grasp point gives three values per window and each joint has three unknown torques, so ridge regression
selects the smallest torques that explain them; joints are distinguished only as far as their lever arms differ in
direction. Noise is taken as white.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from ...sim.base.types import Array
from ..cases.case import BranchCase, JointCase
from ..inference.predict import main_channels
from ..replay.equation_error import fits_torque
from ..replay.recording import Recording
from .diagnosis import Share, Where
from .models.contest import Contest

#: Time windows of the longest recording, and the fewest samples per window.
WINDOWS, FEWEST = 16, 4
#: Ratio from which a part stands out or exceeds the noise; fewest samples of a part.
CONTRAST, ENOUGH = 1.3, 10
#: Most trajectories that are named, and the least rms relative to the worst one's.
NAMED, NEARLY = 3, 0.7
#: Residual assigned to a simulation that is not finite, in units of the motion's rms.
BROKEN = 10.0
#: The force counts as held where it changes by less than this share of its peak over a window of this share of the
#: recording; below that share of the peak there is no force.
STEADY, SLOPE_WINDOW = 0.05, 0.04
#: Ridge penalty, relative to the mean squared response of the grasp point to joint torques.
RIDGE = 0.01

PHASES = {
    "loading": "during loading", "hold": "while holding", "release": "during release",
    "without force": "in contact without force", "gripper open": "with the gripper open",
}  # fmt: skip
DIRECTIONS = ("towards +x", "towards +y", "upwards", "towards -x", "towards -y", "downwards")
PARTS: dict[str, tuple[str, ...]] = {
    "phase": tuple(PHASES), "direction": DIRECTIONS, "amplitude": ("small", "medium", "large"),
    "speed": ("low", "medium", "high"),
}  # fmt: skip
#: Regime where no part stands out: true beside an effect that is spread over all of the motion, too.
NOWHERE = f"nowhere above {CONTRAST} times the noise"
Labels = list[NDArray[np.str_]]


def locate(
    case: BranchCase | JointCase, recordings: Sequence[Recording], sigma: Array, output: Array,
    stiffness: Array | None = None,
) -> Where:  # fmt: skip
    """Return where a model's simulation differs from the measurement.

    Args:
        case: The case.
        recordings: R recordings.
        sigma: Noise of the channels, shape [C], or of each sample with the response to noise of the force, shape
            [R, T, C] (`noise_seen`).
        output: Simulated channels, shape [R, T, C].
        stiffness: Springs of a branch's joints [N m/rad], shape [J], for the torque; None leaves it out.
    """
    squares = [np.nanmean(z**2, axis=1) for z in scaled(case, recordings, sigma, output)]
    edges = window_edges(recordings)
    heat = _heat(recordings, squares, edges)
    part = [np.nanmean(z**2, axis=1) for z in shares_of_motion(case, recordings, sigma, output)]
    worst = _worst(np.array([np.sqrt(s.mean()) for s in squares]))
    shares = _shares(parts_of(case, recordings), squares)
    torque: Array | None = None
    joints: tuple[int, ...] = ()
    if isinstance(case, BranchCase) and stiffness is not None:
        torque, noise = joint_torque(case, recordings, sigma, output, stiffness)
        own, prominent = _by_joint(case, recordings, torque, noise)
        shares, joints = shares + own, prominent if worst else ()
    windows = tuple(_window(heat, edges, recordings[j], j) for j in worst)
    of_motion = _heat(recordings, part, edges)
    return Where(worst, windows, joints, regime(shares), heat, edges, tuple(shares), torque, of_motion)


def noise_seen(contest: Contest) -> Array:
    """Return the noise of each sample including the response to noise of the force, [R, T, C] (or [C])."""
    if contest.colour is None:
        return contest.sigma.cpu().numpy()
    added = contest.colour.variance(contest.measured.shape[1:])  # type: ignore[arg-type]
    return (contest.sigma * (1.0 + added).sqrt()).cpu().numpy()


def scaled(
    case: BranchCase | JointCase, recordings: Sequence[Recording], sigma: Array, output: Array
) -> list[Array]:  # fmt: skip
    """Return the normalised residuals of each recording, [T, C]; NaN in channels without noise."""
    broken, out = BROKEN * motion_of(case, recordings), []
    for r, own, simulated in zip(recordings, np.broadcast_to(sigma, output.shape), output, strict=True):
        noise = own[: len(r.t)]
        with np.errstate(divide="ignore", invalid="ignore"):
            out.append(np.where(noise > 0.0, _residual(r, simulated, broken) / noise, np.nan))
    return out


def shares_of_motion(
    case: BranchCase | JointCase, recordings: Sequence[Recording], sigma: Array, output: Array
) -> list[Array]:
    """Return the residuals of each recording as shares of the motion's rms, [T, C]; NaN in channels without noise."""
    spread = motion_of(case, recordings)
    broken = BROKEN * spread
    used = np.broadcast_to(sigma, output.shape).reshape(-1, output.shape[-1]).max(axis=0) > 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        return [
            np.where(used, _residual(r, simulated, broken) / spread, np.nan)
            for r, simulated in zip(recordings, output, strict=True)
        ]


def _residual(r: Recording, simulated: Array, broken: Array) -> Array:
    """Return measured minus simulated [T, C]; ``broken`` [C] where the simulation is not finite or farther away."""
    away = np.nan_to_num(r.output - simulated[: len(r.t)], nan=np.inf)
    return np.where(np.abs(away) < broken, away, np.copysign(broken, away))


def motion_of(case: BranchCase | JointCase, recordings: Sequence[Recording]) -> Array:
    """Return the rms of every channel's motion, [C]: about rest for a branch, its axes together; else about its mean.

    The zero of an encoder is anywhere, so a joint's motion is what it does about the mean of each recording. Torques
    are taken about the mean of all: at a steady speed one recording's torque is constant, and friction all of it. One
    where nothing moves at all.
    """
    if fits_torque(case):
        return _or_one(np.concatenate([r.output for r in recordings]).std(axis=0))
    if not isinstance(case, BranchCase):
        away = np.concatenate([r.output - r.output.mean(axis=0) for r in recordings])
        return _or_one(np.sqrt(np.mean(away**2, axis=0)))
    squares = np.mean(np.concatenate([r.output for r in recordings]) ** 2, axis=0).reshape(2, 3)
    axes = 2 if case.planar else 3
    return _or_one(np.sqrt(squares.sum(axis=1) / axes)).repeat(3)


def _or_one(spread: Array) -> Array:
    return np.where(spread > 0.0, spread, 1.0)


def swing_of(case: BranchCase | JointCase, recordings: Sequence[Recording], chosen: Sequence[int]) -> float:
    """Return the rms motion of some recordings in the main channels, as `motion_of` takes it; of all for torques."""
    main, taken = list(main_channels(case)), range(len(recordings)) if fits_torque(case) else chosen
    return float(np.sqrt(np.mean(motion_of(case, [recordings[j] for j in taken])[main] ** 2)))


def replicate_scatter(case: BranchCase | JointCase, recordings: Sequence[Recording]) -> float | None:
    """Return the rms by which repeats of an experiment scatter in the main channels; None where none was repeated.

    Half the mean square of the difference of two repeats: noise, and all that was not the same in both. No model of
    the input can do better on the average.
    """
    main, squares = list(main_channels(case)), []
    for j, t in enumerate(case.trajectories):
        if t.replicate_of is not None:
            one, other = (recordings[k].output[:, main] for k in (j, t.replicate_of))
            n = min(len(one), len(other))
            squares.append(((one[:n] - other[:n]) ** 2).ravel() / 2.0)
    return float(np.sqrt(np.mean(np.concatenate(squares)))) if squares else None


def window_edges(recordings: Sequence[Recording]) -> Array:
    """Return edges of equal time windows [s], shape [W + 1], the same for all recordings."""
    longest = max(len(r.t) for r in recordings)
    start, end = min(r.t[0] for r in recordings), max(r.t[-1] for r in recordings)
    return np.linspace(start, end, min(WINDOWS, max(1, longest // FEWEST)) + 1)


def _window_of(r: Recording, edges: Array) -> NDArray[np.intp]:
    return np.clip(np.searchsorted(edges, r.t, side="right") - 1, 0, len(edges) - 2)


def _heat(recordings: Sequence[Recording], squares: Sequence[Array], edges: Array) -> Array:
    heat = np.full((len(recordings), len(edges) - 1), np.nan)
    for row, r, s in zip(heat, recordings, squares, strict=True):
        at = _window_of(r, edges)
        for w in np.unique(at):
            row[w] = np.sqrt(s[at == w].mean())
    return heat


def _worst(ratio: Array) -> tuple[int, ...]:
    """Return the recordings above the noise that are nearly as bad as the worst, worst first."""
    order = np.argsort(-ratio)[:NAMED]
    return tuple(int(j) for j in order if ratio[j] > CONTRAST and ratio[j] >= NEARLY * ratio.max())


def _window(heat: Array, edges: Array, r: Recording, j: int) -> tuple[int, float, float]:
    """Worst window of a recording, with neighbours that are nearly as bad."""
    row = np.nan_to_num(heat[j])
    near = row >= NEARLY * row.max()
    first = last = int(row.argmax())
    while first > 0 and near[first - 1]:
        first -= 1
    while last + 1 < len(row) and near[last + 1]:
        last += 1
    return j, float(edges[first]), float(min(edges[last + 1], r.t[-1]))


# ---- parts of the motion --------------------------------------------------------------------------------------------


def parts_of(case: BranchCase | JointCase, recordings: Sequence[Recording]) -> dict[str, Labels]:
    """Return which part of the motion every sample belongs to, by kind; arrays [T], empty text for none."""
    out: dict[str, Labels] = {}
    if isinstance(case, BranchCase):
        out["phase"] = [phases(r) for r in recordings]
        out["direction"] = [directions(r) for r in recordings]
    for kind, of in (("amplitude", _amplitude), ("speed", _speed)):
        if (values := _every(case, recordings, of)) is not None:
            out[kind] = _thirds(values, PARTS[kind])
    return out


def phases(r: Recording) -> NDArray[np.str_]:
    """Return what the probe does at every sample, from the size of its force and whether the gripper may hold, [T]."""
    size = np.linalg.norm(r.input, axis=1)
    peak = max(float(size[r.contact].max(initial=0.0)), 1e-300)
    half = max(2, round(0.5 * SLOPE_WINDOW * len(size)))
    slope = savgol_filter(size, 2 * half + 1, polyorder=1, deriv=1, mode="nearest")  # per sample
    change = slope * 2 * half / peak
    out = np.where(change > STEADY, "loading", np.where(change < -STEADY, "release", "hold"))
    out = np.where((out == "hold") & (size < STEADY * peak), "without force", out)
    return np.where(r.contact, out, "gripper open")


def directions(r: Recording) -> NDArray[np.str_]:
    """Return the world axis nearest to the force at every sample, [T]; empty where there is next to none."""
    size = np.linalg.norm(r.input, axis=1)
    axis = np.abs(r.input).argmax(axis=1)
    backwards = r.input[np.arange(len(size)), axis] < 0.0
    pushed = r.contact & (size > 2.0 * STEADY * size.max(initial=0.0))
    return np.where(pushed, np.array(DIRECTIONS)[axis + 3 * backwards], "")


def joint_motion(case: JointCase, r: Recording) -> dict[str, tuple[Array | None, Array | None]]:
    """Return coordinate and rate [T] of every joint that has them measured; a rate may be the coordinate's slope."""
    if fits_torque(case):
        return {j.name: (r.input[:, 3 * k], r.input[:, 3 * k + 1]) for k, j in enumerate(case.joints)}
    found: dict[str, dict[str, Array]] = {}
    for channel, values in zip(case.channels, r.output.T, strict=True):
        found.setdefault(channel.joint, {})[channel.quantity] = values
    out: dict[str, tuple[Array | None, Array | None]] = {}
    for name, own in found.items():
        q, v = own.get("position"), own.get("velocity")
        out[name] = q, np.gradient(q, r.t) if v is None and q is not None else v
    return out


def _amplitude(case: BranchCase | JointCase, r: Recording) -> Array | None:
    return np.linalg.norm(r.output[:, :3], axis=1) if isinstance(case, BranchCase) else _size(case, r, 0)


def _speed(case: BranchCase | JointCase, r: Recording) -> Array | None:
    return np.linalg.norm(r.output[:, 3:6], axis=1) if isinstance(case, BranchCase) else _size(case, r, 1)


def _size(case: JointCase, r: Recording, which: int) -> Array | None:
    columns = [pair[which] for pair in joint_motion(case, r).values()]
    known = [c for c in columns if c is not None]
    return np.sqrt(np.sum(np.square(known), axis=0)) if known else None


def _every(
    case: BranchCase | JointCase, recordings: Sequence[Recording],
    of: Callable[[BranchCase | JointCase, Recording], Array | None],
) -> list[Array] | None:  # fmt: skip
    values = [of(case, r) for r in recordings]
    known = [v for v in values if v is not None]
    return known if len(known) == len(values) else None


def _thirds(values: Sequence[Array], names: Sequence[str]) -> Labels:
    """Name every sample by the third of all samples that it belongs to."""
    limits = np.quantile(np.concatenate(list(values)), [1 / 3, 2 / 3])
    return [np.array(names)[np.searchsorted(limits, v, side="right")] for v in values]


def _shares(parts: dict[str, Labels], squares: Sequence[Array]) -> list[Share]:
    flat, out = np.concatenate(list(squares)), []
    for kind, labels in parts.items():
        at = np.concatenate(labels)
        for part in PARTS[kind]:
            if own := int((at == part).sum()):
                out.append(Share(kind, part, float(np.sqrt(flat[at == part].mean())), own))
    return out


def regime(shares: Sequence[Share]) -> str:
    """Return a phrase that names the parts that stand out against the better-fitted ones of their kind."""
    prominent = {kind: _prominent([s for s in shares if s.by == kind and s.samples >= ENOUGH]) for kind in PARTS}
    phrases = [" and ".join(PHASES[s.part] for s in prominent["phase"])]
    for kind, form in (("direction", "on pushes {}"), ("amplitude", "at {} amplitude"), ("speed", "at {} speed")):
        phrases += [form.format(max(own, key=lambda s: s.ratio).part) for own in [prominent[kind]] if own]
    if text := ", ".join(p for p in phrases if p):
        return text
    return "everywhere alike" if any(s.ratio > CONTRAST for s in shares) else NOWHERE


def _prominent(shares: Sequence[Share]) -> list[Share]:
    """Return the parts of a kind that exceed the noise, the better-fitted parts, and `NEARLY` times the worst."""
    worst = max((s.ratio for s in shares), default=0.0)
    return [s for s in shares if s.ratio > max(CONTRAST * max(_better(s, shares), 1.0), NEARLY * worst)]


def _better(share: Share, shares: Sequence[Share]) -> float:
    """Return the pooled ratio of all parts with a smaller ratio; infinite if there are none."""
    others = [s for s in shares if s.ratio < share.ratio]
    count = sum(s.samples for s in others)
    return float(np.sqrt(sum(s.samples * s.ratio**2 for s in others) / count)) if count else np.inf


# ---- torque at the joints -------------------------------------------------------------------------------------------


def joint_torque(
    case: BranchCase, recordings: Sequence[Recording], sigma: Array, output: Array, stiffness: Array
) -> tuple[Array, Array]:
    """Return the residual torque of each joint, and what noise alone would give, rms [N m], both [R, J].

    It is constant in a window and has three components per joint. Arguments as in `locate`.
    """
    edges = window_edges(recordings)
    noise = np.broadcast_to(sigma, output.shape)
    out = np.zeros((2, len(recordings), case.num_segments))
    for j, r in enumerate(recordings):
        n, at = len(r.t), _window_of(r, edges)
        left = np.nan_to_num(r.output - output[j, :n])[:, :3]
        estimator = _estimator(case, r, stiffness)
        for w in np.unique(at):
            own = at == w
            torque = (estimator @ left[own].mean(axis=0)).reshape(-1, 3)
            deviation = np.sqrt((noise[j, :n, :3][own] ** 2).mean(axis=0) / own.sum())
            spread = ((estimator * deviation) ** 2).sum(axis=1).reshape(-1, 3)
            out[:, j] += own.sum() / n * np.stack([(torque**2).sum(axis=1), spread.sum(axis=1)])
    return np.sqrt(out[0]), np.sqrt(out[1])


def grasp_response(case: BranchCase, r: Recording, stiffness: Array) -> Array:
    """Return the grasp point's displacement per torque at the joints [m/(N m)], world axes, shape [3, 3 J]."""
    assert r.grasp is not None
    link, point = r.grasp
    lever = case.lower_end[link] + case.axis[link] * point[2] - case.lower_end
    lever[link + 1 :] = 0.0  # joints above the grasp point do not move it
    turned = np.cross(np.eye(3)[None], lever[:, None])  # of each axis of each joint, [J, 3, 3]
    return np.concatenate([t.T / k for t, k in zip(turned, stiffness, strict=True)], axis=1)


def _estimator(case: BranchCase, r: Recording, stiffness: Array) -> Array:
    """Torques per displacement of the grasp point, by ridge regression [3 J, 3]."""
    response = grasp_response(case, r, stiffness)
    normal = response @ response.T
    return response.T @ np.linalg.inv(normal + RIDGE * np.trace(normal) / 3.0 * np.eye(3))


def _by_joint(
    case: BranchCase, recordings: Sequence[Recording], torque: Array, noise: Array
) -> tuple[list[Share], tuple[int, ...]]:
    """Return residual torque over its noise for each joint, and the joints that stand out, largest torque first."""
    samples = np.array([len(r.t) for r in recordings])
    size, floor = (np.sqrt(np.average(x**2, axis=0, weights=samples)) for x in (torque, noise))
    ratio = size / np.maximum(floor, 1e-300)
    shares = [
        Share("joint", f"{i}: {name}", float(ratio[i]), int(samples.sum()))
        for i, name in enumerate(case.segment_name)
        if floor[i] > 0.0
    ]
    prominent = [int(i) for i in np.argsort(-size) if ratio[i] > CONTRAST and 2.0 * size[i] >= size.max()]
    return shares, tuple(prominent)
