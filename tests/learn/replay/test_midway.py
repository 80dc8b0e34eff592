"""Replays of branches are of second order: halved steps leave a quarter of the error, and dampers keep them stable."""

import numpy as np
import pytest
import torch
import yaml
from bough.learn.cases.case import load_case
from bough.learn.replay.recording import recordings
from bough.learn.replay.rollout import Rollout
from bough.learn.systems import branch
from bough.learn.systems.acting import Acting
from bough.learn.systems.branch import Unknowns
from bough.sim.effects import effect_of
from oracles.effect_case import stick_case

K, D = [30.0, 8.0], [0.25, 0.06]


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    """Pull and let go of a branch of two segments that turn by up to 0.5 rad."""
    t = np.arange(150) * 0.02
    pull = 8.0 * np.clip(np.minimum(t / 0.4, (1.6 - t) / 0.1), 0.0, 1.0)
    case = stick_case(tmp_path_factory.mktemp("pair"), [pull[:, None] * [0.5, 0.7, 0.4]])
    meta = yaml.safe_load((case.folder / "meta.yaml").read_text())
    meta["segments"].append({**meta["segments"][0], "name": "upper", "elevation_deg": 70.0, "azimuth_deg": 60.0})
    meta["grasp"]["segment"] = "upper"
    (case.folder / "meta.yaml").write_text(yaml.safe_dump(meta))
    return load_case(case.folder)


def motion(case, finer, laws):
    """Return displacement [m] and velocity [m/s] with steps a ``finer``-th as long, by either kernel."""
    acting = (Acting("cubic_stiffness", 0),) if laws else ()
    rollout = Rollout(case, recordings(case), 1, unknowns=Unknowns(effects=acting), finer=finer)
    neutral = [p.neutral for p in effect_of("cubic_stiffness").branch.parameters] if laws else []
    return rollout(torch.tensor([[*K, *D, *neutral]], dtype=torch.float64))[0, 0].double().numpy()


@pytest.mark.parametrize("laws", [False, True], ids=["plain", "with laws"])
def test_halved_steps_leave_a_quarter_of_the_error(pair, laws, monkeypatch):
    """See the error of steps of 10 and 5 ms fall by four (of first order by two), all in units of the motion's rms."""
    monkeypatch.setattr(branch, "LONGEST", 0.01)
    monkeypatch.setattr(branch, "TURN", 1.0)
    exact = motion(pair, 16, laws)
    size = np.sqrt(np.mean(exact**2, axis=0))
    assert np.linalg.norm(exact[:, :3], axis=1).max() > 0.15
    one, two = (np.sqrt(np.mean(((motion(pair, n, laws) - exact) / size) ** 2)) for n in (1, 2))
    assert one < 0.01 and 3.2 < one / two < 5.0, (one, two)


FRICTION = [(0.02, 0.0, 0.0, 1.0), (0.005, 0.0, 0.0, 1.0), (0.02, 1.0, 0.0, 1.0), (0.02, 0.0, 0.8, 0.5)]


@pytest.mark.parametrize("values", FRICTION)
def test_friction_acts_in_the_middle_of_a_step(pair, values, monkeypatch):
    """Be off by less than 0.4 % of the motion at steps of 2 ms: for two bends, gradual, and larger at rest.

    Friction at the end of its step, an effort late by half of one, is off by 0.6 to 1.1 %; four fifths of that are
    taken back.
    """
    monkeypatch.setattr(branch, "substep_of", lambda case: 2e-3)
    laws = Unknowns(effects=(Acting("dry_friction", 0),))
    row = torch.tensor([[*K, *D, 0.3, *values, 0.0, 0.0]], dtype=torch.float64)
    coarse, exact = (
        Rollout(pair, recordings(pair), 1, unknowns=laws, finer=n)(row)[0, 0].double().numpy() for n in (1, 16)
    )
    size = np.sqrt(np.mean(exact**2, axis=0))
    assert np.sqrt(np.mean(((coarse - exact) / size) ** 2)) < 0.004


def test_both_kernels_take_the_same_steps(pair):
    """Give the same motion with and without laws in the kernel."""
    np.testing.assert_allclose(motion(pair, 1, True), motion(pair, 1, False), atol=1e-6)


@pytest.mark.parametrize("relaxation", [0.6, 0.8, 1.0, 2.0, 100.0])
def test_a_joint_that_is_too_stiff_for_its_steps_stays_calm(pair, relaxation):
    """Stay within a tenth of the static bend, whatever the inertia, from the least damper of a ball joint on."""
    rollout = Rollout(pair, recordings(pair), 1, unknowns=Unknowns())
    h, spring = pair.dt / rollout.substeps, 3e5
    values = torch.tensor([[spring, spring, *[relaxation * h * spring] * 2]], dtype=torch.float64)
    out = rollout(values)[0, 0, :, :3].double().numpy()
    force = np.linalg.norm(pair.trajectories[0].force, axis=1).max()
    assert np.isfinite(out).all() and np.abs(out).max() < 3.0 * force * 1.0 / spring
