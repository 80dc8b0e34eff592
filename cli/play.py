"""``bough play``: a film of a policy, rendered without a screen."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ..learn.policies.film import Film
from ..learn.tasks.measures import LABELS, Label, label_of
from ..learn.tasks.registry import TASKS, TaskRegistry, known_tasks
from ..learn.tasks.task import require_rsl_rl, unseen_seed
from ..sim.base.console import bar, shown, start_warp, tell
from ..sim.base.errors import InputError, check_seed
from ..sim.base.files import output_folder
from .base.exit_codes import ExitCode

if TYPE_CHECKING:
    from ..learn.policies.evaluate import Policy
    from ..learn.tasks.task import Task

#: Fewest pictures per simulated second: a GIF shows none for longer than eleven minutes.
SLOWEST = 0.01
#: Longest film [s]: a day, and no episode is longer.
LONGEST = 86_400.0


@dataclass(frozen=True)
class Play:
    """Film one episode of a policy in an unseen world with all contacts on; bough view RUN shows it live.

    Writes film.gif, or the folder frames with one PNG per picture. Exit code 0: done; 2: bad input, nothing written.

    Attributes:
        policy: Folder that bough train wrote, or zero (no action), random (actions drawn uniformly)
            or, for reach, mpc (sampling MPC without the tree) or mpc-tree (which knows it).
        out: Folder to write to.
        task: Task of those that are no run; a run has its own.
        seed: Seed of the world; bough evaluate's first world of the first set is that of seed 0.
        seconds: Simulated time; the whole episode if not given.
        fps: Pictures per simulated second, 0.01 to 50; the film runs in real time.
        film: gif, an animation, or png, numbered pictures.
        device: cpu, cuda or cuda:N; a GPU if there is one.
        json: Print the measures of the episode as JSON instead of a sentence.
    """

    policy: tyro.conf.Positional[str]
    out: Path
    task: Annotated[str | None, tyro.conf.arg(help_behavior_hint=TASKS.hint)] = None
    seed: int = 0
    seconds: float | None = None
    fps: float = 20.0
    film: Film = "gif"
    device: str | None = None
    json: bool = False

    def run(self, registry: TaskRegistry | None = None) -> int:
        """Play, say what happened and what was written; return the exit code."""
        self._check()
        require_rsl_rl()
        start_warp()
        return self._film(registry or known_tasks())

    def _film(self, registry: TaskRegistry) -> int:
        from ..learn.policies.crowding import contacts_without_room
        from ..learn.policies.play import Episode, write_film
        from ..learn.runs.threads import one_thread

        task, policy = self._cast(registry)
        every = max(1, round(1.0 / (self.fps * task.step_seconds)))
        with output_folder(self.out) as work, bar("playing", None) as advance, one_thread():
            episode = Episode(task, policy, steps=self._steps(task), every=every, progress=advance)
            name = write_film(work, episode, self.film, 1.0 / (every * task.step_seconds))
        seconds = episode.done * task.step_seconds
        crowded = contacts_without_room(task)
        outcome = _outcome(episode.metrics) + _crowded(crowded)
        said = f"{task.name}, {self.policy}: {seconds:.1f} s, {outcome}, {episode.pictures} pictures."
        result = {"out": str(self.out / name), "task": task.name, "seconds": seconds, "measures": episode.metrics,
                  "contacts_without_room": crowded}  # fmt: skip
        tell(f"{said} Wrote {shown(self.out / name)}", result, self.json)
        return ExitCode.DONE

    def _steps(self, task: Task) -> int | None:
        """Return the most policy steps, None for no limit of this command's."""
        return None if self.seconds is None else max(1, round(self.seconds / task.step_seconds))

    def _check(self) -> None:
        """Raise `InputError` for options that cannot be."""
        if not SLOWEST <= self.fps <= 50.0:
            raise InputError("play", "--fps", f"{self.fps:g}", f"{SLOWEST:g} to 50")
        if self.seconds is not None and not 0.0 < self.seconds <= LONGEST:
            raise InputError("play", "--seconds", f"{self.seconds:g}", f"above 0, up to {LONGEST:g}")
        check_seed("play", self.seed)

    def _cast(self, registry: TaskRegistry) -> tuple[Task, Policy]:
        """Return the task with one world, and who acts in it."""
        from ..learn.policies.evaluate import UNTRAINED, read_policy, untrained
        from ..learn.runs.folder import RunFolder
        from ..learn.runs.processes import Processes

        seed, device = unseen_seed(self.seed, 0), Processes().device(self.device)
        if self.policy not in UNTRAINED:
            trained = read_policy(RunFolder(Path(self.policy)), registry)
            if self.task not in (None, trained.name):
                raise InputError("play", "--task", str(self.task), f"{trained.name}, the run's own, or none")
            task = registry.make(trained.name, trained.settings, num_envs=1, seed=seed, device=device, test=True)
            return task, trained.on(task)
        if self.task is None:
            raise InputError("play", "--task", "nothing", ", ".join(registry.names))
        kind = registry.of(self.task, "play", "--task")
        settings = kind.presets[kind.preset_for(device)]
        task = registry.make(self.task, settings, num_envs=1, seed=seed, device=device, test=True)
        return task, untrained(self.policy, task, seed)


def _outcome(metrics: dict[str, float] | None) -> str:
    if metrics is None:
        return "stopped before the end of the episode"
    won = "success" if metrics["success"] > 0 else "no success"
    others = sorted(metrics.keys() - {"return", "success"}, key=lambda name: (name not in LABELS, name))[:2]
    told = [_said(label_of(name), metrics[name]) for name in others]
    return ", ".join([won, *told])


def _said(label: Label, value: float) -> str:
    return f"{label.name.lower()} {label.scale * value:.3g} {label.unit}".strip()


def _crowded(contacts: int) -> str:
    return f", {contacts} contacts without room" if contacts else ""
