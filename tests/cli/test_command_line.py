"""What all commands share: help, version, unknown options, a quick start, and ``bough info``."""

import json
import subprocess
import sys
from pathlib import Path
from typing import get_args, get_type_hints

import bough as package
import pytest
from bough.cli.main import Command
from oracles import json_page


def _leaves(commands, before=""):
    """Return the classes that do the work, by name; a command whose only field is a choice of commands holds others."""
    leaves = {}
    for command, told in map(get_args, get_args(commands)):
        fields, name = list(get_type_hints(command, include_extras=True).values()), f"{before}{told.name}"
        inner = len(fields) == 1 and len(get_args(fields[0])) > 1
        leaves |= _leaves(fields[0], f"{name} ") if inner else {name: command}
    return leaves


NAMED = _leaves(Command)
WORKING = list(NAMED.values())
#: Commands that run until they are stopped have no result.
SERVING = ("View", "Serve")


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
    """Import nothing heavy before a command runs, so that help and what is refused at once come at once."""
    heavy = ("warp", "torch", "newton", "mujoco", "matplotlib", "trimesh", "scipy", "pandas", "rsl_rl")
    code = f"import sys, bough.cli.main; print([m for m in {heavy} if m in sys.modules])"
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


@pytest.mark.parametrize("command", WORKING, ids=lambda c: f"{c.__module__.split('.')[-1]}.{c.__name__}")
def test_every_help_tells_exit_codes_and_most_take_json(command):
    """Tell in the help what a program wants to know; what is served until Ctrl-C has no result."""
    told = command.__doc__.split("Attributes:")[0]
    assert "Exit code 0: " in " ".join(told.split())
    assert ("json" in command.__dataclass_fields__) == (command.__name__ not in SERVING)


def test_results_as_json(bough, inside):
    """Print nothing but the result, as JSON, on stdout; that of files is what the files hold."""

    def printed(*arguments, run=inside):
        done = run(*arguments, "--json")
        assert done.code == 0, done.err
        result = json.loads(done.out)
        json_page.check(arguments[0], result)
        return result

    facts = printed("info", run=bough)
    assert facts["bough"].startswith(package.__version__) and facts["self-check"].startswith("passed")
    assert isinstance(facts["parts"], list)
    trees = ("--count", 2, "--order", 1, "--format", "urdf", "--picture-width", 0)
    forest = printed("forest", *trees, "--out", "forest")
    assert forest == json.loads(Path("forest/forest.json").read_text()) and "json" not in forest["options"]
    sizes = ("--seconds", 0.05, "--worlds", 2)  # in a process of its own: Newton, which reads a URDF, starts Warp there
    moved = printed("simulate", "forest/tree_0000.urdf", *sizes, "--out", "moved", run=bough)
    assert (moved["worlds"], moved["frozen"], moved["steps"], moved["out"]) == (2, 0, 12, "moved")
    answer = printed("hide", "--segments", 1, "--samples", 40, "--out", "case")
    assert answer == json.loads(Path("case_answer.json").read_text())


def test_page_of_results_tells_every_command():
    """Have a table on the page for every command that prints JSON; a key that it does not tell is an error."""
    printing = {name for name, command in NAMED.items() if command.__name__ not in SERVING}
    assert set(json_page.tables()) == {"reproduce" if name.startswith("reproduce ") else name for name in printing}
    json_page.check("touch train", {"out": "x", "auc": 0.9, "threshold": 1})
    for wrong in ({"out": "x", "auc": 0.9}, {"out": "x", "auc": 0.9, "threshold": "1"},
                  {"out": "x", "auc": 0.9, "threshold": 1, "other": 2}):  # fmt: skip
        with pytest.raises(AssertionError, match=r"bough touch train"):
            json_page.check("touch train", wrong)


@pytest.mark.parametrize("shell", ["bash", "zsh"])
def test_shells_complete_commands(bough, shell):
    """Print a completion script that knows commands and options; bash runs it and completes."""
    done = bough("--tyro-print-completion", shell)
    assert done.code == 0 and all(word in done.out for word in ("simulate", "check-law", "--substeps"))
    if shell == "bash":
        Path("bough.bash").write_text(done.out)
        ask = (
            "source ./bough.bash; complete -p bough; COMP_WORDS=(bough simu); COMP_CWORD=1; COMP_LINE='bough simu';"
            "COMP_POINT=10; $(complete -p bough | sed 's/.*-F \\([^ ]*\\).*/\\1/'); echo ${COMPREPLY[@]}"
        )
        found = subprocess.run(["bash", "-c", ask], capture_output=True, text=True, check=False)
        assert found.stdout.split()[-1] == "simulate", found.stderr
