"""How often the diagnosis of an arm is right: servos of another simulator that lack something, named or not.

    PYTHONPATH=tests python tests/arm_exam.py FIRST LAST

For every seed from FIRST to below LAST, each kind of `KINDS` is hidden in MuJoCo's Jaco 2 (`oracles.robot.hidden_arm`),
12 free recordings of 8 s are made at 10 Hz, and diagnosed. Prints a line for each case, and the counts.
"""

import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from bough.learn.arms.diagnose import diagnose_arm
from bough.learn.cases.arm import load_arm_case
from oracles.robot.hidden_arm import Hidden, at, make_case

#: Drawn by a generator and a joint; friction is felt by the torque sensor or not.
KINDS = {
    "nothing": lambda r, j: Hidden(behind=bool(r.integers(2))),
    "friction, felt": lambda r, j: Hidden(friction=at(j, r.uniform(1.5, 5.0))),
    "friction, not felt": lambda r, j: Hidden(friction=at(j, r.uniform(2.0, 5.0)), behind=True),
    "weight": lambda r, j: Hidden(weight=at(int(r.integers(1, 3)), r.choice([-1, 1]) * r.uniform(0.08, 0.3))),
    "delay": lambda r, j: Hidden(delay=at(j, r.uniform(0.05, 0.2))),
    "play": lambda r, j: Hidden(play=at(0, r.uniform(0.02, 0.06))),
    "gain": lambda r, j: Hidden(gain=at(j % 3, r.uniform(15.0, 40.0), 80.0)),
    "delay and friction": lambda r, j: Hidden(
        delay=np.full(6, r.uniform(0.08, 0.15)), friction=np.full(6, r.uniform(3.0, 5.0)), behind=True
    ),
    "lag": lambda r, j: Hidden(lag=at(j, r.uniform(0.15, 0.4))),
    "slow": lambda r, j: Hidden(slow=at(j, r.uniform(0.6, 0.85), 1.0)),
    "ripple (no name)": lambda r, j: Hidden(ripple=at(j, r.uniform(2.0, 4.0))),
    "cable (no name)": lambda r, j: Hidden(cable=at(j, r.uniform(2.0, 5.0))),
}
#: The name of each field of `Hidden`, and what it is where nothing is hidden.
NAMES = {
    "friction": ("dry_friction", 0.0), "weight": ("gravity_comp_error", 0.0), "delay": ("time_delay", 0.0),
    "play": ("backlash", 0.0), "gain": ("servo_gain", 80.0), "lag": ("servo_lag", 0.0), "slow": ("speed_scale", 1.0),
}  # fmt: skip


def truth(hidden: Hidden) -> set[tuple[str, int]]:
    """Return the names that are hidden, each with its joint."""
    return {(name, int(j)) for key, (name, usual) in NAMES.items()
            for j in np.flatnonzero(getattr(hidden, key) != usual)}  # fmt: skip


def graded(kind: str, seed: int) -> str:
    """Hide, record, diagnose, print; return the grade.

    A loose joint's link also rubs (`hidden_arm.LINK_FRICTION`): friction named there is no mistake.
    """
    number = list(KINDS).index(kind)
    rng = np.random.default_rng([seed, number])
    hidden = KINDS[kind](rng, int(rng.integers(6)))
    with tempfile.TemporaryDirectory() as folder:
        case = load_arm_case(make_case(Path(folder) / "case", hidden, seed=[seed, number, 7]))
        found = diagnose_arm(case)
    wanted, named = truth(hidden), {(n.name, c.joint) for c, n in found.claimed}
    forgiven = {("dry_friction", 0)} if kind == "play" else set()
    wrong = named - wanted - forgiven
    grade = "wrong name" if wrong else "right" if named and wanted <= named else "in part" if named else found.verdict
    print(f"{kind} {seed}: {grade}; hidden {sorted(wanted)}, named {sorted(named)}", flush=True)
    return grade


def main() -> None:
    """Hold the exam and print the counts."""
    first, last = int(sys.argv[1]), int(sys.argv[2])
    began = time.process_time()
    for kind in KINDS:
        grades = Counter(graded(kind, seed) for seed in range(first, last))
        print(f"== {kind}: {dict(grades)}", flush=True)
    print(f"{time.process_time() - began:.0f} s of processor time")


if __name__ == "__main__":
    main()
