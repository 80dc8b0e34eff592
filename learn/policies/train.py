"""Training a policy: begun, killed, gone on with to the same bits, and told about."""

from __future__ import annotations

import math
import platform
import subprocess
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

from ...sim.base.console import warn
from ...sim.base.errors import InputError, check_seed
from ...sim.base.files import check_output
from ...sim.base.host import describe
from ...version import __version__
from ..runs.folder import MODEL, CheckpointFolder, RunFolder
from ..runs.processes import Processes
from ..runs.threads import one_thread
from ..tasks.ppo_settings import PPOSettings
from ..tasks.registry import TaskRegistry, plain, settings_from
from ..tasks.task import Task, policy_seed, task_seed
from .crowding import contacts_without_room
from .lagrangian import algorithm_for
from .ppo_runner import Iteration, Runner
from .run_log import Logger, RunLog, check_logger

Progress = Callable[[int], None]


@dataclass(frozen=True)
class Plan:
    """All that decides what a run computes.

    Attributes:
        task: Name of the task.
        settings: Its settings.
        ppo: Numbers of PPO.
        seed: Seed of everything random.
        device: Torch device.
    """

    task: str
    settings: Any
    ppo: PPOSettings
    seed: int
    device: str

    def check(self) -> None:
        """Raise `InputError` for numbers that cannot be."""
        self.ppo.check()
        check_seed("train", self.seed)


class LostError(RuntimeError):
    """A loss is no longer finite; the newest checkpoint is from before."""


class Trainer:
    """A policy on its way.

    Args:
        task: Task to learn, fresh from its maker.
        plan: What the run computes.
        folder: Folder of the run.
        processes: Those of the run, connected.
        progress: Called with the iterations done since the last call.
        logger: Where the numbers go beside ``metrics.csv``.
    """

    def __init__(
        self, task: Task, plan: Plan, folder: RunFolder, processes: Processes | None = None,
        progress: Progress = lambda done: None, logger: Logger = "tensorboard",
    ) -> None:  # fmt: skip
        self.task, self.plan, self.folder, self.progress, self.logger = task, plan, folder, progress, logger
        self.processes = processes or Processes()
        torch.manual_seed(policy_seed(plan.seed, self.processes.rank))
        self.runner = Runner(task, plan.ppo, self.processes, self._after, algorithm_for(task))
        self.done, self._steps = 0, 0
        self._log: RunLog
        self._without_room = contacts_without_room(task)

    @property
    def _own(self) -> str:
        return f"rank-{self.processes.rank}"

    def begin(self) -> None:
        """Start anew: settings are written, and the worlds' first episodes are of different lengths.

        Were they equal, all worlds would restart together, and every update see one part of an episode only.
        """
        if self.processes.first:
            self.folder.write_config(config_of(self.plan, self.task, self.processes))
            self.folder.keep_metrics(0)
        length = self.task.episode_length_buf
        longest = int(torch.as_tensor(self.task.max_episode_length).max())
        length.copy_(torch.randint(0, longest, length.shape, device=length.device))

    def go_on_from(self, checkpoint: CheckpointFolder) -> None:
        """Take over a checkpoint.

        Raises:
            InputError: It is damaged, or of another task or version; nothing was changed.
        """
        done = checkpoint.check(self.task.name, self.task.version)
        model, own = checkpoint.load_model(), checkpoint.load(self._own)
        try:
            self.runner.go_on_from(model, done)
            self.task.restore(own["task"])
            self.runner.remember(own.get("memory", {}))
            torch.set_rng_state(own["random"])
            if "random_cuda" in own:
                torch.cuda.set_rng_state(own["random_cuda"], self.task.device)
            self.done, self._steps = done, int(own["steps"])
            self._without_room = contacts_without_room(self.task)  # the worlds come with what they had counted before
        except (RuntimeError, KeyError, ValueError, TypeError, AttributeError, IndexError) as error:
            first = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(checkpoint.path, "", f"states that do not fit ({first})", "those of this task") from None
        if self.processes.first:
            self.folder.keep_metrics(done)
            self._note_length()
        self.progress(done)

    def _note_length(self) -> None:
        """Write how long the run is to be; all else stays as it was begun."""
        config = self.folder.config()
        config["ppo"]["iterations"] = self.plan.ppo.iterations
        self.folder.write_config(config)

    def run(self) -> None:
        """Learn until the iterations of the plan are done.

        Raises:
            LostError: A loss is no longer finite.
        """
        if self.done >= self.plan.ppo.iterations:
            return
        logger = self.logger if self.processes.first else "none"
        self._log = RunLog(self.folder.path, logger, self.done, config_of(self.plan, self.task, self.processes))
        try:
            self.runner.run(self.plan.ppo.iterations - self.done)
        finally:
            self._log.close()

    def _after(self, iteration: Iteration) -> None:
        if not all(map(math.isfinite, iteration.losses.values())):
            raise LostError(f"a loss is no longer finite in iteration {iteration.number}")
        self.done, self._steps = iteration.number, self._steps + iteration.steps
        row = self._row(iteration)
        if self.processes.first:
            self.folder.add_metrics(row)
        self._log.add(iteration)
        if self.done % self.plan.ppo.checkpoint_every == 0 or self.done == self.plan.ppo.iterations:
            self._save()
        self.progress(1)

    def _row(self, i: Iteration) -> dict[str, float | None]:
        return {
            "iteration": i.number, "steps": self._steps, "episodes": i.episodes, "reward": i.reward, **i.metrics,
            **{f"{name}_loss": value for name, value in i.losses.items()}, **self.runner.alg.numbers(),
            "learning_rate": i.learning_rate,
            "action_std": i.action_std, "collect_seconds": round(i.collect_seconds, 4),
            "learn_seconds": round(i.learn_seconds, 4), "contacts_without_room": self._crowding(),
        }  # fmt: skip

    def _crowding(self) -> float:
        """Return the contacts that found no room since this was last asked, in the worlds of all processes."""
        now, before = contacts_without_room(self.task), self._without_room
        self._without_room = now
        return float(self.processes.sum(torch.tensor(float(now - before), device=self.plan.device)))

    def _save(self) -> None:
        own = {"task": self.task.snapshot(), "random": torch.get_rng_state(), "steps": self._steps}
        own |= {"memory": held} if (held := self.runner.memory()) else {}
        if self.plan.device.startswith("cuda"):
            own["random_cuda"] = torch.cuda.get_rng_state(self.task.device)
        states = {self._own: own} | ({MODEL: self.runner.state()} if self.processes.first else {})
        about = {"task": self.task.name, "version": self.task.version}
        self.folder.save(self.done, states, about, self.processes)


def train(
    plan: Plan, out: Path, registry: TaskRegistry, *, resume: bool = False, progress: Progress = lambda done: None,
    logger: Logger = "tensorboard",
) -> Trainer:  # fmt: skip
    """Train into a folder, or go on with what is there; return the trainer at the end of its run.

    Args:
        plan: What to compute; with ``resume`` the one that `plan_of` read from the folder.
        out: Folder of the run.
        registry: Where the task is found.
        resume: Whether to go on with a run.
        progress: Called with the iterations done since the last call.
        logger: Where the numbers go beside ``metrics.csv``: ``tensorboard``, ``wandb`` (both), or ``none``.

    Raises:
        InputError: A number cannot be, there is a run already, its checkpoint is not one to go on from, or the logger
            is not installed.
        LostError: A loss is no longer finite.
    """
    plan.check()
    check_logger(logger)
    registry.of(plan.task)
    folder, processes = RunFolder(out), Processes.of_torchrun()
    check_output(out)
    if folder.exists and not resume:
        raise InputError(out, "--out", "a run", "--resume to go on with it, or another folder")
    processes.connect(plan.device)
    try:
        seed = task_seed(plan.seed, processes.rank)
        task = registry.make(plan.task, plan.settings, num_envs=plan.ppo.num_envs, seed=seed, device=plan.device,
                             test=False)  # fmt: skip
        with one_thread():  # a sum in parts depends on how many there are
            trainer = Trainer(task, plan, folder, processes, progress, logger)
            checkpoint = _agreed(folder.newest() if resume else None, folder, plan, processes)
            if checkpoint is None:
                trainer.begin()
            else:
                trainer.go_on_from(checkpoint)
            trainer.run()
    finally:
        processes.disconnect()
    return trainer


def _agreed(
    found: CheckpointFolder | None, folder: RunFolder, plan: Plan, processes: Processes
) -> CheckpointFolder | None:
    """Return the checkpoint that the first process found, once all have looked and before anything is written."""
    own = found.number if found and processes.first else 0
    number = int(processes.sum(torch.tensor(own, device=plan.device)))
    return folder.checkpoint(number) if number else None


def config_of(plan: Plan, task: Task, processes: Processes) -> dict[str, Any]:
    """Return what ``config.json`` says: everything that the result depends on, and where it came from."""
    return {
        "task": {"name": task.name, "version": task.version, "settings": plain(plan.settings)},
        "ppo": plain(plan.ppo),
        "seed": plan.seed,
        "device": plan.device,
        "processes": processes.count,
        "versions": _versions(),
        "source": _source(),
        "machine": describe() | _gpu(plan.device),
        "started": time.strftime("%Y-%m-%dT%H:%M:%S%z"),
    }


def plan_of(folder: RunFolder, registry: TaskRegistry) -> Plan:
    """Return the plan that a run was begun with.

    Raises:
        InputError: There is no run, or it is another version's.
    """
    config, source = folder.config(), folder.path / "config.json"
    name = config["task"]["name"]
    settings = settings_from(registry.of(name, source, "task").settings, config["task"]["settings"], source)
    ppo = settings_from(PPOSettings, config["ppo"], source)
    return Plan(name, settings, ppo, config["seed"], config["device"])


def warn_of_differences(folder: RunFolder, plan: Plan) -> None:
    """Warn where a run goes on, but not to the bits that it would have had."""
    config = folder.config()
    changed = [f"{k} {config['versions'].get(k)} is now {v}" for k, v in _versions().items()
               if config["versions"].get(k) != v]  # fmt: skip
    if config["device"].partition(":")[0] != plan.device.partition(":")[0]:
        changed.append(f"{config['device']} is now {plan.device}")
    if changed:
        warn(f"{folder.path}: goes on, but not to the same bits: {', '.join(changed)}")


def _versions() -> dict[str, str]:
    names = {"torch": "torch", "rsl-rl": "rsl-rl-lib", "warp": "warp-lang", "tensordict": "tensordict"}
    found = {short: version(long) for short, long in names.items()}
    return {"bough": __version__, "python": platform.python_version(), **found}


def _gpu(device: str) -> dict[str, str]:
    return {"gpu": torch.cuda.get_device_name(device)} if device.startswith("cuda") else {}


def _source() -> dict[str, Any]:
    """Return commit and state of the sources, nothing where they are not in a git repository."""
    here = Path(__file__).resolve().parents[2]

    def git(*arguments: str) -> str:
        """Return what git prints about this repository; raise where it fails."""
        command = ["git", "-C", str(here), *arguments]
        done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL, check=True)
        return done.stdout.strip()

    try:
        return {"commit": git("rev-parse", "HEAD"), "changed": bool(git("status", "--porcelain", "--", "."))}
    except (OSError, subprocess.CalledProcessError):
        return {}
