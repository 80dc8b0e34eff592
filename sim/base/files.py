"""Reading what may be anything, and writing results whole or not at all."""

from __future__ import annotations

import codecs
import io
import os
import shutil
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import BinaryIO

from .errors import InputError

#: Largest text file that is read: ten hours of a recording at 1 kHz have a quarter of it.
TEXT_LIMIT = 1 << 30
#: Largest file of numbers that is read: states of many worlds. Whether they fit into memory is another question.
DATA_LIMIT = 1 << 36
_WORK = ".bough-"


@contextmanager
def output_folder(out: str | Path) -> Iterator[Path]:
    """Yield a fresh folder beside ``out`` and move its files into ``out`` when the block ends without an error.

    Until then nothing appears under ``out``; after an error nothing is left behind. Files of the same name are
    replaced, others are kept.

    Raises:
        InputError: ``out`` is a file, or cannot be created or written.
    """
    target = Path(out)
    parent = check_output(target)
    _clear_dead(parent)
    work = Path(tempfile.mkdtemp(prefix=f"{_WORK}{os.getpid()}-", dir=parent))
    try:
        yield work
        work.chmod(0o755)
        target.mkdir(parents=True, exist_ok=True)
        for item in sorted(work.iterdir()):
            _move(item, target / item.name)
    finally:
        shutil.rmtree(work, ignore_errors=True)


def check_output(target: Path) -> Path:
    """Return the folder that is there already in which, or below which, an output folder will be.

    Raises:
        InputError: ``target`` is a file or below one, or cannot be created or written.
    """
    parent = _existing_parent(target)
    if not parent.is_dir() or (target.exists() and not target.is_dir()):
        found = "a file" if target.exists() else f"a path below the file {parent}"
        raise InputError(target, "--out", found, "a folder, or a path where one can be made")
    if not os.access(parent, os.W_OK | os.X_OK) or (target.is_dir() and not os.access(target, os.W_OK | os.X_OK)):
        raise InputError(target, "--out", "a place without permission to write", "a folder that can be written")
    return parent


def _clear_dead(parent: Path) -> None:
    """Remove what killed commands have left: work folders of processes of this user that no longer live."""
    for left in parent.glob(f"{_WORK}[0-9]*-*"):
        number = left.name.removeprefix(_WORK).partition("-")[0]
        if number.isdigit() and left.is_dir() and not _lives(int(number)):
            shutil.rmtree(left, ignore_errors=True)


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        return True
    return True


def _existing_parent(path: Path) -> Path:
    parent = path.absolute().parent
    while not parent.exists():
        parent = parent.parent
    return parent


def _move(item: Path, destination: Path) -> None:
    if destination.is_dir() and not destination.is_symlink():
        shutil.rmtree(destination)
    os.replace(item, destination)


def check_regular(file: Path, limit: int = TEXT_LIMIT) -> None:
    """Check that a file is one, and no larger than ``limit`` bytes, before any of it is read.

    Raises:
        InputError: It is a device or a pipe, which may never end, or too large. What is missing is left to who reads.
    """
    try:
        status = file.stat()
    except (OSError, ValueError):
        return
    if not (stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)):
        raise InputError(file, "", "a device or a pipe", "a file")
    if stat.S_ISREG(status.st_mode) and status.st_size > limit:
        raise InputError(file, "", f"{status.st_size / 2**20:.0f} MiB", f"{limit / 2**20:.0f} MiB at most")


@contextmanager
def opened(path: str | Path, limit: int = TEXT_LIMIT, allowed: str = "") -> Iterator[BinaryIO]:
    """Open a file of at most ``limit`` bytes; what opening and reading it raises becomes one line.

    Args:
        path: The file.
        limit: Bytes that it may have.
        allowed: What the file should be, where a user may have named another one; "a file" if not given.

    Raises:
        InputError: The file is missing, a folder, a device or a pipe, too large or unreadable.
    """
    file = Path(path)
    if "\0" in str(file):
        raise InputError(repr(str(file)), "", "a name with a NUL", "a file's name")
    check_regular(file, limit)
    try:
        with file.open("rb") as stream:
            yield stream
    except OSError as error:
        raise _unread(file, error, allowed) from None


def _unread(file: Path, error: OSError, allowed: str) -> InputError:
    if isinstance(error, FileNotFoundError):
        return InputError(file, "", "no such file", allowed or "an existing file")
    if isinstance(error, IsADirectoryError):
        return InputError(file, "", "a folder", allowed or "a file")
    if isinstance(error, PermissionError):
        return InputError(file, "", "a file without permission to read", "a readable file")
    # a name that is too long, links that lead in a circle
    return InputError(_shortened(file), "", str(error.strerror).lower(), "a readable file")


def read_bytes(path: str | Path, limit: int = DATA_LIMIT, allowed: str = "") -> bytes:
    """Read a file of at most ``limit`` bytes; arguments and errors as of `opened`."""
    with opened(path, limit, allowed) as stream:
        return stream.read()


def read_text(path: str | Path, limit: int = TEXT_LIMIT) -> str:
    """Read a text file of at most ``limit`` bytes: UTF-8, or UTF-16 that begins with its byte-order mark.

    Raises:
        InputError: As of `opened`, or it is not text.
    """
    with opened(path, limit) as stream:
        data = stream.read()
    marked = data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)
    try:
        with io.TextIOWrapper(io.BytesIO(data), "utf-16" if marked else "utf-8") as text:  # any end of a line
            return text.read()
    except UnicodeDecodeError as e:
        raise InputError(path, f"byte {e.start}", "bytes that are not UTF-8 text", "a text file in UTF-8") from None


def _shortened(file: Path) -> str:
    name = str(file)
    return name if len(name) <= 200 else f"{name[:80]}...{name[-80:]}"
