"""What is put on a page: capsules where they belong, motions at their times, sliders and drags as forces."""

import asyncio
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("viser", reason="the page in the browser needs viser (extra view)")

from bough.sim.base.errors import InputError
from bough.sim.base.rotation import quat_rotate
from bough.sim.engine.trajectory import Trajectory, capsules_of
from bough.sim.formats.export_mesh import shape_ends
from bough.sim.trees.species import grow_forest
from bough.sim.view.grove import grove_of, rest_frames, side_by_side
from bough.sim.view.living import Living, Planted
from bough.sim.view.page import open_page
from bough.sim.view.recorded import Recorded
from bough.sim.view.wood import Wood
from oracles.rods import rod, slider


@pytest.fixture
def page():
    """Serve an empty page at a free port."""
    made = open_page(0)
    yield made
    made.stop()


@pytest.mark.parametrize(("trees", "sides"), [(1, 8), (100, 5)])
def test_rods_reach_from_end_to_end(page, trees, sides):
    """Find every corner of every rod's mesh within 8 % of its radius from the cone between the capsule's ends."""
    tree = grow_forest("Ta", count=1, order=2, noise=0.1, seed=0)[0]
    start, end = (np.tile(ends, (trees, 1)) for ends in shape_ends(tree))
    radii = np.tile(tree.shape_radius, (trees, 1))
    wood = Wood(page.server.scene, "/wood", (start, end), radii, np.full((len(start), 3), 0.5))
    assert {len(handle.vertices) for handle in wood.rods} == {2 * sides}
    assert sorted(np.concatenate(wood.members).tolist()) == list(range(len(start)))
    for handle, chosen in zip(wood.rods, wood.members, strict=True):
        for n, c in enumerate(chosen):
            corners = handle.vertices * handle.batched_scales[n]
            at = quat_rotate(handle.batched_wxyzs[n].astype(float), corners) + handle.batched_positions[n]
            axis = end[c] - start[c]
            share = (at - start[c]) @ axis / (axis @ axis)
            away = np.linalg.norm(at - start[c] - share[:, None] * axis, axis=1)
            radius = np.interp(share, [0.0, 1.0], radii[c])
            assert np.abs(np.abs(share - 0.5) - 0.5).max() < 1e-5  # float32 of the page
            # tapers are drawn with the nearest of five, no two more than 0.25 apart
            assert np.abs(away - radius).max() < 0.126 * radii[c].max() + 1e-6


def test_worlds_stand_apart():
    """Let no two of nine equal trees on the grid be closer than one is wide."""
    trees = grow_forest("Ta", count=9, order=2, noise=0.0, seed=0)
    grove, frames = grove_of(trees), rest_frames(trees)
    place = side_by_side(grove, *frames)
    start, end = shape_ends(trees[0])
    wide = np.ptp(np.concatenate([start, end])[:, :2], axis=0).max()
    gaps = np.linalg.norm(place[:, None] - place[None], axis=2)[np.triu_indices(9, 1)]
    assert gaps.min() > wide


def test_a_recorded_motion_is_where_it_was(page, tmp_path):
    """Draw a rod that slides along x at 2 m/s at the middle of two records, and at scrubbed times."""
    tree, time = rod(1.0), np.array([0.0, 0.1, 0.2])
    pos = np.zeros((3, 2, 1, 3))
    pos[:, :, 0, 0] = 2.0 * time[:, None]
    quat = np.tile([1.0, 0.0, 0.0, 0.0], (3, 2, 1, 1))
    Trajectory(time, ["rod"], pos, quat, np.full(2, np.nan)).save(tmp_path / "trajectory.npz", tree)
    scene = Recorded(page, tmp_path / "trajectory.npz")
    apart = scene.ends(0.0)[0]
    np.testing.assert_allclose(scene.ends(0.05)[0] - apart, [[0.1, 0, 0]] * 2, atol=1e-12)
    np.testing.assert_allclose(scene.ends(0.2)[1] - scene.ends(0.2)[0], [[0, 0, 1.0]] * 2, atol=1e-12)
    scene.tick(0.15)
    np.testing.assert_allclose(scene._wood.balls.batched_positions - apart, [[0.3, 0, 1.0]] * 2, atol=1e-6)
    scene._player.play(False)
    scene.tick(1.0)
    assert scene._player.time == pytest.approx(0.15)


def test_capsules_follow_names():
    """Number capsules by the bodies of a file, which leaves massless links out."""
    tree = grow_forest("Ta", count=1, order=1, noise=0.0, seed=0)[0]
    kept = tree.link_name[1:]
    found = capsules_of(tree, kept)
    assert [kept[i] for i in found["capsule_body"]] == [tree.link_name[i] for i in tree.shape_link if i > 0]


def settle(scene: Living, seconds: float = 3.0) -> np.ndarray:
    """Let a live scene go on; return where the rod's end is."""
    for _ in range(round(30 * seconds)):
        scene.tick(1.0 / 30.0)
    return np.array(scene.wood.balls.batched_positions[0], np.float64)


def test_sliders_and_a_drag_bend_a_rod_as_much_as_statics_says(page):
    """Compare wind, a drag and twice the spring with the rod's moment balance; no gravity.

    Wind of 10 m/s: 60 Pa on 0.035 m^2, at 0.476 m, across the rod: K a = q A h cos^2 a. A drag of 0.4 m at 5 N/m:
    K a = F cos a. Tolerance: what is left of the motion after 3 s at a time constant of 0.18 s, and float32.
    """
    stiffness = 4.0
    scene = Living(page, Planted([rod(stiffness)], np.zeros(3)), laws=())
    scene.start()
    np.testing.assert_allclose(settle(scene, 0.5), [0, 0, 1.0], atol=1e-5)
    slider(page, "wind [m/s]").value = 10.0
    height = (0.02 + 2 * 0.015) / (3 * (0.02 + 0.015))
    angle = 0.0
    for _ in range(50):
        angle = 60.0 * 0.035 * height * np.cos(angle) ** 2 / stiffness
    np.testing.assert_allclose(settle(scene), [np.sin(angle), 0, np.cos(angle)], atol=1e-4)
    slider(page, "wind [m/s]").value = 0.0
    settle(scene)
    slider(page, "pull [N per m of drag]").value = 5.0
    drag(scene, "start", [0, 0, 1.0], [0, 0.01, 1.0])
    drag(scene, "update", [0, 0, 1.0], [0, 0.4, 1.0])
    for factor in (1.0, 2.0):
        slider(page, "springs ×").value = factor
        for _ in range(50):
            angle = 2.0 * np.cos(angle) / (factor * stiffness)
        np.testing.assert_allclose(settle(scene), [0, np.sin(angle), np.cos(angle)], atol=1e-4)
    assert "pull 2 N" in scene._said.value
    drag(scene, "end", [0, 0, 1.0], [0, 0.4, 1.0])
    np.testing.assert_allclose(settle(scene), [0, 0, 1.0], atol=1e-4)


def drag(scene: Living, phase: str, start: list, end: list) -> None:
    """Say to the rod's handle what the page says of a drag."""
    handle = scene.wood.rods[0]
    event = SimpleNamespace(phase=phase, instance_index=0, start_position=start, end_position=end)
    for entry in handle._impl.drag_cb:
        asyncio.run(entry.callback(event))


def test_ports_and_laws_are_checked(page):
    """Refuse a port that is taken or does not exist, and a law that a forest cannot have."""
    with pytest.raises(InputError, match=r"--port: found \d+, which is taken; allowed: one that is free"):
        open_page(page.port)
    with pytest.raises(InputError, match="--port: found 70000"):
        open_page(70000)
    with pytest.raises(InputError, match="--law"):
        Living(page, Planted([rod(1.0)], np.zeros(3)), laws=("force_bias",))
    assert page.server.get_host() == "127.0.0.1"
