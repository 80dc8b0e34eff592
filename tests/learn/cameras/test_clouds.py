"""From pictures to points: de-projection, colours, the arm cut out, thinning."""

from __future__ import annotations

import numpy as np
import pytest
from bough.learn.cameras.calibration import Mounted, plain_rig, read_rig
from bough.learn.cameras.clouds import beside, capsules_at, cloud_of, contract, deprojected, joined, thinned
from bough.learn.cameras.colours import ByColour, hue_of
from bough.learn.cameras.folder import FolderSource
from bough.learn.cameras.frames import Frame
from bough.sim.arms.jaco2 import jaco2
from bough.sim.base.errors import InputError
from bough.sim.base.rotation import quat_rotate
from bough.sim.cameras.camera import Cameras
from bough.sim.cameras.label import Label
from bough.sim.cameras.stereo import StereoDepth
from matplotlib.colors import rgb_to_hsv
from oracles.cameras.folder import BRANCH, LINE, SIZE, camera, shown_world, write_folder, written_rig

ARM = jaco2()


@pytest.fixture(scope="module")
def shots():
    """Take the same view as it is and as a D405 measures it."""
    eyes = [camera()]
    perfect = Cameras(SIZE[1], SIZE[0], stereo=StereoDepth.perfect()).shoot(shown_world(), eyes)
    return perfect, Cameras(SIZE[1], SIZE[0]).shoot(shown_world(), eyes)


def frame_of(shot) -> Frame:
    eye = camera()
    return Frame(0.0, shot.colour[0], shot.depth[0], eye.intrinsics, np.array(eye.position), np.array(eye.rotation))


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    return read_rig(written_rig(tmp_path_factory.mktemp("rig")))


def test_points_lie_on_what_was_seen(shots):
    """De-project every pixel with its true label: all lie on that body's surface, to float32 depths (1e-6 of 1 m)."""
    shot = shots[0]
    for kind, body in ((Label.BRANCH, BRANCH), (Label.LINE, LINE)):
        points = deprojected(frame_of(shot), shot.label[0] == kind)
        away = beside(points, body[0][None], body[1][None], np.array([body[2]]))
        assert len(points) > 100 and np.abs(away).max() < 2e-5
    arm = deprojected(frame_of(shot), shot.label[0] == Label.ROBOT)
    assert len(arm) > 1000 and np.abs(beside(arm, *capsules_at(ARM, ARM.home))).max() < 2e-5


def test_clouds_of_a_d405_keep_to_their_bodies(shots, rig):
    """Find branch and line by colour, nothing of arm and ground, within six deviations of the depth's noise."""
    frame = frame_of(shots[1])
    labels = ByColour(rig).label(frame)
    branches, line = cloud_of(frame, labels, rig, capsules_at(ARM, ARM.home))
    noise = 6 * StereoDepth().deviation(1.3)
    for points, body in ((branches, BRANCH), (line, LINE)):
        away = beside(points, body[0][None], body[1][None], np.array([body[2]]))
        assert len(points) > 50 and np.abs(away).max() < noise
    kept = [(labels == k)[(shots[1].label[0] == k) & (frame.depth > 0)].mean() for k in (Label.BRANCH, Label.LINE)]
    assert min(kept) > 0.97


def test_the_arm_is_cut_out_at_its_joints(shots, rig):
    """Leave the arm's points in without its model, and where the model is at other joints; none at its own."""
    frame = frame_of(shots[1])
    labels = ByColour(rig).label(frame)
    body = capsules_at(ARM, ARM.home)
    bare = cloud_of(frame, labels, rig, None)[0]
    wrong = cloud_of(frame, labels, rig, capsules_at(ARM, ARM.home + 1.5 * np.eye(6)[0]))[0]
    right = cloud_of(frame, labels, rig, body)[0]
    on_arm = [(beside(points, *body) < 0.02).sum() for points in (bare, wrong, right)]
    assert on_arm[0] > 500 and on_arm[1] > 100 and on_arm[2] == 0


def test_hues_are_those_of_another_library():
    """Agree with matplotlib's HSV, to float64's rounding over the circle."""
    colours = np.random.default_rng(0).random((200, 3))
    hue, saturation = hue_of(colours)
    other = rgb_to_hsv(colours)
    np.testing.assert_allclose(np.cos(np.radians(hue)), np.cos(2 * np.pi * other[:, 0]), atol=1e-9)
    np.testing.assert_allclose(saturation, other[:, 1], atol=1e-12)
    assert hue_of(np.zeros((1, 3)))[1] == 0


def test_thinning_evens_out_how_closely_a_surface_is_seen():
    """Keep one mean point in each cell, however many there were."""
    random = np.random.default_rng(1)
    close = random.random((5000, 3)) * 0.1
    out = thinned(np.concatenate([close, [[1.0, 1.0, 1.0]]]), 0.05)
    assert out.dtype == np.float32 and len(out) == 9
    np.testing.assert_allclose(out[np.linalg.norm(out, axis=1) < 0.05], [[0.025] * 3], atol=0.002)
    assert len(thinned(np.zeros((0, 3)), 0.05)) == 0


def test_a_contract_s_cloud_has_its_size():
    """Draw without repetition from many, all of few at least once, none of none."""
    random = np.random.default_rng(2)
    many, few = (random.random((n, 3)).astype(np.float32) for n in (700, 100))
    assert len(np.unique(contract(many, 512, random), axis=0)) == 512
    drawn = contract(few, 512, random)
    assert len(drawn) == 512 and len(np.unique(drawn, axis=0)) == 100
    assert contract(few[:0], 512, random).shape == (0, 3)


def test_clouds_of_several_cameras_are_as_old_as_the_oldest():
    """Join points, and take the oldest time."""
    one, two = np.array([[0.0, 0, 0]]), np.array([[1.0, 0, 0]])
    clouds = joined([(2.0, one, two), (1.5, two, two[:0])], 0.01)
    assert clouds.time == 1.5 and len(clouds.branches) == 2 and len(clouds.line) == 1


def test_a_camera_on_the_hand_moves_with_it():
    """Place a camera by the hand's pose; there is none without a hand."""
    mounted = Mounted(name="hand", mount="hand", position_m=[0.0, 0.0, 0.1], rotation=[1.0, 0.0, 0.0, 0.0])
    turn = np.array([np.sqrt(0.5), np.sqrt(0.5), 0.0, 0.0])
    position, rotation = mounted.pose((np.array([1.0, 2.0, 3.0]), turn))
    np.testing.assert_allclose(position, [1.0, 1.9, 3.0], atol=1e-12)
    np.testing.assert_allclose(quat_rotate(rotation, np.array([0.0, 0.0, 1.0])), [0.0, -1.0, 0.0], atol=1e-12)
    assert mounted.pose(None) is None
    assert plain_rig([mounted]).cameras == (mounted,)


BAD = {
    "rotation": ("rotation", [1.0, 1.0, 0.0, 0.0]), "intrinsics": ("intrinsics_px", [0.0, 1.0, 1.0, 1.0]),
    "name": ("name", "a name with spaces"), "unknown": ("colour", "red"),
}  # fmt: skip


@pytest.mark.parametrize("wrong", BAD)
def test_calibrations_that_cannot_be(tmp_path, wrong):
    """Refuse what is no rotation, no lens, no name, no key."""
    with pytest.raises(InputError, match=r"cameras\.yaml"):
        read_rig(written_rig(tmp_path, **dict([BAD[wrong]])))


def test_a_folder_is_played_as_it_was_recorded(tmp_path):
    """Give back colour to the bit, depth to float32, joints, and times a thirtieth apart; then end."""
    shots = write_folder(tmp_path)
    source = FolderSource(tmp_path, read_rig(tmp_path / "cameras.yaml"))
    assert source.sizes == (SIZE,) and len(source) == 4
    for play in (source.still, source.frames):
        taken = list(play())
        assert [round(t.time - taken[0].time, 3) for t in taken] == [0.0, 0.033, 0.067, 0.1]
        np.testing.assert_array_equal(taken[1].colour, shots[1].colour[0])
        np.testing.assert_array_equal(taken[1].depth, shots[1].depth[0])
        np.testing.assert_allclose(taken[1].q, ARM.home, atol=1e-6)


def _rows(folder, old, new):
    path = folder / "frames.csv"
    path.write_text(path.read_text().replace(old, new))


@pytest.mark.parametrize("old, new, word", [
    ("time_s,camera", "time,camera", "header"), ("0.0333,side", "0.0333,other", "camera"), ("0.0333", "nan", "number"),
    ("0.0333,side", "9.0,side", "go back"), ("0.0333,side,1.png", "0.0333,side,../1.png", "no file"),
    ("1.npz", "frames.csv", "depths"),
])  # fmt: skip
def test_folders_that_cannot_be_read(tmp_path, old, new, word):
    """Refuse wrong columns, cameras, times, files outside of the folder, and depths that are none."""
    write_folder(tmp_path)
    _rows(tmp_path, old, new)
    with pytest.raises(InputError, match=word):
        list(FolderSource(tmp_path, read_rig(tmp_path / "cameras.yaml")).still())
