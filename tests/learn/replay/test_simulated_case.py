"""Cases written by this simulator: against C MuJoCo, against their own replay, and in the noise they state."""

import numpy as np
import pytest
import torch
from bough.learn.replay.recording import recordings
from bough.learn.replay.rollout import Rollout
from bough.learn.replay.simulated_case import (
    Experiment,
    push_profile,
    random_branch,
    static_force,
    write_simulated_case,
)
from bough.learn.systems.branch import Unknowns
from oracles.branch_case import Branch, simulate

TRUTH = {"stiffness": np.array([70.0, 30.0]), "damping": np.array([1.2, 0.4])}
CLEAN = Experiment(samples=80, noise=0.0, force_noise=0.0)


@pytest.fixture(scope="module")
def meta():
    return random_branch(np.random.default_rng(2), 2)


@pytest.fixture(scope="module")
def clean(meta, tmp_path_factory):
    """Return a case without noise, held at two places."""
    folder = tmp_path_factory.mktemp("clean") / "case"
    return write_simulated_case(folder, meta, TRUTH, CLEAN, trajectories=3, seed=5, grasps=[0.9, 0.9, 0.5])


def test_case_says_how_it_was_made(clean, meta):
    """Load what was written: geometry, grasp points, and an open gripper after the release, where the force is zero."""
    last = meta["segments"][-1]["length_m"]
    assert clean.warnings == () and len(clean.trajectories) == 3
    np.testing.assert_allclose(clean.length, [s["length_m"] for s in meta["segments"]])
    np.testing.assert_allclose([t.grasp_distance / last for t in clean.trajectories], [0.9, 0.9, 0.5])
    for t in clean.trajectories:
        assert t.no_contact.any() and not t.no_contact[0]
        assert not t.force[t.no_contact].any() and np.abs(t.force[~t.no_contact]).max() > 0.1
        assert len(t.t) == 80 and np.isclose(clean.dt, 0.02)


def test_replay_without_noise(clean):
    """Reproduce a case without noise from its truth to the nine digits that are written, and not from another's."""
    values = torch.tensor(np.concatenate([TRUTH["stiffness"], TRUTH["damping"]]))[None]
    rollout, every = Rollout(clean, recordings(clean), 1), recordings(clean)
    measured = np.stack([r.output for r in every])
    # forces of nine digits and single precision: 1e-6 of the largest motion
    assert np.abs(rollout(values)[0].double().numpy() - measured).max() < 1e-5 * np.abs(measured).max()
    assert np.abs(rollout(1.02 * values)[0].double().numpy() - measured).max() > 1e-2 * np.abs(measured).max()


def test_motion_is_that_of_mujoco(clean, meta):
    """Move as C MuJoCo does with a tenth of the step, to 2.5 % of the largest displacement and 4 % of the velocity.

    A first-order step of 2.5 ms is half a step late, 1.25 ms: at 12 rad/s that is 1.5 % of a swing. The oracle's wood
    is eight cylinders a segment instead of a frustum, and bends by a thousandth.
    """
    rows = {k: [s[k] for s in meta["segments"]] for k in meta["segments"][0]}
    for t in clean.trajectories[:2]:
        branch = Branch(
            rows["length_m"], rows["radius_base_m"], rows["radius_tip_m"], rows["elevation_deg"], rows["azimuth_deg"],
            TRUTH["stiffness"].tolist(), TRUTH["damping"].tolist(), meta["density_kgpm3"], t.grasp_distance,
        )  # fmt: skip
        moved, velocity = simulate(branch, t.force[None], 1 / clean.dt, sub=8, wood=1e-3)
        assert np.abs(moved[0] - t.displacement).max() < 0.025 * np.abs(moved).max()
        assert np.abs(velocity[0] - t.velocity).max() < 0.04 * np.abs(velocity).max()


def test_noise_is_as_stated(meta, clean, tmp_path):
    """Add to a clean case white noise of the stated shares of each channel's rms, to three of their deviations.

    240 samples of three axes know a deviation to 1 / sqrt(2 x 720) = 2.6 %; the force is noisy in contact or not.
    """
    noisy = write_simulated_case(
        tmp_path / "case", meta, TRUTH, Experiment(samples=80, noise=0.03, force_noise=0.1), trajectories=3, seed=5,
        grasps=[0.9, 0.9, 0.5],
    )  # fmt: skip
    for name, share in (("force", 0.1), ("displacement", 0.03), ("velocity", 0.03)):
        before, after = (np.stack([getattr(t, name) for t in c.trajectories]) for c in (clean, noisy))
        touched = np.stack([~t.no_contact for t in clean.trajectories]) if name == "force" else ...
        rms = np.sqrt(np.mean(before[touched] ** 2))
        assert abs(np.std(after - before) / (share * rms) - 1.0) < 0.08
        a, b = (after - before)[:, 1:].ravel(), (after - before)[:, :-1].ravel()
        assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(len(a))


def test_force_has_half_of_the_noise(meta, clean, tmp_path):
    """Give the force half of the motion's share where nothing else is said."""
    experiment = Experiment(samples=80, noise=0.04)
    noisy = write_simulated_case(tmp_path / "case", meta, TRUTH, experiment, trajectories=3, seed=5)
    touched = np.concatenate([t.force[~t.no_contact] for t in noisy.trajectories])
    quiet = np.concatenate([t.force[t.no_contact] for t in noisy.trajectories])
    assert abs(quiet.std() / (0.02 * np.sqrt(np.mean(touched**2))) - 1.0) < 0.15


def test_planar_and_vertical_cases(tmp_path):
    """Leave the axis across a plane at exactly zero, and push along gravity alone where asked to."""
    meta = random_branch(np.random.default_rng(3), 2, planar=True)
    experiment = Experiment(samples=40, vertical=True, planar=True)
    case = write_simulated_case(
        tmp_path / "case", meta, TRUTH, experiment, trajectories=2, seed=0, unknowns=Unknowns("revolute")
    )
    assert case.planar
    for t in case.trajectories:
        assert not t.displacement[:, 1].any() and not t.velocity[:, 1].any() and not t.force[:, 1].any()
        assert np.abs(t.force[:, 0]).max() < 0.1 * np.abs(t.force[:, 2]).max()


def test_static_force_of_one_joint():
    """Return F = K d / l^2 of a single lever."""
    meta = {"segments": [{"length_m": 0.5}]}
    assert np.isclose(static_force(meta, np.array([20.0]), (0, 0.4), 0.1), 20.0 * 0.1 / 0.4**2)


def test_push_starts_and_ends_at_zero():
    """Rise from zero along one direction and be exactly zero once the gripper is open."""
    t = np.arange(200) / 50.0
    direction = np.array([0.6, 0.0, 0.8])
    force, closed = push_profile(np.random.default_rng(0), t, direction, 3.0)
    assert not force[0].any() and not force[~closed].any() and closed[0] and not closed[-1]
    assert 2.0 < np.linalg.norm(force, axis=1).max() < 3.9001
    np.testing.assert_allclose(np.cross(force, direction), 0.0, atol=1e-12)


def test_random_branches_taper():
    """Draw geometry in which every segment is thinner than the one below and weighs what its wood does."""
    for seed in range(5):
        meta = random_branch(np.random.default_rng(seed), 5)
        keys = ("length_m", "radius_base_m", "radius_tip_m", "mass_kg")
        length, a, b, mass = np.array([[s[k] for k in keys] for s in meta["segments"]]).T
        np.testing.assert_allclose(a[1:], b[:-1])
        solid = np.pi / 3 * length * (a * a + a * b + b * b)
        np.testing.assert_allclose(mass, meta["density_kgpm3"] * solid)
