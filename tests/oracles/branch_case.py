"""Make a measured branch with C MuJoCo, finer than any model that will be fitted to it.

The simulator is `bough.learn.hidden`, which shares nothing with the simulator under test; here it hides nothing.
Writes a ``branch-gap-case/1`` folder and, outside it, the truth as JSON.

    python tests/oracles/branch_case.py OUT --seed 1 --segments 3 --noise 0.03
"""

from __future__ import annotations

import argparse
from pathlib import Path

from bough.learn.hidden.branch import Branch, frustum_mass, random_branch
from bough.learn.hidden.drive import simulate
from bough.learn.hidden.probes import HEADER, PROFILES, QUIET, make_branch_case, peak_force, shape
from bough.learn.hidden.rig import build

__all__ = [
    "HEADER", "PROFILES", "QUIET", "Branch", "build", "frustum_mass", "make_branch_case", "peak_force",
    "random_branch", "shape", "simulate",
]  # fmt: skip


def main() -> None:
    """Write one case from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="case folder to write")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--segments", type=int, default=3)
    parser.add_argument("--noise", type=float, default=0.03, help="fraction of channel RMS")
    options = parser.parse_args()
    answer = make_branch_case(options.out, options.seed, segments=options.segments, noise=options.noise)
    print(f"{options.out}: {len(answer['K'])} segments, peak displacement {answer['peak_displacement_m']:.2f} m")


if __name__ == "__main__":
    main()
