"""Commands run as a user runs them, and what several stories look at."""

from __future__ import annotations

import contextlib
import io
import re
import shutil
import subprocess
import sys
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest
from bough.cli.main import main
from oracles.branch_case import make_branch_case
from oracles.forked import LIMIT, Forked


@dataclass(frozen=True)
class Ran:
    """A finished command: exit code and what it printed; ``err`` without lines of progress, which come by the clock."""

    code: int
    out: str
    err: str

    def __post_init__(self) -> None:
        """Leave lines of progress out."""
        kept = [x for x in self.err.splitlines(keepends=True) if not re.match(r"bough: \d+ s: ", x)]
        object.__setattr__(self, "err", "".join(kept))

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
def bough(forked: Forked) -> Bough:
    """Return the function that runs ``bough`` with arguments, in a process of its own, in the present folder.

    Each command is started as a user starts it when it is first run; later processes have torch imported, see `Forked`.
    """
    seen: set[str] = set()

    def run(*arguments: object, before: tuple[str, ...] = ()) -> Ran:
        words = [str(a) for a in arguments]
        if before or not forked.suits() or not {*words[:1]} <= seen:
            seen.update(words[:1])
            command = [*before, sys.executable, "-m", "bough", *words]
            done = subprocess.run(command, capture_output=True, text=True, timeout=LIMIT, check=False)
        else:
            done = forked.run(*words)
        return Ran(done.returncode, done.stdout, done.stderr)

    return run


@pytest.fixture(scope="session")
def inside() -> Bough:
    """Return the function that runs ``bough`` with arguments in the test's own process, which has torch imported.

    For many options of one command: the command as a process of its own, `bough`, is run beside them.
    """

    def run(*arguments: object) -> Ran:
        out, err = io.StringIO(), io.StringIO()
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), warnings.catch_warnings():
            warnings.simplefilter("default")
            code = main([str(a) for a in arguments])
        return Ran(code, out.getvalue(), err.getvalue())

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


@pytest.fixture(scope="session")
def brief(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a branch case of two segments in short recordings: enough for what need not be learnt well."""
    folder = tmp_path_factory.mktemp("brief") / "case"
    make_branch_case(folder, 3, segments=2, samples=40, noise=0.02, rate=25.0)
    return folder


@pytest.fixture
def case(measured: tuple[Path, dict], tmp_path: Path) -> Path:
    """Return a copy of the measured case that a test may spoil."""
    return Path(shutil.copytree(measured[0], tmp_path / "case"))
