"""How well a policy does in worlds it was not trained in: the columns of the thesis's table 5.2."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import torch

from ...sim.base.errors import InputError, check_seed
from ..runs.folder import CONFIG, RunFolder, replace_text
from ..runs.threads import one_thread
from ..tasks.parts import Column
from ..tasks.ppo_settings import PPOSettings
from ..tasks.registry import TaskRegistry, settings_from
from ..tasks.task import Task, Watch, unseen_seed
from .compare import Episodes, join, write_episodes
from .compare_report import Beside, put_beside
from .crowding import contacts_without_room
from .tables import known, lines, wilson
from .train_report import at_the_end

if TYPE_CHECKING:
    from tensordict import TensorDict

Policy = Callable[["TensorDict"], torch.Tensor]
Metrics = dict[str, torch.Tensor]

JSON = "evaluation.json"
PLANNED = ("mpc", "mpc-tree")
"""Policies that plan: sampling MPC without the tree, and with it."""
UNTRAINED = ("zero", "random", *PLANNED)
"""Policies that no run is needed for: no action, actions drawn evenly, and those that plan."""
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
    kind = registry.of(config["task"]["name"])
    newest = folder.newest()
    if newest is None:
        raise InputError(folder.path, "", "a run without a checkpoint", "a run that has reached its first checkpoint")
    name, version = config["task"]["name"], config["task"]["version"]
    done = newest.check(name, version)
    settings = settings_from(kind.settings, config["task"]["settings"], source)
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


def untrained(name: str, task: Task, seed: int) -> Policy:
    """Return a policy of `UNTRAINED` for a task that is fresh.

    Raises:
        InputError: There is no such policy for this task, or what it needs is not installed.
    """
    from .mpc_kinematics import mpc
    from .mpc_tree import mpc_tree

    makers: dict[str, Callable[[], Policy]] = {
        "zero": lambda: zero(task), "random": lambda: random(task, seed), "mpc": lambda: mpc(task, seed),
        "mpc-tree": lambda: mpc_tree(task, seed),
    }  # fmt: skip
    return makers[name]()


@torch.inference_mode()
def first_episodes(task: Task, policy: Policy, watch: Watch | None = None) -> Metrics:
    """Return the metrics of the first episode of every world to its end, shape [W] each; ``watch`` looks at its steps.

    Raises:
        RuntimeError: An episode is longer than the task says.
    """
    nan = torch.full((task.num_envs,), math.nan, device=task.device)
    found = {name: nan.clone() for name in task.metrics}
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


def columns(metrics: Metrics, table_: Sequence[Column]) -> dict[str, float]:
    """Return a table's columns of a test set; NaN where no episode counts to one."""
    return {column.name: column.value(metrics) for column in table_}


@dataclass(frozen=True)
class Row:
    """One policy on all test sets.

    Attributes:
        policy: Its name.
        train_return: Return at the end of training, NaN for a policy that was not trained.
        trials: Episodes.
        sets: Columns of every set.
        overlaps: What passed through what (`Watch.rows`) in every set, by kind; empty for tasks that do not watch it.
        without_room: Contacts that found no room in all of them, of which no force came.
        shares: Names of the columns that are shares of episodes [%].
        strata: Columns by kind of world in every set, where a task tells kinds; and how many worlds of a set are such.
    """

    policy: str
    train_return: float
    trials: int
    sets: Sequence[Mapping[str, float]]
    overlaps: Sequence[Mapping[str, Mapping[str, float]]] = ()
    without_room: int = 0
    shares: tuple[str, ...] = ()
    strata: Sequence[Mapping[str, tuple[Mapping[str, float], int]]] = ()

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

    def interval(self, column: str) -> tuple[float, float]:
        """Return Wilson's 95 % interval of a share of episodes [%]."""
        low, high = wilson(self.mean(column) / 100.0, self.trials)
        return 100.0 * low, 100.0 * high

    def of_stratum(self, name: str) -> Row:
        """Return the row of one kind of worlds alone."""
        found = [kinds[name] for kinds in self.strata]
        trials = sum(count for _, count in found)
        return Row(f"{self.policy}, {name}", math.nan, trials, [values for values, _ in found], shares=self.shares)

    def overlap(self, kind: str) -> tuple[float, float]:
        """Return the share of steps in which a kind overlaps [%], its mean over the sets, and the deepest [mm]."""
        found = [rows[kind] for rows in self.overlaps]
        return sum(f["steps %"] for f in found) / len(found), max(f["deepest mm"] for f in found)

    def _values(self, column: str) -> list[float]:
        return [s[column] for s in self.sets if not math.isnan(s[column])]


def evaluate(
    path: Path, registry: TaskRegistry, *, sets: int = 3, worlds: int | None = None, seed: int = 0,
    device: str = "cpu", baselines: Sequence[str] = (), all_scenes: bool = False, changes: tuple[str, ...] = (),
    against: Sequence[Path] = (), oracle: Sequence[Path] = (), progress: Callable[[int], None] = lambda done: None,
) -> list[Row]:  # fmt: skip
    """Test a run's policy, and others beside it in the same worlds; write ``evaluation.json``, ``.md`` and ``.npz``.

    Args:
        path: Folder of the run.
        registry: Where its task is found.
        sets: Test sets.
        worlds: Worlds of each; None takes the task's own number.
        seed: Seed of the test sets; whatever it is, no world of training is among them.
        device: Torch device.
        baselines: Names of the policies beside it, of `UNTRAINED`.
        all_scenes: Whether scenes are tested that training leaves out as hardly possible; the files are then
            ``evaluation_all_scenes.json`` and so on.
        changes: Settings of the task that are others in the tests, ``name=value``.
        against: Folders of other runs of the task, tested in the same worlds and compared with it.
        oracle: Folders of runs that decide, with the run, those of ``against`` and MPC where it is among the
            baselines, which worlds are possible.
        progress: Called with the episodes' sets done since the last call.

    Raises:
        InputError: A number cannot be, there is no policy to test, runs are of different tasks, or the task leaves no
            scene out.
    """
    check_seed("evaluate", seed)
    for option, value, least in (("--sets", sets, 1), ("--worlds", 1 if worlds is None else worlds, 1)):
        if value < least:
            raise InputError("evaluate", option, str(value), f"{least} or more")
    folder = RunFolder(path)
    trained = _for_tests(read_policy(folder, registry), registry, all_scenes, changes)
    kind = registry.of(trained.name)
    others = _others(trained, path, (*against, *oracle), registry, changes)
    worlds = kind.test_worlds if worlds is None else worlds
    policies = {"trained": trained} | dict(others.values())
    found, scenes = _all_tested(policies, baselines, registry, sets, worlds, seed, device, progress)
    end = at_the_end(folder.metrics(), "return")
    shares = tuple(c.name for c in kind.table if c.interval)
    rows = [_row(n, end if n == "trained" else math.nan, sets * worlds, results, shares)
            for n, results in found.items()]  # fmt: skip
    episodes = {name: join([t.episodes for t in results]) for name, results in found.items()}
    rivals = [others[key][0] for key in dict.fromkeys(p.resolve() for p in against)]
    ensemble = [*policies, *(name for name in baselines if name in PLANNED)] if oracle else []
    beside = put_beside(episodes, rivals, ensemble, kind.table, seed)
    how = {"sets": sets, "worlds": worlds, "seed": seed, "device": device} | ({"set": changes} if changes else {})
    files = files_of(all_scenes, changes)
    _write(folder, trained, rows, scenes, beside, files, **how)
    write_episodes(folder.path / files[0].replace(".json", ".npz"), episodes)
    return rows


def _all_tested(
    policies: Mapping[str, TrainedPolicy], baselines: Sequence[str], registry: TaskRegistry, sets: int, worlds: int,
    seed: int, device: str, progress: Callable[[int], None],
) -> tuple[dict[str, list[Tested]], list[dict[str, float]]]:  # fmt: skip
    """Return what every policy came to on every test set, and what the scenes of each are like."""
    found: dict[str, list[Tested]] = {name: [] for name in ("trained", *baselines, *list(policies)[1:])}
    scenes: list[dict[str, float]] = []
    for index in range(sets):
        own = unseen_seed(seed, index)
        for names in _same_settings(policies):
            some, first = policies[names[0]], names[0] == "trained"
            task = registry.make(some.name, some.settings, num_envs=worlds, seed=own, device=device, test=True)
            if first:
                scenes.append(getattr(task, "scenes", dict)())
            start = task.snapshot()
            for name in (*names, *(baselines if first else ())):
                task.restore(start)
                policy = _policy(name, policies, task, own)
                found[name].append(_tested(task, policy, registry.of(some.name).table, index))
                progress(1)
    return found, scenes


def _for_tests(
    trained: TrainedPolicy, registry: TaskRegistry, all_scenes: bool, changes: tuple[str, ...]
) -> TrainedPolicy:
    """Return a policy with the settings that it is tested with.

    Raises:
        InputError: There are no such settings.
    """
    kind = registry.of(trained.name)
    if all_scenes:
        if kind.all_scenes is None:
            raise InputError("evaluate", "--all-scenes", trained.name, "a task that leaves scenes out")
        trained = replace(trained, settings=kind.all_scenes(trained.settings))
    return replace(trained, settings=kind.changed(trained.settings, changes, "evaluate"))


def _others(
    trained: TrainedPolicy, path: Path, paths: Sequence[Path], registry: TaskRegistry, changes: tuple[str, ...]
) -> dict[Path, tuple[str, TrainedPolicy]]:
    """Return other runs by their folders: names in tables, and policies in the worlds of the first.

    A name is the folder's, or its whole path where two are alike.

    Raises:
        InputError: A folder holds no policy, one of another task, or is the run's own.
    """
    folders = list(dict.fromkeys(p.resolve() for p in paths))
    names, out = [f.name for f in folders], {}
    for place in folders:
        other = read_policy(RunFolder(place), registry)
        if place == path.resolve() or other.name != trained.name:
            found = "the run itself" if other.name == trained.name else f"a run of {other.name}"
            raise InputError(place, "", found, f"another run of {trained.name}")
        settings = registry.of(other.name).changed(other.settings, changes, "evaluate")
        own = {f.name for f in fields(settings)}
        same = {name: getattr(trained.settings, name) for name in _WORLD if name in own}
        clear = names.count(place.name) == 1 and place.name not in ("trained", *UNTRAINED)
        name = place.name if clear else str(place)
        out[place] = name, replace(other, settings=replace(settings, **same))
    return out


_WORLD = ("scene", "within", "episode_seconds", "episode_steps", "success_steps")
"""Settings that say what a task's worlds and its measures are, where it has them: one policy's for all in a test."""


def _same_settings(policies: Mapping[str, TrainedPolicy]) -> list[list[str]]:
    """Return the names of policies that can act in one task, the first's first."""
    groups: list[list[str]] = []
    for name, policy in policies.items():
        for names in groups:
            if policies[names[0]].settings == policy.settings:
                names.append(name)
                break
        else:
            groups.append([name])
    return groups


def _policy(name: str, policies: Mapping[str, TrainedPolicy], task: Task, seed: int) -> Policy:
    return policies[name].on(task) if name in policies else untrained(name, task, seed)


@dataclass(frozen=True)
class Tested:
    """A policy on a test set: see `Row`, and every world's episode."""

    columns: dict[str, float]
    overlaps: dict[str, dict[str, float]]
    without_room: int
    strata: dict[str, tuple[dict[str, float], int]]
    episodes: Episodes


def _tested(task: Task, policy: Policy, table_: Sequence[Column], index: int) -> Tested:
    watch = task.watch() if hasattr(task, "watch") else None
    before = contacts_without_room(task)
    kinds: dict[str, torch.Tensor] = getattr(task, "strata", dict)()
    with one_thread():
        found = first_episodes(task, policy, watch)
    strata = {
        name: (columns({k: v[mask] for k, v in found.items()}, table_), int(mask.sum())) for name, mask in kinds.items()
    }
    overlaps = {} if watch is None else watch.rows()
    own = index * task.num_envs + torch.arange(task.num_envs)
    target = task.targets() if hasattr(task, "targets") else own
    episodes = Episodes(
        {name: values.double().cpu().numpy() for name, values in found.items()}, target.cpu().numpy(),
        {name: mask.cpu().numpy() for name, mask in kinds.items()},
    )  # fmt: skip
    return Tested(columns(found, table_), overlaps, contacts_without_room(task) - before, strata, episodes)


def _row(name: str, train_return: float, trials: int, results: Sequence[Tested], shares: tuple[str, ...]) -> Row:
    overlaps = [r.overlaps for r in results if r.overlaps]
    strata = [r.strata for r in results if r.strata]
    crowded = sum(r.without_room for r in results)
    return Row(name, train_return, trials, [r.columns for r in results], overlaps, crowded, shares, strata)


def files_of(all_scenes: bool = False, changes: Sequence[str] = ()) -> tuple[str, str]:
    """Return the names of the files of a test; one with other scenes or settings does not replace the plain one."""
    parts = ["evaluation", *(["all_scenes"] if all_scenes else []), *(c.replace("=", "-") for c in changes)]
    name = "".join(c if c.isalnum() or c in "._+-" else "-" for c in "_".join(parts))
    return f"{name}.json", f"{name}.md"


def _write(
    folder: RunFolder, trained: TrainedPolicy, rows: Sequence[Row], scenes: Sequence[Mapping[str, float]],
    beside: Beside, files: tuple[str, str], **how: object,
) -> None:  # fmt: skip
    about = {"format": "bough-evaluation/1", "task": trained.name, "iteration": trained.iteration, **how}
    facts = {name: sum(s[name] for s in scenes) / len(scenes) for name in scenes[0]}
    kept = {**about, "scenes": facts, "rows": [_plain(row) for row in rows], **beside.plain()}
    replace_text(folder.path / files[0], json.dumps(kept, indent=2, allow_nan=False) + "\n")
    replace_text(folder.path / files[1], "\n\n".join([table(rows), *_notes(rows, facts), *beside.markdown()]) + "\n")


def _notes(rows: Sequence[Row], scenes: Mapping[str, float]) -> list[str]:
    """Return, where a task tells it, what the scenes are like and what passed through what, as Markdown."""
    notes = []
    if scenes:
        notes.append("Scenes: " + "; ".join(f"{name}: {value:.1f}" for name, value in scenes.items()) + ".")
    told = [kind for row in rows if row.strata for n in row.strata[0] if (kind := row.of_stratum(n)).trials]
    if told:
        notes.append(table(told))
    watched = [row for row in rows if row.overlaps]
    if watched:
        kinds = list(watched[0].overlaps[0])
        body = [(kind, *("{:.2f} %, {:.1f} mm".format(*row.overlap(kind)) for row in watched)) for kind in kinds]
        notes.append("Overlaps: share of steps deeper than 2 mm, and the deepest of all.")
        notes.append(lines([("overlap of", *(row.policy for row in watched)), *body]))
    return notes


def _plain(row: Row) -> dict[str, Any]:
    out = {"policy": row.policy, "Train Rew": known(row.train_return), "Trials": row.trials, **_measured(row),
           ROOM: row.without_room}  # fmt: skip
    if row.strata:
        kinds = {name: row.of_stratum(name) for name in row.strata[0]}
        out["strata"] = {n: {"Trials": r.trials, **_measured(r)} for n, r in kinds.items() if r.trials}
    return out | ({"overlaps": row.overlaps} if row.overlaps else {})


def _measured(row: Row) -> dict[str, Any]:
    out: dict[str, Any] = {
        c: {"mean": known(row.mean(c)), "spread": known(row.spread(c)), "sets": [known(s[c]) for s in row.sets]}
        for c in row.sets[0]
    }
    for c in row.shares:
        out[c]["interval"] = list(row.interval(c))
    return out


def table(rows: Sequence[Row]) -> str:
    """Return the rows as a table in Markdown: mean and standard deviation over the test sets, intervals of shares."""
    names = list(rows[0].sets[0])
    head = ("policy", "Train Rew", "Trials", *names, ROOM)
    body = [(r.policy, _cell(r.train_return), str(r.trials), *(_measure(r, c) for c in names), str(r.without_room))
            for r in rows]  # fmt: skip
    return lines([head, *body])


def _measure(row: Row, column: str) -> str:
    if column in row.shares:
        return "{:.1f} [{:.1f}, {:.1f}]".format(row.mean(column), *row.interval(column))
    return _cell(row.mean(column), row.spread(column))


def _cell(mean: float, spread: float = math.nan) -> str:
    if math.isnan(mean):
        return "-"
    return f"{mean:.1f}" if math.isnan(spread) else f"{mean:.1f} ± {spread:.1f}"
