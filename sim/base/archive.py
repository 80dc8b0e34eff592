"""Arrays from files that may be anything: read whole, or refused in one line before memory is taken for them."""

from __future__ import annotations

import math
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, BinaryIO

import numpy as np

from .errors import InputError, shortened
from .files import DATA_LIMIT, opened
from .host import check_memory

_NPY = np.lib.format
_ENDING = ".npy"


def read_arrays(
    path: str | Path, allowed: str, names: Sequence[str] = (), limit: int = DATA_LIMIT
) -> dict[str, np.ndarray]:
    """Return the arrays of an ``.npz`` archive by their names; objects, which may run code, are never read.

    Args:
        path: The archive.
        allowed: What it should be, as an error says it.
        names: Arrays that are needed, and read alone; all of them if not given.
        limit: Bytes that the file may have.

    Raises:
        InputError: The file is missing, a folder, a device or a pipe, too large or unreadable; it is no such archive;
            an array claims to be larger than what is there for it, or than memory; one that is needed is missing.
    """
    file = Path(path)
    with _archive(file, allowed, limit) as archive:
        there = _names(archive)
        for name in names:
            if name not in there:
                raise InputError(file, name, f"only {', '.join(there) or 'an empty archive'}", f"an array {name}")
        parts = {name: archive.getinfo(name + _ENDING) for name in names or there}
        check_memory(str(file), f"{len(parts)} arrays", sum(part.file_size for part in parts.values()))
        return {name: _member(file, archive, part) for name, part in parts.items()}


def array_names(path: str | Path, allowed: str) -> list[str]:
    """Return the names of the arrays of an ``.npz`` archive, none of which is read; errors as of `read_arrays`."""
    with _archive(Path(path), allowed, DATA_LIMIT) as archive:
        return _names(archive)


def read_array(path: str | Path, allowed: str, limit: int = DATA_LIMIT) -> np.ndarray:
    """Return the array of an ``.npy`` file; arguments and errors as of `read_arrays`."""
    file = Path(path)
    with opened(file, limit, allowed) as stream, _in_one_line(file, "no array of plain numbers", allowed):
        return _array(file, "", stream, file.stat().st_size)


@contextmanager
def _archive(file: Path, allowed: str, limit: int) -> Iterator[zipfile.ZipFile]:
    found = "a file that is no whole .npz archive of plain arrays"
    with opened(file, limit, allowed) as stream, _in_one_line(file, found, allowed):
        if _is_array(stream):
            raise InputError(file, "", "a single array", allowed)
        with zipfile.ZipFile(stream) as archive:
            yield archive


@contextmanager
def _in_one_line(file: Path, found: str, allowed: str) -> Iterator[None]:
    """Turn whatever a broken file makes its readers raise into one line."""
    try:
        yield
    except InputError:
        raise
    except MemoryError:
        raise InputError(file, "", "arrays larger than the memory that is left", "what fits into it") from None
    except Exception:  # zipfile, what unpacks for it and numpy name no common class for what they refuse to read
        raise InputError(file, "", found, allowed) from None


def _is_array(stream: BinaryIO) -> bool:
    begin = stream.read(len(_NPY.MAGIC_PREFIX))
    stream.seek(0)
    return begin == _NPY.MAGIC_PREFIX


def _names(archive: zipfile.ZipFile) -> list[str]:
    return [name.removesuffix(_ENDING) for name in archive.namelist()]


def _member(file: Path, archive: zipfile.ZipFile, part: zipfile.ZipInfo) -> np.ndarray:
    with archive.open(part) as stream:
        return _array(file, part.filename.removesuffix(_ENDING), stream, part.file_size)


def _array(file: Path, name: str, stream: IO[bytes], size: int) -> np.ndarray:
    """Return the array in a stream of ``size`` bytes, if its header claims no more: memory is taken by what it says."""
    reader = {(1, 0): _NPY.read_array_header_1_0, (2, 0): _NPY.read_array_header_2_0}[_NPY.read_magic(stream)]
    shape, _, kind = reader(stream)
    if not kind.hasobject and math.prod(shape) * kind.itemsize > size - stream.tell():
        found = f"no array of the shape {shortened(list(shape))} that its header claims in {size} bytes"
        raise InputError(file, name, found, "a whole array")
    stream.seek(0)
    out: np.ndarray = _NPY.read_array(stream, allow_pickle=False)
    return out
