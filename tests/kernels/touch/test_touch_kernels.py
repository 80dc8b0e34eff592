"""Features and forest of all worlds against plain NumPy, a robot's stream, numbers by hand, and scikit-learn."""

import numpy as np
import pytest
import torch
import warp as wp
from bough.learn.touch.classifier import TouchClassifier
from bough.learn.touch.features import NAMES, TouchStream, features_of, statistics
from bough.learn.touch.forest import Forest, grow_forest, packed
from bough.learn.touch.free_motion import FreeMotion
from bough.learn.touch.model import TouchModel
from bough.learn.touch.network import train_network
from bough.sim.base.errors import InputError

WORLDS, JOINTS, STEPS = 5, 6, 30


def free_motion(rng) -> FreeMotion:
    """Return some arm's friction."""
    return FreeMotion(rng.normal(0, 1, (JOINTS, 5)), rng.uniform(0.05, 0.5, JOINTS))


def sequences(rng):
    """Return torque, expected torque, command and speed of unlike worlds, [4, STEPS, WORLDS, JOINTS], float32."""
    scale = np.array([20.0, 5.0, 0.3, 0.3])[:, None, None, None] * rng.uniform(0.2, 2.0, (1, 1, WORLDS, JOINTS))
    return (rng.standard_normal((4, STEPS, WORLDS, JOINTS)) * scale).astype(np.float32)


def leaf(value: float) -> Forest:
    """Return a forest of one leaf."""
    one = np.zeros(1, np.int32)
    return Forest(one, one - 1, one - 1, np.array([value], np.float32))


class Loop:
    """A classifier with its tensors."""

    def __init__(self, model: TouchModel) -> None:
        self.given = [torch.zeros(WORLDS, JOINTS) for _ in range(4)]
        self.restarted = torch.zeros(WORLDS, dtype=torch.bool)
        torque, expected, command, velocity = self.given
        self.touch = TouchClassifier(model, torque, command, velocity, self.restarted, expected)

    def push(self, rows) -> np.ndarray:
        """Write a sample, update, and return the features."""
        for tensor, row in zip(self.given, rows, strict=True):
            tensor.copy_(torch.from_numpy(row))
        self.touch.features.fill_(np.nan)
        self.touch.update()
        return self.touch.features.numpy().copy()


def model(free: FreeMotion, classifier=None, kind="forest") -> TouchModel:
    """Return a model with a forest of one leaf, or another classifier."""
    return TouchModel(free, classifier or leaf(0.5), kind, 10.0, 0.4, ())


def test_statistics_of_a_window_by_hand():
    """Find 1, 2, 3, 6: mean 3, variance 3.5, third and fourth moments 4.5 and 24.5, up to EPS in the spread."""
    found = statistics(np.array([1.0, 2.0, 3.0, 6.0]))
    spread = 3.5 + 1.0e-4
    np.testing.assert_allclose(found, [1, 6, 3, 3.5, 4.5 / spread**1.5, 24.5 / spread**2 - 3], rtol=1e-12)


def test_first_rows_have_the_samples_that_are_there():
    """Give z of one sample twelve times (minimum, maximum, means), and the mean of two as the second smoothed value."""
    free = FreeMotion(np.tile([0.5, 0, 0, 0, 0.0], (1, 1)), np.array([2.0]))
    one = np.array([[4.5], [0.5], [8.5]])
    rows = features_of(free, one, np.zeros((3, 1)), np.full((3, 1), 7.0), np.full((3, 1), -3.0))
    named = [dict(zip(NAMES, row, strict=True)) for row in rows]
    assert [n["torque"] for n in named] == [2.0, 0.0, 4.0]
    assert (named[0]["smooth max"], named[0]["raw var"], named[0]["raw kurt"]) == (2.0, 0.0, -3.0)
    assert (named[1]["smooth min"], named[1]["smooth max"], named[1]["raw mean"]) == (1.0, 2.0, 1.0)
    assert named[2]["smooth mean"] == pytest.approx((2 + 1 + 2) / 3)
    assert (named[2]["commanded velocity"], named[2]["executed velocity"]) == (7.0, -3.0)


def test_kernel_equals_numpy_and_the_stream():
    """Agree to 1e-5 of a value (float32 hands it over: 6e-8) in unlike worlds, the early samples too."""
    rng = np.random.default_rng(0)
    free, given = free_motion(rng), sequences(rng)
    loop, streams = Loop(model(free)), [TouchStream(free) for _ in range(WORLDS)]
    whole = [features_of(free, *(given[k, :, w].astype(float) for k in range(4))) for w in range(WORLDS)]
    for t in range(STEPS):
        found = loop.push(given[:, t])
        for w in range(WORLDS):
            torque, expected, command, velocity = given[:, t, w].astype(float)
            np.testing.assert_allclose(streams[w].push(torque, command, velocity, expected), whole[w][t], rtol=1e-12,
                                       atol=1e-12)  # fmt: skip
            np.testing.assert_allclose(found[w], whole[w][t], rtol=1e-5, atol=1e-5)


def test_a_restarted_world_forgets_and_the_others_do_not():
    """Give a world that restarts the features of a fresh one."""
    rng = np.random.default_rng(1)
    free, given = free_motion(rng), sequences(rng)
    loop, fresh, other = Loop(model(free)), Loop(model(free)), Loop(model(free))
    for t in range(20):
        loop.restarted[:] = torch.tensor([False, t == 13, False, False, False])
        found, kept = loop.push(given[:, t]), other.push(given[:, t])
        again = fresh.push(given[:, t]) if t >= 13 else kept
    np.testing.assert_array_equal(found[1], again[1])
    np.testing.assert_array_equal(np.delete(found, 1, 0), np.delete(kept, 1, 0))


def test_the_sample_is_captured_in_a_graph():
    """Replay a captured sample to the bits of one that is launched."""
    rng = np.random.default_rng(2)
    given = sequences(rng)
    forest = grow_forest(rng.normal(0, 9, (300, 15 * JOINTS)), rng.integers(0, 2, 300))
    plain = Loop(model(free_motion(rng), forest))
    loop = Loop(plain.touch.model)
    with wp.ScopedCapture(device="cpu") as scope:
        loop.touch.update()
    for t in range(15):
        plain.push(given[:, t])
        for tensor, row in zip(loop.given, given[:, t], strict=True):
            tensor.copy_(torch.from_numpy(row))
        wp.capture_launch(scope.graph)
    assert torch.equal(loop.touch.probability, plain.touch.probability)


def test_forest_equals_scikit_learn():
    """Walk to the same leaves as scikit-learn for rows that sit on thresholds too; the mean is of float32 leaves."""
    ensemble = pytest.importorskip("sklearn.ensemble")
    rng = np.random.default_rng(3)
    x = np.round(rng.normal(0, 2, (400, 12)), 1).astype(np.float32)
    y = (x[:, 0] * x[:, 3] + rng.normal(0, 1, 400) > 0).astype(int)
    grown = ensemble.ExtraTreesClassifier(20, random_state=0).fit(x[:300], y[:300])
    forest = packed([e.tree_ for e in grown.estimators_])
    forest.check("test", 12)
    np.testing.assert_allclose(forest.probability(x), grown.predict_proba(x)[:, 1], atol=1e-6)


@pytest.mark.parametrize("kind", ["forest", "network"])
def test_probability_in_the_loop_equals_that_of_a_recording(kind):
    """Give the host's probability to the rounding of features (1e-4 at a threshold's edge in no tree), and the flag."""
    rng = np.random.default_rng(4)
    free, given = free_motion(rng), sequences(rng)
    rows = np.concatenate([features_of(free, *(given[k, :, w].astype(float) for k in range(4))) for w in range(WORLDS)])
    contact = (rows[:, 0] > 0).astype(int)
    classifier = grow_forest(rows, contact) if kind == "forest" else train_network(rows, contact)
    loop = Loop(model(free, classifier, kind))
    found, flags = [], []
    for t in range(STEPS):
        loop.push(given[:, t])
        found.append(loop.touch.probability.numpy().copy())
        flags.append(loop.touch.flag.numpy().copy())
    wanted = classifier.probability(rows).reshape(WORLDS, STEPS).T
    np.testing.assert_allclose(found, wanted, atol=1e-4)
    np.testing.assert_array_equal(flags, np.array(found) > np.float32(0.4))
    assert 0.1 < np.mean(flags) < 0.9


def test_a_model_of_another_arm_is_refused():
    """Name both numbers of joints."""
    free = FreeMotion(np.zeros((7, 5)), np.ones(7))
    with pytest.raises(InputError, match="model for 7 joints; allowed: a model for 6 joints"):
        Loop(model(free))
