"""What all commands share: help, version, unknown options, a quick start, and ``bough info``."""

import subprocess
import sys

import bough as package


def test_help_names_every_command(bough):
    """List the commands, and every option of one of them."""
    help_ = bough("--help")
    assert help_.code == 0 and all(name in help_.out for name in ("info", "forest", "simulate", "identify"))
    options = bough("simulate", "--help")
    names = ("--seconds", "--dt", "--substeps", "--qpos", "--worlds", "--precision", "--device", "--out")
    assert options.code == 0 and all(name in options.out for name in names)


def test_version(bough):
    """Print the package's version."""
    assert bough("--version").out == f"bough {package.__version__}\n"


def test_unknown_options_are_refused(bough, tmp_path):
    """Exit with 2 and name the option; write nothing."""
    for arguments in (("forest", "--cuont", 3, "--out", "x"), ("grow",), ("simulate", "a.xml"), ("forest", "--out")):
        done = bough(*arguments)
        assert done.code == 2 and done.err
    assert list(tmp_path.iterdir()) == []


def test_the_start_is_quick():
    """Import nothing heavy before a command runs."""
    heavy = ("warp", "torch", "newton", "numpy", "mujoco", "matplotlib", "trimesh")
    code = f"import sys, bough.cli; print([m for m in {heavy} if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_info_tells_what_there_is(bough):
    """Print versions, devices, lanes, cores, the kernel cache, extras and a passed self-check."""
    done = bough("info")
    assert done.code == 0 and done.err == ""
    facts = {line[:14].strip(): line[14:] for line in done.out.splitlines()}
    assert facts["bough"].startswith(package.__version__)
    assert "cpu" in facts["devices"] and "cores" in facts["processor"] and "warp" in facts["kernel cache"]
    assert facts["lanes"].split()[0] in ("8", "16")
    assert "mujoco" in facts["packages"] and "taichi" in facts["extras"]
    assert facts["self-check"].startswith("passed")
