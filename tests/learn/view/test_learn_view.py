"""Shapes and clouds that a page shows of a case, against minimisation and against the replay itself."""

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

pytest.importorskip("viser", reason="the page in the browser needs viser (extra view)")

from bough.learn.cases.case import load_case
from bough.learn.replay.bend import bent
from bough.learn.view.case import CaseScene
from bough.learn.view.posterior import PosteriorScene
from bough.learn.view.replayed import Drawn, nominal, nominal_springs
from bough.sim.base.rotation import quat_rotate
from bough.sim.trees.measured import axis_rotation
from bough.sim.view.page import open_page
from oracles.branch_case import make_branch_case


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Return a branch of two segments, recorded by MuJoCo without noise."""
    folder = tmp_path_factory.mktemp("measured") / "case"
    make_branch_case(folder, 3, segments=2, samples=40, noise=0.0, rate=25.0)
    return load_case(folder)


@pytest.fixture
def page():
    """Serve an empty page at a free port."""
    made = open_page(0)
    yield made
    made.stop()


def held_point(case, position, rotation):
    """Return where the grasp point is, [T, 3]."""
    link, point = case.grasp
    return position[:, link] + quat_rotate(rotation[:, link], np.broadcast_to(point, position[:, link].shape))


def test_a_shape_is_the_least_bending_that_reaches(case):
    """Reach the held point to a micrometre, with an energy that SciPy's constrained minimiser does not undercut."""
    stiffness = np.array([20.0, 5.0])
    moved = case.trajectories[0].displacement[[10, 25]]
    position, rotation = bent(case, case.grasp, moved, stiffness)
    rest = bent(case, case.grasp, np.zeros((1, 3)), stiffness)
    target = held_point(case, *rest) + moved
    np.testing.assert_allclose(held_point(case, position, rotation), target, atol=1e-6)
    quats = axis_rotation(case.elevation, case.azimuth)
    straight = Rotation.from_quat(np.roll(quats, -1, axis=1))

    def reached(x):
        first = Rotation.from_rotvec(x[:3])
        second = first * Rotation.from_rotvec(x[3:])
        at = case.base_position + case.length[0] * (first * straight[0]).apply([0, 0, 1.0])
        return at + case.grasp_distance * (second * straight[1]).apply([0, 0, 1.0])

    for k in range(2):
        worlds = [Rotation.from_quat(np.roll(rotation[k, i], -1)) * straight[i].inv() for i in range(2)]
        own = [worlds[0].as_rotvec(), (worlds[0].inv() * worlds[1]).as_rotvec()]
        energy = sum(s * a @ a for s, a in zip(stiffness, own, strict=True))
        found = minimize(lambda x: stiffness[0] * x[:3] @ x[:3] + stiffness[1] * x[3:] @ x[3:], np.full(6, 1e-3),
                         constraints={"type": "eq", "fun": lambda x, k=k: reached(x) - target[k]}, method="SLSQP",
                         options={"ftol": 1e-12, "maxiter": 300})  # fmt: skip
        assert found.success
        # turns do not commute: our linearisation leaves out terms of the angle squared
        assert energy < found.fun * (1.0 + np.linalg.norm(found.x) ** 2 + 1e-4)


def test_a_case_is_off_by_what_its_replay_misses(case, page):
    """Say at a sample the distance between the model's held point and the measured one; colour by it."""
    told = nominal(case)
    scene = CaseScene(page, case, [told])
    scene._player.playing = False
    scene._player.time = 20 * case.dt
    scene.tick(0.0)
    off = np.linalg.norm(told.moved[0, 20] - case.trajectories[0].displacement[20])
    assert scene._said.value.endswith(f"off {100 * off:.2g} cm")
    tip = scene._arrows.points[0, 1]
    rest = bent(case, case.grasp, np.zeros((1, 3)), told.stiffness)
    np.testing.assert_allclose(tip, held_point(case, *rest)[0] + case.trajectories[0].displacement[20], atol=1e-5)


def test_a_cloud_of_one_and_the_same_branch_has_no_spread(case, page):
    """Draw two members with the nominal springs: both move as the nominal replay; a stiffer one moves less."""
    own = nominal_springs(case)
    names = tuple(f"stiffness {n}" for n in case.segment_name)
    scene = PosteriorScene(page, case, Drawn(names, np.stack([own, own, 4.0 * own])), case.folder)
    np.testing.assert_array_equal(scene.moved[0], scene.moved[1])
    np.testing.assert_allclose(scene.moved[0], nominal(case).moved, atol=1e-6)  # float32
    assert np.abs(scene.moved[2]).max() < 0.5 * np.abs(scene.moved[0]).max()
    scene._player.time = 10 * case.dt
    scene.tick(0.0)
    assert "spread" in scene._said.value
