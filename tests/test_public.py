"""What ``import bough`` offers: lazily, completely, and as the page on the API lists it."""

import inspect
import re
import subprocess
import sys
from pathlib import Path

import bough
import pytest

ROOT = Path(__file__).resolve().parents[1]
NAMES = sorted(set(bough.__all__) - {"__version__"})


def test_import_loads_nothing_heavy():
    """Load neither Warp, torch, NumPy nor MuJoCo with the package, nor with the list of its names."""
    code = (
        "import sys, bough; dir(bough); bough.__version__\n"
        "heavy = {'warp', 'torch', 'numpy', 'mujoco', 'scipy', 'matplotlib', 'newton', 'pydantic'} & set(sys.modules)\n"
        "assert not heavy, heavy\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, stdin=subprocess.DEVNULL)


def test_input_errors_and_cases_need_no_warp():
    """Read and refuse a case without Warp or torch: what is quick to say is said quickly."""
    code = (
        "import sys, bough\n"
        "try:\n    bough.load_case('nowhere')\nexcept bough.InputError as error:\n    assert 'nowhere' in str(error)\n"
        "assert not {'warp', 'torch'} & set(sys.modules)\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, stdin=subprocess.DEVNULL)


@pytest.mark.parametrize("name", NAMES)
def test_name_is_there_and_documented(name):
    """Find every public name, with a docstring, the same object each time."""
    assert getattr(bough, name).__doc__
    assert getattr(bough, name) is getattr(bough, name)


@pytest.mark.parametrize("name", NAMES)
def test_page_says_what_every_parameter_is(name):
    """Describe each parameter and each attribute by itself: two in one entry would be a name and a type on the page."""
    thing = getattr(bough, name)
    text = f"{inspect.getdoc(thing)}\n{inspect.getdoc(thing.__init__) if inspect.isclass(thing) else ''}"
    entries = re.findall(r"^ {4}(\w[\w, ]*):", text, re.MULTILINE)
    assert not [entry for entry in entries if "," in entry]
    assert set(inspect.signature(thing).parameters) <= set(entries)
    assert inspect.isclass(thing) or "Returns:" in text


def test_other_names_are_missing():
    """Raise what Python raises for a name that is not there."""
    with pytest.raises(AttributeError, match="no attribute 'grow_forrest'"):
        _ = bough.grow_forrest


def test_page_lists_exactly_the_public_names():
    """List each public name on the API page, and no other."""
    listed = re.findall(r"^::: bough\.(\S+)$", (ROOT / "docs" / "api.md").read_text(), re.MULTILINE)
    assert sorted(listed) == NAMES


@pytest.mark.parametrize(
    ("before", "after", "said"), [("", "", False), ("", "wp.config.log_level = wp.LOG_INFO", True),
                                  ("wp.config.log_level = wp.LOG_DEBUG", "", True)],
)  # fmt: skip
def test_a_library_adds_no_lines_to_its_users(tmp_path, before, after, said):
    """Step a tree in a script: what it prints is its own, unless it asks Warp to talk."""
    script = f"import warp as wp\n{before}\nimport bough\nmodel = bough.Model\n{after}\n"
    script += "simulator = bough.Simulator(model(bough.grow_forest('Ta', count=1, order=0, seed=0)))\n"
    script += "simulator.step()\nprint('mine')\n"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, cwd=tmp_path, check=True)
    lines = done.stdout.splitlines()
    assert "mine" in lines
    assert (lines != ["mine"]) == said
    assert "Module" not in done.stderr
