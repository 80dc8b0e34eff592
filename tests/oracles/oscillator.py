"""Joint cases whose motion is known in closed form."""

from pathlib import Path

import numpy as np


def decay(t, inertia, stiffness, damping, q0, v0):
    """Angle and rate of J q'' + D q' + K q = 0 below critical damping, from q0 and v0."""
    a = damping / (2 * inertia)
    w = np.sqrt(stiffness / inertia - a * a)
    c, s = np.cos(w * t), np.sin(w * t)
    b = (v0 + a * q0) / w
    e = np.exp(-a * t)
    return e * (q0 * c + b * s), e * ((b * w - a * q0) * c - (q0 * w + a * b) * s)


def write_case(
    folder: Path, runs, *, noise=0.0, seed=0, dt=0.005, duration=3.0, inertia=2.0, stiffness=80.0, damping=1.5
):
    """Write a joint-gap-case of free decays, one a (q0, v0) pair; stiffness and damping are unknown in it."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(seed)
    t = np.arange(round(duration / dt) + 1) * dt
    for k, (q0, v0) in enumerate(runs):
        q, _ = decay(t, inertia, stiffness, damping, q0, v0)
        q = q + noise * rng.normal(size=q.shape)
        rows = "\n".join(f"{a:.4f},{b:.9f}" for a, b in zip(t, q, strict=True))
        (folder / f"run_{k + 1}.csv").write_text(f"time_s,angle_rad\n{rows}\n")
    listed = "\n".join(
        f"  - {{file: run_{k + 1}.csv, t_start_s: {10.0 * k}, replicate_of: null}}" for k in range(len(runs))
    )
    (folder / "meta.yaml").write_text(
        "format: joint-gap-case/1\nname: decay\nmechanism:\n  joints:\n"
        f"    - {{name: hinge, type: revolute, inertia: {inertia}, stiffness: null, damping: null}}\n"
        "input: null\noutputs:\n  - {joint: hinge, quantity: position, column: angle_rad, scale: 1.0}\n"
        f"trajectories:\n{listed}\nnoise_nominal: null\n"
    )
    return folder
