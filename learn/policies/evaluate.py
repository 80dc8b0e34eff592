"""How well a policy does in worlds it was not trained in: the columns of the thesis's table 5.2."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from ...sim.base.errors import InputError, check_seed
from ..runs.folder import CONFIG, RunFolder, replace_text
from ..runs.threads import one_thread
from ..tasks.registry import TaskRegistry, settings_from
from ..tasks.task import METRICS, Task, Watch, unseen_seed
from .crowding import contacts_without_room
from .ppo_settings import PPOSettings
from .train_report import at_the_end

if TYPE_CHECKING:
    from tensordict import TensorDict

Policy = Callable[["TensorDict"], torch.Tensor]
Metrics = dict[str, torch.Tensor]

JSON, TABLE = "evaluation.json", "evaluation.md"
ALL_JSON, ALL_TABLE = "evaluation_all_scenes.json", "evaluation_all_scenes.md"
"""Files of a test in which no scene is left out."""
COLUMNS = ("Test Rew", "Test SR %", "Occ Drop %", "Touch %", "Steps in Succ")
"""What is measured on every test set, as table 5.2 calls it; it has Train Rew and Trials before."""
ROOM = "No room"
"""Contacts that found no room in a world's buffer, so that nothing held the branches apart; 0 where all is well."""


@dataclass(frozen=True)
class TrainedPolicy:
    """A policy as a run has left it.

    Attributes:
        name: Name of its task.
        settings: Settings of its task.
        ppo: Numbers of PPO; its network is among them.
        state: Networks and normalisers.
        iteration: Iterations done.
        checkpoint: Folder it was read from.
    """

    name: str
    settings: Any
    ppo: PPOSettings
    state: dict[str, Any]
    iteration: int
    checkpoint: Path

    def on(self, task: Task) -> Policy:
        """Return the policy without noise, for a task with the same observations and actions.

        Raises:
            InputError: The task is of another version, or its observations are not the policy's.
        """
        from ..runs.folder import CheckpointFolder
        from .ppo_runner import policy_of

        CheckpointFolder(self.checkpoint).check(task.name, task.version)
        try:
            return policy_of(self.state, self.ppo, task)
        except (RuntimeError, KeyError, TypeError, AttributeError) as error:
            first = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(self.checkpoint, "", f"a network that does not fit ({first})", "this task's") from None


def read_policy(folder: RunFolder, registry: TaskRegistry) -> TrainedPolicy:
    """Read the newest policy of a run.

    Raises:
        InputError: There is no run or no checkpoint, or it is damaged or of another version.
    """
    config, source = folder.config(), folder.path / CONFIG
    registry.check_name(config["task"]["name"])
    newest = folder.newest()
    if newest is None:
        raise InputError(folder.path, "", "a run without a checkpoint", "a run that has reached its first checkpoint")
    name, version = config["task"]["name"], config["task"]["version"]
    done = newest.check(name, version)
    settings = settings_from(registry.settings, config["task"]["settings"], source)
    ppo = settings_from(PPOSettings, config["ppo"], source)
    return TrainedPolicy(name, settings, ppo, newest.load_model(), done, newest.path)


def zero(task: Task) -> Policy:
    """Return the policy that lets the arm be."""
    still = torch.zeros(task.num_envs, task.num_actions, device=task.device)
    return lambda _observations: still


def random(task: Task, seed: int) -> Policy:
    """Return the policy that draws every action evenly from -1 to 1."""
    generator = torch.Generator(device=task.device).manual_seed(seed)
    shape = (task.num_envs, task.num_actions)
    return lambda _observations: 2.0 * torch.rand(shape, generator=generator, device=task.device) - 1.0


@torch.inference_mode()
def first_episodes(task: Task, policy: Policy, watch: Watch | None = None) -> Metrics:
    """Return the metrics of the first episode of every world to its end, shape [W] each; ``watch`` looks at its steps.

    Raises:
        RuntimeError: An episode is longer than the task says.
    """
    nan = torch.full((task.num_envs,), math.nan, device=task.device)
    found = {name: nan.clone() for name in METRICS}
    over = torch.zeros(task.num_envs, dtype=torch.bool, device=task.device)
    observations = task.get_observations()
    for _ in range(longest_episode(task) + 1):
        observations, _, dones, extras = task.step(policy(observations))
        ends = (dones > 0) & ~over
        for name, values in found.items():
            values.copy_(torch.where(ends, extras["log"][name], values))
        over |= ends
        if watch is not None:
            watch.measure(~over)
        if bool(over.all()):
            return found
    raise RuntimeError(f"{int((~over).sum())} episodes of {task.name} did not end in max_episode_length steps")


def longest_episode(task: Task) -> int:
    """Return the policy steps of the longest episode."""
    return int(torch.as_tensor(task.max_episode_length).max())


def columns(metrics: Metrics) -> dict[str, float]:
    """Return `COLUMNS` of a test set; steps in success are a mean over the worlds that succeeded, NaN if none did."""
    won = metrics["success"] > 0
    values = (
        metrics["return"].mean(),
        100.0 * metrics["success"].float().mean(),
        100.0 * metrics["occlusion_drop"].mean(),
        100.0 * metrics["breach"].float().mean(),
        metrics["steps_clear"].float()[won].mean(),
    )
    return {name: float(value) for name, value in zip(COLUMNS, values, strict=True)}


@dataclass(frozen=True)
class Row:
    """One policy on all test sets.

    Attributes:
        policy: Its name.
        train_return: Return at the end of training, NaN for a policy that was not trained.
        trials: Episodes.
        sets: `COLUMNS` of every set.
        overlaps: What passed through what (`Watch.rows`) in every set, by kind; empty for tasks that do not watch it.
        without_room: Contacts that found no room in all of them, of which no force came.
    """

    policy: str
    train_return: float
    trials: int
    sets: Sequence[Mapping[str, float]]
    overlaps: Sequence[Mapping[str, Mapping[str, float]]] = ()
    without_room: int = 0

    def mean(self, column: str) -> float:
        """Return the mean over the sets that have a value."""
        values = self._values(column)
        return sum(values) / len(values) if values else math.nan

    def spread(self, column: str) -> float:
        """Return the standard deviation over the sets (n - 1), NaN for fewer than two."""
        values = self._values(column)
        if len(values) < 2:
            return math.nan
        mean = self.mean(column)
        return math.sqrt(sum((v - mean) ** 2 for v in values) / (len(values) - 1))

    def overlap(self, kind: str) -> tuple[float, float]:
        """Return the share of steps in which a kind overlaps [%], its mean over the sets, and the deepest [mm]."""
        found = [rows[kind] for rows in self.overlaps]
        return sum(f["steps %"] for f in found) / len(found), max(f["deepest mm"] for f in found)

    def _values(self, column: str) -> list[float]:
        return [s[column] for s in self.sets if not math.isnan(s[column])]


def evaluate(
    path: Path, registry: TaskRegistry, *, sets: int = 3, worlds: int = 512, seed: int = 0, device: str = "cpu",
    baselines: Sequence[str] = (), all_scenes: bool = False, progress: Callable[[int], None] = lambda done: None,
) -> list[Row]:  # fmt: skip
    """Test a run's policy, and others beside it in the same worlds; write ``evaluation.json`` and ``evaluation.md``.

    Args:
        path: Folder of the run.
        registry: Where its task is found.
        sets: Test sets.
        worlds: Worlds of each.
        seed: Seed of the test sets; whatever it is, no world of training is among them.
        device: Torch device.
        baselines: Names of the policies beside it, ``zero`` and ``random``.
        all_scenes: Whether scenes are tested that training leaves out as hardly possible; the files are then
            ``evaluation_all_scenes.json`` and ``.md``.
        progress: Called with the episodes' sets done since the last call.

    Raises:
        InputError: A number cannot be, there is no policy to test, or the task leaves no scene out.
    """
    check_seed("evaluate", seed)
    for option, value, least in (("--sets", sets, 1), ("--worlds", worlds, 1)):
        if value < least:
            raise InputError("evaluate", option, str(value), f"{least} or more")
    folder = RunFolder(path)
    trained = read_policy(folder, registry)
    if all_scenes:
        if registry.all_scenes is None:
            raise InputError("evaluate", "--all-scenes", trained.name, "a task that leaves scenes out")
        trained = replace(trained, settings=registry.all_scenes(trained.settings))
    found: dict[str, list[Tested]] = {name: [] for name in ("trained", *baselines)}
    scenes: list[dict[str, float]] = []
    for index in range(sets):
        test_seed = unseen_seed(seed, index)
        task = registry.make(trained.name, trained.settings, num_envs=worlds, seed=test_seed, device=device, test=True)
        scenes.append(getattr(task, "scenes", dict)())
        start = task.snapshot()
        for name, results in found.items():
            task.restore(start)
            policy = zero(task) if name == "zero" else random(task, test_seed) if name == "random" else trained.on(task)
            results.append(_tested(task, policy))
            progress(1)
    end = at_the_end(folder.metrics(), "return")
    rows = [_row(n, end if n == "trained" else math.nan, sets * worlds, results) for n, results in found.items()]
    how = {"sets": sets, "worlds": worlds, "seed": seed, "device": device}
    _write(folder, trained, rows, scenes, (ALL_JSON, ALL_TABLE) if all_scenes else (JSON, TABLE), **how)
    return rows


Tested = tuple[dict[str, float], dict[str, dict[str, float]], int]
"""`COLUMNS` of a policy on a test set, its overlaps, and its contacts without room."""


def _tested(task: Task, policy: Policy) -> Tested:
    watch = task.watch() if hasattr(task, "watch") else None
    before = contacts_without_room(task)
    with one_thread():
        measured = columns(first_episodes(task, policy, watch))
    return measured, {} if watch is None else watch.rows(), contacts_without_room(task) - before


def _row(name: str, train_return: float, trials: int, results: Sequence[Tested]) -> Row:
    measured, overlaps, crowded = zip(*results, strict=True)
    return Row(name, train_return, trials, list(measured), [found for found in overlaps if found], sum(crowded))


def _write(
    folder: RunFolder, trained: TrainedPolicy, rows: Sequence[Row], scenes: Sequence[Mapping[str, float]],
    files: tuple[str, str], **how: object,
) -> None:  # fmt: skip
    about = {"format": "bough-evaluation/1", "task": trained.name, "iteration": trained.iteration, **how}
    facts = {name: sum(s[name] for s in scenes) / len(scenes) for name in scenes[0]}
    kept = {**about, "scenes": facts, "rows": [_plain(row) for row in rows]}
    replace_text(folder.path / files[0], json.dumps(kept, indent=2, allow_nan=False) + "\n")
    replace_text(folder.path / files[1], "\n\n".join([table(rows), *_notes(rows, facts)]) + "\n")


def _notes(rows: Sequence[Row], scenes: Mapping[str, float]) -> list[str]:
    """Return, where a task tells it, what the scenes are like and what passed through what, as Markdown."""
    notes = []
    if scenes:
        notes.append("Scenes: " + "; ".join(f"{name}: {value:.1f}" for name, value in scenes.items()) + ".")
    watched = [row for row in rows if row.overlaps]
    if watched:
        kinds = list(watched[0].overlaps[0])
        body = [(kind, *("{:.2f} %, {:.1f} mm".format(*row.overlap(kind)) for row in watched)) for kind in kinds]
        notes.append("Overlaps: share of steps deeper than 2 mm, and the deepest of all.")
        notes.append(_lines([("overlap of", *(row.policy for row in watched)), *body]))
    return notes


def _plain(row: Row) -> dict[str, Any]:
    def known(value: float) -> float | None:
        return None if math.isnan(value) else value

    measured = {
        c: {"mean": known(row.mean(c)), "spread": known(row.spread(c)), "sets": [known(s[c]) for s in row.sets]}
        for c in COLUMNS
    }
    out = {"policy": row.policy, "Train Rew": known(row.train_return), "Trials": row.trials, **measured,
           ROOM: row.without_room}  # fmt: skip
    return out | ({"overlaps": row.overlaps} if row.overlaps else {})


def table(rows: Sequence[Row]) -> str:
    """Return the rows as a table in Markdown: mean and standard deviation over the test sets."""
    head = ("policy", "Train Rew", "Trials", *COLUMNS, ROOM)
    body = [(r.policy, _cell(r.train_return), str(r.trials), *(_cell(r.mean(c), r.spread(c)) for c in COLUMNS),
             str(r.without_room)) for r in rows]  # fmt: skip
    return _lines([head, *body])


def _lines(table_: Sequence[Sequence[str]]) -> str:
    """Return cells as a table in Markdown, the first row its head, the first column left-aligned."""
    widths = [max(map(len, column)) for column in zip(*table_, strict=True)]

    def line(cells: Sequence[str]) -> str:
        first, *others = zip(cells, widths, strict=True)
        return "| " + " | ".join([first[0].ljust(first[1]), *(c.rjust(w) for c, w in others)]) + " |"

    rule = "|" + "|".join([" " + "-" * widths[0] + " ", *(" " + "-" * w + ":" for w in widths[1:])]) + "|"
    return "\n".join([line(table_[0]), rule, *map(line, table_[1:])])


def _cell(mean: float, spread: float = math.nan) -> str:
    if math.isnan(mean):
        return "-"
    return f"{mean:.1f}" if math.isnan(spread) else f"{mean:.1f} ± {spread:.1f}"
