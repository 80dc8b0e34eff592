"""What is said of a policy: columns by hand, the same worlds for every policy, a film that holds what happened."""

import json
import math
import re
import shutil
from pathlib import Path

import numpy as np
import PIL.Image
import PIL.ImageSequence
import pytest
import torch
from bough.cli.evaluate import Evaluate
from bough.cli.play import Play
from bough.learn.policies.evaluate import Row, columns, evaluate, files_of, first_episodes, random, table, wilson, zero
from bough.learn.runs.folder import RunFolder
from bough.learn.tasks.measures import CLEARING_COLUMNS
from bough.learn.tasks.task import unseen_seed
from bough.sim.base.errors import InputError
from oracles import json_page
from oracles.reach.task import LENGTH, Crowded, Reach, ReachSettings, registry
from oracles.reach.train import short_run

COLUMNS = tuple(column.name for column in CLEARING_COLUMNS)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder of a short run."""
    return short_run(tmp_path_factory.mktemp("run") / "run")


def task(worlds=5, seed=1):
    """Return the point mass as a test set."""
    return registry().make("reach", ReachSettings(), num_envs=worlds, seed=seed, device="cpu", test=True)


def test_columns_by_hand():
    """Four worlds, two of which succeed, each number worked out on paper."""
    metrics = {
        "return": torch.tensor([1.0, 2.0, 3.0, 6.0]),
        "success": torch.tensor([0.0, 1.0, 0.0, 1.0]),
        "occlusion_drop": torch.tensor([-0.2, 0.5, 0.1, 1.0]),
        "breach": torch.tensor([0.0, 0.0, 0.5, 0.1]),
        "steps_clear": torch.tensor([3.0, 40.0, 9.0, 60.0]),
    }
    found = columns(metrics, CLEARING_COLUMNS)
    assert tuple(found) == COLUMNS
    np.testing.assert_allclose(list(found.values()), [3.0, 50.0, 35.0, 15.0, 50.0], rtol=1e-6)  # float32 shares
    metrics["success"].zero_()
    assert math.isnan(columns(metrics, CLEARING_COLUMNS)["Steps in Succ"])


def test_mean_and_spread_over_sets():
    """Sample standard deviation over the sets that have a value; none from one set."""
    sets = [dict.fromkeys(COLUMNS, v) for v in (1.0, 2.0, 6.0)]
    sets[2] = sets[2] | {"Steps in Succ": math.nan}
    row = Row("trained", 4.25, 30, sets)
    assert row.mean("Test Rew") == 3.0 and row.spread("Test Rew") == pytest.approx(math.sqrt(7.0))
    assert row.mean("Steps in Succ") == 1.5 and row.spread("Steps in Succ") == pytest.approx(math.sqrt(0.5))
    assert math.isnan(Row("zero", math.nan, 10, sets[:1]).spread("Test Rew"))
    lines = table([row, Row("zero", math.nan, 10, sets[:1])]).splitlines()
    assert lines[0].split("|")[1:4] == [" policy  ", " Train Rew ", " Trials "]
    assert lines[0].split("|")[-2:] == [" No room ", ""] and lines[2].split("|")[-2].strip() == "0"
    assert "3.0 ± 2.6" in lines[2] and lines[3].split("|")[2].strip() == "-"
    assert len(set(map(len, lines))) == 1


def test_intervals_of_shares_and_kinds_of_worlds():
    """Wilson's interval of 8 in 10 is 49.0 to 94.3 %, of 0 in 60 it is 0 to 6.0 %; a kind's trials are its own."""
    np.testing.assert_allclose(wilson(0.8, 10), (0.4902, 0.9433), atol=1e-4)
    np.testing.assert_allclose(wilson(0.0, 60), (0.0, 0.0602), atol=1e-4)
    one = {"SR %": 80.0, "Force N": 3.0}
    strata = [{"near": (one, 4), "far": (one | {"Force N": 9.0}, 6)}] * 2
    row = Row("trained", math.nan, 20, [one] * 2, shares=("SR %",), strata=strata)
    assert "80.0 [58.4, 91.9]" in table([row])
    far = row.of_stratum("far")
    assert far.trials == 12 and far.mean("Force N") == 9.0 and far.policy == "trained, far"
    assert files_of() == ("evaluation.json", "evaluation.md")
    assert files_of(True, ["forest=Tb"])[0] == "evaluation_all_scenes_forest-Tb.json"


def test_first_episode_of_every_world_counts_once():
    """Return what a world's own first episode came to, from the positions, in float64, though worlds go on."""
    t = task()
    t.episode_length_buf.copy_(torch.tensor([0, 5, 19, 0, 12]))  # they end at different times
    start, left = t.x.double().numpy().copy(), np.array([20, 15, 1, 20, 8])
    found = first_episodes(t, zero(t))
    assert set(found) == set(t.metrics)
    np.testing.assert_allclose(found["return"], -(start**2).sum(1) * left, rtol=1e-5)  # float32 sums of 20 numbers
    np.testing.assert_allclose(found["occlusion_drop"], 0.0, atol=1e-6)


def test_random_policy_is_even_and_seeded():
    """Fill -1 to 1 evenly: mean 0, variance 1/3, within five standard errors of 20 000 draws."""
    t = task(worlds=10_000)
    drawn, again = random(t, 3)(None), random(t, 3)(None)
    assert torch.equal(drawn, again) and not torch.equal(drawn, random(t, 4)(None))
    assert drawn.abs().max() <= 1 and abs(float(drawn.mean())) < 5 * math.sqrt(1 / 3 / 20_000)
    assert abs(float(drawn.var()) - 1 / 3) < 5 * math.sqrt((1 / 5 - 1 / 9) / 20_000)


def test_all_scenes_of_a_task_that_leaves_none_out_is_refused(run):
    """Say so in one line and write nothing."""
    before = sorted(p.name for p in run.iterdir())
    with pytest.raises(InputError, match="--all-scenes: found reach; allowed: a task that leaves scenes out"):
        evaluate(run, registry(), all_scenes=True)
    assert sorted(p.name for p in run.iterdir()) == before


def test_command_writes_and_prints_the_table(run, capsys):
    """Test trained, zero and random in the same worlds; the same command gives the same file."""
    assert Evaluate(run, sets=2, worlds=16, device="cpu").run(registry()) == 0
    said = capsys.readouterr().out
    found = json.loads((run / "evaluation.json").read_text())
    assert (run / "evaluation.md").read_text() in said and "evaluation.json" in said.splitlines()[-1]
    rows = {row["policy"]: row for row in found["rows"]}
    assert list(rows) == ["trained", "zero", "random"] and rows["trained"]["Trials"] == 32
    assert rows["trained"]["Train Rew"] < 0 and rows["zero"]["Train Rew"] is None
    for index in (0, 1):
        t = task(worlds=16, seed=unseen_seed(0, index))
        start = t.x.double().numpy()
        expected = -(start**2).sum(1).mean() * LENGTH
        assert rows["zero"]["Test Rew"]["sets"][index] == pytest.approx(expected, rel=1e-5)
    before = (run / "evaluation.json").read_bytes()
    Evaluate(run, sets=2, worlds=16, device="cpu").run(registry())
    assert (run / "evaluation.json").read_bytes() == before
    alone = evaluate(run, registry(), sets=2, worlds=16)
    assert [row.policy for row in alone] == ["trained"]
    assert alone[0].sets[1]["Test Rew"] == rows["trained"]["Test Rew"]["sets"][1]


def test_contacts_without_room_are_told_of_every_policy(run, tmp_path):
    """Count those of the test's own steps: seven a step of two sets' episodes, in JSON and in the table's last column.

    The counter begins at 100: what was left out before a test is not the policy's.
    """
    shutil.copytree(run, tmp_path / "run")
    assert Evaluate(tmp_path / "run", sets=2, worlds=4, device="cpu").run(registry(kind=Crowded)) == 0
    rows = json.loads((tmp_path / "run" / "evaluation.json").read_text())["rows"]
    assert {row["policy"]: row["No room"] for row in rows} == dict.fromkeys(("trained", "zero", "random"), 14 * LENGTH)
    head, _, *body = (tmp_path / "run" / "evaluation.md").read_text().splitlines()
    assert head.split("|")[-2].strip() == "No room"
    assert [line.split("|")[-2].strip() for line in body if line.startswith("|")] == [str(14 * LENGTH)] * 3


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"worlds": 0}, "--worlds: found 0; allowed: 1 or more"),
        ({"sets": 0}, "--sets: found 0"),
        ({"seed": -1}, "--seed: found -1"),
        ({"run_folder": "nothing"}, "nothing: found no such folder; allowed: a folder that bough train wrote"),
        ({"run_folder": "."}, ".: found no config.json; allowed: a folder that bough train wrote"),
    ],
)
def test_bad_options_are_one_line(run, options, words):
    """Refuse before anything is written."""
    arguments = {"run_folder": run, "device": "cpu"} | options
    arguments["run_folder"] = Path(arguments["run_folder"])
    with pytest.raises(InputError, match=re.escape(words)):
        Evaluate(**arguments).run(registry())


def test_policies_of_another_version_are_refused(run, tmp_path):
    """Name what was found and what this version has; a run before its first checkpoint has no policy."""
    with pytest.raises(InputError, match="version of reach: found 1; allowed: 2"):
        evaluate(run, registry(version=2), sets=1, worlds=2)
    shutil.copytree(run, tmp_path / "young")
    shutil.rmtree(tmp_path / "young" / "checkpoints")
    with pytest.raises(InputError, match="a run without a checkpoint"):
        evaluate(tmp_path / "young", registry(), sets=1, worlds=2)
    shutil.copytree(run, tmp_path / "other")
    config = RunFolder(tmp_path / "other").config()
    config["task"]["settings"]["groups"] = ["place"]
    RunFolder(tmp_path / "other").write_config(config)
    with pytest.raises(InputError, match="a network that does not fit") as error:
        evaluate(tmp_path / "other", registry(), sets=1, worlds=2)
    assert "\n" not in str(error.value)


def test_film_of_an_episode(run, tmp_path, capsys):
    """Hold a picture of the start and every second step, in real time, the first one of the test set's first world."""
    assert Play(str(run), tmp_path / "film", fps=10.0, device="cpu").run(registry()) == 0
    assert re.fullmatch(r"reach, \S+: 1.0 s, (no )?success, inside the margin \d+ %, occlusion drop -?\d+ %, "
                        r"10 pictures. Wrote \S*film.gif\n",
                        capsys.readouterr().out)  # fmt: skip
    with PIL.Image.open(tmp_path / "film" / "film.gif") as film:
        frames = PIL.ImageSequence.Iterator(film)
        assert sum(frame.info["duration"] for frame in frames) == 10 * 100  # equal pictures are one that stays
        film.seek(0)
        assert film.size == (32, 24)
        t = task(worlds=1, seed=unseen_seed(0, 0))
        np.testing.assert_array_equal(np.asarray(film.convert("RGB")), t.render(0))


def test_pictures_of_policies_without_a_run(tmp_path, capsys):
    """Write numbered pictures of zero and random for as long as asked; nothing moves under zero."""
    assert Play("zero", tmp_path / "a", task="reach", film="png", seconds=0.2, device="cpu").run(registry()) == 0
    assert "stopped before the end" in capsys.readouterr().out
    frames = sorted((tmp_path / "a" / "frames").iterdir())
    assert [f.name for f in frames] == [f"{i:04d}.png" for i in range(5)]
    pictures = [np.asarray(PIL.Image.open(f)) for f in frames]
    assert all(np.array_equal(pictures[0], p) for p in pictures)
    command = Play("random", tmp_path / "b", task="reach", film="png", seconds=0.2, device="cpu", json=True)
    assert command.run(registry()) == 0
    json_page.check("play", json.loads(capsys.readouterr().out))
    last = np.asarray(PIL.Image.open(tmp_path / "b" / "frames" / "0004.png"))
    assert not np.array_equal(last, pictures[0])


def test_a_film_tells_contacts_without_room(tmp_path, capsys):
    """Say them in the sentence and in JSON, 100 of the start and seven a step; a task without contact has none."""
    crowded = 100 + 7 * LENGTH
    for kind, told, found in ((Crowded, f", {crowded} contacts without room, ", crowded), (Reach, "pictures", 0)):
        for json_ in (False, True):
            out = tmp_path / f"{kind.__name__}_{json_}"
            play = Play("zero", out, task="reach", fps=5.0, device="cpu", json=json_)
            assert play.run(registry(kind=kind)) == 0
            said = capsys.readouterr().out
            assert json_ or (told in said and ("without room" in said) == bool(found))
        assert json.loads(said)["contacts_without_room"] == found
    json_page.check("play", json.loads(said))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"policy": "zero"}, "--task: found nothing; allowed: reach"),
        ({"policy": "zero", "task": "fly"}, "found fly; allowed: reach"),
        ({"policy": "nowhere"}, "found no such folder"),
        ({"policy": "zero", "task": "reach", "fps": 0.0}, "--fps: found 0"),
        ({"policy": "zero", "task": "reach", "fps": 5e-324}, "--fps: found 4.94066e-324; allowed: 0.01 to 50"),
        ({"policy": "zero", "task": "reach", "fps": math.nan}, "--fps: found nan"),
        ({"policy": "zero", "task": "reach", "seconds": -1.0}, "--seconds: found -1"),
        ({"policy": "zero", "task": "reach", "seconds": 1e308}, "--seconds: found 1e+308; allowed: above 0, up to"),
        ({"policy": "zero", "task": "reach", "seconds": math.inf}, "--seconds: found inf"),
        ({"policy": "zero", "task": "reach", "seconds": math.nan}, "--seconds: found nan"),
        ({"policy": "zero", "task": "reach", "seed": -1}, "--seed: found -1"),
    ],
)
def test_plays_that_cannot_be(tmp_path, options, words):
    """Refuse in one line and write nothing."""
    with pytest.raises(InputError, match=re.escape(words)):
        Play(out=tmp_path / "out", device="cpu", **options).run(registry())
    assert not (tmp_path / "out").exists()
