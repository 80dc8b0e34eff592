"""Writing results whole or not at all."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .errors import InputError


@contextmanager
def output_folder(out: str | Path) -> Iterator[Path]:
    """Yield a fresh folder beside ``out`` and move its files into ``out`` when the block ends without an error.

    Until then nothing appears under ``out``; after an error nothing is left behind. Files of the same name are
    replaced, others are kept.

    Raises:
        InputError: ``out`` is a file, or cannot be created or written.
    """
    target = Path(out)
    if target.exists() and not target.is_dir():
        raise InputError(target, "--out", "a file", "a folder, or a path where one can be made")
    parent = _existing_parent(target)
    if not os.access(parent, os.W_OK | os.X_OK) or (target.is_dir() and not os.access(target, os.W_OK | os.X_OK)):
        raise InputError(target, "--out", "a place without permission to write", "a folder that can be written")
    work = Path(tempfile.mkdtemp(prefix=".bough-", dir=parent))
    try:
        yield work
        work.chmod(0o755)
        target.mkdir(parents=True, exist_ok=True)
        for item in sorted(work.iterdir()):
            _move(item, target / item.name)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _existing_parent(path: Path) -> Path:
    parent = path.absolute().parent
    while not parent.exists():
        parent = parent.parent
    return parent


def _move(item: Path, destination: Path) -> None:
    if destination.is_dir() and not destination.is_symlink():
        shutil.rmtree(destination)
    os.replace(item, destination)


def read_text(path: str | Path) -> str:
    """Read a UTF-8 text file.

    Raises:
        InputError: The file is missing, a folder, unreadable or not text.
    """
    file = Path(path)
    try:
        return file.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(file, "", "no such file", "an existing file") from None
    except IsADirectoryError:
        raise InputError(file, "", "a folder", "a file") from None
    except PermissionError:
        raise InputError(file, "", "a file without permission to read", "a readable file") from None
    except UnicodeDecodeError as e:
        raise InputError(file, f"byte {e.start}", "bytes that are not UTF-8 text", "a text file") from None
