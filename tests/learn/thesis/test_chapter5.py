"""Chapter 5 again: its runs and columns, a command that is killed and goes on, the encoder against NumPy."""

import html
import json
import math
import re
from dataclasses import dataclass, field, replace

import numpy as np
import pytest
import torch
import tyro
from bough.cli.reproduce import Reproduce
from bough.learn.policies import train_report
from bough.learn.policies.train import Trainer
from bough.learn.runs.folder import RunFolder
from bough.learn.tasks.clearing import make_task
from bough.learn.tasks.measures import CLEARING_COLUMNS
from bough.learn.tasks.names import CLEARING
from bough.learn.tasks.ppo_settings import PRESETS as PPO
from bough.learn.tasks.registry import TaskKind, TaskRegistry
from bough.learn.tasks.settings import GROUPS, PRESETS, TaskSettings, columns_of
from bough.learn.thesis.chapter5 import embedding
from bough.learn.thesis.chapter5.pointnet import PointNet
from bough.learn.thesis.chapter5.report import curve, verdict
from bough.learn.thesis.chapter5.reproduce import check
from bough.learn.thesis.chapter5.runs import REMOVED, TABLE_5_2, Options, Run, outcome
from bough.learn.thesis.common.interval import Interval, interval
from bough.learn.thesis.common.trainings import learn, runs_under
from bough.sim.base.console import start_warp
from bough.sim.base.errors import InputError
from bough.sim.scenes.scene import SceneSettings
from oracles.reach.task import Reach, Start

TINY = replace(PPO["cpu"], num_envs=4, horizon=8, hidden=(8,), checkpoint_every=1)


@pytest.fixture
def tiny(monkeypatch):
    """Let the preset of PPO be a tiny one."""
    monkeypatch.setitem(PPO, "cpu", TINY)


@dataclass(frozen=True)
class PointSettings:
    """What chapter 5 sets of a task."""

    groups: tuple[str, ...] = GROUPS
    max_noise: tuple[float, float] = (0.0, 0.0)
    episode_steps: int = 20
    start: Start = field(default_factory=Start)


class PointTask(Reach):
    """The point mass under the name of the power line: it is seen with the group kme alone."""

    name = "powerline"

    def __init__(self, settings, **how):
        assert settings.max_noise[0] == settings.max_noise[1] > 0
        seen = ("time", "place") if "kme" in settings.groups else ("time",)
        super().__init__(replace(settings, groups=seen), **how)


def points():
    """Return a registry in which every task is the point mass."""
    return one_kind({"cpu": PointSettings()}, lambda name, settings, **how: PointTask(settings, **how))


def one_kind(presets, make=make_task):
    """Return a registry of the clearing tasks alone."""
    return TaskRegistry((TaskKind(CLEARING, GROUPS, presets, make, CLEARING_COLUMNS),))


def small():
    """Return a registry of the real task with two trees and episodes of four steps."""
    settings = TaskSettings(scene=SceneSettings(distinct=2), episode_steps=4, success_steps=2)
    return one_kind({"cpu": settings})


def command(out, *options):
    sizes = ("--iterations", "2", "--noise-levels", "0.005", "0.02", "--sets", "2", "--worlds", "4", "--device", "cpu")
    arguments = ["chapter5", "--out", str(out), *sizes, *options]
    config = (tyro.conf.OmitArgPrefixes, tyro.conf.DisallowNone)
    return tyro.cli(Reproduce, args=arguments, config=config).chapter


# ---- what is run ---------------------------------------------------------------------------------------------------


def test_rows_see_what_the_thesis_says():
    """By hand from table 5.1: 16 + 1 numbers in (a), 6 local ones, 1 of touch, 64 of the embeddings: 88 in all."""
    registry = one_kind(PRESETS)
    widths = [columns_of(Options().settings(row.run, registry), 6)[1] for row in TABLE_5_2]
    assert widths == [17, 23, 24, 87, 88, 88]
    assert [Options().settings(row.run, registry).max_noise[1] for row in TABLE_5_2] == [0.02] * 5 + [0.005]
    removed = {n: columns_of(Options().settings(Run(left, 0.01), registry), 6)[1] for n, left in REMOVED.items()}
    assert removed == {"-KME": 24, "-touch": 87, "-local": 82, "-occlusion": 87, "none": 88}


def test_runs_of_table_and_figure_are_shared():
    """Train six rows and 5 x 3 points with 17 runs: (c), (d), (e) and (f) are points of the figure too.

    Three seeds take 51, all of the first seed first; they differ in the seed of training, not in that of the tests.
    """
    runs = Options(seeds=1).runs
    assert len(runs) == 17 and len({run.name for run in runs}) == 17
    assert [runs[row.run] for row in TABLE_5_2] == [3] * 6 and sum(runs.values()) == 6 * 3 + 11
    assert TABLE_5_2[0].run.name == "without-kme-touch-local-0.02-seed0"
    assert TABLE_5_2[-1].run.name == "all-0.005-seed0"
    three = Options(seed=7).runs
    assert len(three) == 51 and [run.repeat for run in three] == [0] * 17 + [1] * 17 + [2] * 17
    registry = one_kind(PRESETS)
    plans = [Options(seed=7).plan(run, registry) for run in list(three)[::17]]
    assert [plan.seed for plan in plans] == [7, 8, 9] and len({plan.settings for plan in plans}) == 1
    assert [len(Options().policies(replace(TABLE_5_2[-1].run, repeat=k))) for k in range(3)] == [2, 0, 0]
    assert Options(iterations=1250, num_envs=6144).share == 1.0


def test_intervals_over_seeds_by_hand():
    """Of 10, 20 and 30: 20 +- 4.3027 x 10 / sqrt 3 (table of t, two degrees of freedom); one value has no interval."""
    found = interval([10.0, 20.0, 30.0])
    half = 4.302652729911275 * 10 / math.sqrt(3)
    assert (found.mean, found.low, found.high) == pytest.approx((20.0, 20.0 - half, 20.0 + half))
    one = interval([7.0, math.nan])
    assert one.mean == 7.0 and math.isnan(one.low) and one.count == 1


def test_a_verdict_takes_three_seeds_and_intervals_apart():
    """No word where intervals overlap or touch, nor with one or two trainings, however far apart they are."""
    low, high = interval([10.0, 11.0, 12.0]), interval([40.0, 41.0, 42.0])
    assert verdict(low, high) == "helps" and verdict(high, low) == "harms"
    assert verdict(low, interval([10.0, 20.0, 60.0])) == "-"
    assert verdict(Interval(1.0, 0.0, 2.0, 3), Interval(3.0, 2.0, 4.0, 3)) == "-"
    for few in ([40.0, 40.1], [40.0]):
        assert verdict(low, interval(few)) == verdict(interval(few), low) == "-"


def test_curve_weighs_episodes():
    """Mean over the episodes of a tenth of the run, here two iterations; where none ended nothing is drawn."""
    rows = [{"episodes": 0.0, "return": None, "success": None}] + [
        {"episodes": float(k), "return": 10.0 * k, "success": 0.1 * k} for k in range(1, 20)
    ]
    iterations, returns, success = curve(rows)
    assert iterations[:3] == [2.0, 3.0, 4.0] and len(iterations) == 19
    assert returns[:2] == pytest.approx([10.0, (10 + 40) / 3]) and success[1] == pytest.approx(100 * (0.1 + 0.4) / 3)


# ---- the command ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def sensors():
    """Return sensors of the real task: three worlds, and one."""
    start_warp()
    return {n: small().make("powerline", TaskSettings(scene=SceneSettings(distinct=2)), num_envs=n, seed=1,
                            device="cpu", test=False) for n in (3, 1)}  # fmt: skip


@pytest.fixture
def no_timing(monkeypatch, sensors):
    """Time the embeddings on few worlds that are there already."""
    monkeypatch.setattr(embedding, "WORLDS", (3, 1))
    monkeypatch.setattr(embedding, "_REPEATS", {embedding.KERNELS: 2, embedding.LEARNT: 1})
    measure = embedding.measure
    kind = replace(small().of("powerline"), make=lambda *_, num_envs, **__: sensors[num_envs])
    registry = TaskRegistry((kind,))
    monkeypatch.setattr(embedding, "measure", lambda task, settings, _, **how: measure(task, settings, registry, **how))


def untimed(out):
    """Return the tables without the one that holds times."""
    tables = json.loads((out / "tables.json").read_text())["tables"]
    return {name: table for name, table in tables.items() if name != "table_5_3"}


def test_command_that_is_interrupted_goes_on(tiny, no_timing, tmp_path, monkeypatch, capsys):
    """Stop inside the third run; go on, keep what is done, and end with the tables of an uninterrupted command."""
    monkeypatch.setattr(train_report, "write", lambda folder: None)  # eight pages more, seconds of drawing
    level = ("--noise-levels", "0.02", "--seeds", "1")
    assert command(tmp_path / "whole", *level).run(points()) == 0
    said = capsys.readouterr().out
    assert said.count("\n") == 1 and "report.html" in said
    after, calls = Trainer._after, []

    def cut(self, iteration):
        after(self, iteration)
        calls.append(iteration.number)
        if len(calls) == 5:  # after the first checkpoint of the third run
            raise KeyboardInterrupt

    out = tmp_path / "cut"
    with monkeypatch.context() as patch:
        patch.setattr(Trainer, "_after", cut)
        assert command(out, *level).run(points()) == 130
    assert "--resume" in capsys.readouterr().err and not (out / "report.html").exists()
    first = out / "runs" / TABLE_5_2[0].run.name / "metrics.csv"
    before = first.stat().st_mtime_ns
    with pytest.raises(InputError, match=r"--out: found 3 runs; allowed: --resume"):
        command(out, *level).run(points())
    assert command(out, *level, "--resume").run(points()) == 0
    assert first.stat().st_mtime_ns == before
    assert untimed(tmp_path / "whole") == untimed(out)


def test_report_holds_every_table_and_figure(tiny, no_timing, tmp_path):
    """Show the thesis's rows beside ours over two seeds, zero and random, and the scale; need no other page.

    Begun with one seed and gone on to two: the first one's runs stay.
    """
    out = tmp_path / "out"
    assert command(out, "--seeds", "1").run(points()) == 0
    first = out / "runs" / "all-0.02-seed0" / "metrics.csv"
    before = first.stat().st_mtime_ns
    assert command(out, "--seeds", "2", "--resume").run(points()) == 0
    assert first.stat().st_mtime_ns == before
    kept = json.loads((out / "tables.json").read_text())["tables"]
    assert set(kept) == {"table_5_2", "table_5_2_added", "figure_5_4", "figure_5_4_policies", "table_5_3"}
    rows = {row[0]: row for row in kept["table_5_2"]["rows"]}
    assert len(rows) == 2 * 6 + 4
    assert rows["thesis, (f) all, less noise"][4:] == [
        "1763.6 ± 21.5", "68.4 ± 2.1", "53.7 ± 2.2", "3.3 ± 0.4", "429.8 ± 25.6",
    ]  # fmt: skip
    found = [json.loads((out / "runs" / f"all-0.02-seed{k}" / "evaluation.json").read_text())["rows"] for k in (0, 1)]
    for label, entry in zip(("zero, worlds of (e)", "random, worlds of (e)"), found[0][1:], strict=True):
        reward = entry["Test Rew"]
        assert rows[f"bough, {label}"][4] == f"{reward['mean']:.1f} ± {reward['spread']:.1f}"
    ours = [entry[0]["Test Rew"]["mean"] for entry in found]
    half = 12.706204736174698 * abs(ours[0] - ours[1]) / 2  # t of one degree of freedom, deviation over root two
    mean = sum(ours) / 2
    assert rows["bough, (e) all"][4] == f"{mean:.1f} ({mean - half:.1f} to {mean + half:.1f})"
    assert rows["bough, (e) all"][3] == 2 * 2 * 4 and len(found[1]) == 1
    assert {row[-1] for row in kept["table_5_2_added"]["rows"]} == {"-"}  # two seeds are too few for a word
    assert len(kept["figure_5_4_policies"]["rows"]) == 5 * 2 * 2
    text = html.unescape((out / "report.html").read_text())
    assert all(table["title"] in text for table in kept.values())
    assert "4 worlds and 2 iterations" in text and not re.search(r"https?:", text)
    assert sorted(p.name for p in out.glob("*.png")) == ["figure_5_4.png", "table_5_2.png", "table_5_2_curves.png"]
    assert (out / "runs" / "all-0.02-seed1" / "report.html").exists()


def test_runs_can_be_longer_and_nothing_else(tiny, tmp_path, monkeypatch):
    """Go on to more iterations and test anew; fewer, or another seed, are refused."""
    monkeypatch.setattr(train_report, "write", lambda folder: None)
    run, registry, silent = TABLE_5_2[-1].run, points(), lambda done: None
    folder = RunFolder(runs_under(tmp_path) / run.name)
    for iterations in (2, 3):
        options = Options(iterations=iterations, sets=1, worlds=4)
        learn(folder, options.plan(run, registry), registry, silent)
        outcome(folder, options, run, registry, silent)
        assert folder.newest().number == iterations
        assert json.loads((folder.path / "evaluation.json").read_text())["iteration"] == iterations
    for other, words in (({"iterations": 2}, "--iterations: found 2; allowed: 3 or more"),
                         ({"iterations": 3, "seed": 1}, "a run with other options"),
                         ({"iterations": 3, "num_envs": 5}, "a run with other options")):  # fmt: skip
        with pytest.raises(InputError, match=words):
            check(tmp_path, Options(**other), registry, resume=True)
    check(tmp_path, Options(iterations=4), registry, resume=True)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--num-envs", "0"), "reproduce: --num-envs: found 0; allowed: 1 or more"),
        (("--iterations", "0"), "reproduce: --iterations: found 0"),
        (("--sets", "0"), "reproduce: --sets: found 0"),
        (("--seeds", "0"), "reproduce: --seeds: found 0"),
        (("--noise-levels", "0.02", "0.02"), "reproduce: --noise-levels: found 0.02, 0.02; allowed: one or more"),
        (("--noise-levels", "-0.1"), "reproduce: --noise-levels: found -0.1"),
        (("--device", "tpu"), "--device: found tpu"),
    ],
)
def test_bad_options_are_one_line(tmp_path, options, words):
    """Refuse before anything is written."""
    with pytest.raises(InputError, match=re.escape(words)) as caught:
        command(tmp_path / "out", *options).run(points())
    assert "\n" not in str(caught.value) and not (tmp_path / "out").exists()


def test_the_real_task_without_groups(tiny, tmp_path):
    """Train and test row (a) on the real task, tiny; what was tested is read, not tested again."""
    options, run = Options(num_envs=4, iterations=1, sets=1, worlds=3), TABLE_5_2[0].run
    folder = RunFolder(tmp_path / run.name)
    learn(folder, options.plan(run, small()), small(), lambda done: None)
    first = outcome(folder, options, run, small(), lambda done: None)
    assert list(first) == ["trained"] and first["trained"].trials == 3
    assert 0.0 < first["trained"].mean("Test Rew") < 4 * 1.4  # at most 1 + 0.4 a step
    again = outcome(folder, options, run, None, lambda done: None)
    assert again["trained"].sets[0]["Test Rew"] == first["trained"].sets[0]["Test Rew"]


# ---- table 5.3 -----------------------------------------------------------------------------------------------------


def test_what_is_timed_writes_all_four_embeddings(sensors):
    """Time launches that fill the columns of all worlds with what the task's own step had written, to the bit."""
    task = sensors[3]
    before, first = task.observation.clone(), task.columns["wbr"]
    task.observation[:, first : first + 64] = math.nan
    found = embedding.kernels(task.sensor)
    assert torch.equal(task.observation, before)
    assert found.clouds == 12 and 0.0 < found.seconds < 1.0


def test_encoder_time_grows_in_proportion(sensors, monkeypatch):
    """Time as many clouds as fit at once and scale to four a world."""
    seen = []
    monkeypatch.setattr(embedding, "_median", lambda call, repeats: seen.append(call().shape) or 2.0)
    monkeypatch.setattr(embedding, "_PART", {"cpu": 6})
    assert [embedding.learnt(sensors[n].sensor).seconds for n in (3, 1)] == [4.0, 2.0]
    assert seen == [(6, 1024), (4, 1024)]


def test_encoder_is_set_abstraction():
    """Agree with loops in float64: gather the 32 nearest, subtract the centre, shared layers, maximum."""
    torch.manual_seed(0)
    net, cloud = PointNet(), torch.randn(2, 64, 3)

    def chain(layers, x):
        for layer in layers:
            if isinstance(layer, torch.nn.Linear):
                x = x @ layer.weight.detach().double().numpy().T + layer.bias.detach().double().numpy()
            else:
                x = np.maximum(x, 0.0)
        return x

    def abstraction(points, features, layers, step):
        out = []
        for centre in points[::step]:
            order = np.argsort(((points - centre) ** 2).sum(1), kind="stable")[:32]
            local = np.concatenate([features[order], points[order] - centre], axis=1)
            out.append(chain(layers, local).max(0))
        return points[::step], np.array(out)

    for k in range(2):
        points, features = cloud[k].double().numpy(), np.zeros((64, 0))
        points, features = abstraction(points, features, net.local[0], 2)
        points, features = abstraction(points, features, net.local[1], 4)
        expected = chain(net.last, np.concatenate([features, points], axis=1)).max(0)
        with torch.no_grad():
            found = net(cloud)[k].numpy()
        # float32 through nine layers of up to 512 inputs, values below 1
        np.testing.assert_allclose(found, expected, atol=2e-6)
