"""``bough play``: watch a policy, as a film rendered without a screen or in a window."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, cast

import tyro

from ..learn.policies.film import Film
from ..learn.policies.ppo_settings import preset_of
from ..learn.tasks.registry import TaskRegistry, builtin_tasks
from ..learn.tasks.task import require_rsl_rl, unseen_seed
from ..sim.base.console import bar, shown, start_warp
from ..sim.base.errors import InputError, check_seed
from ..sim.base.files import output_folder
from .exit_codes import ExitCode

if TYPE_CHECKING:
    from ..learn.policies.evaluate import Policy
    from ..learn.tasks.powerline import Powerline
    from ..learn.tasks.task import Task


@dataclass(frozen=True)
class Play:
    """Film one episode of a policy in an unseen world with all contacts on, or watch it live.

    Writes film.gif, or the folder frames with one PNG per picture. Exit code 0: done; 2: bad input, nothing written.
    With --viewer nothing is written: a window shows episode after episode until it is closed, and needs a screen and
    pip install 'bough[viewer]'.

    Attributes:
        policy: Folder that bough train wrote, or zero (no action) or random (actions drawn uniformly).
        out: Folder to write to; none with --viewer.
        task: Task of zero and random; a run has its own.
        seed: Seed of the world; bough evaluate's first world of the first set is that of seed 0.
        seconds: Simulated time; the whole episode if not given, or until the window is closed.
        fps: Pictures per simulated second; the film runs in real time.
        film: gif, an animation, or png, numbered pictures.
        device: cpu, cuda or cuda:N; a GPU if there is one.
        viewer: Watch live in a window instead.
    """

    policy: tyro.conf.Positional[str]
    out: Path | None = None
    task: str | None = None
    seed: int = 0
    seconds: float | None = None
    fps: float = 20.0
    film: Film = "gif"
    device: str | None = None
    viewer: bool = False

    def run(self, registry: TaskRegistry | None = None) -> int:
        """Play, say what happened and what was written; return the exit code."""
        self._check()
        require_rsl_rl()
        start_warp()
        registry = registry or builtin_tasks()
        return self._watch(registry) if self.out is None else self._film(registry, self.out)

    def _film(self, registry: TaskRegistry, out: Path) -> int:
        from ..learn.policies.crowding import contacts_without_room
        from ..learn.policies.play import Episode, write_film
        from ..learn.runs.threads import one_thread

        task, policy = self._cast(registry)
        every = max(1, round(1.0 / (self.fps * task.step_seconds)))
        with output_folder(out) as work, bar("playing", None) as advance, one_thread():
            episode = Episode(task, policy, steps=self._steps(task), every=every, progress=advance)
            name = write_film(work, episode, self.film, 1.0 / (every * task.step_seconds))
        seconds = episode.done * task.step_seconds
        outcome = _outcome(episode.metrics) + _crowded(contacts_without_room(task))
        print(f"{task.name}, {self.policy}: {seconds:.1f} s, {outcome}, {episode.pictures} pictures. "
              f"Wrote {shown(out / name)}")  # fmt: skip
        return ExitCode.DONE

    def _watch(self, registry: TaskRegistry) -> int:
        from ..learn.policies.live_viewer import open_viewer, watch
        from ..learn.runs.threads import one_thread

        viewer = open_viewer()  # before the worlds, which take longer than to say that there is no screen
        try:
            task, policy = self._cast(registry)
        except InputError:
            viewer.close()
            raise
        with one_thread():
            done = watch(cast("Powerline", task), policy, viewer, steps=self._steps(task))
        print(f"{task.name}, {self.policy}: {done * task.step_seconds:.1f} s watched.")
        return ExitCode.DONE

    def _steps(self, task: Task) -> int | None:
        """Return the most policy steps, None for no limit of this command's."""
        return None if self.seconds is None else max(1, round(self.seconds / task.step_seconds))

    def _check(self) -> None:
        """Raise `InputError` for options that cannot be."""
        if self.viewer == (self.out is not None):
            found = "--viewer and --out" if self.viewer else "nothing"
            raise InputError("play", "--out", found, "a folder for the film, or --viewer without it")
        if not 0.0 < self.fps <= 50.0:
            raise InputError("play", "--fps", f"{self.fps:g}", "above 0, up to 50")
        if self.seconds is not None and not self.seconds > 0.0:
            raise InputError("play", "--seconds", f"{self.seconds:g}", "above 0")
        check_seed("play", self.seed)

    def _cast(self, registry: TaskRegistry) -> tuple[Task, Policy]:
        """Return the task with one world, and who acts in it."""
        from ..learn.policies.evaluate import random, read_policy, zero
        from ..learn.runs.folder import RunFolder
        from ..learn.runs.processes import Processes

        seed, device = unseen_seed(self.seed, 0), Processes().device(self.device)
        if self.policy not in ("zero", "random"):
            trained = read_policy(RunFolder(Path(self.policy)), registry)
            if self.task not in (None, trained.name):
                raise InputError("play", "--task", str(self.task), f"{trained.name}, the run's own, or none")
            task = registry.make(trained.name, trained.settings, num_envs=1, seed=seed, device=device, test=True)
            return task, trained.on(task)
        if self.task is None:
            raise InputError("play", "--task", "nothing", ", ".join(registry.names))
        registry.check_name(self.task)
        task = registry.make(
            self.task, registry.presets[preset_of(device)], num_envs=1, seed=seed, device=device, test=True
        )
        return task, zero(task) if self.policy == "zero" else random(task, seed)


def _outcome(metrics: dict[str, float] | None) -> str:
    if metrics is None:
        return "stopped before the end of the episode"
    won = "cleared" if metrics["success"] > 0 else "not cleared"
    return f"{won}, occlusion drop {100 * metrics['occlusion_drop']:.0f} %"


def _crowded(contacts: int) -> str:
    return f", {contacts} contacts without room" if contacts else ""
