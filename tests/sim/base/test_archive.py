"""Archives of arrays that are none: one line, and no memory for what a header only claims."""

import io
import os
import re
import warnings
import zipfile

import numpy as np
import pytest
from bough.learn.cameras.folder import read_depth
from bough.learn.policies.compare import read_episodes
from bough.learn.priors.earlier import read_earlier
from bough.learn.touch.model import read_model
from bough.learn.view.replayed import drawn_from
from bough.sim.base.archive import array_names, read_array, read_arrays
from bough.sim.base.errors import InputError
from bough.sim.engine.last_states import Fault
from bough.sim.view.recorded import read as read_recorded
from bough.sim.wood.posterior import SpringPosterior

READERS = {
    "any": lambda path: read_arrays(path, "an archive"),
    "forest's posterior": SpringPosterior.from_file,
    "prior": lambda path: read_earlier(path, []),
    "recorded": read_recorded,
    "drawn": lambda path: drawn_from(path, 2, 0),
    "episodes": read_episodes,
    "last states": Fault.read,
    "touch model": read_model,
    "depth": read_depth,
}
NAMES = ("names", "units", "particles", "depth", "format")


def header(shape, kind="<f8", version=1):
    """Return the head of an .npy file, which claims an array of a shape."""
    out = io.BytesIO()
    write = {1: np.lib.format.write_array_header_1_0, 2: np.lib.format.write_array_header_2_0}[version]
    write(out, {"descr": kind, "fortran_order": False, "shape": shape})
    return out.getvalue()


def member(array):
    """Return an array as an .npy file."""
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue()


def packed(path, data, compression=zipfile.ZIP_DEFLATED):
    """Write an archive in which every name that any reader looks for first holds some bytes."""
    with zipfile.ZipFile(path, "w", compression) as archive:
        for name in NAMES:
            archive.writestr(f"{name}.npy", data)


def places(data, mark):
    """Return where a mark is in some bytes."""
    return [found.start() for found in re.finditer(re.escape(mark), bytes(data))]


def lying(path):
    """Let the archive's own directory claim four gigabytes for every array."""
    packed(path, header((2 * 10**12,)))
    data = bytearray(path.read_bytes())
    for at in places(data, b"PK\x01\x02"):
        data[at + 24 : at + 28] = (2**32 - 2).to_bytes(4, "little")
    path.write_bytes(data)


def cut(path):
    """Keep the first half of an archive."""
    packed(path, member(np.zeros(1000)))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def turned(path):
    """Turn a byte of every array over."""
    packed(path, member(np.arange(1000.0)))
    data = bytearray(path.read_bytes())
    for at in places(data, b"PK\x03\x04"):
        data[at + 200] ^= 255
    path.write_bytes(data)


def encrypted(path):
    """Say of every array that it needs a password."""
    packed(path, member(np.zeros(3)))
    data = bytearray(path.read_bytes())
    for mark, flags in ((b"PK\x01\x02", 8), (b"PK\x03\x04", 6)):
        for at in places(data, mark):
            data[at + flags] |= 1
    path.write_bytes(data)


def sparse(path):
    """Make a file of 128 GiB that takes no room."""
    with path.open("wb") as file:
        file.truncate(1 << 37)


SPOILT = {
    "terabytes": (lambda p: packed(p, header((2 * 10**12,))), "no array of the shape [2000000000000]"),
    "terabytes in two": (
        lambda p: packed(p, header((10**6, 2 * 10**6), version=2)),
        "array of the shape [1000000, ",
    ),
    "no end": (lambda p: packed(p, header((10**30,))), "no array of the shape"),
    "less than none": (lambda p: packed(p, header((-1, -1)) + bytes(8)), "no whole .npz archive"),
    "one row short": (lambda p: packed(p, member(np.zeros(9))[:-8]), "no array of the shape [9]"),
    "brackets": (lambda p: packed(p, header(()).replace(b"()", b"(" * 3000)), "no whole .npz archive"),
    "a lying directory": (lying, "no array of the shape [2000000000000]"),
    "cut": (cut, "no whole .npz archive"),
    "turned": (turned, "no whole .npz archive"),
    "encrypted": (encrypted, "no whole .npz archive"),
    "objects": (lambda p: packed(p, member(np.array([{}, 1], dtype=object))), "no whole .npz archive"),
    "text": (lambda p: packed(p, b"no array"), "no whole .npz archive"),
    "no archive": (lambda p: p.write_text("no archive"), "no whole .npz archive"),
    "nothing": (lambda p: p.write_bytes(b""), "no whole .npz archive"),
    "one array": (lambda p: p.write_bytes(member(np.zeros(3))), "a single array"),
    "a pipe": (os.mkfifo, "a device or a pipe"),
    "a device": (lambda p: p.symlink_to("/dev/zero"), "a device or a pipe"),
    "a folder": (lambda p: p.mkdir(), "a folder"),
    "vast": (sparse, "MiB at most"),
    "absent": (lambda p: None, "no such file"),
}


@pytest.mark.parametrize("reader", READERS)
@pytest.mark.parametrize("kind", SPOILT)
def test_archives_that_are_none(tmp_path, kind, reader):
    """Name the file in one line, whoever reads it."""
    spoil, words = SPOILT[kind]
    path = tmp_path / "spoilt.npz"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a name twice
        spoil(path)
    with pytest.raises(InputError) as error:
        READERS[reader](path)
    said = str(error.value)
    assert str(path) in said and words in said and "\n" not in said and len(said) < 600


@pytest.mark.parametrize("kind", ["terabytes", "vast", "a pipe", "a device", "absent", "cut"])
def test_the_names_alone(tmp_path, kind):
    """Tell the names where the directory is whole, whatever the arrays claim; else one line."""
    path = tmp_path / "spoilt.npz"
    SPOILT[kind][0](path)
    if kind == "terabytes":
        assert array_names(path, "an archive") == list(NAMES)
        return
    with pytest.raises(InputError):
        array_names(path, "an archive")


@pytest.mark.parametrize(
    "data",
    [b"", b"no array", header((2 * 10**12,)), member(np.zeros(9))[:-8], member(np.array([{}], dtype=object))],
    ids=["nothing", "text", "terabytes", "one row short", "objects"],
)
def test_single_arrays_that_are_none(tmp_path, data):
    """Refuse them as numbers and as depths."""
    path = tmp_path / "spoilt.npy"
    path.write_bytes(data)
    for reader in (lambda p: read_array(p, "an array"), read_depth):
        with pytest.raises(InputError, match=r"spoilt\.npy: found no array"):
            reader(path)


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_come_back_as_they_were(tmp_path, save):
    """Read every kind that bough writes, all or by name, Fortran order, no numbers and no dimension among them."""
    arrays = {"a": np.arange(6.0).reshape(2, 3).T, "b": np.array(["x", "yz"]), "c": np.array(3), "d": np.zeros((0, 4))}
    save(tmp_path / "good.npz", **arrays)
    found = read_arrays(tmp_path / "good.npz", "an archive")
    assert list(found) == list(arrays)
    for name, array in arrays.items():
        assert found[name].dtype == array.dtype and np.array_equal(found[name], array)
    assert list(read_arrays(tmp_path / "good.npz", "an archive", ("b",))) == ["b"]
    with pytest.raises(InputError, match="e: found only a, b, c, d; allowed: an array e"):
        read_arrays(tmp_path / "good.npz", "an archive", ("e",))
    np.save(tmp_path / "good.npy", arrays["a"])
    assert np.array_equal(read_array(tmp_path / "good.npy", "an array"), arrays["a"])


def test_arrays_larger_than_memory_are_refused_before_they_are_read(tmp_path, monkeypatch):
    """Look at what all of them take; a gibibyte of zeros is a megabyte in an archive."""
    packed(tmp_path / "zeros.npz", member(np.zeros(1 << 17)))
    monkeypatch.setattr("bough.sim.base.host.memory_bytes", lambda: 1 << 20)
    with pytest.raises(InputError, match=r"zeros\.npz: found 5 arrays, about .* GiB; allowed: what fits into"):
        read_arrays(tmp_path / "zeros.npz", "an archive")
