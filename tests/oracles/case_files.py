"""Small case folders of either form, right as they stand, for tests that spoil them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import yaml
from bough.learn.cases.case import BRANCH_COLUMNS

RATE, SAMPLES = 25.0, 40


def branch_meta() -> dict:
    """Return a two-segment case that is right."""
    segment = {"length_m": 0.5, "radius_base_m": 0.02, "radius_tip_m": 0.015, "elevation_deg": 30.0,
               "azimuth_deg": 10.0, "mass_kg": 0.4}  # fmt: skip
    trajectory = {"profile": "steps", "direction": [0.0, 1.0, 0.0], "no_contact": [[0.0, 0.2], [1.0, 1.56]]}
    return {
        "format": "branch-gap-case/1", "sample_rate_hz": RATE, "n_samples": SAMPLES, "gravity_mps2": 9.81,
        "planar": False, "density_kgpm3": 800.0, "base_position_m": [0.0, 0.0, 0.5], "trunk_pivot_below_base_m": 1.0,
        "segments": [{"name": "parent", **segment}, {"name": "child", **segment, "azimuth_deg": 40.0}],
        "fork_angles_deg": [25.0], "grasp": {"segment": "child", "distance_from_lower_end_m": 0.4},
        "noise_nominal": None,
        "trajectories": [
            {"file": "a.csv", "t_start_s": 0.0, "replicate_of": None, **trajectory},
            {"file": "b.csv", "t_start_s": 20.0, "replicate_of": 1, **trajectory},
        ],
    }  # fmt: skip


def joint_meta() -> dict:
    """Return a driven pendulum that is right."""
    swing = {"name": "swing", "type": "revolute", "inertia": None, "stiffness": 0.0, "damping": None,
             "gravity_torque": {"amplitude": None, "zero_angle": 0.0}}  # fmt: skip
    return {
        "format": "joint-gap-case/1", "name": "rig", "mechanism": {"joints": [swing]},
        "input": {"joint": "swing", "column": "torque_mNm", "scale": 1e-3, "hold": "zero_order"},
        "outputs": [{"joint": "swing", "quantity": "position", "column": "angle_deg", "scale": 0.0174532925}],
        "trajectories": [{"file": "a.csv", "t_start_s": 0.0, "rows": [2, 30]}, {"file": "b.csv", "t_start_s": 9.0}],
        "split": {"train": [1], "test": [2]},
    }  # fmt: skip


def table(names: tuple[str, ...], seed: int = 0) -> list[list[str]]:
    """Header and rows of a CSV with a uniform clock and small random numbers."""
    values = np.random.default_rng(seed).normal(scale=0.01, size=(SAMPLES, len(names) - 1))
    rows = [[f"{i / RATE:.7g}", *(f"{v:.7g}" for v in row)] for i, row in enumerate(values)]
    return [list(names), *rows]


def write(folder: Path, meta: dict, tables: dict[str, list[list[str]]]) -> Path:
    folder.mkdir(exist_ok=True)
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta, sort_keys=False))
    for name, rows in tables.items():
        (folder / name).write_text("\n".join(",".join(row) for row in rows) + "\n")
    return folder


def write_branch(folder: Path, meta: dict | None = None, first: list[list[str]] | None = None) -> Path:
    tables = {"a.csv": first or table(BRANCH_COLUMNS), "b.csv": table(BRANCH_COLUMNS, 1)}
    return write(folder, meta or branch_meta(), tables)


JOINT_COLUMNS = ("time_s", "remark", "torque_mNm", "angle_deg")


def write_joint(folder: Path, meta: dict | None = None, first: list[list[str]] | None = None) -> Path:
    tables = {"a.csv": first or table(JOINT_COLUMNS), "b.csv": table(JOINT_COLUMNS, 1)}
    return write(folder, meta or joint_meta(), tables)


def make_planar(source: Path, folder: Path) -> None:
    """Copy a case with everything turned into the x-z plane and its y columns zeroed."""
    folder.mkdir()
    meta = yaml.safe_load((source / "meta.yaml").read_text())
    meta["planar"] = True
    for segment in meta["segments"]:
        segment["azimuth_deg"] = 0.0
    for trajectory in meta["trajectories"]:
        rows = np.loadtxt(source / trajectory["file"], delimiter=",", skiprows=1)
        rows[:, [2, 5, 8]] = 0.0
        text = "\n".join(",".join(f"{v:.7g}" for v in row) for row in rows)
        (folder / trajectory["file"]).write_text(f"{','.join(BRANCH_COLUMNS)}\n{text}\n")
        trajectory["direction"] = None
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta))
