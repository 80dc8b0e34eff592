"""The numbers of a run for TensorBoard, or for Weights & Biases too, through rsl-rl's writer."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from ...sim.base.errors import InputError
from ...sim.base.extras import install_hint

if TYPE_CHECKING:
    from .ppo_runner import Iteration

Logger = Literal["tensorboard", "wandb", "none"]
FOLDER = "tensorboard"


def check_logger(logger: Logger) -> None:
    """Raise `InputError` for a logger whose package is not installed."""
    if logger == "wandb" and find_spec("wandb") is None:
        raise InputError(
            "train", "--logger", "wandb, which is not installed", f"{install_hint('wandb')}, or tensorboard"
        )


class RunLog:
    """Events of a run, under the names that rsl-rl gives them; steps are the iterations of ``metrics.csv``.

    Args:
        run: Folder of the run; events go to its folder ``tensorboard``.
        logger: Where to, see `Logger`.
        done: Iterations done; events after them, of a run that was killed, count no longer.
        about: What ``config.json`` says, for W&B.
    """

    def __init__(self, run: Path, logger: Logger, done: int, about: dict[str, Any]) -> None:
        self._writer: Any = None
        if logger == "tensorboard":
            from torch.utils.tensorboard import SummaryWriter

            self._writer = SummaryWriter(str(run / FOLDER), flush_secs=10)
        elif logger == "wandb":
            self._writer = _wandb_writer(run, about)
        if self._writer is not None:
            self._forget_after(done)

    def _forget_after(self, done: int) -> None:
        """Tell TensorBoard that it goes on after some iterations, as ``purge_step`` of torch's writer does."""
        from tensorboard.compat.proto.event_pb2 import Event, SessionLog

        file = self._writer.file_writer
        file.add_event(Event(step=done + 1, file_version="brain.Event:2"))
        file.add_event(Event(step=done + 1, session_log=SessionLog(status=SessionLog.START)))

    def add(self, iteration: Iteration) -> None:
        """Write the numbers of an iteration; measures of which no episode ended have none."""
        if self._writer is not None:
            for tag, value in scalars(iteration).items():
                self._writer.add_scalar(tag, value, iteration.number)

    def close(self) -> None:
        """Write what is not written yet and end a W&B run."""
        if self._writer is not None:
            self._writer.close()
        if hasattr(self._writer, "stop"):
            self._writer.stop()


def scalars(i: Iteration) -> dict[str, float]:
    """Return the numbers of an iteration by rsl-rl's names: ``Train``, ``Episode``, ``Loss``, ``Policy``, ``Perf``."""
    seconds = i.collect_seconds + i.learn_seconds
    episode = {f"Episode/{name}": value for name, value in i.metrics.items() if value is not None}
    train = {"Train/mean_reward": episode["Episode/return"]} if "Episode/return" in episode else {}
    return {
        **train, **episode, "Train/mean_step_reward": i.reward,
        **{f"Loss/{name}": value for name, value in i.losses.items()}, "Loss/learning_rate": i.learning_rate,
        "Policy/mean_std": i.action_std, "Perf/total_fps": i.steps / seconds, "Perf/collection_time": i.collect_seconds,
        "Perf/learning_time": i.learn_seconds,
    }  # fmt: skip


def _wandb_writer(run: Path, about: dict[str, Any]) -> Any:
    """Return rsl-rl's writer for W&B, which writes TensorBoard's events too; a run there is called as its folder."""
    os.environ.setdefault("WANDB_DIR", str(run))  # else it writes where the command was given
    import wandb
    from rsl_rl.utils.wandb_log_writer import WandbLogWriter

    folder = run / FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    writer = WandbLogWriter(str(folder), project_name="bough")
    wandb.config.update(about)
    return writer
