"""What holds for the benchmarks as a whole: declared, kept, and shown on the pages as they were measured."""

import ast
import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / "benchmarks"
RUN = FOLDER / "run.py"
sys.path.append(str(FOLDER))  # last: what is installed comes first
import history  # noqa: E402
import run  # noqa: E402
import tables  # noqa: E402
from bough.sim.base.errors import InputError  # noqa: E402
from declared import BENCHMARKS, Bound, named  # noqa: E402
from measuring import Figure, InvalidRunError, in_turn, judge, write_json  # noqa: E402

FILES = sorted((FOLDER / "history").glob("*.json"))


def command(*words: str) -> subprocess.CompletedProcess:
    """Run benchmarks/run.py."""
    return subprocess.run([sys.executable, str(RUN), *words], capture_output=True, text=True, stdin=subprocess.DEVNULL)


def functions(script: str) -> set[str]:
    """Return the names of a script's functions; it may need what is not installed here."""
    tree = ast.parse((FOLDER / f"{script}.py").read_text())
    return {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}


# ---- the declaration ---------------------------------------------------------------------------------------------


def test_every_script_is_declared():
    """Declare each script that runs as a program, and none that does not; `run.py` is what runs them.

    `menagerie.py` needs a collection that is not bough's.
    """
    programs = {
        str(p.relative_to(FOLDER).with_suffix(""))
        for p in FOLDER.rglob("*.py")
        if 'if __name__ == "__main__":' in p.read_text()
    }
    assert programs - {"run", "menagerie"} == {b.script for b in BENCHMARKS}
    assert len({b.name for b in BENCHMARKS}) == len(BENCHMARKS)


@pytest.mark.parametrize("benchmark", BENCHMARKS, ids=lambda b: b.name)
def test_declaration_is_whole(benchmark):
    """Name functions and options that the script has, and either bounds or the reason why there is none."""
    text = (FOLDER / f"{benchmark.script}.py").read_text()
    assert {"measured", "parser"} <= functions(benchmark.script)
    assert f'"{benchmark.name}"' in text, "the script does not say under which name it is declared"
    options = [a for a in (*benchmark.arguments, *benchmark.quick) if a.startswith("--")]
    assert all(f'"{o}"' in text or o in ("--quick", "--seed") for o in options)
    assert bool(benchmark.bounds) != bool(benchmark.unbound)
    assert all(b.least is not None or b.most is not None for b in benchmark.bounds)


# ---- bounds ------------------------------------------------------------------------------------------------------


def test_bounds_are_judged_where_they_apply():
    """Judge values and ratios, leave out bounds of other machines, and refuse one whose figure is missing."""
    figures = [Figure("a", "x", 2.0, ratio=5.0), Figure("a", "y", 0.5)]
    bounds = [Bound("a", "x", least=2.0), Bound("a", "x", "ratio", most=4.0), Bound("a", "z", least=1.0, lanes=16)]
    assert [v.met for v in judge(figures, bounds, lanes=8, cores=2)] == [True, False]
    assert judge(figures, [Bound("a", "z", least=1.0, cores=2)], lanes=8, cores=1) == []
    with pytest.raises(InvalidRunError, match="a, z"):
        judge(figures, bounds, lanes=16, cores=2)
    with pytest.raises(InvalidRunError, match="not finite"):
        judge([Figure("a", "x", float("nan"))], [], lanes=8, cores=2)


def scale_figures():
    """Return the figures of two sizes."""
    import scale

    row = {"worlds": 64, "links": 38.0, "build_s": 3.0, "process_gib": 0.5, "policy_steps_per_s": 1e5,
           "world_steps_per_s": 4e5, "sensing": 0.3, "sensing_of_step": 0.4, "lost": 0}  # fmt: skip
    return scale.figures([row, row | {"worlds": 256, "world_steps_per_s": 5e5}])


def identification_figures():
    """Return the figures of two cases."""
    import identification

    row = [1.0, 1.0, 0.4, 0.6, 0.7, 95.0, 80.0, 99.0, 2.0, 2.0, 5.0, 1.0, 5.0]
    assert len(row) == len(identification.HEAD)
    return identification.figures([row, row])


def calibration_figures():
    """Return the figures of made-up units of every study."""
    import calibration

    rng = np.random.default_rng(0)

    def unit(segments: int) -> dict:
        return {"segments": segments, "particles": 48, "rank": rng.integers(0, 49, 2 * segments).tolist(),
                "z": rng.normal(size=2 * segments).tolist(), "converged": True}  # fmt: skip

    score = {"coverage": 0.95, "width": 1.0}
    units = [{"study": "ranks", **unit(r)} for r in (1, 2, 3) for _ in range(20)]
    units += [{"study": "others", "noise": n, "error": [0.02], **score, **unit(1)} for n in (0.01, 0.03)]
    units += [{"study": "grasp", "by_place": {"0.9": score, "0.5": score}}]
    units += [{"study": "force", "by_level": {"0.005": score, "0.05": score | {"width": 1.5}}}]
    return calibration.figures(calibration.summary([u | {"seconds": 1.0} for u in units]))


def accuracy_figures():
    """Return the figures of a stable tree and of one that MuJoCo blows up on."""
    import accuracy
    from oracles.random_tree import random_tree
    from rich.console import Console

    tree = random_tree(np.random.default_rng(0), 2)
    outcomes = [accuracy.Outcome(tree, 0.1, 1e-3, 1e-3, 0, False),
                accuracy.Outcome(tree, 0.1, 1e-3, None, 1, False, True, 1e-6, True)]  # fmt: skip
    return accuracy.report(outcomes, 32, Console(quiet=True))


@pytest.mark.parametrize("figures", [scale_figures, identification_figures, calibration_figures, accuracy_figures])
def test_bounds_find_their_figures(figures):
    """Judge what the scripts that take minutes give, by the bounds declared for them: none is without its figure."""
    name = figures.__name__.removesuffix("_figures")
    assert len(judge(figures(), named(name).bounds, lanes=16, cores=2)) == len(named(name).bounds)


def test_rows_are_measured_in_turn():
    """Call rows one after the other, round by round."""
    calls: list[str] = []
    rows = [lambda: calls.append("a") or 1, lambda: calls.append("b") or 2]
    assert in_turn(rows, 2) == [[1, 1], [2, 2]]
    assert calls == ["a", "b", "a", "b"]


# ---- the history -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", FILES, ids=lambda p: p.stem)
def test_history_is_sound(path):
    """Read each file; its name begins with its date, its benchmarks are declared or were once, ratios are ratios."""
    run = history.read(path)
    assert path.name.startswith(run.date[:10])
    for result in run.results.values():
        figures = {(f.case, f.what): f for f in result.figures}
        assert len(figures) == len(result.figures)
        for f in figures.values():
            if f.ratio is not None and f.peer is not None:
                # pages rounded to two figures; time over time counts the other way round
                assert f.ratio == pytest.approx(f.value / f.peer, rel=0.08) or f.ratio == pytest.approx(
                    f.peer / f.value, rel=0.08
                ), f
        for v in result.verdicts:
            assert v.found == getattr(figures[v.case, v.what], v.of)
            assert v.met == ((v.least is None or v.found >= v.least) and (v.most is None or v.found <= v.most))


def a_run(date: str, name: str = "tree", value: float = 1.0) -> dict:
    """Return the content of a file."""
    result = {"arguments": [], "seconds": 1.0, "load": 0.0, "verdicts": [],
              "figures": [{"case": "a", "what": "x", "value": value}]}  # fmt: skip
    machine = {"cpu": "Fast(R) CPU @ 3 GHz", "cores": 2, "lanes": 16, "gpu": None, "system": "Linux"}
    versions = {"python": "3.11", "bough": "0.1", "warp": "1.19"}
    return {"source": "measured by benchmarks/run.py", "date": date, "machine": machine, "versions": versions,
            "commit": None, "dirty": None, "results": {name: result}}  # fmt: skip


def test_the_newest_file_that_has_it_counts(tmp_path):
    """Take each benchmark from the newest file that holds it; a new file never has an old one's name."""
    for k, (date, name) in enumerate(
        [("2026-01-02", "tree"), ("2026-01-02T10:00Z", "tree"), ("2026-01-03", "contact")]
    ):
        content = a_run(date, name, float(k))
        path = history.new_path(date, history.Machine(**content["machine"]), "cpu", tmp_path)
        write_json(path, content)
    assert sorted(p.name for p in tmp_path.iterdir()) == [
        "2026-01-02_fast-avx512_cpu-2.json", "2026-01-02_fast-avx512_cpu.json", "2026-01-03_fast-avx512_cpu.json",
    ]  # fmt: skip
    every = history.runs(tmp_path)
    assert history.last("tree", every).get("a", "x").value == 1.0
    assert history.last("contact", every).run.date == "2026-01-03"
    assert history.last("effects", every) is None


@pytest.mark.parametrize(
    "damage",
    [
        lambda c: c.pop("date"),
        lambda c: c.update(date="yesterday"),
        lambda c: c["machine"].update(cores=None),
        lambda c: c["versions"].pop("warp"),
        lambda c: c.update(source="somebody said so"),
        lambda c: c["results"]["tree"]["figures"][0].update(value=None),
        lambda c: c["results"]["tree"]["figures"][0].update(colour="red"),
        lambda c: c.update(results={}),
    ],
)
def test_a_damaged_file_is_refused(damage, tmp_path):
    """Refuse a file that lacks what a measured run states, in one line that names it."""
    content = a_run("2026-01-02")
    damage(content)
    path = tmp_path / "run.json"
    path.write_text(json.dumps(content))
    with pytest.raises(InputError, match=r"run\.json") as error:
        history.read(path)
    assert "\n" not in str(error.value)


def test_json_is_written_whole_or_not_at_all(tmp_path):
    """Leave the old file where the new content cannot be written, and nothing beside it."""
    path = tmp_path / "run.json"
    write_json(path, {"a": 1.0})
    with pytest.raises(ValueError, match="JSON"):
        write_json(path, {"a": float("nan")})
    assert json.loads(path.read_text()) == {"a": 1.0} and list(tmp_path.iterdir()) == [path]


# ---- the pages ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("page", tables.pages(), ids=lambda p: p.name)
def test_pages_show_what_was_measured(page):
    """Find each block of a page as it is made from the declaration and the newest files: else run make tables."""
    text = page.read_text()
    assert text.count("<!-- bench:") == len(tables.names_in(text)), "a marker without its end"
    assert text == tables.renewed(text, history.runs())


def test_every_block_stands_on_one_page():
    """Show each block once, and again what the comparison shows; trees' speed is in the README."""
    shown = {page.name: tables.names_in(page.read_text()) for page in tables.pages()}
    assert shown.pop("comparison.md") == ["tree", "contact", "identification"]
    assert sorted(name for names in shown.values() for name in names) == sorted(["declared", "bounds", *tables.BLOCKS])
    assert "tree" in tables.names_in((ROOT / "README.md").read_text())


def test_a_table_shows_the_figures_it_is_made_from():
    """Print the speeds and ratios of the newest run of trees in the README's table."""
    found = history.last("tree", history.runs())
    lines = [line for line in tables.tree(found).splitlines() if line.startswith("| 40 links")]
    cells = [cell.strip() for cell in lines[0].strip("|").split("|")]
    assert cells[0] == "40 links, 120 dof"
    figure = found.get("40 links", "one world per thread")
    assert cells[1] == f"{found.get('40 links', 'C MuJoCo').value / 1000:,.0f}"
    assert cells[2] == f"{figure.value / 1000:,.0f} ({figure.ratio:.1f})"


# ---- the command -------------------------------------------------------------------------------------------------


def test_list_names_every_benchmark():
    """Print a line for each benchmark."""
    done = command("--list")
    assert done.returncode == 0 and all(f"\n{b.name} (" in "\n" + done.stdout for b in BENCHMARKS)


def test_a_wrong_name_is_one_line():
    """Refuse a benchmark that is not declared: one line with the nearest name, exit code 2, nothing written."""
    before = sorted((FOLDER / "history").iterdir())
    done = command("contcat")
    assert (done.returncode, done.stdout) == (2, "")
    assert len(done.stderr.splitlines()) == 1 and "'contact'" in done.stderr
    assert sorted((FOLDER / "history").iterdir()) == before


def test_records_of_other_machines_are_taken_in(tmp_path, monkeypatch, capsys):
    """Put a record into the history under a new name; refuse what is none in one line, before anything is written."""
    monkeypatch.setattr(run, "FOLDER", tmp_path / "history")
    write_json(tmp_path / "record.json", a_run("2026-01-02T10:00Z", "gpu"))
    (tmp_path / "no.json").write_text("{}")
    with pytest.raises(InputError, match=r"no\.json"):
        run.keep([tmp_path / "record.json", tmp_path / "no.json"])
    assert not (tmp_path / "history").exists()
    assert run.keep([tmp_path / "record.json"]) == 0
    (kept,) = (tmp_path / "history").iterdir()
    assert kept.name == "2026-01-02_fast-avx512_gpu.json" and kept.name in capsys.readouterr().out
    assert history.read(kept) == history.read(tmp_path / "record.json")


def test_what_was_finished_is_kept(tmp_path, monkeypatch, capsys):
    """Keep the figures of what was finished when a run is stopped, pass by what fails, and say so in a line each."""

    def run_one(benchmark, quick, scratch):
        if benchmark.name == "contact":
            return None
        if benchmark.name == "scale":
            raise KeyboardInterrupt
        path = tmp_path / "record.json"
        write_json(path, a_run("2026-01-02T10:00Z", benchmark.name))
        return history.read(path)

    monkeypatch.setattr(run, "run_one", run_one)
    monkeypatch.setattr(run, "SCRATCH", tmp_path / "scratch")
    out = tmp_path / "out.json"
    names = ("tree", "contact", "effects", "scale", "accuracy")
    assert run.measure([named(name) for name in names], False, out) == 1
    assert list(history.read(out).results) == ["tree", "effects"]
    said = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in said[-3:-1]] == ["contact", "scale"]


def test_a_missed_bound_is_told_and_kept(tmp_path):
    """Run a script that misses its bound: exit code 1, one line, and its figures are in the record all the same."""
    out, script = tmp_path / "record.json", tmp_path / "slow.py"
    script.write_text(
        "import sys\n"
        f"sys.path.append({str(FOLDER)!r})\n"
        "import declared, measuring\n"
        "bound = declared.Bound('a', 'x', least=3.0)\n"
        "declared.BENCHMARKS += (declared.Benchmark('slow', '', None, 'slow', 1, bounds=(bound,)),)\n"
        "figures = [measuring.Figure('a', 'x', 2.0, 's')]\n"
        "sys.exit(measuring.main(measuring.parser_of(''), lambda options: figures, 'slow'))\n"
    )
    done = subprocess.run([sys.executable, str(script), "--record", str(out)], capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    result = history.read(out).results["slow"]
    (verdict,) = result.verdicts
    assert not verdict.met and verdict.line() in done.stdout
    assert result.arguments == [] and result.figures == [Figure("a", "x", 2.0, "s")]


def test_menagerie_tells_what_loads(tmp_path, capsys, monkeypatch):
    """Run the table on a collection of three: one as it is, one without limits, one that says what is in its way."""
    monkeypatch.syspath_prepend(str(ROOT / "benchmarks"))
    import menagerie

    geom = '<geom size=".1" pos=".1 0 0" contype="0" conaffinity="0"/>'
    bodies = {
        "plain": f'<body><joint damping=".1" frictionloss=".1"/>{geom}<body pos=".3 0 0"><joint/>{geom}</body></body>',
        "limited": f'<body><joint range="-1 1" armature=".01"/>{geom}</body><body gravcomp="1"><joint/>{geom}</body>',
        "odd": f'<body><joint springdamper="1 1"/>{geom}</body>',
    }
    links = "".join(f"| {name} | [MIT]({name}/LICENSE) |\n" for name in bodies)
    (tmp_path / "README.md").write_text(f"**Arms.**\n\n{links}\n**Hands.**\n\n| [MIT](hand/LICENSE) |\n")
    for name, body in bodies.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / f"{name}.xml").write_text(f"<mujoco><worldbody>{body}</worldbody></mujoco>")
        (tmp_path / name / "scene.xml").write_text(f'<mujoco>\n<include file="{name}.xml"/></mujoco>')
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- menagerie -->\nold\n<!-- /menagerie -->\nafter\n")
    assert menagerie.main([str(tmp_path), "--page", str(page)]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert rows[0].startswith("| plain/plain.xml, 2 dof | as it is, with the friction of 1 joints | nothing | ")
    assert "| `--ignore limits,gravcomp` | joint limits (1), gravity compensation (1) | " in rows[1]
    assert "| no | line 1, <joint>: springdamper | | |" in rows[2]
    assert all(float(row.split("|")[4]) < 1e-9 for row in rows[:2])
    text = page.read_text()
    assert text.startswith("before\n<!-- menagerie -->\n| model |") and "old" not in text and text.endswith("after\n")
