"""Bad input from the outside: one line with file and place, exit code 2, nothing written."""

import os
import re
import shutil
import subprocess
import sys
import zipfile

import numpy as np
import pytest

TREE = '<body name="a"><joint {joint}/><geom type="capsule" fromto="0 0 0 0 0 1" size=".02" {geom}/>{more}</body>'
CLOSED = '<equality><connect body1="a" body2="b" anchor="0 0 1"/></equality>'


def mjcf(joint="", geom="", more="", after=""):
    """MJCF text with one body and what spoils it."""
    return f"<mujoco><worldbody>{TREE.format(joint=joint, geom=geom, more=more)}</worldbody>{after}</mujoco>"


@pytest.fixture(autouse=True)
def nothing_written(tmp_path):
    """Assert that no output and no temporary folder is left."""
    yield
    assert not (tmp_path / "out").exists()
    assert not list(tmp_path.glob("**/.bough-*"))


def rewrite(path, change):
    """Change a table of comma-separated text: its rows, split, the header first."""
    rows = [line.split(",") for line in path.read_text().splitlines()]
    path.write_text("".join(",".join(row) + "\n" for row in change(rows)))


def without_column(rows):
    return [row[:4] + row[5:] for row in rows]


def with_nan(rows):
    rows[7][5] = "nan"
    return rows


def scaled(columns, factor):
    """Return what multiplies some columns of a table."""

    def change(rows):
        return rows[:1] + [[repr(float(v) * factor) if i in columns else v for i, v in enumerate(r)] for r in rows[1:]]

    return change


def with_gap(rows):
    return rows[:20] + rows[21:] + [["9.5", *rows[-1][1:]]]


@pytest.mark.parametrize(
    ("change", "words"),
    [(without_column, ("x_m",)), (with_nan, ("row 8", "y_m", "nan")), (with_gap, ("row 21", "t_s"))],
)
def test_spoilt_tables(bough, case, change, words):
    """Refuse a missing column, a NaN in a row and a clock with a gap; name the file and where in it."""
    rewrite(case / "traj_02.csv", change)
    bough("simulate", case, "--out", "out").refused("traj_02.csv", *words)


@pytest.mark.parametrize("command", ["identify", "diagnose"])
@pytest.mark.parametrize(
    ("columns", "factor", "words"),
    [
        (range(4, 10), 1e-300, ("in all", "1e-15 or more")),
        (range(1, 4), 1e-300, ("column f", "in all", "1e-15 or more")),
        (range(7, 10), 1e30, ("column v", "up to 1e+15")),
        (range(4, 10), 1e30, ("twice the branch's length",)),
    ],
)
def test_numbers_beyond_single_precision(bough, case, tmp_path, command, columns, factor, words):
    """Refuse a branch that hardly moves or is hardly pulled, and one that moves beyond all bounds; leave nothing."""
    rewrite(case / "traj_02.csv", scaled(columns, factor))
    bough(command, case, "--out", "out").refused("traj_02.csv", *words)
    assert not (tmp_path / ".out.unfinished").exists()


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (("forest", "--out", "out", "--posterior", "vast.npz"), "vast.npz"),
        (("forest", "--out", "out", "--posterior", "pipe.npz"), "pipe.npz"),
        (("identify", "case", "--out", "out", "--prior", "vast.npz"), "vast.npz"),
        (("identify", "case", "--out", "out", "--prior", "pipe.npz"), "pipe.npz"),
        (("replay", "vast.npz"), "vast.npz"),
        (("view", "vast.npz", "--case", "case", "--export", "page.html"), "vast.npz"),
        (("view", "pipe.npz", "--export", "page.html"), "pipe.npz"),
    ],
)
def test_archives_that_claim_terabytes_or_never_end(bough, case, tmp_path, command, name):
    """Refuse arrays that are not there as large as they say, and a pipe, without memory or patience for them."""
    os.mkfifo(tmp_path / "pipe.npz")
    with zipfile.ZipFile(tmp_path / "vast.npz", "w") as archive:
        for key in ("names", "units", "particles"):
            with archive.open(f"{key}.npy", "w") as file:
                claim = {"descr": "<f8", "fortran_order": False, "shape": (2 * 10**12,)}
                np.lib.format.write_array_header_1_0(file, claim)
    bough(*command).refused(name)
    assert not (tmp_path / "page.html").exists()


@pytest.mark.parametrize(
    ("command", "key", "value"),
    [("identify", "length_m", "520"), ("simulate", "length_m", "0"), ("simulate", "sample_rate_hz", "-25")],
)
def test_impossible_quantities(bough, case, command, key, value):
    """Refuse a length that must be in millimetres, a segment without length and a negative rate; name the key."""
    meta = case / "meta.yaml"
    lines = meta.read_text().splitlines()
    i = next(i for i, line in enumerate(lines) if f"{key}:" in line)
    lines[i] = lines[i].split(f"{key}:")[0] + f"{key}: {value}"
    meta.write_text("\n".join(lines))
    bough(command, case, "--out", "out").refused("meta.yaml", f"line {i + 1}", key, value)


@pytest.mark.parametrize("command", ["simulate", "identify"])
def test_folders_that_are_no_case(bough, tmp_path, command):
    """Refuse an empty folder and one that does not exist."""
    (tmp_path / "nothing").mkdir()
    bough(command, "nothing", "--out", "out").refused("nothing", "empty folder")
    bough(command, "nowhere", "--out", "out").refused("nowhere", "no such f")


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (mjcf('range="-9 9"'), ("line 1", "a joint limit", "--ignore limits")),
        (mjcf(more='<body name="b"/>', after=CLOSED), ("closed loop",)),
        (mjcf(geom='mass="-1"'), ("mass", "-1")),
        (mjcf('type="screw"'), ("screw",)),
        (mjcf(geom='mass="1e300"'), ("link a", "mass", "1e+12")),
        (mjcf('stiffness="1e308"'), ("link a", "stiffness", "1e+12")),
        (mjcf(more='<body name="b" pos="1e308 0 0"><geom size=".1"/></body>'), ("link b", "position", "1e+12")),
        (mjcf(more='<geom size="1e30"/>'), ("link a", "1e+12")),
        ("<mujoco><worldbody>", ("line 1",)),
        ("<mujoco/>", ("no bodies",)),
    ],
)
def test_mechanisms_that_cannot_be(bough, tmp_path, text, words):
    """Refuse unsupported joints, closed loops, negative and vast numbers, broken XML; name the file and where in it."""
    (tmp_path / "tree.xml").write_text(text)
    bough("simulate", "tree.xml", "--out", "out").refused("tree.xml", *words)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("axiom: F(1)A\nproductions: ['A -> F(1)B']\n", ("column 10", "symbol B")),
        ("axiom: F(a)\nconstants: {a: b + 1, b: a}\n", ("circle",)),
        ("axiom: F(1)\nproductions: ['F(l) > F(l)']\n", ("F(l) > F(l)",)),
        ("axiom: F(1)\nangel_deg: 3\n", ("angel_deg",)),
    ],
)
def test_faulty_lsystems(bough, tmp_path, text, words):
    """Refuse unknown symbols, constants that define each other and what is no production; name the file."""
    (tmp_path / "bush.yaml").write_text(text)
    done = bough("forest", "--lsystem", "bush.yaml", "--count", 1, "--out", "out")
    done.refused("bush.yaml", *words)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--qpos", "short.txt"), ("short.txt", "line 2", "1 numbers")),
        (("--qpos", "word.txt"), ("word.txt", "line 1", "ten")),
        (("--qpos", "nan.npy"), ("nan.npy", "row 0", "nan")),
        (("--qpos", "zero.txt"), ("zero.txt", "[0. 0. 0. 0.]")),
        (("--qpos", "rows.txt", "--worlds", "3"), ("rows.txt", "2 rows")),
        (("--dt", "0"), ("--dt",)),
        (("--seconds", "nan"), ("--seconds",)),
        (("--device", "tpu"), ("--device", "tpu", "cpu")),
        (("--worlds", "100000000"), ("100000000 worlds", "GiB")),
        (("--seconds", "1e308"), ("--seconds", "1e+308 s", "finite number of steps")),
        (("--seconds", "1e12"), ("--seconds", "GiB")),
        (("--substeps", "1000000000000"), ("--substeps", "1 to 10000")),
        (("--qpos", "vast.npy"), ("vast.npy", "no array")),
        (("--qpos", "/dev/zero"), ("/dev/zero", "a device or a pipe")),
    ],
)
def test_starts_and_options_that_do_not_fit(bough, tmp_path, options, words):
    """Refuse starts of the wrong shape and options out of range; name the file and row, or the option."""
    (tmp_path / "ball.xml").write_text(mjcf('type="ball"'))
    (tmp_path / "short.txt").write_text("1 0 0 0\n1\n")
    (tmp_path / "word.txt").write_text("1 0 0 ten")
    (tmp_path / "zero.txt").write_text("0 0 0 0")
    (tmp_path / "rows.txt").write_text("1 0 0 0\n1 0 0 0\n")
    np.save(tmp_path / "nan.npy", [1.0, 0.0, 0.0, np.nan])
    with (tmp_path / "vast.npy").open("wb") as file:  # a header that claims 8 TB
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (10**12, 1)})
    done = bough("simulate", "ball.xml", *options, "--out", "out")
    # the geom's contacts are left out with a warning before a start is looked at
    kept = "".join(line + "\n" for line in done.err.splitlines() if "warning" not in line)
    type(done)(done.code, done.out, kept).refused(*words)


@pytest.mark.parametrize("name", ["/dev/zero", "pipe.xml"])
def test_mechanisms_that_never_end(bough, tmp_path, name):
    """Refuse a device and a pipe in a file's place instead of reading for ever."""
    os.mkfifo(tmp_path / "pipe.xml")
    (tmp_path / "link.xml").symlink_to(name)
    bough("simulate", "link.xml", "--out", "out").refused("link.xml", "a device or a pipe")


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (("hide", "--seed", -1), ("--seed", "-1")),
        (("hide", "--seed", 2**64), ("--seed", "0 to 9223372036854775807")),
        (("forest", "--seed", 2**64), ("--seed",)),
        (("exam", "--cases", 1, "--seed", -1), ("--seed",)),
        (("exam", "--cases", 10**9), ("--cases", "1000000000", "1 to 10000")),
        (("exam", "--cases", 10**9, "--joints"), ("--cases", "1000000000", "1 to 10000")),
        (("exam", "--cases", 0), ("--cases", "1 to 10000")),
        (("diagnose", "nowhere", "--effects", ","), ("--effects", "''")),
    ],
)
def test_seeds_and_names_that_are_none(bough, command, words):
    """Refuse seeds that some generator does not take, and an empty name in a list."""
    bough(*command, "--out", "out").refused(*words)


#: A command that writes a folder, with arguments that are quick to get right.
WRITE = (
    "forest", "simulate case", "identify case", "hide --effects force_scale", "diagnose case", "exam --cases 1",
    "train reach", "play zero --task reach", "export case", "reproduce chapter3", "reproduce chapter4",
    "reproduce chapter5", "touch record", "touch train case", "touch evaluate case", "touch fit case",
    "probe --branch branch.yaml", "robot serve", "run case --robot http://127.0.0.1:1", "import-case bag",
    "import-arm bag", "new-case table.csv",
)  # fmt: skip


@pytest.mark.parametrize("out", ["taken", "taken/below"])
def test_places_that_are_files_are_refused_before_anything_is_made(inside, tmp_path, out):
    """Say that the folder cannot be made, before a case is."""
    (tmp_path / "taken").write_text("mine")
    (tmp_path / "case").mkdir()
    for command in WRITE:
        inside(*command.split(), "--out", out).refused("taken", "a folder, or a path where one can be made")


def test_places_that_are_files_are_refused_before_torch_is_imported(tmp_path):
    """Refuse in a process in which torch cannot be imported."""
    (tmp_path / "taken").write_text("mine")
    (tmp_path / "case").mkdir()
    code = (
        "import sys\n"
        "class Fence:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        assert name != 'torch'\n"
        "sys.meta_path.insert(0, Fence())\n"
        "from bough.cli.main import main\n"
        f"sys.exit(any(main([*command.split(), '--out', 'taken/below']) != 2 for command in {WRITE!r}))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    # lines of progress come by the clock
    lines = [line for line in done.stderr.splitlines() if not re.match(r"bough: \d+ s: ", line)]
    assert len(lines) == len(WRITE) and all("a path below the file" in line for line in lines)


def test_sizes_beyond_memory(bough):
    """Say what a billion trees or worlds would take instead of taking it."""
    none = ("--picture-width", 0, "--out", "out")
    bough("forest", "--count", 10**9, *none).refused("--count", "1000000000 trees", "GiB")
    bough("train", "powerline", "--num-envs", 10**9, "--device", "cpu", "--out", "out").refused(
        "1000000000 worlds", "GiB"
    )


def as_nobody_special():
    """Return what to put before a command so that file permissions hold for it too: root bypasses them."""
    if os.geteuid() != 0:
        return ()
    if shutil.which("setpriv") is None:
        pytest.skip("root without setpriv: permissions cannot be made to hold")
    return ("setpriv", "--bounding-set=-dac_override,-dac_read_search")


def test_folders_without_permission(bough, case, tmp_path):
    """Refuse to write where that is not allowed and to read what is closed."""
    before = as_nobody_special()
    locked, closed = tmp_path / "locked", tmp_path / "closed"
    locked.mkdir()
    locked.chmod(0o555)
    case.rename(closed)
    closed.chmod(0o000)
    try:
        done = bough("forest", "--count", 1, "--picture-width", 0, "--out", "locked/out", before=before)
        done.refused("locked/out", "permission")
        done = bough("identify", "closed", "--out", "out", before=before)
        done.refused("closed", "permission")
        assert list(locked.iterdir()) == []
    finally:
        closed.chmod(0o755)


def test_an_output_that_is_a_file(bough, tmp_path):
    """Refuse to make a folder where a file is."""
    (tmp_path / "taken").write_text("mine")
    bough("forest", "--count", 1, "--out", "taken").refused("taken", "a file")
    assert (tmp_path / "taken").read_text() == "mine"
