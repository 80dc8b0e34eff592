"""Recordings, free motion, the sensor, scores and models of touch against known numbers."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bough.learn.touch.free_motion import fit_free_motion
from bough.learn.touch.model import FORMAT, LAYOUT, read_model, train_model
from bough.learn.touch.motions import DIRECTIONS, PLACES, obstructed_motion, place_path
from bough.learn.touch.read import read_recordings
from bough.learn.touch.record import carrying_torque, simulate
from bough.learn.touch.recording import Recording
from bough.learn.touch.scores import Told, auc, detections, over_recordings, roc, specificity_at, threshold_for
from bough.learn.touch.sensor import JACO2, TorqueSensor, fit_sensor, quantum, read_sensor
from bough.sim.arms.jaco2 import jaco2
from bough.sim.base.errors import InputError

SHARED = Path("/work/shared/data/touch")


def recording(rng, rows=200, joints=2, name="a.csv", contact=None) -> Recording:
    """Return noise of a tenth about a friction model of three terms, with contact of 5 N m where asked."""
    velocity = rng.normal(0, 0.3, (rows, joints))
    torque = 1.5 - 0.4 * np.tanh(velocity / 0.02) + 2.0 * velocity + rng.normal(0, 0.1, (rows, joints))
    label = np.zeros(rows, np.int64) if contact is None else contact
    torque = torque + 5.0 * label[:, None]
    return Recording(name, np.arange(rows) / 10, torque, velocity, velocity, np.zeros_like(torque), label)


def test_free_motion_is_found_from_rows_without_contact():
    """Find offset, dry and viscous friction and noise to 4 standard errors (1/sqrt(1000) of 0.1, times leverage)."""
    rng = np.random.default_rng(0)
    free = fit_free_motion([recording(rng, 1000, contact=(np.arange(1000) > 800).astype(np.int64))], "here")
    np.testing.assert_allclose(free.mean[:, :3], [[1.5, -0.4, 2.0]] * 2, atol=0.08)
    np.testing.assert_array_equal(free.mean[:, 3:], 0.0)  # nothing was expected, so nothing is known of it
    np.testing.assert_allclose(free.noise, 0.1, rtol=0.15)


def test_sensor_is_learnt_back():
    """Find noise at rest and in motion to 15 %, drift to 30 % (few time constants), its time to a factor of 1.6."""
    rng = np.random.default_rng(1)
    one = (0.5,)
    given = TorqueSensor(10.0, one, (0.0,), (1.0,), (0.05,), (0.4,), (0.3,), (2.0,), (0.0,), (0.0,))
    speed = 0.5 * np.sin(np.arange(3000) / 25)[None, :, None] + np.zeros((8, 1, 1))
    told = given.measure(np.zeros_like(speed), speed, rng)
    made = [Recording(f"{k}", np.arange(3000) / 10, told[k], speed[k], speed[k], np.zeros_like(speed[k]),
                      np.zeros(3000, np.int64)) for k in range(8)]  # fmt: skip
    found = fit_sensor(made, "here")
    assert found.rate == pytest.approx(10.0)
    assert found.moving[0] == pytest.approx(0.4, rel=0.15)
    assert found.still[0] == pytest.approx(0.05, abs=0.04)  # white noise and drift's own steps add up at rest
    assert found.drift[0] == pytest.approx(0.3, rel=0.3)
    assert 2.0 / 1.6 < found.drift_time[0] < 2.0 * 1.6


def test_quanta_are_told_from_numbers_without():
    """Find a step of 0.0078 rad/s, and none in normal numbers."""
    x = np.random.default_rng(2).normal(0, 0.1, 2000)
    assert quantum(0.0078 * np.round(x / 0.0078)) == pytest.approx(0.0078, rel=1e-6)
    assert quantum(x) == 0.0


def test_sensor_file_round_trip_and_faults(tmp_path):
    """Read what was written; refuse another arm's, another format, a noise below zero."""
    JACO2.write(tmp_path / "s.json")
    assert read_sensor(tmp_path / "s.json", 6) == JACO2
    with pytest.raises(InputError, match="6 joints; allowed: 7"):
        read_sensor(tmp_path / "s.json", 7)
    good = json.loads((tmp_path / "s.json").read_text())
    for change, said in (({"format": "x"}, "format"), ({"still": [-1.0] * 6}, r"still\.0"), ({"more": 1}, "more")):
        (tmp_path / "bad.json").write_text(json.dumps(good | change))
        with pytest.raises(InputError, match=said):
            read_sensor(tmp_path / "bad.json", 6)


def test_carrying_torque_is_the_servo_s_at_rest():
    """Equal the simulator's torque of arms at rest to single precision, and a payload's lever by differences."""
    arm, rng = jaco2(), np.random.default_rng(3)
    motion = obstructed_motion(arm, "palm", 0, "hand", rng, 2.0)
    still = replace(motion, command=np.zeros((12, 6)))
    q, _, torque, _ = simulate(arm, [still], 10.0)
    np.testing.assert_allclose(torque, carrying_torque(arm, q), atol=2e-4)
    from bough.sim.arms.arm import forward_kinematics

    height = lambda x: forward_kinematics(arm, x)[2][0][..., 2]  # noqa: E731
    step = 1e-5 * np.eye(6)
    slope = [(height(q[0, 0] + e) - height(q[0, 0] - e)) / 2e-5 for e in step]
    payload = carrying_torque(arm, q[:, :1], np.array([[2.0]]), links=False)[0, 0]
    np.testing.assert_allclose(payload, 2.0 * 9.81 * np.array(slope), atol=1e-6)


@pytest.mark.parametrize("side", range(4))
def test_a_place_moves_towards_its_obstacle(side):
    """Put the obstacle's axis within its reach of the place's path, on the wanted side of the link."""
    arm = jaco2()
    for place in PLACES:
        motion = obstructed_motion(arm, place, side, "branch", np.random.default_rng(side), 4.0)
        q = motion.start + np.cumsum(motion.command, axis=0) / 60
        point, axis, across = place_path(arm, place, q)
        root, turn = motion.tree.position[0], motion.tree.rotation[0]
        w, x, y, z = turn
        along = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
        apart = point - root - ((point - root) @ along)[:, None] * along
        near = int(np.argmin(np.linalg.norm(apart, axis=1)))
        assert np.linalg.norm(apart[near]) < 0.07, place
        assert motion.direction == DIRECTIONS[side]
        assert abs(along @ axis[near]) < 0.6 and np.isfinite(across).all()


# ---- scores ------------------------------------------------------------------------------------------------------


def told(name, probability, contact, tolerance=0.0) -> Told:
    """Return what was told of a recording at 10 Hz."""
    rows = len(contact)
    zero = np.zeros((rows, 1))
    return Told(Recording(name, np.arange(rows) / 10, zero, zero, zero, zero, np.array(contact), "palm", "left",
                          tolerance), np.array(probability, float))  # fmt: skip


def test_auc_and_roc_by_hand():
    """Count pairs: of 2 x 3, 4 in order and one tied make 4.5/6; specificity at a recall of a half is 2/3."""
    p, y = np.array([0.9, 0.4, 0.4, 0.8, 0.1]), np.array([1, 1, 0, 0, 0])
    assert auc(p, y) == pytest.approx(4.5 / 6)
    assert math.isnan(auc(p, np.zeros(5, int)))
    wrong, found, threshold = roc(p, y)
    np.testing.assert_allclose(wrong, [0, 0, 1 / 3, 2 / 3, 1])
    np.testing.assert_allclose(found, [0, 0.5, 0.5, 1, 1])
    assert [float(np.mean(p[y == 0] > t)) for t in threshold] == pytest.approx(wrong.tolist())
    assert specificity_at(p, y, 0.5) == 1.0
    assert specificity_at(p, y, 0.8) == pytest.approx(1 / 3)


def test_threshold_keeps_the_specificity():
    """Choose the lowest threshold with which one free row of twenty may be told contact."""
    rng = np.random.default_rng(4)
    some = [told("a", rng.random(200), rng.integers(0, 2, 200))]
    t = threshold_for(some, 0.95)
    free = some[0].probability[some[0].recording.contact == 0]
    assert np.mean(free <= t) >= 0.95 > np.mean(free <= t - 0.02)


def test_delay_and_edges_by_hand():
    """Find the first contact after 0.2 s, miss the second; leave rows within 0.1 s of an edge unscored."""
    one = told("a", [0, 0, 0, 0, 1, 1, 0, 0, 0, 0], [0, 0, 1, 1, 1, 1, 0, 0, 1, 1], tolerance=0.1)
    found = detections([one], 0.5)
    assert [d.delay for d in found] == [pytest.approx(0.2), None]
    assert one.rows(True)[1].tolist() == [0, 1, 1, 1]
    assert len(one.rows(False)[1]) == 10


def test_intervals_are_over_recordings():
    """Give recordings that agree no interval, however few rows they have, and others that differ a wide one."""
    same = [told(f"{k}", [0.1, 0.9], [0, 1]) for k in range(5)]
    hits = lambda p, y: float(np.mean(p[y == 1] > 0.5))  # noqa: E731
    (one,) = over_recordings(same, [hits], True)
    assert (one.low, one.high) == (1.0, 1.0)
    (other,) = over_recordings([*same, *(told(f"b{k}", [0.1, 0.2], [0, 1]) for k in range(5))], [hits], True)
    assert other.value == 0.5 and other.low < 0.3 and other.high > 0.7


# ---- models ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def trained(tmp_path_factory):
    """Return the path of a forest's model and what it was trained on."""
    pytest.importorskip("sklearn")
    rng = np.random.default_rng(5)
    contact = (np.arange(200) % 50 > 30).astype(np.int64)
    recordings = [recording(rng, name=f"{k}.csv", contact=contact) for k in range(3)]
    model = train_model(recordings, "forest", 0.3, 0, "here")
    path = tmp_path_factory.mktemp("model") / "model.npz"
    model.write(path)
    return path, model, recordings


@pytest.mark.parametrize("kind", ["forest", "network"])
def test_model_round_trip(trained, kind, tmp_path):
    """Read a model that gives the same bits, and tells contact of 50 standard deviations from none."""
    model = trained[1] if kind == "forest" else train_model(trained[2], kind, 0.3, 0, "here")
    model.write(tmp_path / "m.npz")
    again = read_model(tmp_path / "m.npz")
    p = model.probability(trained[2][0])
    np.testing.assert_array_equal(again.probability(trained[2][0]), p)
    assert (again.threshold, again.rate, again.trained_on) == (0.3, pytest.approx(10.0), model.trained_on)
    assert auc(p, trained[2][0].contact) > 0.99


def changed(path: Path, out: Path, **change) -> Path:
    """Write a model with other arrays."""
    with np.load(path) as file:
        held = {k: file[k] for k in file.files}
    np.savez(out, **(held | change))
    return out


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"format": np.array("x/1")}, f"format: found 'x/1'; allowed: {FORMAT}"),
        ({"layout": np.array("13 a joint")}, f"features: found '13 a joint'; allowed: {LAYOUT}"),
        ({"kind": np.array("svm")}, "kind 'svm'"),
        ({"noise": np.zeros(2)}, "noise above zero"),
        ({"mean": np.zeros((3, 5))}, "no friction model"),
        ({"threshold": np.array(1.5)}, "threshold"),
        ({"classifier_child": np.zeros(5, np.int32)}, "no trees"),
        ({"trained_on": np.array([{}], dtype=object)}, "no whole .npz archive of plain arrays"),
    ],
)
def test_models_that_are_none_are_refused(trained, tmp_path, change, said):
    """Say in one line what is wrong; never load a pickle."""
    with pytest.raises(InputError) as caught:
        read_model(changed(trained[0], tmp_path / "bad.npz", **change))
    assert said in str(caught.value)


def test_a_walk_in_a_circle_is_refused(trained, tmp_path):
    """Refuse a forest whose child leads back, which a kernel would walk for ever."""
    with np.load(trained[0]) as file:
        child = file["classifier_child"].copy()
    child[child > 0] = 0
    with pytest.raises(InputError, match="no trees"):
        read_model(changed(trained[0], tmp_path / "bad.npz", classifier_child=child))


# ---- real recordings ---------------------------------------------------------------------------------------------


@pytest.mark.skipif(not SHARED.is_dir(), reason="the real recordings are not in the repository")
def test_pushes_on_a_real_arm_at_rest_are_told():
    """Find pushes of more than 5 N on a UR5 at another pose than that trained at (measured: 0.88 and 0.81)."""
    made = {r.name: r for r in read_recordings(SHARED / "ur5")}
    first, second = (made[f"still_force_{name}.csv"] for name in "ab")
    model = train_model([first], "forest", 0.5, 0, "ur5")
    model = model.with_free_motion(fit_free_motion([second], "ur5"))
    assert auc(model.probability(second), second.contact) > 0.8
