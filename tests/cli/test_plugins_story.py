"""Packages with parts of their own, installed and used at the command line as their authors' users would."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from bough.sim.base import plugins

PAGE = Path(__file__).parents[2] / "docs" / "plugins.md"


def install(folder: Path, name: str, entries: dict[str, str], files: dict[str, str]) -> None:
    """Lay a package into a folder as pip does: modules beside a dist-info with metadata and entry points."""
    info = folder / f"{name}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {name}\nVersion: 1.0\n")
    groups = [f"[{group}]\n{lines}\n" for group, lines in entries.items()]
    (info / "entry_points.txt").write_text("".join(groups))
    for file, text in files.items():
        (folder / file).write_text(text)


def of_the_page() -> tuple[dict[str, str], dict[str, str]]:
    """Return the entry points by group and the modules that the page shows, without what follows a module's end."""
    text = PAGE.read_text()
    groups = re.findall(r"\[project\.entry-points\.(\w+)\]\n((?:\w+ = .+\n)+)", text)
    modules = re.findall(r"```python\n# (\w+\.py)\n(.*?)```", text, re.DOTALL)
    return {g: lines.replace('"', "") for g, lines in groups}, {f: t.split("# it draws")[0] for f, t in modules}


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    """Folder into which the page's package is installed, and a package of which each part is broken in its own way."""
    folder = tmp_path_factory.mktemp("site")
    entries, modules = of_the_page()
    assert set(entries) == {"bough_tasks", "bough_arms", "bough_probes", "bough_samplers"} and len(modules) == 4
    install(folder, "someones-parts", entries, modules)
    install(
        folder, "broken-parts",
        {"bough_tasks": "gone = no_such_module:x\nmisnamed = someones_task:calm",
         "bough_arms": "bent = broken:bent", "bough_probes": "wild = broken:wild",
         "bough_samplers": "number = broken:number\nstill = broken:still\nstops = broken:stops"},
        {"broken.py": "number = 3\n\ndef bent():\n    raise ValueError('no\\nsuch arm')\n\n"
                      "from bough.learn.samplers.registry import SamplerKind\nstill = SamplerKind('idle', dict, 0)\n\n"
                      "class Stops:\n    def __init__(self, particles, **_):\n        self.particles = particles\n\n"
                      "    def step(self, density):\n        return 1 / 0\n\n"
                      "stops = SamplerKind('stops', Stops, 24)\n\n"
                      "from bough.learn.replay.probes import ArmProbe, Push\n"
                      "wild = ArmProbe('wild', (Push(0, 1.0, 1.0, lambda t: 7.0 * t),))\n"},
    )  # fmt: skip
    return folder


@pytest.fixture
def installed(site, monkeypatch):
    """Let commands find what is installed in `site`."""
    monkeypatch.setenv("PYTHONPATH", str(site), prepend=os.pathsep)


@pytest.fixture
def here(site, monkeypatch):
    """Let commands in the test's own process find what is installed in `site`."""
    monkeypatch.syspath_prepend(site)
    plugins._accepted.cache_clear()
    yield
    plugins._accepted.cache_clear()


def lines(text: str) -> str:
    """Return a help's text without its frame, in one line."""
    return " ".join(text.replace("│", " ").split())


def test_names_are_told(bough, installed, tmp_path, monkeypatch):
    """List the parts of packages, say which are broken and why, refuse bough's own names; the helps list them too."""
    install(tmp_path, "clash", {"bough_tasks": "powerline = broken:x", "bough_samplers": "nnsvgd = broken:number",
                                "bough_effects": "bent = no_law\nbye = law_bye\nempty = law_empty"},
            {"law_bye.py": "raise SystemExit(3)", "law_empty.py": "x = 1"})  # fmt: skip
    with monkeypatch.context() as patch:
        patch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
        done = bough("info")
    assert done.code == 0, done.err
    for words in (r"task +calm \(someones-parts 1.0\)", r"arm +slow_jaco \(someones-parts 1.0\)",
                  r"probe +twist \(someones-parts 1.0\)", r"sampler +mala \(someones-parts 1.0\)",
                  r"task +gone: BROKEN: broken-parts 1.0: task gone: found ModuleNotFoundError: No module named",
                  r"task +misnamed: BROKEN: .*names: found calm; allowed: names with misnamed",
                  r"effect +bent: BROKEN: clash 1.0: effect bent: found ModuleNotFoundError: No module named 'no_law'",
                  r"arm +bent: BROKEN: .*found ValueError: no such arm;",
                  r"probe +wild: BROKEN: .*course: found .*-1 to 1",
                  r"sampler +number: BROKEN: .*found TypeError: .*SamplerKind",
                  r"sampler +still: BROKEN: broken-parts 1.0: sampler still: sampler: updates: found 0; allowed: 10",
                  r"effect +bye: BROKEN: clash 1.0: effect bye: found SystemExit: 3",
                  r"effect +empty: BROKEN: clash 1.0: effect empty: .*a module that registers no effect"):  # fmt: skip
        assert re.search(rf"^{words}", done.out, re.MULTILINE), (words, done.out)
    for name, group in (("powerline", "tasks"), ("nnsvgd", "samplers")):
        told = f"bough: warning: clash 1.0: {name} of bough_{group} is refused: bough has one of that name"
        assert done.err.splitlines().count(told) == 1, done.err
    shown = lines(bough("train", "--help").out)
    assert "reach, calm of someones-parts 1.0" in shown and "slow_jaco of someones-parts 1.0" in shown
    assert "emcee, mala of someones-parts 1.0" in lines(bough("identify", "--help").out)


TINY = ("--preset", "cpu", "--device", "cpu", "--num-envs", 8, "--iterations", 2)


def test_a_package_s_task_and_arm(bough, installed):
    """Train and test a package's task with a package's arm, which the run keeps."""
    done = bough("train", "calm", *TINY, "--set", "arm=slow_jaco", "--out", "run")
    assert done.code == 0, done.err
    assert json.loads(Path("run/config.json").read_text())["task"]["settings"]["arm"] == "slow_jaco"
    done = bough("evaluate", "run", "--sets", 1, "--worlds", 4, "--device", "cpu", "--json")
    assert done.code == 0 and "Test SR %" in json.loads(done.out)["rows"][0], done.err


def test_what_is_not_there_is_refused(inside, here, brief):
    """Say in one line which package is broken, or what names there are; write nothing."""
    inside("train", "gone", *TINY, "--out", "x").refused("broken-parts 1.0: task gone", "no_such_module")
    train = ("train", "calm", *TINY, "--out", "x", "--set")
    inside(*train, "arm=bent").refused("broken-parts 1.0: arm bent", "no such arm")
    inside(*train, "arm=ur5").refused("task: arm: found ur5", "jaco2_spherical", "slow_jaco")
    inside("play", "zero", "--task", "calmer", "--out", "x").refused("--task", "calmer", "calm")
    inside("identify", brief, "--method", "number", "--out", "x").refused("broken-parts 1.0: sampler number", "int")
    stops = ("identify", brief, "--method", "stops", "--particles", 16)
    inside(*stops, "--out", "x").refused("broken-parts 1.0: sampler stops", "ZeroDivisionError: division by zero")
    inside("identify", brief, "--method", "nuts", "--out", "x").refused("--method", "nuts", "emcee, mala")
    assert not Path("x").exists()


def test_a_package_s_sampler(bough, inside, installed, brief):
    """Learn a case's springs with a package's sampler, whose title the report tells, near bough's own."""
    chains = ("--method", "mala", "--particles", 16, "--iterations", 400, "--out", "out")
    done = bough("identify", brief, *chains, "--json")
    assert done.code in (0, 3), done.err
    assert "Metropolis-adjusted Langevin" in Path("out/report.html").read_text()
    drawn = json.loads(done.out)["parameters"]
    inside("identify", brief, "--particles", 32, "--out", "svgd")
    for name, other in json.loads(Path("svgd/report.json").read_text())["parameters"].items():
        assert drawn[name]["low"] < other["median"] < drawn[name]["high"], name


def test_import_of_bough_looks_for_no_package(installed):
    """Import bough, and know names of parts, without importing a package or Warp."""
    code = (
        "import sys, bough; from bough.sim.arms.registry import ARMS;"
        "from bough.learn.samplers.registry import SAMPLERS;"
        "assert 'slow_jaco' in ARMS.names and 'mala' in SAMPLERS.names;"
        "assert not {'warp', 'torch', 'someones_arm', 'someones_sampler'} & set(sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_package_s_probe(bough, installed, tmp_path, monkeypatch):
    """Recommend a package's probe where it tells more than bough's own, as thirty times the force does."""
    probe = "strong = ArmProbe('push with thirty times the force', (Push(0, 30.0, 1.0, lambda t: 0.0 * t + 1.0),))\n"
    install(tmp_path / "site", "strong", {"bough_probes": "strong = strong:strong"},
            {"strong.py": f"from bough.learn.replay.probes import ArmProbe, Push\n{probe}"})  # fmt: skip
    monkeypatch.setenv("PYTHONPATH", str(tmp_path / "site"), prepend=os.pathsep)
    hide = ("--effects", "force_scale", "--size", 0.25, "--segments", 1, "--samples", 60, "--seed", 3)
    assert bough("hide", *hide, "--out", "case").code == 0
    done = bough("diagnose", "case", "--effects", "force_scale", "dry_friction", "--out", "out", "--json")
    left_out = "warning: broken-parts 1.0: probe wild: probe: course: found [1.05]; allowed: -1 to 1; it is left out"
    assert done.code == 0 and left_out in done.err, done.err
    verdict = json.loads(done.out)
    assert verdict == json.loads(Path("out/verdict.json").read_text())
    assert verdict["next_experiment"].startswith("push with thirty times the force: it would tell force_scale from")
