"""Cases made by this simulator itself: truth of the model's own structure, for calibration and for chapter 3.

Everything a case folder holds is written and read back, so that such cases go the same way as measured ones. What a
branch of another structure does to identification is the business of cases from another simulator.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml

from ...sim.base.types import Array
from ..cases.case import BRANCH_COLUMNS, BranchCase, load_case
from ..systems.branch import Unknowns
from .recording import Recording
from .rollout import Rollout

NAMES = ("trunk", "limb", "branch", "twig")


@dataclass(frozen=True)
class Experiment:
    """How a simulated branch is probed.

    Attributes:
        samples: Samples per trajectory.
        rate: Sampling rate [Hz].
        noise: Standard deviation of the noise on displacement and velocity, as a share of the channel's rms; the
            force has half of it.
        force_noise: Share for the force instead, as a fraction of its rms.
        vertical: Push along gravity only, as the thesis does; else in all directions.
        deflection: Typical displacement that a push is meant to cause [m].
        planar: The branch lies and moves in the x-z plane.
    """

    samples: int = 110
    rate: float = 50.0
    noise: float = 0.03
    force_noise: float | None = None
    vertical: bool = False
    deflection: float = 0.1
    planar: bool = False


def random_branch(rng: np.random.Generator, segments: int, *, planar: bool = False) -> dict[str, Any]:
    """Return the geometry keys of a ``meta.yaml`` for a random branch; each segment thinner than the one below."""
    length = rng.uniform(0.35, 0.6, segments)
    radius = 0.02 * rng.uniform(0.75, 1.25) * 0.72 ** np.arange(segments + 1)
    elevation = np.clip(rng.uniform(15, 60) + rng.normal(0.0, 15.0, segments).cumsum(), -20, 80)
    azimuth = np.zeros(segments) if planar else rng.normal(0.0, 20.0, segments).cumsum()
    density = float(rng.uniform(700, 1000))
    a, b = radius[:-1], radius[1:]
    mass = density * np.pi * length * (a * a + a * b + b * b) / 3
    rows = zip(NAMES[-segments:] if segments <= 4 else [f"segment{i}" for i in range(segments)],
               length, a, b, elevation, azimuth, mass, strict=True)  # fmt: skip
    keys = ("name", "length_m", "radius_base_m", "radius_tip_m", "elevation_deg", "azimuth_deg", "mass_kg")
    return {
        "gravity_mps2": 9.81, "density_kgpm3": density, "base_position_m": [0.0, 0.0, 1.0], "planar": planar,
        "segments": [dict(zip(keys, [r[0], *map(float, r[1:])], strict=True)) for r in rows],
    }  # fmt: skip


def push_profile(rng: np.random.Generator, t: Array, direction: Array, size: float) -> tuple[Array, Array]:
    """Return a random push [T, 3], a smooth rise, a wobbling hold, a release, and where the gripper is closed [T]."""
    rise, hold = rng.uniform(0.1, 0.3) * t[-1], rng.uniform(0.15, 0.4) * t[-1]
    up = np.clip(t / rise, 0.0, 1.0)
    shape = up * up * (3 - 2 * up) * (1 + 0.3 * np.sin(2 * np.pi * rng.uniform(0.5, 3.0) * t + rng.uniform(0, 6.28)))
    let_go = rise + hold
    closed = t <= let_go
    return size * np.where(closed, shape, 0.0)[:, None] * direction, closed


def static_force(meta: dict[str, Any], stiffness: Array, grasp: tuple[int, float], deflection: float) -> float:
    """Return the force [N] that moves the grasp point about ``deflection``: levers in series, sum of l^2 / K."""
    length = np.array([s["length_m"] for s in meta["segments"]])
    lever = np.array([length[i : grasp[0]].sum() + grasp[1] for i in range(grasp[0] + 1)])
    return float(deflection / np.sum(lever**2 / stiffness[: grasp[0] + 1]))


def write_simulated_case(
    folder: Path, meta: dict[str, Any], truth: dict[str, Array], experiment: Experiment, *, trajectories: int,
    seed: int, grasps: Sequence[float] | None = None, unknowns: Unknowns | None = None, name: str = "simulated",
) -> BranchCase:  # fmt: skip
    """Simulate a branch under random pushes, write it as a case folder and return the case as loaded.

    Args:
        folder: Folder to make.
        meta: From `random_branch`.
        truth: ``stiffness`` and ``damping``, shapes [R].
        experiment: How it is probed.
        trajectories: Their number.
        seed: Of pushes and noise.
        grasps: Grasp point of every trajectory as a share of the last segment's length; 0.9 where None.
        unknowns: Joints of the simulated branch (its ``infer`` must be stiffness and damping).
        name: Name of the case.
    """
    rng = np.random.default_rng(seed)
    last = meta["segments"][-1]
    places = [0.9] * trajectories if grasps is None else list(grasps)
    t = np.arange(experiment.samples) / experiment.rate
    pushes = [_push(rng, meta, truth, experiment, t, p * last["length_m"]) for p in places]
    rows = [np.column_stack([t, f, np.zeros((len(t), 6))]) for f, _ in pushes]
    items = [
        _item(i, len(t), experiment.rate, closed, t, last["name"], p * last["length_m"])
        for i, (p, (_, closed)) in enumerate(zip(places, pushes, strict=True))
    ]
    full = _meta(meta, experiment, items, name)
    clean = np.stack([r[:, 4:] for r in rows])
    for _ in range(2):  # the second time with steps as short as what then moves needs, see `BranchSystem`
        _write(folder, full, [np.column_stack([r[:, :4], c]) for r, c in zip(rows, clean, strict=True)])
        clean = _simulate(load_case(folder), rows, truth, unknowns)
    _write(folder, full, _noisy(rng, rows, clean, [c for _, c in pushes], experiment))
    case = load_case(folder)
    assert isinstance(case, BranchCase)
    return case


def _push(
    rng: np.random.Generator, meta: dict[str, Any], truth: dict[str, Array], e: Experiment, t: Array, place: float
) -> tuple[Array, Array]:
    direction = np.array([0.0, 0.0, -1.0])
    if not e.vertical:
        direction = rng.normal(size=3) * ([1.0, 0.0, 1.0] if e.planar else [1.0, 1.0, 1.0])
        direction /= np.linalg.norm(direction)
    size = static_force(meta, np.asarray(truth["stiffness"]), (len(meta["segments"]) - 1, place), e.deflection)
    return push_profile(rng, t, direction, size * rng.uniform(0.6, 1.4))


def _item(i: int, samples: int, rate: float, closed: Array, t: Array, segment: str, place: float) -> dict[str, Any]:
    last = float(t[closed][-1])
    free = [[last + 1.0 / rate, float(t[-1])]] if not closed[-1] else []
    return {
        "file": f"traj_{i + 1:02d}.csv", "profile": "push_release", "t_start_s": i * (samples / rate + 5.0),
        "no_contact": free, "grasp": {"segment": segment, "distance_from_lower_end_m": float(place)},
    }  # fmt: skip


def _meta(meta: dict[str, Any], e: Experiment, items: list[dict[str, Any]], name: str) -> dict[str, Any]:
    return {
        "format": "branch-gap-case/1", "name": name, "sample_rate_hz": e.rate, "n_samples": e.samples, **meta,
        "grasp": items[0]["grasp"], "noise_nominal": e.noise, "trajectories": items,
    }  # fmt: skip


def _simulate(case: Any, rows: list[Array], truth: dict[str, Array], unknowns: Unknowns | None) -> Array:
    """Clean channels [trajectories, T, 6]."""
    chosen = [
        Recording(t.t, r[:, 1:4], r[:, 4:], np.zeros((0, 2)), ~t.no_contact, t.grasp, t.t_start)
        for t, r in zip(case.trajectories, rows, strict=True)
    ]
    values = torch.tensor(np.concatenate([truth["stiffness"], truth["damping"]]))[None]
    return np.asarray(Rollout(case, chosen, 1, unknowns=unknowns)(values)[0].double().cpu().numpy())


def _noisy(
    rng: np.random.Generator, rows: list[Array], clean: Array, closed: list[Array], e: Experiment
) -> list[Array]:
    """Add white noise, one deviation a kind of channel for the whole case, pooled over the axes that move."""
    axes = [0, 2] if e.planar else [0, 1, 2]
    force = np.concatenate([r[c, 1:4] for r, c in zip(rows, closed, strict=True)])
    share = 0.5 * e.noise if e.force_noise is None else e.force_noise
    sigma = [share * np.sqrt(np.mean(force[:, axes] ** 2))]
    sigma += [e.noise * np.sqrt(np.mean(clean[..., [k + a for a in axes]] ** 2)) for k in (0, 3)]
    out = []
    for r, c in zip(rows, clean, strict=True):
        noise = rng.normal(size=(len(r), 9)) * np.repeat(sigma, 3)
        noise[:, [k + a for k in (0, 3, 6) for a in {0, 1, 2} - set(axes)]] = 0.0
        out.append(np.column_stack([r[:, 0], r[:, 1:4] + noise[:, :3], c + noise[:, 3:]]))
    return out


def _write(folder: Path, meta: dict[str, Any], rows: list[Array]) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta, sort_keys=False))
    for item, data in zip(meta["trajectories"], rows, strict=True):
        text = "\n".join(",".join(f"{v:.9g}" for v in row) for row in data)
        (folder / item["file"]).write_text(",".join(BRANCH_COLUMNS) + "\n" + text + "\n")
