"""The folder of a training run: its settings, its numbers an iteration, its newest checkpoint."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import shutil
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from ...sim.base.errors import InputError
from ...sim.base.files import read_bytes, read_text
from .processes import Processes
from .schema import CHECKPOINT_FORMAT, FORMAT, Manifest, RunRecord, read_record
from .state import packed, unpacked

CONFIG, METRICS_FILE, CHECKPOINTS, MANIFEST = "config.json", "metrics.csv", "checkpoints", "manifest.json"
MODEL = "model"
_A_RUN = "a folder that bough train wrote"


@dataclass(frozen=True)
class RunFolder:
    """Files of a run; every one is replaced whole or not at all.

    Attributes:
        path: The folder.
    """

    path: Path

    @property
    def exists(self) -> bool:
        """Whether a run was begun here."""
        return (self.path / CONFIG).is_file()

    def config(self) -> dict[str, Any]:
        """Return the settings that the run was begun with.

        Raises:
            InputError: There is no run here, or its settings are not readable.
        """
        file = self.path / CONFIG
        if not file.exists():
            raise InputError(self.path, "", f"no {CONFIG}" if self.path.is_dir() else "no such folder", _A_RUN)
        return read_record(file, RunRecord, _A_RUN).model_dump()

    def write_config(self, config: dict[str, Any]) -> None:
        """Write the settings."""
        self.path.mkdir(parents=True, exist_ok=True)
        replace_text(self.path / CONFIG, json.dumps({"format": FORMAT, **config}, indent=2) + "\n")

    def metrics(self) -> list[dict[str, float | None]]:
        """Return a row per iteration; None where an iteration saw no episode end.

        Raises:
            InputError: Names the line that is not one of numbers.
        """
        file = self.path / METRICS_FILE
        if not file.exists():
            return []
        lines = csv.DictReader(io.StringIO(read_text(file)))
        return [_numbers(file, number, row) for number, row in enumerate(lines, start=2)]

    def keep_metrics(self, done: int) -> None:
        """Forget the rows after a number of iterations, as if they had not been."""
        file = self.path / METRICS_FILE
        if not file.exists():
            return
        head, *rows = read_text(file).splitlines() or [""]
        kept = [row for row in rows if row.split(",")[0].isdigit() and int(row.split(",")[0]) <= done]
        replace_text(file, "".join(f"{line}\n" for line in [head, *kept]) if done and kept else "")

    def add_metrics(self, row: dict[str, float | None]) -> None:
        """Append the row of an iteration; ``iteration`` is its first column.

        A run of an earlier bough keeps the columns that it was begun with.
        """
        file = self.path / METRICS_FILE
        fresh = not file.exists() or file.stat().st_size == 0
        line, head = io.StringIO(), list(row)
        if not fresh:
            with file.open() as begun:
                head = begun.readline().rstrip("\n").split(",")
        writer = csv.DictWriter(line, head, lineterminator="\n", extrasaction="ignore")
        if fresh:
            writer.writeheader()
        writer.writerow(row)
        with file.open("a", newline="") as out:
            out.write(line.getvalue())

    def newest(self) -> CheckpointFolder | None:
        """Return the newest checkpoint, None before the first."""
        folder = self.path / CHECKPOINTS
        numbers = [p for p in folder.iterdir() if p.name.isdigit()] if folder.is_dir() else []
        return CheckpointFolder(max(numbers, key=lambda p: int(p.name))) if numbers else None

    def checkpoint(self, done: int) -> CheckpointFolder:
        """Return the checkpoint after some iterations."""
        return CheckpointFolder(self.path / CHECKPOINTS / f"{done:06d}")

    def save(self, done: int, states: dict[str, dict[str, Any]], about: dict[str, Any], processes: Processes) -> None:
        """Write the checkpoint after some iterations; then remove the ones before.

        The folder has its name only when every process has written its part, so a run killed meanwhile still has the
        checkpoint before.

        Args:
            done: Iterations done.
            states: States by name; the names of different processes differ.
            about: Task and version, for `CheckpointFolder.check`.
            processes: Those of the run; all of them call this.
        """
        folder = self.path / CHECKPOINTS
        part = folder / f".{done:06d}.part"
        if processes.first:
            for left in folder.glob(".*.part"):
                shutil.rmtree(left)
            part.mkdir(parents=True)
        processes.wait()
        for name, state in states.items():
            _write_state(part, name, state)
        processes.wait()
        if processes.first:
            manifest = {"format": CHECKPOINT_FORMAT, **about, "iteration": done, "processes": processes.count}
            _write_bytes(part / MANIFEST, (json.dumps(manifest, indent=2) + "\n").encode())
            os.replace(part, self.checkpoint(done).path)
            _sync_folder(folder)
            for old in folder.iterdir():
                if old.name.isdigit() and int(old.name) < done:
                    shutil.rmtree(old)
        processes.wait()


@dataclass(frozen=True)
class CheckpointFolder:
    """A finished checkpoint: a manifest, and states with their digests.

    Attributes:
        path: Its folder.
    """

    path: Path

    @property
    def number(self) -> int:
        """Iterations done, as the name says."""
        return int(self.path.name)

    def check(self, task: str, version: int) -> int:
        """Return how many iterations were done.

        Raises:
            InputError: It is damaged, or of another task or version.
        """
        file = self.path / MANIFEST
        found = read_record(file, Manifest, "a checkpoint as bough train writes it")
        if found.task != task:
            raise InputError(file, "task", found.task, task)
        if found.version != version:
            raise InputError(file, f"version of {task}", str(found.version), f"{version}, this bough's")
        if found.iteration != self.number:
            raise InputError(file, "iteration", str(found.iteration), f"{self.number}, as its folder is called")
        return found.iteration

    def load(self, name: str) -> dict[str, Any]:
        """Return a state: tensors, numbers and text, never anything that runs.

        Raises:
            InputError: It is missing, damaged, or holds anything else.
        """
        file = self.path / f"{name}.pt"
        data = read_bytes(file, allowed="a whole checkpoint")
        noted = read_bytes(file.with_suffix(".sha256"), allowed="a whole checkpoint")
        if hashlib.sha256(data).hexdigest().encode() != noted.strip():
            raise InputError(file, "", "a damaged checkpoint (its digest does not fit)", "the file as it was written")
        return unpacked(data, file, "a checkpoint", "cpu")

    def load_model(self) -> dict[str, Any]:
        """Return networks, normalisers and optimiser.

        Raises:
            InputError: See `load`; or one of their numbers is not finite.
        """
        state = self.load(MODEL)
        check_finite(self.path / f"{MODEL}.pt", state)
        return state


def check_finite(file: Path, state: object, place: str = "") -> None:
    """Raise `InputError` for the first number of a state (nested dicts and lists of tensors) that is not finite."""
    if isinstance(state, torch.Tensor):
        if state.is_floating_point() and not bool(torch.isfinite(state).all()):
            raise InputError(file, place, "a number that is not finite", "a policy as bough train leaves it")
    elif isinstance(state, Mapping):
        for name, value in state.items():
            check_finite(file, value, f"{place}.{name}" if place else str(name))
    elif isinstance(state, Sequence) and not isinstance(state, str):
        for k, value in enumerate(state):
            check_finite(file, value, f"{place}[{k}]")


def _write_state(folder: Path, name: str, state: dict[str, Any]) -> None:
    data = packed(state)
    _write_bytes(folder / f"{name}.pt", data)
    _write_bytes(folder / f"{name}.sha256", hashlib.sha256(data).hexdigest().encode())


def _write_bytes(file: Path, data: bytes) -> None:
    with file.open("wb") as out:
        out.write(data)
        out.flush()
        os.fsync(out.fileno())


def _sync_folder(folder: Path) -> None:
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def replace_text(file: Path, text: str) -> None:
    """Write a text file whole or not at all."""
    part = file.with_name(f".{file.name}.part")
    _write_bytes(part, text.encode())
    os.replace(part, file)


def _numbers(file: Path, line: int, row: dict[str | Any, str | Any]) -> dict[str, float | None]:
    try:
        return {k: float(v) if v else None for k, v in row.items()}
    except (TypeError, ValueError):
        raise InputError(file, f"line {line}", "a row that is not one of numbers", "what bough train wrote") from None
