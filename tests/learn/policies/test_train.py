"""PPO on a task with a known optimum: it learns, the same seed gives the same bits, a run cut anywhere too."""

import hashlib
import json
import math
import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from importlib.machinery import ModuleSpec
from types import ModuleType

import numpy as np
import pytest
import torch
from bough.cli.evaluate import Evaluate
from bough.cli.export import Export
from bough.cli.play import Play
from bough.cli.train import Train
from bough.learn.policies.ppo_runner import InPlacePPO, Runner
from bough.learn.policies.train import LostError, Plan, Trainer, train
from bough.learn.policies.train_report import content
from bough.learn.runs.folder import MODEL, RunFolder
from bough.learn.runs.processes import Processes
from bough.learn.tasks.measures import CLEARING_COLUMNS
from bough.learn.tasks.ppo_settings import PRESETS, PPOSettings
from bough.learn.tasks.reach_settings import ReachSettings as TouchSettings
from bough.learn.tasks.registry import TaskKind, TaskRegistry, plain, settings_from
from bough.learn.tasks.settings import TaskSettings
from bough.learn.tasks.task import policy_seed, task_seed, unseen_seed
from bough.sim.base.errors import InputError
from bough.sim.base.extras import install_hint
from bough.sim.wood.posterior import SpringPosterior, Wood
from oracles.reach.task import LENGTH, Crowded, Reach, ReachSettings, best_return, registry
from oracles.reach.train import TINY
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

SMALL = PPOSettings(num_envs=16, iterations=6, horizon=8, hidden=(16,), checkpoint_every=2)


@pytest.fixture
def tiny(monkeypatch):
    """Let the command's preset be a tiny one, whatever bough's own is."""
    monkeypatch.setitem(PRESETS, "cpu", TINY)


def plan(seed: int = 0, **ppo) -> Plan:
    """Return a small run of the point mass."""
    return Plan("reach", ReachSettings(), replace(SMALL, **ppo), seed, "cpu")


def states(folder) -> dict:
    """Return everything of the newest checkpoint: networks, optimiser, task, random numbers."""
    newest = RunFolder(folder).newest()
    return {"model": newest.load(MODEL), "own": newest.load("rank-0")}


def same(a, b) -> bool:
    """Return whether two nested states are equal to the last bit."""
    if isinstance(a, torch.Tensor):
        return a.dtype == b.dtype and torch.equal(a, b)
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, list):
        return len(a) == len(b) and all(map(same, a, b))
    return a == b


def numbers(folder) -> list:
    """Return the rows of metrics.csv without the two columns that are times."""
    return [{k: v for k, v in row.items() if not k.endswith("seconds")} for row in RunFolder(folder).metrics()]


def events(folder) -> dict:
    """Return what TensorBoard shows: iterations and values by tag, without those that are times.

    Files of one second and process differ by a count that TensorBoard sorts as text, 10 before 9; runs of a user do not
    begin twice in a second.
    """
    for file in (folder / "tensorboard").glob("events*"):
        head, _, count = file.name.rpartition(".")
        file.rename(file.with_name(f"{head}.{int(count):06d}"))
    log = EventAccumulator(str(folder / "tensorboard"))
    log.Reload()
    tags = [tag for tag in log.Tags()["scalars"] if not tag.startswith("Perf/")]
    return {tag: [(e.step, np.float32(e.value)) for e in log.Scalars(tag)] for tag in tags}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Folder of an uninterrupted run."""
    out = tmp_path_factory.mktemp("whole") / "run"
    train(plan(), out, registry())
    return out


# ---- learning ------------------------------------------------------------------------------------------------------


def test_learns_the_point_mass(tmp_path):
    """Come within a twentieth of the way from doing nothing to the closed-form optimum."""
    ppo = {"num_envs": 64, "horizon": LENGTH, "iterations": 30, "hidden": (32, 32), "learning_rate": 3e-3}
    trainer = train(plan(**ppo), tmp_path / "run", registry())
    task = registry().make("reach", ReachSettings(), num_envs=256, seed=unseen_seed(0, 0), device="cpu", test=True)
    start = task.x.double().numpy().copy()
    best, nothing = best_return(start).mean(), -(start**2).sum(1).mean() * LENGTH
    policy = trainer.runner.get_inference_policy("cpu")
    with torch.inference_mode():
        for _ in range(LENGTH):
            _, _, _, extras = task.step(policy(task.get_observations()))
    reached = float(extras["log"]["return"].double().mean())
    assert nothing < best < 0 and reached <= best + 1e-4  # float32 sums of 20 numbers below 2
    assert reached > best + 0.05 * (nothing - best), (nothing, reached, best)


def test_keeps_observations_that_the_next_step_overwrites():
    """Store what the policy saw, though the task writes its next observation into the same memory.

    rsl-rl's own PPO keeps a reference until the step is over and would store the next observation.
    """
    task = registry().make("reach", ReachSettings(), num_envs=3, seed=1, device="cpu", test=False)
    runner = Runner(task, replace(SMALL, num_envs=3), Processes(), lambda iteration: None)
    assert isinstance(runner.alg, InPlacePPO)
    seen = []
    with torch.inference_mode():
        for _ in range(4):
            observations = task.get_observations()
            seen.append(observations["policy"].clone())
            actions = runner.alg.act(observations)
            runner.alg.process_env_step(*task.step(actions))
    assert torch.equal(runner.alg.storage.observations["policy"][:4], torch.stack(seen))
    assert not torch.equal(seen[0], seen[1])


# ---- the same bits -------------------------------------------------------------------------------------------------


def test_one_seed_gives_one_result_and_two_seeds_two(whole, tmp_path):
    """Repeat a run to the bit, numbers of every iteration included; another seed gives other parameters."""
    train(plan(), tmp_path / "again", registry())
    train(plan(seed=1), tmp_path / "other", registry())
    assert same(states(whole), states(tmp_path / "again"))
    assert numbers(whole) == numbers(tmp_path / "again")
    assert not same(states(whole)["model"], states(tmp_path / "other")["model"])


@pytest.mark.parametrize("stop", [1, 3, 4])
def test_a_run_cut_after_any_iteration_ends_the_same(whole, tmp_path, monkeypatch, stop):
    """Stop between two iterations, before the first checkpoint too, go on, and end with the same bits everywhere."""
    after = Trainer._after

    def cut(self, iteration):
        after(self, iteration)
        if iteration.number == stop:
            raise KeyboardInterrupt

    with monkeypatch.context() as patch, pytest.raises(KeyboardInterrupt):
        patch.setattr(Trainer, "_after", cut)
        train(plan(), tmp_path / "run", registry())
    trainer = train(plan(), tmp_path / "run", registry(), resume=True)
    assert trainer.done == SMALL.iterations
    assert same(states(whole), states(tmp_path / "run"))
    assert numbers(whole) == numbers(tmp_path / "run")
    assert events(whole) == events(tmp_path / "run")


NAMES = {
    "Train/mean_reward": "return", "Episode/success": "success", "Train/mean_step_reward": "reward",
    "Loss/value": "value_loss", "Loss/surrogate": "surrogate_loss", "Loss/learning_rate": "learning_rate",
    "Policy/mean_std": "action_std",
}  # fmt: skip


def test_tensorboard_holds_the_numbers_of_every_iteration(whole, tmp_path):
    """Find the columns of metrics.csv under rsl-rl's names, as float32; a run without a logger has no such file."""
    rows, found = RunFolder(whole).metrics(), events(whole)
    for tag, column in NAMES.items():
        kept = [(row["iteration"], np.float32(row[column])) for row in rows if row[column] is not None]
        assert found[tag] == kept, tag
    train(plan(iterations=1), tmp_path / "run", registry(), logger="none")
    assert not (tmp_path / "run" / "tensorboard").exists()


def test_wandb_gets_what_tensorboard_gets(tmp_path, monkeypatch, tiny):
    """Hand rsl-rl's writer a service that notes what it is told; refuse W&B in one line where it is not installed."""
    told, ended = {}, []
    service = ModuleType("wandb")
    service.__spec__ = ModuleSpec("wandb", None)
    service.init = lambda **how: told.update(how)
    service.log = lambda values, step: told.setdefault(step, {}).update(values)
    service.config, service.finish = {}, lambda: ended.append(True)
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "wandb", service)
        patch.setattr("rsl_rl.utils.wandb_log_writer.wandb", service)
        assert Train("reach", tmp_path / "run", num_envs=8, iterations=2, logger="wandb").run(registry()) == 0
        assert ended and told["project"] == "bough" and service.config["task"]["name"] == "reach"
        found = events(tmp_path / "run")
        assert all(np.float32(told[step][tag]) == value for tag, rows in found.items() for step, value in rows)
        assert len(found["Loss/value"]) == 2
    monkeypatch.setitem(sys.modules, "wandb", None)
    monkeypatch.setattr("bough.learn.policies.run_log.find_spec", lambda name: None)
    with pytest.raises(InputError, match="--logger: found wandb, which is not installed"):
        Train("reach", tmp_path / "other", logger="wandb").run(registry())
    assert not (tmp_path / "other").exists()


def test_a_finished_run_can_be_made_longer(whole, tmp_path):
    """Give the result of a run that was that long from the start; the settings then say so."""
    train(plan(iterations=4), tmp_path / "run", registry())
    assert Train("reach", tmp_path / "run", iterations=6, resume=True).run(registry()) == 0
    assert same(states(whole), states(tmp_path / "run"))
    assert RunFolder(tmp_path / "run").config()["ppo"]["iterations"] == 6


def test_seeds_of_tests_are_never_those_of_training():
    """Keep them apart by parity, so by construction; they also differ among themselves."""
    trained = {task_seed(s, r) for s in range(50) for r in range(8)}
    tested = {unseen_seed(s, i) for s in range(50) for i in range(8)}
    assert all(s % 2 == 0 for s in trained) and all(s % 2 == 1 for s in tested)
    assert len(trained) == len(tested) == 400 and max(trained | tested) < 2**31
    assert policy_seed(0, 0) != policy_seed(0, 1)


# ---- what is written -----------------------------------------------------------------------------------------------


def test_command_writes_the_run_folder(tmp_path, capsys, tiny):
    """Write settings, numbers, curve, report and checkpoint; say so in one line; refuse to do it over."""
    out = tmp_path / "run"
    command = Train("reach", out, num_envs=8, iterations=2, seed=3, without=("time",))
    assert command.run(registry()) == 0
    said = capsys.readouterr()
    assert re.fullmatch(r"reach: 2 iterations, 128 steps, return -?[\d.]+, success [\d.]+ % in training. "
                        r"Open \S*run/report.html\n", said.out)  # fmt: skip
    assert {p.name for p in out.iterdir()} == {"config.json", "metrics.csv", "learning.png", "report.html",
                                               "checkpoints", "tensorboard"}  # fmt: skip
    config = json.loads((out / "config.json").read_text())
    assert config["task"] == {"name": "reach", "version": 1, "settings": {"groups": ["place"], "start": {"width": 1.0}}}
    assert config["seed"] == 3 and config["ppo"]["num_envs"] == 8 and {"torch", "rsl-rl"} <= set(config["versions"])
    assert [p.name for p in (out / "checkpoints").iterdir()] == ["000002"]
    assert "learning.png" in (out / "report.html").read_text()
    before = {p: p.read_bytes() for p in out.rglob("*") if p.is_file()}
    with pytest.raises(InputError, match="found a run; allowed: --resume"):
        command.run(registry())
    assert before == {p: p.read_bytes() for p in out.rglob("*") if p.is_file()}
    assert Train("reach", out, resume=True).run(registry()) == 0  # all done: says so again
    assert len(RunFolder(out).metrics()) == 2


@dataclass(frozen=True)
class InForest(ReachSettings):
    """Settings of a task that has trees."""

    wood: Wood = ()


MODEL_YAML = """
format: branch-model/1
name: branch
segments:
  - {name: twig, stiffness_Nmprad: 15.1, damping_Nmsprad: 0.27,
     length_m: 0.41, radius_base_m: 0.01, radius_tip_m: 0.008}
"""


def test_all_commands_take_the_wood_that_a_run_was_begun_with(tmp_path, tiny):
    """Give the same wood to the worlds of training, of going on, of tests and of the film; none to tasks without."""
    seen, out, model = [], tmp_path / "run", tmp_path / "model.yaml"

    def make(name, settings, **arguments):
        seen.append(settings)
        return Reach(settings, **arguments)

    kind = TaskKind(("reach",), ("place", "time"), {"cpu": InForest()}, make, CLEARING_COLUMNS,
                    of_wood=lambda s, w, e: replace(s, wood=w))  # fmt: skip
    tasks = TaskRegistry((kind,))
    model.write_text(MODEL_YAML)
    assert Train("reach", out, num_envs=8, iterations=1, model=model, device="cpu").run(tasks) == 0
    assert Train("reach", out, iterations=2, model=model, resume=True).run(tasks) == 0
    assert Evaluate(out, sets=1, worlds=4, device="cpu").run(tasks) == 0
    assert Play(str(out), tmp_path / "film", seconds=0.2, device="cpu").run(tasks) == 0
    assert seen == [InForest(wood=SpringPosterior.from_model(model).wood())] * 4
    with pytest.raises(InputError, match="no model: reach without trees"):
        Train("reach", tmp_path / "other", model=model).run(registry())
    assert not (tmp_path / "other").exists()


def test_runs_from_before_there_was_wood_are_read():
    """Take what is empty unless given from the defaults; what has a value must be there."""
    old = {k: v for k, v in plain(InForest()).items() if k != "wood"}
    assert settings_from(InForest, old, "config.json") == InForest()
    with pytest.raises(InputError, match="start: found settings of another version"):
        settings_from(InForest, {k: v for k, v in old.items() if k != "start"}, "config.json")
    for settings in (TaskSettings(), TouchSettings()):  # all runs had the Jaco before arms had names
        kept = {k: v for k, v in plain(settings).items() if k != "arm"}
        assert settings_from(type(settings), kept, "config.json") == settings


def test_metrics_are_means_over_finished_episodes(whole):
    """Count every finished episode once: 16 worlds x 48 steps of episodes of 20 steps, begun at different ages."""
    rows = RunFolder(whole).metrics()
    assert [row["iteration"] for row in rows] == list(range(1, 7))
    assert [row["steps"] for row in rows] == [16 * 8 * i for i in range(1, 7)]
    assert 16 * 2 <= sum(row["episodes"] for row in rows) <= 16 * 3
    assert all(row["reward"] < 0 and np.isfinite(row["value_loss"]) for row in rows)
    for row in rows:
        assert (row["return"] is None) == (row["episodes"] == 0)
        assert row["collect_seconds"] > 0


def test_contacts_without_room_are_told_iteration_by_iteration(tmp_path):
    """Write seven a step of every iteration's eight, not those of before, resumed or not; the report adds them up."""
    train(plan(iterations=3), tmp_path / "run", registry(kind=Crowded))
    train(plan(), tmp_path / "run", registry(kind=Crowded), resume=True)
    folder = RunFolder(tmp_path / "run")
    told = [row["contacts_without_room"] for row in folder.metrics()]
    assert told == [7 * SMALL.horizon] * SMALL.iterations
    assert {n.label: n.value for n in content(folder).numbers}["Contacts without room"] == sum(told)


def test_a_loss_that_is_not_finite_ends_the_run(tmp_path, capsys, monkeypatch, tiny):
    """Stop with exit code 3 and a line, the checkpoint from before untouched."""
    after = Trainer._after

    def spoilt(self, iteration):
        after(self, replace(iteration, losses={"value": float("nan")}) if iteration.number == 5 else iteration)

    monkeypatch.setattr(Trainer, "_after", spoilt)
    assert Train("reach", tmp_path / "run", iterations=6).run(registry()) == 3
    assert "no longer finite in iteration 5" in capsys.readouterr().err
    assert RunFolder(tmp_path / "run").newest().check("reach", 1) == 4
    assert issubclass(LostError, RuntimeError)


# ---- bad input -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"num_envs": 0}, "--num-envs: found 0; allowed: 1 or more"),
        ({"iterations": 0}, "--iterations: found 0"),
        ({"seed": -1}, "--seed: found -1"),
        ({"task": "fly"}, "found fly; allowed: reach"),
        ({"device": "tpu"}, "--device: found tpu"),
        ({"device": "cuda:99"}, "--device: found cuda:99"),
        ({"without": ("smell",)}, "--without: found smell; allowed: place, time"),
        ({"without": ("place,time",)}, "--without: found every group"),
    ],
)
def test_bad_options_are_one_line_and_write_nothing(tmp_path, options, words):
    """Refuse what cannot be before anything is written."""
    with pytest.raises(InputError, match=re.escape(words)):
        Train(**({"task": "reach", "out": tmp_path / "run"} | options)).run(registry())
    assert not (tmp_path / "run").exists()


def damaged(file) -> None:
    """Turn one bit in the middle of a file over."""
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 4
    file.write_bytes(data)


class Runs:
    """What a pickle can do when it is loaded."""

    def __reduce__(self):
        return (open, ("executed", "w"))


def with_code(folder) -> None:
    """Put a pickle that runs code in a state's place, its digest too."""
    torch.save({"task": Runs()}, folder / "model.pt")
    (folder / "model.sha256").write_text(hashlib.sha256((folder / "model.pt").read_bytes()).hexdigest())


def kept(folder, name, state) -> None:
    """Put another state in a state's place, with its digest."""
    torch.save(state, folder / f"{name}.pt")
    (folder / f"{name}.sha256").write_text(hashlib.sha256((folder / f"{name}.pt").read_bytes()).hexdigest())


def noted(folder, **changes) -> None:
    """Write other values into the manifest; ... leaves a key out."""
    found = {**json.loads((folder / "manifest.json").read_text()), **changes}
    (folder / "manifest.json").write_text(json.dumps({k: v for k, v in found.items() if v is not ...}))


def config_of_run(folder) -> dict:
    """Return the settings of the run that a checkpoint belongs to."""
    return json.loads((folder.parents[1] / "config.json").read_text())


def configured(folder, **changes) -> None:
    """Write other values into the settings of the run."""
    (folder.parents[1] / "config.json").write_text(json.dumps({**config_of_run(folder), **changes}))


def piped(file) -> None:
    """Put a pipe, which nobody writes to, in a file's place."""
    file.unlink()
    os.mkfifo(file)


#: What is spoilt of the policy itself, so that nobody can use it.
POLICY = [
    (lambda c: damaged(c / "model.pt"), "a damaged checkpoint"),
    (lambda c: (c / "model.pt").write_bytes((c / "model.pt").read_bytes()[:1000]), "a damaged checkpoint"),
    (lambda c: (c / "model.pt").unlink(), "model.pt: found no such file"),
    (lambda c: (c / "model.sha256").write_bytes(b"\xff"), "a damaged checkpoint"),
    (lambda c: piped(c / "model.pt"), "model.pt: found a device or a pipe"),
    (lambda c: piped(c / "model.sha256"), "model.sha256: found a device or a pipe"),
    (lambda c: piped(c / "manifest.json"), "manifest.json: found a device or a pipe"),
    (lambda c: (c / "manifest.json").write_text("{"), "not JSON"),
    (lambda c: (c / "manifest.json").write_text("[]"), "JSON without fields"),
    (lambda c: (c / "manifest.json").write_text('{"n": ' + "9" * 5000 + "}"), "a number of too many digits"),
    (lambda c: (c.parents[1] / "config.json").write_text("{}"), "bough-run/1"),
    (with_code, "not a checkpoint"),
    (lambda c: kept(c, "model", [1.0, 2.0]), r"model\.pt: found not a checkpoint \(list\)"),
    (lambda c: kept(c, "model", torch.zeros(3)), r"model\.pt: found not a checkpoint \(Tensor\)"),
    (lambda c: kept(c, "model", {"actor_state_dict": {"x": torch.tensor([math.nan])}}), "not finite"),
    (lambda c: noted(c, iteration=-5), r"manifest\.json: iteration: found -5; allowed: greater than or equal to 0"),
    (lambda c: noted(c, iteration="6"), "iteration: found '6'; allowed: a valid integer"),
    (lambda c: noted(c, iteration=None), "iteration: found null"),
    (lambda c: noted(c, iteration=math.nan), "iteration: found"),
    (lambda c: noted(c, iteration=4), "iteration: found 4; allowed: 6, as its folder is called"),
    (lambda c: noted(c, iteration=...), "iteration: found no such key"),
    (lambda c: (c / "manifest.json").write_text("[" * 100_000), "nested too deeply|not JSON"),
    (lambda c: configured(c, seed="0"), r"config\.json: seed: found '0'; allowed: a valid integer"),
    (lambda c: configured(c, task=[]), r"config\.json: task: found \[\]"),
    (lambda c: configured(c, ppo={**config_of_run(c)["ppo"], "hidden": "wide"}), "hidden: found 'wide'"),
    (lambda c: configured(c, versions=None), "versions: found null"),
]
#: Networks that are none.
NETWORKS = (
    {}, {"actor_state_dict": None}, {"actor_state_dict": 3}, {"actor_state_dict": {}},
    {"actor_state_dict": {"mlp.0.weight": torch.zeros(2, 2)}}, {"actor_state_dict": {"mlp.0.weight": "text"}},
    {"actor_state_dict": {1: torch.zeros(2)}},
)  # fmt: skip


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        *POLICY,
        *((lambda c, n=n: kept(c, "model", n), "states that do not fit") for n in NETWORKS),
        (lambda c: damaged(c / "rank-0.pt"), "a damaged checkpoint"),
        (lambda c: (c / "rank-0.pt").unlink(), "no such file"),
        (lambda c: piped(c / "rank-0.pt"), "rank-0.pt: found a device or a pipe"),
        (lambda c: kept(c, "rank-0", {}), "states that do not fit"),
        (lambda c: kept(c, "rank-0", {"task": 3, "random": None, "steps": 1}), "states that do not fit"),
        (lambda c: (c.parents[1] / "metrics.csv").write_bytes(b"iteration\n\xff\n"), "metrics.csv: byte 10"),
    ],
)
def test_corrupt_checkpoints_are_refused_and_left_alone(whole, tmp_path, spoil, words):
    """Name the file in one line, run nothing of it, change nothing."""
    out = tmp_path / "run"
    shutil.copytree(whole, out)
    spoil(out / "checkpoints" / "000006")
    before = {p: p.read_bytes() for p in out.rglob("*") if p.is_file()}
    with pytest.raises(InputError, match=words) as error:
        Train("reach", out, iterations=8, resume=True).run(registry())
    assert "\n" not in str(error.value) and str(out) in str(error.value)
    assert before == {p: p.read_bytes() for p in out.rglob("*") if p.is_file()}
    assert not (tmp_path / "executed").exists()


@pytest.mark.parametrize(
    "use",
    [
        lambda run, out: Evaluate(run, sets=1, worlds=2, baselines=(), device="cpu"),
        lambda run, out: Play(str(run), out, seconds=0.1, device="cpu"),
        lambda run, out: Export(run, out),
    ],
    ids=["evaluate", "play", "export"],
)
@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        *POLICY,
        *((lambda c, n=n: kept(c, "model", n), "a network that does not fit|a damaged network") for n in NETWORKS),
    ],
)
def test_corrupt_policies_are_refused_by_whoever_uses_them(whole, tmp_path, use, spoil, words):
    """Name the file in one line, run nothing of it, write nothing."""
    run, out = tmp_path / "run", tmp_path / "out"
    shutil.copytree(whole, run)
    spoil(run / "checkpoints" / "000006")
    before = {p: p.read_bytes() for p in run.rglob("*") if p.is_file()}
    with pytest.raises(InputError, match=words) as error:
        use(run, out).run(registry())
    assert "\n" not in str(error.value) and str(run) in str(error.value)
    assert before == {p: p.read_bytes() for p in run.rglob("*") if p.is_file()}
    assert not out.exists() and not (tmp_path / "executed").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"seed": 5}, "--seed: found 5; allowed: 0"),
        ({"num_envs": 5}, "--num-envs: found 5; allowed: 16"),
        ({"without": ("time",)}, "--without: found other settings"),
        ({"preset": "gpu"}, "--preset: found other settings"),
    ],
)
def test_a_run_goes_on_only_as_it_was_begun(whole, options, words):
    """Refuse other settings than the run's."""
    with pytest.raises(InputError, match=words):
        Train("reach", whole, resume=True, **options).run(registry())


def test_checkpoints_of_another_task_or_version_are_refused(whole, tmp_path, monkeypatch):
    """Tell apart: a task with another name, the same task of a later version, settings it no longer has."""
    with pytest.raises(InputError, match=r"version of reach: found 1; allowed: 2, this bough's"):
        Train("reach", whole, iterations=8, resume=True).run(registry(version=2))
    with pytest.raises(InputError, match="a run of reach"):
        Train("powerline", whole, resume=True).run(registry())
    other = tmp_path / "run"
    shutil.copytree(whole, other)
    for file, old, new in (("config.json", '"start"', '"begin"'), ("checkpoints/000006/manifest.json", "reach", "fly")):
        text = (other / file).read_text()
        (other / file).write_text(text.replace(old, new))
        words = "settings of another version" if "begin" in new else "task: found fly; allowed: reach"
        with pytest.raises(InputError, match=words):
            Train("reach", other, iterations=8, resume=True).run(registry())
        (other / file).write_text(text)
    monkeypatch.setenv("WORLD_SIZE", "2")
    with pytest.raises(InputError, match="torchrun's processes: found 2; allowed: 1"):
        Train("reach", whole, resume=True).run(registry())


def test_says_which_extra_is_missing():
    """Load the commands without rsl-rl and tensordict, and name what to install in one line, for each of them."""
    code = (
        "import sys\n"
        "for name in ('rsl_rl', 'rsl_rl.env', 'tensordict'):\n"
        "    sys.modules[name] = None\n"
        "from pathlib import Path\n"
        "from bough.cli.evaluate import Evaluate\n"
        "from bough.cli.play import Play\n"
        "from bough.cli.train import Train\n"
        "from bough.sim.base.errors import InputError\n"
        "for command in (Train('powerline', Path('run')), Evaluate(Path('run')), Play('zero', Path('film'))):\n"
        "    try:\n"
        "        command.run()\n"
        "    except InputError as error:\n"
        "        print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    assert done.stdout == f"bough: found no rsl_rl; allowed: {install_hint('train')}\n" * 3


def test_presets_can_be():
    """Pass their own checks, with more worlds on a GPU."""
    for preset in PRESETS.values():
        preset.check()
    assert PRESETS["gpu"].num_envs == 6144 > PRESETS["cpu"].num_envs
