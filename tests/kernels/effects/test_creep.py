"""Creep of a branch from one recording to the next: beside one long recording that holds both and the time between."""

import numpy as np
import pytest
from oracles.effect_case import simulate, stick_case

K, D, DT = 1.0, 0.1, 0.02
PULL, GAP = 150, 200


def cut(folder, law, *, held=False):
    """Return what a long recording of a pull and a rest shows of its end, and the same as a second recording.

    The first recording ends while the pull lasts, where it is ``held``, or with the gripper open.
    """
    ends = PULL if held else PULL + 50
    force = np.zeros((PULL + GAP + ends, 3))
    force[:PULL] = [0.3, 0.5, 0.1]
    long = simulate(stick_case(folder / "long", [force], gravity=0.0), K, D, form="branch", viscoelastic_sls=law)[0]
    starts = [0.0, (PULL + GAP) * DT]
    parts = stick_case(folder / "parts", [force[:ends], force[PULL + GAP :]], gravity=0.0, starts=starts)
    return long, simulate(parts, K, D, form="branch", viscoelastic_sls=law)[1]


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize(
    "law",
    [
        {"share": 0.8, "relaxation_s": 3.0, "kept": 1.0},
        {"share": 19.0, "relaxation_s": 12.0, "second_share": 9.0, "second_relaxation_s": 0.5, "kept": 1.0},
    ],
    ids=["solid", "fluid"],
)
def test_creep_goes_on_between_recordings(tmp_path, law, held):
    """Stand where the long recording does, within an eightieth of its largest displacement.

    The time between goes by in 16 steps of 0.03 to 0.8 s. In each the joint is where it was before, and moves by four
    fifths of what is left to rest: a second element of 0.5 s is late by about a step of its own length, half of which
    comes back with the next.
    """
    long, second = cut(tmp_path, law, held=held)
    most = np.linalg.norm(long[:, :3], axis=1).max()
    tail = long[PULL + GAP :, :3]
    assert np.linalg.norm(tail[0]) > 0.1 * most
    assert np.linalg.norm(second[:, :3] - tail, axis=1).max() < 0.0125 * most


def test_creep_that_is_not_kept_begins_anew(tmp_path):
    """Begin every recording at rest where the share that is kept is nothing, as when nothing is said."""
    own = {"share": 0.8, "relaxation_s": 3.0}
    for law in (own, own | {"kept": 0.0}):
        long, second = cut(tmp_path, law)
        assert np.abs(second[:, :3]).max() < 1e-5 * np.abs(long[:, :3]).max()
