"""The flag of touch from joint torques, in the loop: samples by NumPy, a robot's stream, exact resume, bad models."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import warp as wp
from bough.kernels.tasks.parts import Clock
from bough.kernels.touch.features import V0
from bough.kernels.touch.tell import tell
from bough.learn.tasks.clearing import make_reach
from bough.learn.tasks.reach_settings import ReachSettings
from bough.learn.tasks.touch_flag import _device_sensor, _told, read_classifier
from bough.learn.touch.features import TouchStream
from bough.learn.touch.forest import Forest
from bough.learn.touch.free_motion import FreeMotion
from bough.learn.touch.model import TouchModel
from bough.learn.touch.record import carrying_torque
from bough.learn.touch.sensor import JACO2, TorqueSensor
from bough.sim.arms.jaco2 import jaco2
from bough.sim.base.errors import InputError
from bough.sim.scenes.reach_scene import ReachScene

WORLDS = 4
SMALL = ReachSettings(scene=ReachScene(order=2, attempts=32), episode_seconds=0.5)
FRICTION = np.array([JACO2.offset, JACO2.dry, JACO2.viscous, (0.0,) * 6, (0.0,) * 6]).T
FREE = FreeMotion(FRICTION, np.linspace(0.5, 2.0, 6))


def model(rate=10.0, joints=6, threshold=0.4) -> TouchModel:
    """Return a forest of one split: contact where the first joint's z is above zero, with a probability of 0.9."""
    forest = Forest(np.int32([0]), np.int32([0, -1, -1]), np.int32([1, -1, -1]), np.float32([0.0, 0.1, 0.9]))
    return TouchModel(FreeMotion(FREE.mean[:joints], FREE.noise[:joints]), forest, "forest", rate, threshold, ())


def still_sensor() -> TorqueSensor:
    """Return a sensor with friction and quanta of the speeds, and no noise."""
    none = (0.0,) * 6
    return replace(JACO2, still=none, moving=none, drift=none, speed_quantum=(0.01,) * 6)


@pytest.fixture
def make(tmp_path):
    """Return what makes a task with a classifier."""

    def made(rate=10.0, sensor=None, **changes):
        model(rate).write(tmp_path / "model.npz")
        (sensor or JACO2).write(tmp_path / "sensor.json")
        settings = replace(SMALL, flag="classifier", classifier=str(tmp_path / "model.npz"),
                           sensor=str(tmp_path / "sensor.json"), **changes)  # fmt: skip
        return make_reach("reach", settings, num_envs=WORLDS, seed=0)

    return made


def actions(count):
    generator = torch.Generator().manual_seed(1)
    return [2.0 * torch.rand(WORLDS, 6, generator=generator) - 1.0 for _ in range(count)]


@pytest.mark.parametrize(("policy_rate", "rate", "every"), [(10.0, 20.0, 3), (60.0, 9.9, 6)])
def test_samples_are_those_of_a_robot_s_stream(make, policy_rate, rate, every):
    """Two samples a policy step and one in six: torques less weight and friction told, mean commands, features, flag.

    The weight is that of the arm a substep ago: 0.4 rad/s x 1/240 s x 20 N m is 0.03 N m. Features are a NumPy
    stream's to 1e-5 of what the task had told; a world forgets where its episode begins, and has no flag there.
    """
    task = make(rate, still_sensor(), policy_rate=policy_rate, speed_step=0.4 if policy_rate == 10 else 0.07)
    told, touch = task._touch._told, task._touch.classifier
    streams, asked, period, begun = [TouchStream(FREE) for _ in range(WORLDS)], [], 0, [True] * WORLDS
    seen = []

    def sample():
        nonlocal period
        asked.append(task.simulator.target.numpy().copy())
        period += 1
        if period % every:
            return
        torque, command, velocity = (getattr(told, n).numpy() for n in ("torque", "command", "velocity"))
        np.testing.assert_allclose(command, np.mean(asked, 0), atol=1e-6)
        qd = task.simulator.qd.numpy()
        np.testing.assert_allclose(velocity, 0.01 * np.round(qd / 0.01), atol=1e-6)
        steady = np.array(JACO2.offset) + np.array(JACO2.dry) * np.tanh(qd / V0) + np.array(JACO2.viscous) * qd
        expected = task.simulator.torque.numpy() - carrying_torque(jaco2(), task.simulator.q.numpy().astype(float))
        np.testing.assert_allclose(torque, expected + steady, atol=0.05)
        asked.clear()
        for w, stream in enumerate(streams):
            if begun[w]:
                stream.restart()
            row = stream.push(*(x[w].astype(float) for x in (torque, command, velocity)))
            np.testing.assert_allclose(touch.features[w].numpy(), row, rtol=1e-5, atol=1e-5)
            assert touch.flag[w] == (row[0] > 0.0)
        begun[:] = [False] * WORLDS
        seen.append(touch.flag.numpy().copy())

    take = task._touch.take
    task._touch.take = lambda k: (take(k), sample())
    for action in actions(round(0.7 * policy_rate)):
        observations, _, done, _ = task.step(action)
        flag = observations["policy"][:, task.columns["touch"]]
        assert torch.equal(flag, torch.where(done, 0.0, task._touch.classifier.flag))
        if bool(done.any()):
            asked.clear()
            begun[:] = [True] * WORLDS
    assert 0.0 < np.mean(seen) < 1.0  # both were told


def test_noise_and_drift_of_the_sensor():
    """In 3000 worlds: white noise of 0.1 + 0.5 x 0.4 N m, drift of 0.3 N m that keeps exp(-0.1 / 2) a sample.

    Within five standard errors: 1 / sqrt(2 x 3000) of a standard deviation, 1 / sqrt(3000) of a correlation.
    """
    n, dev = 3000, wp.get_device("cpu")
    clock = Clock()
    for name, kind in Clock.vars.items():
        setattr(clock, name, wp.zeros(n, dtype=kind.type.dtype, device=dev))
    flag, told = wp.ones(n, dtype=wp.float32, device=dev), _told((n, 1), dev)
    one = (0.0,)
    sensor = TorqueSensor(10.0, (1.0,), one, one, (0.1,), (0.5,), (0.3,), (2.0,), one, one)
    speed, zero = (wp.full((n, 1), x, dtype=wp.float32, device=dev) for x in (0.4, 0.0))
    numbers = _device_sensor(sensor, 0.1, dev)
    out, drift = [], []
    for step in range(2):
        clock.age.fill_(step + 1)
        clock.clock.fill_(step)
        wp.launch(tell, dim=n, inputs=[zero, zero, speed, zero, clock, wp.vec2ui(1, 2), numbers, 0, 1, 1, told, flag],
                  device=dev)  # fmt: skip
        out.append(told.torque.numpy()[:, 0] - 1.0)
        drift.append(told.drift.numpy()[:, 0].copy())
        assert told.restarted.numpy().all() == (step == 0)
    white = [o - d for o, d in zip(out, drift, strict=True)]
    error = 5.0 / np.sqrt(2 * n)
    for found, expected in ((white[0], 0.3), (white[1], 0.3), (drift[0], 0.3), (drift[1], 0.3)):
        assert found.std() == pytest.approx(expected, rel=error) and abs(found.mean()) < 5 * expected / np.sqrt(n)
    assert np.corrcoef(*drift)[0, 1] == pytest.approx(np.exp(-0.05), abs=5 / np.sqrt(n))
    assert abs(np.corrcoef(*white)[0, 1]) < 5 / np.sqrt(n) and abs(np.corrcoef(white[0], drift[0])[0, 1]) < 0.1
    assert not flag.numpy().any()  # an episode begins without contact


def test_restored_task_goes_on_to_the_same_bits(make, tmp_path):
    """Through samples and ends of episodes, in a graph as well; with another model it is refused."""
    task = make()
    given = actions(7)
    for a in given[:2]:
        task.step(a)
    kept = task.snapshot()
    runs = []
    for captured in (False, False, True):
        task.restore(kept)
        if captured:
            task.capture()
            task.restore(kept)
        runs.append([torch.cat([o["policy"].ravel(), r, d.float()]).clone() for o, r, d, _ in map(task.step, given)])
        flags = torch.stack([row[: 20 * WORLDS].view(WORLDS, 20)[:, 19] for row in runs[-1]])
        assert 0.0 < float(flags.mean()) < 1.0
    for other in runs[1:]:
        assert all(torch.equal(a, b) for a, b in zip(runs[0], other, strict=True))
    model(threshold=0.95).write(tmp_path / "other.npz")
    other = make_reach("reach", replace(task.cfg, classifier=str(tmp_path / "other.npz")), num_envs=WORLDS, seed=0)
    with pytest.raises(ValueError, match="another classifier"):
        other.restore(kept)


@pytest.mark.parametrize(
    ("change", "found"),
    [({"flag": "classifier"}, "classifier: found none"), ({"classifier": "m.npz"}, "classifier: found m.npz"),
     ({"sensor": "s.json"}, "sensor: found s.json"),
     ({"flag": "classifier", "classifier": "nothing.npz"}, "nothing.npz: found no such file")],
)  # fmt: skip
def test_settings_that_cannot_be(change, found):
    """One line: what was found, what is allowed."""
    with pytest.raises(InputError) as error:
        make_reach("reach", replace(SMALL, **change), num_envs=1)
    assert found in str(error.value) and "\n" not in str(error.value)


def test_models_that_do_not_fit_are_refused(forked, tmp_path):
    """A model of another rate, or of other joints: one line. One of other features, by the command: exit with 2."""
    for name, given, says in (("rate", {"rate": 25.0}, "rate: found 25 Hz; allowed: 60 Hz"),
                              ("joints", {"joints": 5}, "joints: found 5; allowed: 6")):  # fmt: skip
        model(**given).write(tmp_path / f"{name}.npz")
        with pytest.raises(InputError) as error:
            read_classifier(tmp_path / f"{name}.npz", 6, 60.0)
        assert says in str(error.value) and "\n" not in str(error.value)
    model().write(tmp_path / "features.npz")
    held = dict(np.load(tmp_path / "features.npz"))
    np.savez(tmp_path / "features.npz", **held | {"layout": np.array("13 a joint, window 10, smoothed over 2")})
    out = tmp_path / "run"
    given = ["--set", "flag=classifier", f"classifier={tmp_path / 'features.npz'}"]
    done = forked.run("train", "reach", "--out", out, *given)
    assert done.returncode == 2 and "features: found '13 a joint" in done.stderr, done.stderr
    assert len(done.stderr.strip().splitlines()) == 1 and not out.exists()
