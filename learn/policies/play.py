"""A film of one episode."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import PIL.Image
import torch

from .evaluate import Policy, longest_episode
from .film import Film

if TYPE_CHECKING:
    from ..tasks.task import Task


class Episode:
    """One episode of a task's first world, a picture every few steps.

    Args:
        task: The task, fresh.
        policy: Who acts.
        steps: Most policy steps; the whole episode if None.
        every: Policy steps between two pictures.
        progress: Called with the policy steps done since the last call.
    """

    def __init__(
        self, task: Task, policy: Policy, *, steps: int | None = None, every: int = 1,
        progress: Callable[[int], None] = lambda done: None,
    ) -> None:  # fmt: skip
        self.task, self.policy, self.every, self.progress = task, policy, every, progress
        self.most = longest_episode(task) + 1 if steps is None else steps
        self.done, self.pictures = 0, 0
        self.metrics: dict[str, float] | None = None

    def frames(self) -> Iterator[PIL.Image.Image]:
        """Yield pictures from the start until the episode is over; its metrics are known then."""
        yield self._picture()
        observations = self.task.get_observations()
        while self.done < self.most and self.metrics is None:
            with torch.inference_mode():
                observations, _, dones, extras = self.task.step(self.policy(observations))
            self.done += 1
            self.progress(1)
            if bool(dones[0] > 0):  # the world has started anew: its picture is of the next episode
                self.metrics = {name: float(value[0]) for name, value in extras["log"].items()}
            elif self.done % self.every == 0:
                yield self._picture()

    def _picture(self) -> PIL.Image.Image:
        self.pictures += 1
        return PIL.Image.fromarray(self.task.render(0))


def write_film(folder: Path, episode: Episode, film: Film, frames_per_second: float) -> str:
    """Write an episode into an existing folder as it goes along; return the name of what was written.

    Args:
        folder: Where to.
        episode: The episode.
        film: ``gif``, one animation, or ``png``, a folder of numbered pictures.
        frames_per_second: Of the animation, up to 50.
    """
    return write_frames(folder, episode.frames(), film, frames_per_second)


def write_frames(folder: Path, frames: Iterator[PIL.Image.Image], film: Film, frames_per_second: float) -> str:
    """Write pictures into an existing folder as they come, one at least; return the name of what was written."""
    if film == "gif":
        return _gif(folder, frames, frames_per_second)
    (folder / "frames").mkdir()
    for number, frame in enumerate(frames):
        frame.save(folder / "frames" / f"{number:04d}.png")
    return "frames"


def _gif(folder: Path, frames: Iterator[PIL.Image.Image], frames_per_second: float) -> str:
    first = next(frames)
    hundredths = max(2, round(100.0 / frames_per_second))  # the format's unit; viewers slow down below 2
    first.save(folder / "film.gif", save_all=True, append_images=frames, duration=10 * hundredths, loop=0)
    return "film.gif"
