"""What an arm's servos lack, found in recordings of another simulator (C MuJoCo), and the sums that find it."""

import numpy as np
import pytest
from bough.learn.arms.channels import rows_of
from bough.learn.arms.diagnose import diagnose_arm
from bough.learn.arms.effects import lagging, played
from bough.learn.arms.held_out import centred, chance, held_out, spread_of
from bough.learn.cases.arm import is_arm_case, load_arm_case
from bough.sim.base.errors import InputError
from oracles.robot.hidden_arm import Hidden, at, make_case


def diagnosed(tmp_path, hidden, seed=3, **options):
    return diagnose_arm(load_arm_case(make_case(tmp_path / "case", hidden, seed, 10, 7.0)), **options)


def test_nothing_hidden_is_none(tmp_path):
    """With the noise and drift of a real arm's torques, nothing is named, and the servos stay the arm's own."""
    found = diagnosed(tmp_path, Hidden())
    arm = found.case.arm
    assert found.verdict == "none" and not found.claimed
    for joint, friction in zip(found.model().joints, arm.friction, strict=True):
        assert (joint.delay_s, joint.weight_error, joint.backlash_rad) == (0.0, 0.0, 0.0)
        assert joint.friction_Nm == friction and joint.gain_Nmsprad == 80.0


def test_four_joints_that_lack_four_things(tmp_path):
    """Name friction, weight, play and delay where they are, with the values that MuJoCo was given.

    Tolerances are the grids' steps: 5 ms, 0.2 N m (a speed of 0.0025 rad/s at the gain of 80); a quarter of a play, in
    which the loose link also swings: no play operator does.
    """
    hidden = Hidden(friction=at(3, 4.0), weight=at(1, 0.2), delay=at(4, 0.12), play=at(0, 0.05), behind=True)
    found = diagnosed(tmp_path, hidden)
    named = {(n.name, c.joint) for c, n in found.claimed}
    assert found.verdict == "effects"
    assert {("dry_friction", 3), ("gravity_comp_error", 1), ("time_delay", 4), ("backlash", 0)} <= named
    # the link that is loose at joint 0 rubs as well
    assert named <= {("dry_friction", 3), ("gravity_comp_error", 1), ("time_delay", 4), ("backlash", 0),
                     ("dry_friction", 0)}  # fmt: skip
    joints = found.model().joints
    assert joints[3].friction_Nm == pytest.approx(4.0, abs=0.2)
    assert joints[1].weight_error == pytest.approx(0.2, abs=0.03)
    assert joints[4].delay_s == pytest.approx(0.12, abs=0.005)
    assert joints[0].backlash_rad == pytest.approx(0.05, rel=0.25)
    speed = {c.joint: c for c in found.channels if c.kind == "speed"}
    assert all(speed[j].repaired < 0.5 * speed[j].base for j in (1, 3, 4))
    assert speed[0].repaired < 0.8 * speed[0].base  # a link that is loose also swings, which no play operator does


def test_what_has_no_name_is_unknown(tmp_path):
    """A torque that goes round three times with the joint is on no list."""
    found = diagnosed(tmp_path, Hidden(ripple=at(1, 4.0)))
    assert found.verdict == "unknown" and any(c.joint == 1 and c.unnamed > 0.0 for c in found.channels)


def test_too_little_motion_is_no_verdict(tmp_path):
    """Say what is missing instead of a verdict."""
    case = load_arm_case(make_case(tmp_path / "case", Hidden(), 3, 2, 3.0))
    found = diagnose_arm(case)
    assert found.verdict == "unknown" and not found.channels and "needs 8" in found.unusable
    with pytest.raises(InputError, match="dry_friction"):
        diagnose_arm(case, effects=("steady_wind",))


def test_held_out_is_refitting_without_each_block():
    """Errors, coefficients and choices are those of fits made one by one; to round-off of the normal equations."""
    rng = np.random.default_rng(0)
    block, z = np.repeat(np.arange(5), 12), rng.normal(size=(60, 2))
    curve = np.stack([np.sin(k * np.arange(60) / 9) for k in (1.0, 2.0, 3.0)])
    y = z @ [0.5, -2.0] + curve[1] + 0.1 * rng.normal(size=60)
    found = held_out(y - curve, z, block)
    assert found.at == 1 and (found.chosen == 1).all()
    for b in range(5):
        seen = block != b
        beta = np.linalg.lstsq(z[seen], (y - curve[1])[seen], rcond=None)[0]
        np.testing.assert_allclose(found.betas[b], beta, rtol=1e-6)
        left = (y - curve[1] - z @ beta)[~seen]
        assert found.error[b] == pytest.approx(left @ left, rel=1e-6)
    np.testing.assert_allclose(found.left, y - curve[1] - z @ found.beta)


def test_chance_and_spread_of_noise():
    """Of pure noise one pair of models in twenty is better at 5 %; the jackknife of a mean is its standard error."""
    rng = np.random.default_rng(1)
    block = np.repeat(np.arange(12), 30)
    p = [chance(rng.chisquare(30, 12), rng.chisquare(30, 12), block) for _ in range(400)]
    assert abs(np.mean(np.array(p) < 0.05) - 0.05) < 4 * np.sqrt(0.05 * 0.95 / 400)
    x = rng.normal(size=20)
    without = (x.sum() - x) / 19
    assert spread_of(without) == pytest.approx(x.std(ddof=1) / np.sqrt(20))
    assert chance(np.ones(12), np.ones(12), block) == 1.0
    np.testing.assert_allclose(centred(np.array([1.0, 3.0, 7.0]), np.array([0, 0, 1])), [-1, 1, 0])


def test_a_play_and_a_lag():
    """A play of 0.4 follows a path up by 1 and back 0.2 and 0.8 late; a lag is 1 - exp(-t / T), in means over rows."""
    path = np.array([[0.0, 0.5, 1.0, 0.8, 0.2, -0.5]])
    np.testing.assert_allclose(played(path, np.array([0.4])), [[0.0, 0.3, 0.8, 0.8, 0.4, -0.3]])
    lag, dt = 0.3, 0.1
    step = np.array([[0.0, 1.0, 1.0, 1.0]])
    t = dt * np.arange(4)
    mean = 1.0 + lag / dt * (np.exp(-t[1:] / lag) - np.exp(-t[:-1] / lag))
    np.testing.assert_allclose(lagging(step, np.array([lag]), dt)[0, 1:], mean)


def test_rows_and_blocks(tmp_path):
    """Rows are windows of a tenth of a second without the outermost; few recordings are cut into blocks of 2 s."""
    case = load_arm_case(make_case(tmp_path / "case", Hidden(), 3, 2, 9.0))
    rows = rows_of(case)
    assert is_arm_case(case.folder) and len(rows.start) == sum(len(t.t) - 3 for t in case.trajectories)
    assert np.bincount(rows.block).min() >= 20 and (np.diff(rows.block) >= 0).all()
    np.testing.assert_allclose(rows.end - rows.start, 0.1, rtol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("weight: out", "weight: beside", ("weight",)),
        ("arm: jaco2", "arm: jaco7", ("jaco7", "jaco2")),
        ("joint: wrist_2\n  column: q5", "joint: wrist_1\n  column: q5", ("outputs", "wrist_1")),
        ("  column: dq_cmd6", "  column: dq_cmd9", ("dq_cmd9",)),
        ("format:", "fit: replay\nformat:", ("fit", "arm")),
    ],
)
def test_what_an_arm_s_case_cannot_be(tmp_path, old, new, words):
    """Refuse what is not said of weight, unknown arms, a joint twice, columns that are not there, keys of others."""
    folder = make_case(tmp_path / "case", Hidden(), 3, 1, 1.5)
    meta = folder / "meta.yaml"
    text = meta.read_text()
    assert old in text
    meta.write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as found:
        load_arm_case(folder)
    assert all(word in str(found.value) for word in words), found.value
