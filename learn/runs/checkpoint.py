"""What a long run has reached, kept beside its output so that a killed run goes on to the same bits."""

from __future__ import annotations

import hashlib
import math
import os
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ...sim.base.errors import InputError
from ...sim.base.files import DATA_LIMIT, opened, read_bytes
from .state import packed, unpacked

_COUNT = "work counted"


@dataclass
class Checkpoint:
    """Named states in a hidden folder beside the output, each replaced whole or not at all.

    Attributes:
        folder: Where they are kept; None keeps nothing.
        key: What the run is made of; a run of another key is not gone on with.
        every: Seconds between two writes of the same state.
        count: Returns what this process has counted of the work so far, such as world-steps; kept with every state.
        earlier: What the processes before had counted when they last wrote.
        part: What the names of all states begin with: one run may have parts with states of the same name.
    """

    folder: Path | None = None
    key: str = ""
    every: float = 1.0
    count: Callable[[], int] = lambda: 0
    earlier: int = 0
    part: str = ""
    _written: dict[str, float] = field(default_factory=dict)

    def open(self, resume: bool) -> bool:
        """Begin anew, or go on where a run was left; return whether there was one to go on with.

        Raises:
            InputError: The run that was left is of another case or other settings, or one of its states is damaged.
        """
        assert self.folder is not None
        mark = self.folder / "key"
        if resume and mark.exists():
            if read_bytes(mark) != self.key.encode():
                allowed = "the case and settings it was begun with, or no --resume"
                raise InputError(
                    self.folder, "--resume", "an unfinished run of another case or other settings", allowed
                )
            states = [self.folder / name for name in os.listdir(self.folder) if name[0] != "." and name != "key"]
            self.earlier = max((_read(file)[_COUNT] for file in states), default=0)
            return True
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)
        mark.write_text(self.key)
        return False

    def load(self, name: str) -> dict[str, Any] | None:
        """Return a state (tensors, numbers, text and lists of them), or None where there is none."""
        if self.folder is None or not (self.folder / (self.part + name)).exists():
            return None
        state = _read(self.folder / (self.part + name))
        return {key: value for key, value in state.items() if key != _COUNT}

    def due(self, name: str) -> bool:
        """Return whether a state should be written now."""
        written = self._written.get(self.part + name, -math.inf)
        return self.folder is not None and time.monotonic() - written >= self.every

    def save(self, name: str, state: dict[str, Any]) -> None:
        """Write a state."""
        if self.folder is None:
            return
        name = self.part + name
        part = self.folder / f".{name}.part"
        data = packed({**state, _COUNT: self.earlier + self.count()})
        part.write_bytes(hashlib.sha256(data).digest() + data)
        os.replace(part, self.folder / name)
        self._written[name] = time.monotonic()

    def close(self) -> None:
        """Remove everything: the run is finished."""
        if self.folder is not None:
            shutil.rmtree(self.folder, ignore_errors=True)


def _read(file: Path) -> dict[str, Any]:
    """Return a state, if it is to the bit what was written: whoever asked for it need not doubt what it holds.

    Raises:
        InputError: It is not.
    """
    data = read_bytes(file)
    size = hashlib.sha256().digest_size
    if hashlib.sha256(data[size:]).digest() != data[:size]:
        allowed = f"the file as it was written; begin anew without --resume, which removes {file.parent.name}"
        raise InputError(file, "", "a damaged state of an unfinished run", allowed)
    return unpacked(data[size:], file, "a state of an unfinished run")


def digest(folder: Path, *parts: object) -> str:
    """Return a key of a folder's files and anything else that can be printed.

    Raises:
        InputError: A file cannot be read.
    """
    h = hashlib.sha256()
    for path in sorted(p for p in folder.iterdir() if p.is_file()):
        h.update(path.name.encode() + b"\0")
        with opened(path, DATA_LIMIT) as file:
            for block in iter(lambda: file.read(1 << 20), b""):
                h.update(block)
    h.update(repr(parts).encode())
    return h.hexdigest()
