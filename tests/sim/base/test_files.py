"""Files that are no files, names that are none, and what killed commands leave."""

import os
import subprocess
import sys

import pytest
from bough.sim.base.errors import InputError
from bough.sim.base.files import check_output, output_folder, read_bytes, read_text
from bough.sim.base.host import check_memory, memory_bytes
from bough.sim.base.json_file import object_of, read_object


def test_what_never_ends_is_not_read(tmp_path):
    """Refuse a device and a pipe, which a read would wait for or never finish."""
    os.mkfifo(tmp_path / "pipe")
    for path in ("/dev/zero", tmp_path / "pipe"):
        with pytest.raises(InputError, match="a device or a pipe"):
            read_text(path)


def test_large_files_are_refused_before_they_are_read(tmp_path):
    """Look at the size first: a sparse file of a terabyte costs nothing to refuse, one byte below the limit is read."""
    with (tmp_path / "large").open("wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(InputError, match="found 1048576 MiB; allowed: 1024 MiB at most"):
        read_text(tmp_path / "large")
    (tmp_path / "small").write_text("abc")
    assert read_text(tmp_path / "small", limit=3) == "abc"
    with pytest.raises(InputError, match="0 MiB at most"):
        read_text(tmp_path / "small", limit=2)


@pytest.mark.parametrize("name", ["a\0b", "x" * 5000, "circle"])
def test_names_that_are_none(tmp_path, monkeypatch, name):
    """Say in one short line what is wrong with a name that no file can have, and with links in a circle."""
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    with pytest.raises(InputError) as error:
        read_text(name)
    assert "\n" not in str(error.value) and "\0" not in str(error.value) and len(str(error.value)) < 300


def test_output_below_a_file_is_refused(tmp_path):
    """Name the file in whose place a folder would have to be."""
    (tmp_path / "file").write_text("")
    for out, words in (("file", "found a file"), ("file/run/deep", "a path below the file")):
        with pytest.raises(InputError, match=words):
            check_output(tmp_path / out)


def test_what_a_killed_command_left_is_cleared(tmp_path):
    """Remove the work folder of a process that no longer lives; leave those of living ones and other folders alone."""
    dead = subprocess.run([sys.executable, "-c", "import os; print(os.getpid())"], capture_output=True, text=True)
    left, living = tmp_path / f".bough-{dead.stdout.strip()}-abc", tmp_path / f".bough-{os.getpid()}-abc"
    other = tmp_path / ".bough-notes"
    for folder in (left, living, other):
        folder.mkdir()
        (folder / "part").write_text("x")
    with output_folder(tmp_path / "out") as work:
        assert work.parent == tmp_path and not left.exists()
    assert living.exists() and other.exists() and (tmp_path / "out").is_dir()


def test_memory_is_compared_before_it_is_taken():
    """Say what would be needed and what is there; let pass what fits."""
    check_memory("--count", "one", memory_bytes())
    for needed in (2.0 * memory_bytes(), float("inf"), float("nan")):
        with pytest.raises(InputError, match=r"--count: found many, about .* GiB; allowed: what fits into"):
            check_memory("--count", "many", needed)


@pytest.mark.parametrize("read", [read_bytes, read_text, lambda path: object_of(read_text(path), path, "a file")])
@pytest.mark.parametrize(
    ("make", "words"),
    [
        (os.mkfifo, "a device or a pipe"),
        (lambda p: p.symlink_to("/dev/zero"), "a device or a pipe"),
        (lambda p: p.mkdir(), "a folder"),
        (lambda p: None, "no such file"),
        (lambda p: p.symlink_to(p), "symbolic links"),
    ],
)
def test_all_readers_refuse_what_is_no_file(tmp_path, read, make, words):
    """Say in one line what is in a file's place."""
    make(tmp_path / "odd")
    with pytest.raises(InputError, match=f"odd: found .*{words}") as error:
        read(tmp_path / "odd")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("data", [b"a\r\nb\rc\n", "a\nb\nc\n".encode("utf-16")])
def test_text_is_read_whatever_ends_its_lines(tmp_path, data):
    """Give one end of a line for all of them, in either encoding."""
    (tmp_path / "text").write_bytes(data)
    assert read_text(tmp_path / "text").splitlines() == ["a", "b", "c"] and "\r" not in read_text(tmp_path / "text")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", "line 1: found text that is not JSON"),
        ('{\n"a": 1,}', "line 2: found text that is not JSON"),
        ("[" * 100_000, "found JSON that is nested too deeply"),
        ("9" * 5000, "found a number of too many digits"),
        ("[]", "found JSON without fields"),
        ("null", "found JSON without fields"),
    ],
)
def test_json_that_is_none(tmp_path, text, words):
    """Name the line of a file; of a line that stands for itself name its number."""
    (tmp_path / "x.json").write_text(text)
    with pytest.raises(InputError, match=f"x.json: {words}; allowed: a record"):
        read_object(tmp_path / "x.json", "a record")
    with pytest.raises(InputError, match=f"x.jsonl: line 7: {words.partition(': ')[2] or words}; allowed: a record"):
        object_of(text, tmp_path / "x.jsonl", "a record", 7)
