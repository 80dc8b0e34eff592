"""Pages that teach: tutorials run, the gallery's code draws its pictures, commands on pages are run by tests."""

import ast
import io
import re
import shlex
import sys
from pathlib import Path

import nbformat
import numpy as np
import pytest
import tyro
from bough.cli.main import Command
from PIL import Image

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
sys.path.insert(0, str(ROOT / "docs"))

import remake  # noqa: E402
from notebooks import page_of  # noqa: E402

NOTEBOOKS = sorted(remake.TUTORIALS.glob("*.ipynb"))
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")), *NOTEBOOKS]
GALLERY = remake.blocks_of_the_gallery()

#: Options that pages show with a command and that no test gives it, with the reason.
NOT_RUN = {
    ("run", "--calibration"): "belongs to a real camera; learn/cameras/test_sources.py reads such files",
    ("reproduce", "--preset"): "half an hour and more a policy; bough train runs the presets",
}


# ---- tutorials and gallery ---------------------------------------------------------------------------------------


def _told(cell) -> tuple[int, str]:
    """Return how many pictures a cell has, and what it printed with every number left out: those depend on machines."""
    pictures = sum("image/png" in output.get("data", {}) for output in cell.outputs)
    text = "".join(output.text for output in cell.outputs if output.output_type == "stream")
    return pictures, re.sub(r"-?\d+(\.\d+)?(e-?\d+)?|[ \t-]+", " ", text)


@pytest.mark.parametrize("path", [pytest.param(p, id=p.stem) for p in NOTEBOOKS])
def test_tutorials_run(path, tmp_path):
    """Run all cells in an empty folder; find what the committed notebook shows, numbers aside."""
    kept, now = nbformat.read(path, as_version=4), remake.executed(path, tmp_path)
    shown = [_told(cell) for cell in now.cells if cell.cell_type == "code"]
    assert shown == [_told(cell) for cell in kept.cells if cell.cell_type == "code"]
    assert sum(pictures for pictures, _ in shown) > 0


@pytest.mark.parametrize("path", [pytest.param(p, id=p.stem) for p in NOTEBOOKS])
def test_tutorials_become_pages(path):
    """Turn each notebook into a page with one title, no magic of notebooks, and every picture in its place."""
    page, pictures = page_of(nbformat.read(path, as_version=4), path.stem)
    prose = re.sub(r"^```.*?^```", "", page, flags=re.MULTILINE | re.DOTALL)
    assert len(re.findall(r"^# ", prose, re.MULTILINE)) == 1
    assert not re.search(r"^(%|!(?!\[))", page, re.MULTILINE)
    assert re.findall(r"!\[[^\]]+\]\(([^)]+)\)", page) == list(pictures)
    assert all(content.startswith(b"\x89PNG") for content in pictures.values())


@pytest.mark.parametrize("path", [pytest.param(p, id=p.stem) for p in NOTEBOOKS])
def test_links_of_tutorials_lead_somewhere(path):
    """Find the file behind every link of a notebook."""
    prose = "\n".join(c.source for c in nbformat.read(path, as_version=4).cells if c.cell_type == "markdown")
    targets = re.findall(r"\]\((?!https?:)([^)#\s]+)", prose)
    assert targets and [t for t in targets if not (path.parent / t).exists()] == []


def test_every_block_of_the_gallery_has_its_picture():
    """Find below each block the picture that it saves, and no picture beside these."""
    page = remake.GALLERY.read_text()
    assert len(GALLERY) == page.count("```python\n") == page.count("![") > 5
    for code, name in GALLERY:
        assert re.findall(r'(?:save|savefig)\("([^"]+)"', code) == [name]
    assert {name for _, name in GALLERY} == {p.name for p in (ROOT / "docs" / "images").glob("gallery_*")}


@pytest.mark.parametrize(("code", "name"), [pytest.param(*block, id=block[1]) for block in GALLERY])
def test_the_gallery_s_code_draws_what_the_page_shows(code, name, tmp_path):
    """Run a block, and compare its picture with the page's: the same size, and the same but for the palette.

    A palette of 96 colours moves a channel by less than 256 / 96^(1/3) / 2 = 28 of 255, on average by half of that;
    another picture (the next one of the gallery) differs by more.
    """
    now = np.asarray(Image.open(io.BytesIO(remake.smaller(remake.drawn(code, name, tmp_path)))).convert("RGB"), float)
    kept = np.asarray(Image.open(ROOT / "docs" / "images" / name).convert("RGB"), float)
    assert now.shape == kept.shape and np.abs(now - kept).mean() < 14.0


# ---- commands ----------------------------------------------------------------------------------------------------


def _blocks(page: Path) -> list[str]:
    """Return the blocks of a page that are typed in a terminal."""
    if page.suffix == ".ipynb":
        text, _ = page_of(nbformat.read(page, as_version=4), page.stem)
    else:
        text = page.read_text()
    fenced = re.findall(r"^```(\w*)[^\n]*\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    return [block for language, block in fenced if language in ("", "sh")]


def _lines(block: str) -> list[str]:
    """Return the lines of a block, those that go on on the next one joined."""
    return re.sub(r"(\\\n|\n {4,})\s*", " ", block).splitlines()


def shown_commands() -> list[tuple[str, str]]:
    """Return (page, arguments of bough) of every command in a block, and of those in the README's table."""
    found = [(page.name, line) for page in PAGES for block in _blocks(page) for line in _lines(block)]
    for row in re.findall(r"^\| (`bough .*?`) \|", (ROOT / "README.md").read_text(), re.MULTILINE):
        found += [("README.md", command) for command in re.findall(r"`([^`]+)`", row)]
    pattern = re.compile(r"^(?:\.venv/bin/|torchrun .*-m )?bough (?!--)(.*)$")
    matches = [(page, pattern.match(line)) for page, line in found]
    return [(page, re.split(r"#| \| ", match[1])[0].rstrip(" &>")) for page, match in matches if match]


COMMANDS = shown_commands()


def _plain(arguments: str) -> list[str]:
    """Return a usage line as words: without what may be left out, the first of alternatives, numbers for letters."""
    while "[" in arguments:
        arguments = re.sub(r"\[[^\[\]]*\]", "", arguments)
    words = [word.split("|")[0] for word in shlex.split(arguments.replace("...", ""))]
    return [{"N": "3", "n": "3"}.get(word, word) for word in words]


@pytest.mark.parametrize(("page", "arguments"), [pytest.param(*c, id=f"{c[0]}-{i}") for i, c in enumerate(COMMANDS)])
def test_commands_of_the_pages_parse(page, arguments):
    """Parse each command that a page shows by the command line's own parser."""
    config = (tyro.conf.OmitArgPrefixes, tyro.conf.DisallowNone)
    try:
        tyro.cli(Command, args=_plain(arguments), config=config, console_outputs=False)
    except SystemExit as error:
        pytest.fail(f"{page}: bough {arguments}: exit code {error.code}")


def _words(path: Path) -> set[str]:
    """Return what a test module or a notebook may type: words of strings, or a command's class and its keywords."""
    if path.suffix == ".ipynb":
        return set(" ".join(_blocks(path)).split())
    nodes = list(ast.walk(ast.parse(path.read_text())))
    typed = {w for n in nodes if isinstance(n, ast.Constant) and isinstance(n.value, str) for w in n.value.split()}
    classes = {n.id.lower() for n in nodes if isinstance(n, ast.Name)}
    keywords = {f"--{n.arg.replace('_', '-')}" for n in nodes if isinstance(n, ast.keyword) and n.arg}
    return typed | classes | keywords


def test_commands_of_the_pages_are_run_by_tests():
    """Find for each command of a page, and each option with it, a test module or tutorial that gives both."""
    modules = [_words(p) for p in [*TESTS.rglob("*.py"), *NOTEBOOKS] if p != Path(__file__)]
    shown = set()
    for _, arguments in COMMANDS:
        words = arguments.split()
        command = " ".join(words[:2] if words[0] in ("touch", "robot") else words[:1])
        shown |= {(command, option) for option in ("", *re.findall(r"(?<![\w-])--[a-z][a-z-]*", arguments))}
    lacking = {
        (command, option)
        for command, option in shown
        if not any({*command.split(), option} - {""} <= words for words in modules)
    }
    assert lacking == set(NOT_RUN), sorted(lacking ^ set(NOT_RUN))
