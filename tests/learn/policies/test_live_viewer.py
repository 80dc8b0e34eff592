"""A policy in a window: capsules where the simulator has them, real time, one line where there is no screen."""

import math
import sys
import types

import numpy as np
import pytest
import torch
import warp as wp
from bough.cli.play import Play
from bough.learn.policies import live_viewer
from bough.learn.policies.evaluate import random
from bough.learn.policies.live_viewer import angles, instances, open_viewer, watch
from bough.learn.tasks.clearing import make_task
from bough.learn.tasks.settings import TaskSettings
from bough.sim.base.errors import InputError
from bough.sim.scenes.scene import SceneSettings
from oracles.reach_task import registry
from scipy.spatial.transform import Rotation


class Recorder:
    """Stand where a viewer does and keep what it was given."""

    device = "cpu"

    def __init__(self, frames=math.inf):
        self.frames, self.times, self.capsules, self.closed = frames, [], [], False

    def set_camera(self, pos, pitch, yaw):
        self.camera = pos, pitch, yaw

    def is_running(self):
        return len(self.times) < self.frames

    def should_step(self):
        return True

    def begin_frame(self, time):
        self.times.append(time)

    def log_capsules(self, name, mesh, xforms, scales, colors, materials):
        self.capsules.append((xforms.numpy().copy(), scales.numpy().copy(), colors.numpy().copy()))

    def end_frame(self):
        pass

    def close(self):
        self.closed = True


def task():
    settings = TaskSettings(scene=SceneSettings(distinct=1), policy_rate=60.0)
    return make_task("powerline", settings, num_envs=1, seed=3, device="cpu", test=True)


def ends(xforms, scales):
    """Return starts and ends of capsules along z after scipy's rotations, and their radii."""
    along = Rotation.from_quat(xforms[:, 3:]).apply([0.0, 0.0, 1.0]) * scales[:, 2:]
    return xforms[:, :3] - along, xforms[:, :3] + along, scales[:, 0]


def test_instances_end_where_capsules_end():
    """Turn z into any direction, straight down and a sphere included."""
    rng = np.random.default_rng(0)
    start, end = rng.normal(size=(2, 40, 3))
    end[0], end[1], end[2] = start[0] - [0, 0, 0.3], start[1], start[2] + [0, 0, 0.2]
    end[3] = start[3] + [1e-4, 0.0, -1.0]
    found = ends(*instances(start, end, np.full(40, 0.1)))
    for value, expected in zip(found, (start, end, 0.1), strict=True):
        np.testing.assert_allclose(value, np.broadcast_to(expected, value.shape), atol=1e-10)


def test_angles_look_along_a_direction():
    """Agree with the definition: forward is (cos p cos y, cos p sin y, sin p)."""
    pitch, yaw = np.radians(angles(np.array([0.3, -1.2, 0.5])))
    forward = [np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)]
    np.testing.assert_allclose(forward, np.array([0.3, -1.2, 0.5]) / np.linalg.norm([0.3, -1.2, 0.5]), atol=1e-12)


def test_every_step_is_drawn_where_it_is():
    """Show arm, branches and line of every policy step, at most in real time, and close the window at the end."""
    shown, viewer = task(), Recorder()
    assert watch(shown, random(shown, 0), viewer, steps=3) == 3 and viewer.closed
    assert viewer.times[0] == pytest.approx(1 / 60) and viewer.times[-1] == pytest.approx(3 / 60)
    assert len(viewer.times) == len(viewer.capsules) >= 3
    c, line = shown.simulator.capsules, shown.simulator.line
    radius = wp.to_torch(c.radius)[0]
    used = radius > 0
    expected = [torch.cat([wp.to_torch(a)[0][used], wp.to_torch(b)[:1]]).numpy()
                for a, b in ((c.start, line.start), (c.end, line.end))]  # fmt: skip
    start, end, thick = ends(*viewer.capsules[-1][:2])
    # float32 positions of about a metre
    np.testing.assert_allclose(start, expected[0], atol=1e-6)
    np.testing.assert_allclose(end, expected[1], atol=1e-6)
    np.testing.assert_allclose(thick, np.append(radius[used].numpy(), line.radius), rtol=1e-6)
    assert not np.array_equal(viewer.capsules[0][0], viewer.capsules[-1][0])


def test_watching_ends_with_the_window():
    """Stop when the window is closed; a frame is drawn even before the next step is due."""
    shown, viewer = task(), Recorder(frames=2)
    assert watch(shown, random(shown, 0), viewer) in (1, 2) and viewer.closed


def test_missing_library_is_one_line(monkeypatch):
    """Say what to install."""
    monkeypatch.setitem(sys.modules, "pyglet", None)
    with pytest.raises(InputError, match=r"^play: --viewer: found no pyglet; allowed: pip install 'bough\[viewer\]'"):
        Play("zero", task="powerline", viewer=True, device="cpu").run(registry())


def test_missing_screen_is_one_line(monkeypatch):
    """Give the first line of what the library says."""
    import newton.viewer

    def refuse():
        raise RuntimeError("Cannot connect to None\nlonger story")

    monkeypatch.setitem(sys.modules, "pyglet", types.ModuleType("pyglet"))
    monkeypatch.setattr(newton.viewer, "ViewerGL", refuse)
    with pytest.raises(InputError, match=r"found no window \(Cannot connect to None\); allowed: a screen") as error:
        open_viewer()
    assert "\n" not in str(error.value)


def test_film_and_window_are_two_things(tmp_path):
    """Ask for a folder or a window, one of both."""
    for options, found in (({}, "nothing"), ({"out": tmp_path / "a", "viewer": True}, "--viewer and --out")):
        with pytest.raises(InputError, match=f"play: --out: found {found}; allowed: a folder for the film"):
            Play("zero", task="reach", **options).run(registry())


def test_newtons_viewer_draws_the_capsules():
    """Draw without a screen: the middle of the picture holds the line's red and the arm's white."""
    pyglet = pytest.importorskip("pyglet")
    pyglet.options["headless"] = True
    from newton.viewer import ViewerGL

    try:
        viewer = ViewerGL(width=480, height=270, headless=True)
    except Exception as error:  # pyglet's own classes, by platform
        pytest.skip(f"no OpenGL here: {error}")
    shown = live_viewer.Shown(task(), viewer)
    shown.draw(0.0)
    picture = viewer.get_frame().numpy().astype(int)
    viewer.close()
    red, green, blue = picture[..., 0], picture[..., 1], picture[..., 2]
    assert ((red > 100) & (green < 60) & (blue < 60)).sum() > 100
    assert ((red > 150) & (green > 150) & (blue > 150)).sum() > 300
