"""Policies in the same worlds: differences, bootstrap and relative success by hand, and the command that tells them."""

import json
import math
import re

import numpy as np
import pytest
from bough.cli.evaluate import Evaluate
from bough.learn.policies.compare import (
    Episodes,
    difference,
    feasible,
    join,
    read_episodes,
    relative_success,
    write_episodes,
)
from bough.learn.policies.compare_report import put_beside
from bough.learn.tasks.parts import Column
from bough.sim.base.errors import InputError
from oracles.reach.task import registry
from oracles.reach.train import short_run
from scipy import stats

SR, FORCE = Column("SR %", "success", 100.0), Column("Force N", "force")
LATE = Column("Steps", "duration", of_successes=True)


def episodes(target, kinds=None, **measures):
    """Return episodes about some targets."""
    given = {name: np.array(values, float) for name, values in measures.items()}
    return Episodes(given, np.array(target), kinds or {})


def test_difference_of_two_targets_by_hand():
    """Forces differ by 1 N about one target and by 3 N about the other, two episodes of each.

    A resample holds the first twice, each once, or the second twice: differences 1, 2, 3 N with chances 1/4, 1/2, 1/4,
    so that the 95 % interval is 1 to 3 N.
    """
    one = episodes([0, 0, 1, 1], success=[1, 0, 1, 1], force=[5.0, 7.0, 9.0, 4.0])
    other = episodes([0, 0, 1, 1], success=[0, 0, 1, 1], force=[5.0, 5.0, 5.0, 2.0])
    found = difference(one, other, FORCE)
    assert (found.value, found.low, found.high) == (2.0, 1.0, 3.0) and found.sure
    shares = difference(one, other, SR)
    assert (shares.value, shares.low, shares.high) == (25.0, 0.0, 50.0) and not shares.sure
    assert difference(other, one, FORCE).value == -2.0


def test_only_successes_count_where_a_column_says_so():
    """Successes took 10 and 20 steps against 40; of a policy without successes there is nothing to say."""
    one = episodes([0, 1, 2], success=[1, 1, 0], duration=[10.0, 20.0, 99.0])
    other = episodes([0, 1, 2], success=[0, 1, 0], duration=[99.0, 40.0, 99.0])
    never = episodes([0, 1, 2], success=[0, 0, 0], duration=[99.0] * 3)
    assert difference(one, other, LATE).value == 15.0 - 40.0
    assert math.isnan(difference(one, never, LATE).value) and math.isnan(difference(one, other, FORCE).value)
    with pytest.raises(ValueError, match="other targets"):
        difference(one, episodes([0, 1, 3], success=[0, 0, 0]), SR)


def test_interval_is_scipy_s():
    """Of 60 targets with an episode each: ends as scipy's paired percentile bootstrap, to a tenth of the width.

    Both scatter by 1 / sqrt(0.025 x 0.975 x 10000) of a quantile's density: a fiftieth of the width each.
    """
    rng = np.random.default_rng(0)
    a = rng.gamma(2.0, 5.0, 60)
    b = 0.7 * a + rng.gamma(1.0, 2.0, 60)
    one, other = (episodes(np.arange(60), success=np.ones(60), force=x) for x in (a, b))
    found = difference(one, other, FORCE)
    theirs = stats.bootstrap((a, b), lambda x, y, axis: x.mean(axis) - y.mean(axis), paired=True, method="percentile",
                             vectorized=True, rng=1).confidence_interval  # fmt: skip
    assert found.value == pytest.approx(a.mean() - b.mean())
    np.testing.assert_allclose((found.low, found.high), theirs, atol=0.1 * (theirs.high - theirs.low))


def test_success_relative_to_an_ensemble_by_hand():
    """Of five worlds three are reached by one of two policies; the first reaches two of those, the third all of none.

    Wilson's interval of 2 in 3 is 20.8 to 93.9 %.
    """
    kinds = {"hard": np.array([True, True, False, False, False]), "none": np.zeros(5, bool)}
    target = [0, 1, 2, 3, 4]
    found = {"trained": episodes(target, kinds, success=[1, 0, 1, 0, 0]),
             "b": episodes(target, kinds, success=[1, 1, 0, 0, 0]),
             "c": episodes(target, kinds, success=[0, 0, 0, 0, 0])}  # fmt: skip
    possible = feasible([found["trained"], found["b"]])
    assert possible.tolist() == [True, True, True, False, False]
    assert relative_success(found["trained"], possible) == (2 / 3, 3)
    assert math.isnan(relative_success(found["c"], np.zeros(5, bool))[0])
    beside = put_beside(found, ["b"], ["trained", "b"], (SR,), 0)
    share = beside.relative["trained"]["all"]
    assert (share.possible, share.worlds) == (3, 5)
    np.testing.assert_allclose(share.interval, (0.2077, 0.9385), atol=1e-4)
    assert beside.relative["b"]["hard"].share == 1.0 and set(beside.relative["b"]) == {"all", "hard"}
    told = "\n".join(beside.markdown())
    assert "all (3 of 5)" in told and "66.7 [20.8, 93.9]" in told and "trained less b" in told
    assert json.loads(json.dumps(beside.plain()))["oracle"]["success"]["c"]["hard"]["share %"] == 0.0


def test_episodes_of_sets_are_joined_written_and_read(tmp_path):
    """Get back what was written; refuse another file, and a policy that is not in it."""
    kinds = {"hard": np.array([True, False])}
    both = join([episodes([0, 1], kinds, success=[1, 0]), episodes([0, 1], kinds, success=[0, 0])])
    assert both.target.tolist() == [0, 1, 0, 1] and both.kinds["hard"].tolist() == [True, False] * 2
    write_episodes(tmp_path / "e.npz", {"trained": both})
    back = read_episodes(tmp_path / "e.npz")
    np.testing.assert_array_equal(back.measures["success"], [1, 0, 0, 0])
    np.testing.assert_array_equal(back.kinds["hard"], both.kinds["hard"])
    (tmp_path / "text.npz").write_text("no")
    for name, policy, words in (("e.npz", "zero", "zero: found no episodes"), ("text.npz", "trained", "no whole .npz"),
                                ("none.npz", "trained", "no such file")):  # fmt: skip
        with pytest.raises(InputError, match=words):
            read_episodes(tmp_path / name, policy)


def test_command_puts_runs_beside_each_other(tmp_path, capsys):
    """Test two runs in the same worlds: the second's row is what it comes to alone, differences are of the means."""
    one, other = short_run(tmp_path / "one"), short_run(tmp_path / "other", seed=5)
    sizes = {"sets": 2, "worlds": 16, "device": "cpu", "baselines": ()}
    assert Evaluate(one, against=(other,), oracle=(other,), **sizes).run(registry()) == 0
    assert "trained less other" in capsys.readouterr().out
    found = json.loads((one / "evaluation.json").read_text())
    rows = {row["policy"]: row["Test Rew"] for row in found["rows"]}
    assert list(rows) == ["trained", "other"] and found["oracle"]["ensemble"] == ["trained", "other"]
    told = found["differences"]["other"]["all"]["Test Rew"]
    assert told["difference"] == pytest.approx(rows["trained"]["mean"] - rows["other"]["mean"], rel=1e-5)
    assert told["interval"][0] <= told["difference"] <= told["interval"][1]
    assert len(read_episodes(one / "evaluation.npz", "other").target) == 32
    Evaluate(other, **sizes).run(registry())
    assert json.loads((other / "evaluation.json").read_text())["rows"][0]["Test Rew"] == rows["other"]
    for given, words in (((one,), "found the run itself"), ((tmp_path / "nothing",), "found no such folder")):
        with pytest.raises(InputError, match=re.escape(words)):
            Evaluate(one, against=given, **sizes).run(registry())
