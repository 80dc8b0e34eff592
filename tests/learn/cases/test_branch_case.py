"""The case generator itself: against closed forms, at rest before the force, and in the format that is loaded."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml
from bough.learn.cases.case import load_case
from oracles.branch_case import Branch, build, make_branch_case, random_branch, simulate
from scipy.optimize import brentq

RATE = 25.0
STIFFNESS, LENGTH, GRASP = 12.0, 0.4, 0.3


def rod(gravity: float) -> Branch:
    """One cylinder that rises at 30 degrees in the x-z plane."""
    return Branch([LENGTH], [0.01], [0.01], [30.0], [0.0], [STIFFNESS], [1.0], 800.0, GRASP, gravity, ["rod"])


def settled(branch: Branch, force: np.ndarray, **options: float) -> np.ndarray:
    """Displacement under a constant force after 8 s, about a hundred time constants D / K."""
    ramp = np.clip(np.arange(200) / RATE, 0, 1)[:, None]
    return simulate(branch, (ramp * force)[None], RATE, **options)[0][0, -1]


def test_small_force_is_torque_over_stiffness() -> None:
    """Without gravity and bending, a small force across turns the rod by F l / K; tolerance (F l / K)^2 relative."""
    moved = settled(rod(0.0), np.array([0.0, 0.2, 0.0]), sub=1)
    angle = 0.2 * GRASP / STIFFNESS
    np.testing.assert_allclose(moved[1], GRASP * angle, rtol=angle**2)


def test_large_force_against_gravity() -> None:
    """Under gravity the settled angle solves K phi = F l cos(a) - m g l/2 (cos(a) - cos(30 deg)), a = 30 deg + phi.

    Vertical force F at distance l; the spring is wound up by the weight at rest. Relaxed to 1e-6 m; integrator error
    does not enter an equilibrium.
    """
    branch, force, start = rod(9.81), 15.0, np.radians(30.0)
    weight = float(branch.mass()[0]) * 9.81 * LENGTH / 2

    def torque(phi: float) -> float:
        lift = force * GRASP * np.cos(start + phi) - weight * (np.cos(start + phi) - np.cos(start))
        return STIFFNESS * phi - lift

    end = start + brentq(torque, 0.0, 1.0)
    expected = GRASP * np.array([np.cos(end) - np.cos(start), 0.0, np.sin(end) - np.sin(start)])
    np.testing.assert_allclose(settled(branch, np.array([0.0, 0.0, force]), sub=1), expected, atol=1e-6)


def test_wood_bends_by_the_stated_share() -> None:
    """Two inner joints, each (sub - 1) / wood times stiffer, add wood (l1^2 + l2^2) / (2 l^2) to a small deflection."""
    force = np.array([0.0, 0.2, 0.0])
    ratio = settled(rod(0.0), force, sub=3, wood=0.08)[1] / settled(rod(0.0), force, sub=1)[1]
    levers = GRASP - np.array([1, 2]) * LENGTH / 3
    expected = 1 + 0.08 / 2 * np.sum(levers**2) / GRASP**2
    assert abs(ratio - expected) < 1e-4


def test_rest_pose_is_an_equilibrium() -> None:
    """Random branches of one to four segments stay where they are under gravity until a force acts."""
    for segments in (1, 2, 3, 4):
        branch = random_branch(np.random.default_rng(segments), segments)
        model, data = build(branch)
        assert np.abs(data.qfrc_bias).max() > 0.01  # there is a load to carry
        moved, velocity = simulate(branch, np.zeros((1, 20, 3)), RATE)
        assert np.abs(moved).max() < 1e-9 and np.abs(velocity).max() < 1e-9
        assert model.nv == 9 * segments


def test_step_is_fine_enough() -> None:
    """Halving the default step moves a violent release by less than a tenth of 3 % noise."""
    branch = random_branch(np.random.default_rng(3), 3)
    time = np.arange(60) / RATE
    force = np.zeros((1, 60, 3))
    force[0, :, 1] = np.interp(time, [0.25, 1.0, 1.2, 1.21], [0, 8, 8, 0])
    coarse, fine = (simulate(branch, force, RATE, dt=dt)[0] for dt in (2.5e-4, 1.25e-4))
    assert np.sqrt(np.mean((coarse - fine) ** 2)) < 0.1 * 0.03 * np.sqrt(np.mean(fine**2))


@pytest.mark.parametrize("segments", [1, 3])
def test_written_case_loads(tmp_path: Path, segments: int) -> None:
    """The folder loads, is at rest in its open-gripper windows, and the answer lies outside it."""
    answer = make_branch_case(tmp_path / "case", 5, segments=segments, noise=0.0, dt=1e-3)
    case = load_case(tmp_path / "case")
    assert (tmp_path / "case_answer.json").is_file() and not list((tmp_path / "case").glob("*answer*"))
    assert case.warnings == () and case.num_segments == segments and len(case.trajectories) == 8
    np.testing.assert_allclose(case.mass, Branch(**answer["branch"]).mass(), rtol=1e-4)
    for item in case.trajectories:
        assert not item.force[item.no_contact].any() and item.no_contact[: int(0.25 / case.dt)].all()
        assert np.abs(item.displacement[0]).max() < 1e-9
    assert 0.05 < answer["peak_displacement_m"] / case.length.sum() < 0.35
    first, again = case.trajectories[0], case.trajectories[6]
    assert again.replicate_of == 0
    np.testing.assert_array_equal(first.force, again.force)


def test_seed_decides_everything(tmp_path: Path) -> None:
    """The same seed writes the same files, another seed another branch."""
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        make_branch_case(tmp_path / name, seed, segments=1, dt=2e-3)
    for file in ("meta.yaml", "traj_04.csv"):
        texts = [(tmp_path / name / file).read_text() for name in "abc"]
        assert texts[0] == texts[1] != texts[2]
    assert yaml.safe_load((tmp_path / "a" / "meta.yaml").read_text())["noise_nominal"] == 0.03
