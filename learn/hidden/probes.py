"""The experiment: six probes and two replicates, their forces, and the case folder that they are written to."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from ...sim.base.errors import InputError
from ...sim.base.files import output_folder
from .branch import TRUNK_PIVOT, Array, Branch, random_branch, unit
from .drive import Motion, drive
from .measurement import HARD, Hard, measured, mounting, noise, shaped
from .parts import Readings

HEADER = "t_s,fx_N,fy_N,fz_N,x_m,y_m,z_m,vx_mps,vy_mps,vz_mps"
PROFILES = ("ramp_hold_return", "pull_release", "triangle_bothways", "sweep", "steps", "pull_release")
QUIET = 0.25
#: Other profiles, in any order, and their sampling rates [Hz] with how often each is taken.
HARD_PROFILES = ("ramp", "chirp", "step_release", "pseudo_random", "circle", "sines")
HARD_RATES = ((50.0, 100.0, 200.0, 500.0), (0.4, 0.3, 0.2, 0.1))
#: Samples of a recording, and the most of them.
SAMPLES, MOST_SAMPLES = 110, 2000


def shape(profile: str, t: Array, duration: float, rng: np.random.Generator) -> Array:
    """Force history of a profile with peak one (sweep: 0.3), zero until ``QUIET`` and at the end, shape [T]."""
    x = t - QUIET
    span = duration - 2 * QUIET
    if profile == "ramp_hold_return":
        back = duration * rng.uniform(0.55, 0.62)
        return np.interp(x, [0, 0.25 * duration, back, back + 0.15 * duration], [0, 1, 1, 0])
    if profile == "pull_release":
        off = duration * rng.uniform(0.28, 0.36)
        return np.where(x < off, np.interp(x, [0, 0.18 * duration], [0, 1]), 0.0)
    if profile == "triangle_bothways":
        return np.interp(x / span, [0, 0.25, 0.75, 1], [0, 1, -1, 0])
    if profile == "sweep":
        u = np.clip(x / span, 0, 1)
        taper = np.minimum(1, 8 * np.minimum(u, 1 - u))
        return np.asarray(0.3 * taper * np.sin(2 * np.pi * span * (0.4 * u + 1.2 * u * u)))
    knots = [0.18, 0.22, 0.38, 0.42, 0.58, 0.65, 0.77, 0.88, 0.96, 1.0]
    return np.interp(x / (0.88 * duration - QUIET), knots, [0, 0.35, 0.35, 0.7, 0.7, 1, 1, -0.4, -0.4, 0])


def hard_shape(profile: str, t: Array, duration: float, rng: np.random.Generator) -> Array:
    """Force history of one of `HARD_PROFILES` along two axes, zero until ``QUIET`` and at the end, shape [T, 2]."""
    x, span = t - QUIET, duration - 2 * QUIET
    u = np.clip(x / span, 0, 1)
    taper = np.minimum(1, 6 * np.minimum(u, 1 - u))
    aside = np.zeros_like(t)
    if profile == "ramp":
        return np.stack([np.interp(u, [0, 0.6, 0.75, 0.8], [0, 1, 1, 0]), aside], axis=1)
    if profile == "chirp":
        low, high = rng.uniform(0.2, 0.4), rng.uniform(2.0, 4.0)
        phase = 2 * np.pi * low * span * ((high / low) ** u - 1) / np.log(high / low)
        return np.stack([0.35 * taper * np.sin(phase), aside], axis=1)
    if profile == "step_release":
        off = rng.uniform(0.4, 0.6)
        return np.stack([np.where(u < off, np.minimum(1, x.clip(0) / 0.06), 0.0), aside], axis=1)
    if profile == "pseudo_random":
        knots = np.cumsum(rng.uniform(0.15, 0.5, 60))
        level = rng.choice([-0.5, 0.0, 0.5], 60)
        edges = np.stack([knots, knots + 0.04], axis=1).ravel()
        held = np.stack([np.r_[0.0, level[:-1]], level], axis=1).ravel()
        return np.stack([taper * np.interp(x, edges, held), aside], axis=1)
    if profile == "circle":
        turns = 2 * np.pi * rng.uniform(0.4, 1.0) * x
        return np.asarray(0.6 * taper[:, None] * np.stack([np.cos(turns), np.sin(turns)], axis=1))
    sines = np.sin(2 * np.pi * rng.uniform(0.3, 3.0, 5) * x[:, None] + rng.uniform(0, 2 * np.pi, 5))
    return np.stack([taper * sines.mean(axis=1), aside], axis=1)


def peak_force(branch: Branch, direction: Array, reach: float) -> float:
    """Force [N] along ``direction`` that the linear springs answer with a grasp displacement of ``reach`` [m]."""
    lever = np.cross(branch.grasp() - branch.joints(), direction)
    moved = (np.cross(lever / np.array(branch.stiffness)[:, None], branch.grasp() - branch.joints())).sum(axis=0)
    return float(reach / np.linalg.norm(moved))


def _directions(branch: Branch, rng: np.random.Generator, count: int) -> list[Array]:
    """Directions mostly across the branch; the second is the first reversed."""
    chord = unit(branch.grasp())
    out: list[Array] = []
    while len(out) < count:
        v = rng.normal(size=3)
        out.append(unit(v - 0.8 * (v @ chord) * chord))
    out[1] = -out[0]
    return out


def plan(branch: Branch, rng: np.random.Generator, t: Array, reach: float, hard: bool = False) -> list[dict[str, Any]]:
    """Six probes and replicates of the first two, each with its true force [T, 3]; ``reach`` in m."""
    duration, clock, out = float(t[-1]), float(rng.uniform(0, 3)), []
    profiles = rng.permutation(HARD_PROFILES).tolist() if hard else PROFILES
    for profile, direction in zip(profiles, _directions(branch, rng, len(PROFILES)), strict=True):
        history = (hard_shape if hard else shape)(profile, t, duration, rng)
        size = reach * rng.uniform(0.85, 1.1)
        force = peak_force(branch, direction, size) * history.reshape(len(t), -1)[:, :1] * direction
        if history.ndim > 1 and history[:, 1].any():
            side = unit(np.cross(direction, unit(branch.grasp())))
            force = force + peak_force(branch, side, size) * history[:, 1:] * side
        # Linear between samples: zero only from the first sample at zero on.
        last = int(np.flatnonzero(np.abs(force).max(axis=1) > 1e-12).max())
        spans = [[0.0, QUIET], [float(t[last + 1]), duration]] if last + 1 < len(t) else [[0.0, QUIET]]
        out.append({"profile": profile, "direction": direction.round(6).tolist(), "replicate_of": None,
                    "no_contact": spans, "force": force})  # fmt: skip
    out += [{**out[i], "replicate_of": i + 1} for i in range(2)]
    for i, item in enumerate(out):
        item.update(file=f"traj_{i + 1:02d}.csv", t_start_s=round(clock, 3))
        clock += duration + float(rng.uniform(18, 24))
    return out


def within_reach(branch: Branch, forces: Array, rate: float, **options: Any) -> tuple[Array, Motion]:
    """Weaken every force history [N, T, 3] that moves the grasp point by more than a third of the branch.

    Returns:
        The forces [N] and how the branch moves under them.
    """
    most = sum(branch.length) / 3
    for _ in range(6):
        motion = drive(branch, forces, rate, **options)
        peak = np.linalg.norm(motion.moved, axis=-1).max(axis=1)
        if not np.isfinite(peak).all():
            raise RuntimeError("the branch left the finite")
        if (peak <= most).all():
            return forces, motion
        forces = forces * np.minimum(1.0, 0.95 * most / peak)[:, None, None]
    return forces, drive(branch, forces, rate, **options)


class Experiment:
    """A random branch and what is done to it; everything random comes from one seed.

    Attributes:
        rng: Source of what is random; the noise is drawn from it last.
        branch: The branch.
        measured: The branch as ``meta.yaml`` has it.
        mounting: How the sensors sit, None as they should.
        noise: What the noise is like, None for white noise.
        rate: Sampling rate [Hz].
        time: Times of the samples [s], shape [T].
        recordings: What ``meta.yaml`` says of each recording.
        forces: True forces [N], shape [N, T, 3].
    """

    def __init__(
        self, seed: int, segments: int, rate: float | None, samples: int | None, reach: float, hard: Sequence[Hard] = ()
    ) -> None:
        self.seed, self.rng = seed, np.random.default_rng(seed)
        harder = {kind: np.random.default_rng([seed, 23, k]) for k, kind in enumerate(HARD)}
        branch = random_branch(self.rng, segments)
        self.branch = shaped(branch, harder["shape"]) if "shape" in hard else branch
        straight = replace(self.branch, bend=[], swell=[])
        self.measured = measured(straight, harder["geometry"]) if "geometry" in hard else straight
        self.mounting = mounting(harder["sensors"]) if "sensors" in hard else None
        drawn = float(self.rng.choice([20.0, 25.0, 40.0])) if rate is None else rate
        if "probes" in hard:
            drawn = rate or float(harder["probes"].choice(HARD_RATES[0], p=HARD_RATES[1]))
            samples = samples or min(MOST_SAMPLES, round(drawn * harder["probes"].uniform(3.0, 5.0)))
        self.rate = drawn
        self.noise = noise(harder["noise"], self.rate) if "noise" in hard else None
        self.time = np.arange(samples or SAMPLES) / self.rate
        wide = reach * sum(self.branch.length)
        self.recordings = plan(self.branch, self.rng, self.time, wide, "probes" in hard)
        self.forces = np.stack([r.pop("force") for r in self.recordings])

    @property
    def clock(self) -> Array:
        """Start of each recording on the absolute clock [s], shape [N]."""
        return np.array([r["t_start_s"] for r in self.recordings])

    @property
    def open_hand(self) -> Array:
        """Where the gripper is known to be open, shape [N, T]."""
        out = np.zeros(self.forces.shape[:2], dtype=bool)
        for k, item in enumerate(self.recordings):
            for start, end in item["no_contact"]:
                out[k] |= (self.time >= start - 1e-9) & (self.time <= end + 1e-9)
        return out

    def noisy(self, seen: Readings, noise: float) -> tuple[Array, list[float]]:
        """Return noisy readings, force, displacement, velocity [N, T, 9], and the noise's deviations [N, m, m/s]."""
        clean = (seen.force, seen.moved, seen.velocity)
        rms = [float(np.sqrt(np.mean(np.sum(c**2, axis=-1)) / 3)) for c in clean]
        sigma = [noise / 2 * rms[0], noise * rms[1], noise * rms[2]]
        if self.noise is None:
            noisy = [c + s * self.rng.normal(size=c.shape) for c, s in zip(clean, sigma, strict=True)]
        else:
            law, drawn = self.noise, [self.noise.draw(self.rng, c.shape) for c in clean]
            noisy = [law.rounded(c + s * d, s) for c, s, d in zip(clean, sigma, drawn, strict=True)]
        return np.concatenate(noisy, axis=-1), sigma


def write_case(folder: str | Path, experiment: Experiment, tables: Array, noise: float, answer: dict[str, Any]) -> None:
    """Write a case folder and ``<folder>_answer.json`` beside it, both whole or not at all.

    Args:
        folder: Case folder to write.
        experiment: What was done.
        tables: Readings of all recordings, shape [N, T, 9].
        noise: Noise to state, as a fraction of a channel's rms.
        answer: What the JSON holds.

    Raises:
        InputError: The folder or the file beside it cannot be written.
    """
    path = Path(folder).absolute()
    if not path.name:
        raise InputError(folder, "--out", "the root folder", "a folder below it")
    beside = path.with_name(path.name + "_answer.json")
    if beside.is_dir():
        raise InputError(beside, "--out", "a folder", "a file, or a path where one can be made")
    with output_folder(path) as work:
        for item, table in zip(experiment.recordings, tables, strict=True):
            rows = np.column_stack([experiment.time, table])
            np.savetxt(work / item["file"], rows, fmt="%.7g", delimiter=",", header=HEADER, comments="")
        # Through JSON, so that replicates do not become YAML aliases.
        meta = json.loads(json.dumps(_meta(experiment, noise)))
        (work / "meta.yaml").write_text(yaml.safe_dump(meta, sort_keys=False))
        fresh = work.with_name(work.name + ".json")
        fresh.write_text(json.dumps(answer, indent=1))
    os.replace(fresh, beside)


def make_branch_case(
    folder: str | Path,
    seed: int,
    *,
    segments: int = 3,
    noise: float = 0.03,
    sub: int = 3,
    wood: float = 0.08,
    dt: float = 2.5e-4,
    rate: float | None = None,
    samples: int = 110,
    reach: float = 0.22,
) -> dict[str, Any]:
    """Write a case folder in which nothing is hidden and ``<folder>_answer.json`` beside it; return the answer.

    Args:
        folder: Case folder to write.
        seed: Seed of everything random.
        segments: Number of segments R.
        noise: Noise on displacement and velocity as a fraction of their RMS over the case; force has half of it.
        sub: Sub-links per segment.
        wood: See `rig.build`.
        dt: Largest step [s].
        rate: Sampling rate [Hz]; drawn from 20, 25, 40 if None.
        samples: Samples per trajectory.
        reach: Peak displacement aimed at, as a fraction of the branch's length.
    """
    experiment = Experiment(seed, segments, rate, samples, reach)
    options = {"sub": sub, "wood": wood, "dt": dt}
    seen = recorded(experiment, options)
    tables, sigma = experiment.noisy(seen, noise)
    answer = truth(experiment, seen, sigma, noise, sub, wood)
    write_case(folder, experiment, tables, noise, answer)
    return answer


def recorded(experiment: Experiment, options: dict[str, Any]) -> Readings:
    """Keep the forces within reach and record the branch in which nothing is hidden."""
    forces, motion = within_reach(experiment.branch, experiment.forces, experiment.rate, **options)
    experiment.forces = forces
    return Readings(experiment.time, forces, motion.moved, motion.velocity, motion.turn)


def truth(
    experiment: Experiment, seen: Readings, sigma: list[float], noise: float, sub: int, wood: float
) -> dict[str, Any]:
    """Return the part of an answer on branch and noise."""
    branch = experiment.branch
    return {
        "seed": experiment.seed, "K": branch.stiffness, "D": branch.damping, "wood": wood, "sub_links": sub,
        "noise": noise, "sigma_force_N": sigma[0], "sigma_displacement_m": sigma[1], "sigma_velocity_mps": sigma[2],
        "peak_displacement_m": float(np.linalg.norm(seen.moved, axis=-1).max()), "branch": asdict(branch),
    }  # fmt: skip


def _meta(experiment: Experiment, noise: float) -> dict[str, Any]:
    branch, axes = experiment.measured, experiment.measured.axes()
    forks = np.degrees(np.arccos(np.clip((axes[1:] * axes[:-1]).sum(axis=1), -1, 1)))
    columns = zip(
        branch.names, branch.length, branch.radius_base, branch.radius_tip, branch.elevation, branch.azimuth,
        branch.mass().tolist(), strict=True,
    )  # fmt: skip
    keys = ("name", "length_m", "radius_base_m", "radius_tip_m", "elevation_deg", "azimuth_deg", "mass_kg")
    rounded = [[v if isinstance(v, str) else round(v, 6) for v in row] for row in columns]
    order = ("file", "profile", "direction", "t_start_s", "replicate_of", "no_contact")
    return {
        "format": "branch-gap-case/1", "sample_rate_hz": experiment.rate, "n_samples": len(experiment.time),
        "gravity_mps2": branch.gravity, "planar": False, "density_kgpm3": round(branch.density, 4),
        "base_position_m": [0.0, 0.0, 0.0], "trunk_pivot_below_base_m": TRUNK_PIVOT,
        "segments": [dict(zip(keys, row, strict=True)) for row in rounded],
        "fork_angles_deg": forks.round(4).tolist(),
        "grasp": {"segment": branch.names[-1], "distance_from_lower_end_m": round(branch.grasp_distance, 6)},
        "noise_nominal": noise or None, "trajectories": [{k: r[k] for k in order} for r in experiment.recordings],
        "conventions": "z up, world frame; rest pose = equilibrium under gravity",
    }  # fmt: skip
