"""Commands run as a user runs them, and what several stories look at."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from oracles.branch_case import make_branch_case


@dataclass(frozen=True)
class Ran:
    """A finished command: exit code and what it printed."""

    code: int
    out: str
    err: str

    def refused(self, *words: str) -> None:
        """Assert exit code 2 and one line on stderr that holds the words, with nothing on stdout."""
        assert self.code == 2, self.err
        lines = self.err.splitlines()
        assert len(lines) == 1 and lines[0].startswith("bough: "), self.err
        assert all(word in lines[0] for word in words), (words, lines[0])
        assert "found " in lines[0] and "allowed: " in lines[0]
        assert self.out == ""


Bough = Callable[..., Ran]


@pytest.fixture(scope="session")
def bough() -> Bough:
    """Return the function that runs ``bough`` with arguments, in a process of its own, in the present folder."""

    def run(*arguments: object, before: tuple[str, ...] = ()) -> Ran:
        command = [*before, sys.executable, "-m", "bough", *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
        return Ran(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture(scope="session")
def forest(bough: Bough, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder that one ``bough forest`` wrote: three trees in three formats and a picture 320 pixels wide."""
    out = tmp_path_factory.mktemp("forest") / "made" / "here"
    done = bough("forest", "--count", 3, "--order", 2, "--seed", 5, "--format", "mjcf", "urdf", "glb",
                 "--picture-width", 320, "--out", out)  # fmt: skip
    assert done.code == 0, done.err
    assert done.err == ""
    assert len(done.out.splitlines()) == 1 and str(out) in done.out
    return out


@pytest.fixture(scope="session")
def measured(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict]:
    """Folder of a branch case made by MuJoCo, and the truth behind it."""
    folder = tmp_path_factory.mktemp("measured") / "case"
    return folder, make_branch_case(folder, 3, samples=60, noise=0.0, rate=25.0)


@pytest.fixture
def case(measured: tuple[Path, dict], tmp_path: Path) -> Path:
    """Return a copy of the measured case that a test may spoil."""
    return Path(shutil.copytree(measured[0], tmp_path / "case"))
