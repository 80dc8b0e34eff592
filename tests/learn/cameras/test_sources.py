"""Where pictures come from: a twin's service, ROS bags, RealSense cameras, and what is refused."""

from __future__ import annotations

import itertools
import signal
import sys
import time

import numpy as np
import pytest
from bough.learn.cameras.bag import BagSource
from bough.learn.cameras.calibration import Mounted, plain_rig, read_rig
from bough.learn.cameras.clouds import beside
from bough.learn.cameras.open import open_clouds, open_source, twin_rig
from bough.learn.cameras.realsense import RealSenseSource
from bough.learn.cameras.source import TwinSource
from bough.learn.robot.twin import Twin
from bough.sim.arms.jaco2 import jaco2
from bough.sim.base.errors import InputError
from bough.sim.cameras.described import packed, unpacked
from bough.sim.cameras.label import Label
from oracles.cameras import fake_realsense
from oracles.cameras.folder import SIZE, camera, write_folder, written_rig

ARM = jaco2()


# ---- the twin ----------------------------------------------------------------------------------------------------


def test_a_twin_tells_its_world():
    """Give the capsules of arm and tree with their labels, where the simulator has them, through bytes and back."""
    twin = Twin(ARM, seed=1)
    data = twin.scene()
    scene = unpacked(data)
    c = twin.simulator.capsules
    used = c.radius.numpy()[0] > 0
    np.testing.assert_allclose(scene.world.solids.start, c.start.numpy()[0][used], atol=1e-7)
    assert (scene.world.label[: c.num_arm] == Label.ROBOT).all() and (scene.world.label == Label.BRANCH).sum() > 5
    np.testing.assert_allclose(scene.hand_position, twin.simulator.end_position[0].numpy(), atol=1e-6)
    assert packed(scene) == data
    twin.simulator.line_start[0, 2] = twin.simulator.line_end[0, 2] = 0.7
    assert unpacked(twin.scene()).world.label[-1] == Label.LINE
    for wrong in (data[:-1], b"{}\n", b"no json", data.replace(b'"count": ', b'"count": 9')):
        with pytest.raises(ValueError):
            unpacked(wrong)


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    pytest.importorskip("fastapi", reason="the service needs pip install 'bough[robot]'")
    from oracles.robot.service import Served

    service = Served(tmp_path_factory.mktemp("robot"))
    yield service
    service.end(signal.SIGINT)


def test_cameras_look_at_a_served_twin(served):
    """See branches of a served twin from processes of their own, the arm cut out where its joints are told."""
    with open_clouds("twin", arm=ARM, url=f"http://127.0.0.1:{served.port}", token=served.token, limit=5.0) as clouds:
        q = np.array(served.ask("/fetch_kinova_metrics")[1]["robot_dof_pos"])
        end, found = time.monotonic() + 240.0, None
        while found is None and time.monotonic() < end:
            clouds.tell(time.monotonic(), q)
            found = clouds.latest()
            time.sleep(0.01)
        assert found is not None, clouds.trouble
        assert len(found.branches) > 20 and len(found.line) == 0
        with TwinSource(f"http://127.0.0.1:{served.port}", twin_rig(), token=served.token)._connected() as socket:
            socket.send("next")
            scene = unpacked(socket.recv())
        wood = scene.world.solids
        away = beside(found.branches.astype(float), wood.start, wood.end, wood.radius.max(axis=1))
        assert np.percentile(np.abs(away), 99) < 0.08  # six deviations of the depth at 1.2 m, and none on the ground
        assert 0.0 < time.monotonic() - found.time < 10.0


def test_a_twin_that_is_not_there(served):
    """Say what answers there: nothing, or a service that wants a token."""
    for url, token in (("http://127.0.0.1:9", None), (f"http://127.0.0.1:{served.port}", None), ("ftp://a", None)):
        source = TwinSource(url, twin_rig(), token=token)
        with pytest.raises(InputError):
            next(source.frames())


# ---- bags --------------------------------------------------------------------------------------------------------


def write_bag(path, shots, *, depth="16UC1", colour="rgb8", joints=True):
    """Write pictures as a ROS 2 bag, depth 5 ms after colour, joint states with fingers before them."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="bags need pip install 'bough[vision]'")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    t = store.types
    stamp, header = t["builtin_interfaces/msg/Time"], t["std_msgs/msg/Header"]
    image, state = t["sensor_msgs/msg/Image"], t["sensor_msgs/msg/JointState"]

    def head(ns):
        return header(stamp(ns // 10**9, ns % 10**9), "camera")

    def picture(ns, array, kind):
        array = np.ascontiguousarray(array)
        height, width = array.shape[:2]
        data = np.frombuffer(array.tobytes(), np.uint8)
        return image(head(ns), height, width, kind, 0, len(data) // height, data)

    with rosbag2.Writer(path, version=9) as bag:
        topics = [("/colour", image), ("/depth", image), ("/joint_states", state)]
        to = {name: bag.add_connection(name, kind.__msgtype__, typestore=store) for name, kind in topics}

        def write(name, ns, message):
            bag.write(to[name], ns, store.serialize_cdr(message, message.__msgtype__))

        for k, shot in enumerate(shots):
            ns = 1_000_000_000 + k * 33_000_000
            if joints:
                values, names = np.append(ARM.home, 1.0), [*(f"joint_{n}" for n in range(6)), "finger_1"]
                write("/joint_states", ns - 1, state(head(ns - 1), names, values, values * 0, values * 0))
            seen = shot.colour[0][..., ::-1] if colour == "bgr8" else shot.colour[0]
            metres = shot.depth[0]
            deep = metres if depth == "32FC1" else np.round(1000 * metres).astype(np.uint16)
            write("/colour", ns, picture(ns, seen, colour))
            write("/depth", ns + 5_000_000, picture(ns + 5_000_000, deep, depth))


@pytest.mark.parametrize("depth, colour, off", [("16UC1", "bgr8", 5.1e-4), ("32FC1", "rgb8", 0.0)])
def test_a_bag_gives_pictures_with_their_depth(tmp_path, depth, colour, off):
    """Match colour and depth by their stamps; depth in mm to half of one, joints without fingers."""
    shots = write_folder(tmp_path / "folder")
    write_bag(tmp_path / "bag", shots, depth=depth, colour=colour)
    rig = read_rig(written_rig(tmp_path / "rig", colour_topic="/colour", depth_topic="/depth"))
    source = BagSource(tmp_path / "bag", rig)
    assert source.sizes == (SIZE,)
    for taken, shot in zip(source.frames(), shots, strict=True):
        np.testing.assert_array_equal(taken.colour, shot.colour[0])
        np.testing.assert_allclose(taken.depth, shot.depth[0], atol=off)
        np.testing.assert_allclose(taken.q, ARM.home)
    assert [round(t.time, 3) for t in source.still()] == [1.0, 1.033]


def test_bags_that_cannot_be_read(tmp_path):
    """Refuse a bag without the topics, without intrinsics or names in the rig, and of another encoding."""
    shots = write_folder(tmp_path / "folder")
    write_bag(tmp_path / "bag", shots, depth="mono8", colour="rgb8")
    named = {"colour_topic": "/colour", "depth_topic": "/depth"}
    for k, (more, word) in enumerate([(named, "encoding"), (named | {"depth_topic": "/no"}, "no picture"),
                                      ({}, "colour_topic"),
                                      (named | {"intrinsics_px": None}, "intrinsics")]):  # fmt: skip
        rig = read_rig(written_rig(tmp_path / f"rig{k}", **more))
        with pytest.raises(InputError, match=word):
            BagSource(tmp_path / "bag", rig)


# ---- RealSense, whose library is a module of ours here -----------------------------------------------------------


def serials(*names):
    return plain_rig([Mounted(name=n, position_m=[0, 0, 0], rotation=[1, 0, 0, 0]) for n in names])


def test_realsense_cameras_through_their_library(monkeypatch):
    """Take pictures of two cameras in turn, depth in metres by the camera's unit; one that is late keeps nobody."""
    monkeypatch.setitem(sys.modules, "pyrealsense2", fake_realsense.module())
    source = RealSenseSource(serials("11", "22"), ("11", "22"))
    play = source.frames()
    taken = list(itertools.islice(play, 4))
    play.close()
    assert [t.camera for t in taken] == [0, 1, 0, 1] and source.sizes == ((480, 848),) * 2
    for t, level in zip(taken, (11, 22, 11, 22), strict=True):
        assert t.colour.shape == (480, 848, 3) and (t.colour == level).all()
        np.testing.assert_allclose(t.depth, (5000 + level) * fake_realsense.SCALE, rtol=1e-6)
        assert t.intrinsics == (430.0, 431.0, 420.0, 240.0)
    assert fake_realsense._Pipeline.stopped == 2


def test_realsense_cameras_that_are_not_there(monkeypatch):
    """Say so where the library or a camera is missing, or serial numbers and calibration differ."""
    monkeypatch.setitem(sys.modules, "pyrealsense2", None)
    with pytest.raises(InputError, match="pyrealsense2"):
        next(RealSenseSource(serials("11"), ("11",)).frames())
    monkeypatch.setitem(sys.modules, "pyrealsense2", fake_realsense.module())
    with pytest.raises(InputError, match="No device"):
        next(RealSenseSource(serials("000"), ("000",)).frames())
    for named, given in ((("11",), ("12",)), (("11", "12"), ("11",))):
        with pytest.raises(InputError):
            RealSenseSource(serials(*named), given)


# ---- by what a user types ----------------------------------------------------------------------------------------


def test_texts_that_name_no_cameras(tmp_path):
    """Refuse what is no source or lacks calibration or address, and a limit or a prompt that means nothing."""
    (tmp_path / "empty").mkdir()
    for spec, more in (("nowhere", {}), ("twin", {}), ("realsense:1", {}), (str(tmp_path / "empty"), {})):
        with pytest.raises(InputError):
            open_source(spec, **more)
    write_folder(tmp_path / "folder")
    for more in ({"limit": 0.0}, {"prompts": ("a", "b")}, {"weights": tmp_path / "none"}):
        with pytest.raises(InputError):
            open_clouds(str(tmp_path / "folder"), arm=None, **more)
    assert camera().width == SIZE[1]
