"""Do two checkouts give the same results to the bit? Run it around a change that should change none.

    python tests/same_bits.py BEFORE AFTER [--out DIR]

BEFORE and AFTER are checkouts of the repository. A fixed set of commands runs in each (forests, trajectories in both
precisions, hidden cases, posteriors, verdicts, a training and its evaluation; some five minutes per checkout). Then
each number in every .npz, .json, .csv, .yaml and .xml file is compared. Prints a line for each file that differs and
ends with exit code 1 if there is one. What tells the time or the machine is left out (`PASSING`).
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

COMMANDS = (
    "forest --species Ta --count 8 --order 2 --noise 0.1 --seed 0 --out forest",
    "simulate forest/tree_0000.xml --bend 0.2 --worlds 16 --seconds 1 --precision 32 --out motion32",
    "simulate forest/tree_0001.xml --bend 0.2 --seconds 1 --effect dry_friction:torque_Nm=0.05 --out motion64",
    "hide --seed 1 --segments 2 --noise 0.03 --out plain",
    "identify plain --out identified",
    "identify plain --method mh --iterations 100 --out chains",
    "hide --effects quadratic_drag --seed 7 --out hidden",
    "diagnose hidden --out diagnosis",
    "simulate hidden --model diagnosis/model.yaml --out repaired",
    "forest --species Tb --count 2 --order 2 --seed 3 --posterior identified/posterior.npz --out wood",
    "train powerline --preset cpu --iterations 3 --num-envs 64 --seed 5 --out run",
    "evaluate run --sets 1 --worlds 32",
)
#: Keys and columns that differ from run to run: times, machine and commit.
PASSING = {"seconds", "started", "machine", "version", "versions", "source", "collect_seconds", "learn_seconds"}


def run(checkout: Path, out: Path) -> None:
    """Run all commands with a checkout's code, their output below ``out``."""
    name = out / "package"
    name.mkdir(parents=True)
    (name / "bough").symlink_to(checkout.resolve())
    environment = {**os.environ, "PYTHONPATH": str(name)}
    for command in COMMANDS:
        print(f"{checkout}: bough {command}", flush=True)
        done = subprocess.run(
            [sys.executable, "-m", "bough", *command.split()], cwd=out, env=environment, capture_output=True, text=True
        )
        if done.returncode not in (0, 3):
            sys.exit(f"bough {command} ended with {done.returncode}: {done.stderr}")


def numbers(path: Path) -> object:
    """Return what a file holds, in a form that compares to the bit."""
    if path.suffix == ".npz":
        with np.load(path, allow_pickle=False) as data:
            return {k: (v.shape, v.dtype.str, v.tobytes()) for k, v in data.items() if k not in PASSING}
    if path.suffix == ".json":
        return _lasting(json.loads(path.read_text()))
    if path.suffix == ".csv":
        rows = list(csv.DictReader(line for line in path.read_text().splitlines() if not line.startswith("#")))
        return [{k: v for k, v in row.items() if k not in PASSING} for row in rows]
    return path.read_bytes()


def _lasting(value: object) -> object:
    if isinstance(value, dict):
        return {k: _lasting(v) for k, v in value.items() if k not in PASSING}
    return [_lasting(v) for v in value] if isinstance(value, list) else value


def differences(before: Path, after: Path) -> list[str]:
    """Return a line for each file that is in one of two folders only, or holds other numbers."""
    kinds = {".npz", ".json", ".csv", ".yaml", ".xml"}
    found = [
        {p.relative_to(folder) for p in folder.rglob("*") if p.suffix in kinds and "package" not in p.parts}
        for folder in (before, after)
    ]
    lines = [f"{path}: in one only" for path in sorted(found[0] ^ found[1])]
    for path in sorted(found[0] & found[1]):
        a, b = numbers(before / path), numbers(after / path)
        if a != b:
            keys = [k for k in a if a[k] != b.get(k)] if isinstance(a, dict) and isinstance(b, dict) else []
            lines.append(f"{path}: differs {', '.join(map(str, keys))}")
    return lines


def main() -> int:
    """Run both checkouts and say what differs."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("before", type=Path)
    parser.add_argument("after", type=Path)
    parser.add_argument("--out", type=Path, help="where results are kept; a side that is there is not run again")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.out or Path(scratch)
        for side in ("before", "after"):
            if not (folder / side).exists():
                run(getattr(options, side), (folder / side).resolve())
        lines = differences(folder / "before", folder / "after")
    print("\n".join(lines) or "the same bits")
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
