"""The repository itself: what is installed, what the pages promise, and the lines the house keeps."""

import ast
import re
import subprocess
import sys
import warnings
import zipfile
from email.parser import Parser
from pathlib import Path
from typing import get_args, get_type_hints

import pytest
from bough.cli.info import _EXTRAS
from bough.cli.main import Command, main
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from packaging.version import Version

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10; pytest brings tomli there
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("kernels", "sim", "perception", "learn", "cli")
HEAVY = {"torch", "newton", "mujoco", "numpy", "rsl_rl"}  # what device code must not know
PACKAGE = sorted(p for room in ROOMS for p in (ROOT / room).rglob("*.py")) + sorted(ROOT.glob("*.py"))
TEMPLATES = ROOT / "learn" / "reports" / "templates"
MODULES = {str(p.relative_to(ROOT).with_suffix("")) for p in PACKAGE}
#: The rooms of the package, each below those it may import from: the README's table.
ORDER = re.findall(r"^\| \[`([a-z0-9/]+)/`\]\(\1\) \|", (ROOT / "README.md").read_text(), re.MULTILINE)
SOURCES = PACKAGE + sorted(p for room in ("tests", "benchmarks") for p in (ROOT / room).rglob("*.py"))
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
#: Blocks of the gallery are run by test_pages.py, which looks at their pictures.
EXAMPLES = [
    pytest.param(block, id=f"{page.name}-{i + 1}")
    for page in PAGES
    if page.name != "gallery.md"
    for i, block in enumerate(re.findall(r"^```python\n(.*?)^```", page.read_text(), re.MULTILINE | re.DOTALL))
]


def name_of(path: Path) -> str:
    """Return a path as the repository's reader writes it."""
    return str(path.relative_to(ROOT))


# ---- what is installed -------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def wheel(tmp_path_factory) -> zipfile.ZipFile:
    """Build the wheel from a copy of the sources, so that nothing is left in the repository."""
    copy = tmp_path_factory.mktemp("copy")
    for path in [*PACKAGE, *TEMPLATES.iterdir()]:
        (copy / path.relative_to(ROOT)).parent.mkdir(parents=True, exist_ok=True)
        (copy / path.relative_to(ROOT)).write_bytes(path.read_bytes())
    for name in ("pyproject.toml", "README.md", "LICENSE", "py.typed", "MANIFEST.in", "constraints.txt"):
        (copy / name).write_bytes((ROOT / name).read_bytes())
    (copy / "tests").mkdir()
    (copy / "tests" / "test_nothing.py").write_text("")
    out = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--quiet", "--wheel-dir", str(out), str(copy)]
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL)
    return zipfile.ZipFile(next(out.glob("bough-*.whl")))


def test_wheel_holds_the_package(wheel):
    """Hold every module, the type marker and the templates under ``bough/``, and no test."""
    names = {n for n in wheel.namelist() if ".dist-info/" not in n}
    expected = {f"bough/{name_of(p)}" for p in PACKAGE}
    expected |= {"bough/py.typed"} | {f"bough/learn/reports/templates/{p.name}" for p in TEMPLATES.iterdir()}
    assert names == expected


def test_wheel_installs_the_command_and_the_licence(wheel):
    """Install ``bough`` as a command that calls `cli.main.main`, with the licence beside it."""
    info = next(n for n in wheel.namelist() if n.endswith("entry_points.txt")).rsplit("/", 1)[0]
    assert "bough = bough.cli.main:main" in wheel.read(f"{info}/entry_points.txt").decode()
    assert b"Apache License" in wheel.read(f"{info}/licenses/LICENSE")
    metadata = Parser().parsestr(wheel.read(f"{info}/METADATA").decode())
    assert metadata["Requires-Python"] == ">=3.10"


def test_wheel_imports_without_the_repository(wheel, tmp_path):
    """Import every room from the wheel alone, by the package's name only."""
    wheel.extractall(tmp_path)
    code = (
        "import sys\n"
        "sys.meta_path[:] = [f for f in sys.meta_path if 'editable' not in getattr(f, '__module__', str(f))]\n"
        f"sys.path.insert(0, {str(tmp_path)!r})\n"
        "import bough, bough.cli, bough.sim.engine.simulator, bough.learn.cases.case, bough.perception\n"
        f"assert bough.__file__.startswith({str(tmp_path)!r}), bough.__file__\n"
        "assert 'sim' not in sys.modules and 'kernels' not in sys.modules\n"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=tmp_path, stdin=subprocess.DEVNULL)


def test_constraints_pin_what_the_project_names():
    """Pin each dependency to one version a Python, inside the bounds of ``pyproject.toml``."""
    lines = [line.split("#")[0].strip() for line in (ROOT / "constraints.txt").read_text().splitlines()]
    pins = [Requirement(line) for line in lines if line]
    named = list(PROJECT["project"]["dependencies"])
    for extra in PROJECT["project"]["optional-dependencies"].values():
        named += extra
    named = [requirement for requirement in named if Requirement(requirement).name != "bough"]  # extras of extras
    for python in ("3.10", "3.11", "3.12", "3.13"):
        chosen = [p for p in pins if p.marker is None or p.marker.evaluate({"python_version": python})]
        versions = {canonicalize_name(p.name): re.fullmatch(r"==([^*,]+)", str(p.specifier))[1] for p in chosen}
        assert len(versions) == len(chosen), f"a package pinned twice for Python {python}"
        for requirement in map(Requirement, named):
            version = versions.get(canonicalize_name(requirement.name))
            assert version, f"{requirement.name} is not pinned for Python {python}"
            assert Version(version) in requirement.specifier, f"{requirement} against {version}"


def test_all_extras_are_what_commands_can_ask_for():
    """Let ``all`` hold every extra that pages of install tell users of, as ``bough info`` lists them."""
    extras = PROJECT["project"]["optional-dependencies"]
    assert set(extras) - {"all"} == Requirement(*extras["all"]).extras | {"test", "dev", "docs", "sysid"}
    assert set(_EXTRAS) == Requirement(*extras["all"]).extras
    told = re.findall(r"`(\w+)`", "".join(re.findall(r"^\| (`[^|]+) \|", (ROOT / "docs/install.md").read_text(), re.M)))
    assert set(told) == set(extras) - {"sysid"}


@pytest.mark.parametrize("name", ["cpu", "cuda"])
def test_images_hold_the_package(name):
    """Copy into an image what the wheel is built from, install the pinned torch first and all extras after it."""
    lines = re.findall(r"^([A-Z]+) (.+)$", (ROOT / "docker" / f"{name}.Dockerfile").read_text(), re.MULTILINE)
    copied = {word for key, rest in lines if key == "COPY" for word in rest.split()[:-1]}
    assert all((ROOT / path).exists() for path in copied)
    sources = {name_of(p).split("/")[0] for p in PACKAGE}
    assert copied == sources | {"constraints.txt", "pyproject.toml", "README.md", "LICENSE", "py.typed"}
    torch, package = (rest for key, rest in lines if key == "RUN" and rest.startswith("pip "))
    assert torch == "pip install torch --constraint /src/constraints.txt --index-url ${TORCH_INDEX}"
    assert package == 'pip install "/src[all]" --constraint /src/constraints.txt'
    index = dict(rest.split("=") for key, rest in lines if key == "ARG")["TORCH_INDEX"]
    assert index.endswith("/cpu") == (name == "cpu")


# ---- what the pages promise --------------------------------------------------------------------------------------


def test_commands_of_the_pages_exist_in_the_makefile():
    """Find every ``make`` target that a page names in the Makefile."""
    targets = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for page in [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / ".ci" / "run"]:
        named = re.findall(r"(?:^|`|exec |[A-Z]=\S+ )make ([a-z-]+)", page.read_text(), re.MULTILINE)
        assert set(named) <= targets, name_of(page)
    assert {"demo", "test"} <= targets


def _commands(choice, before=()):
    """Yield the words of every command: ``("touch", "record")``."""
    for annotated in get_args(choice):
        command, told = get_args(annotated)
        words, (first, *others) = (*before, told.name), get_type_hints(command, include_extras=True).values()
        yield from _commands(first, words) if not others and len(get_args(first)) > 1 else [words]


def _help(words, capsys):
    """Return what a command's help prints; tests of the command line ask for one in a process of its own."""
    with pytest.raises(SystemExit) as done:
        main([*words, "--help"])
    assert done.value.code in (None, 0)
    return capsys.readouterr().out


def test_commands_of_the_pages_exist(capsys, monkeypatch):
    """Find every ``bough`` command and option that a page names in the command's help."""
    commands = {" ".join(words) for words in _commands(Command)}
    monkeypatch.setattr("warnings.showwarning", warnings.showwarning)  # `main` shows them its own way
    names, helps, begun = "|".join(sorted(commands, reverse=True)), {}, {words.split()[0] for words in commands}
    for page in [*PAGES, ROOT / "Makefile"]:
        text = page.read_text()
        for word in re.findall(r"(?:`|bin/)bough ([a-z][a-z-]*)\b", text):
            assert word in begun, f"{name_of(page)}: bough {word}"
        for command, rest in re.findall(rf"bough ({names})\b([^`\n]*(?:\n {{4,}}(?!bough )\S[^`\n]*)*)", text):
            if command not in helps:
                helps[command] = _help(command.split(), capsys)
            for option in re.findall(r"(?<![\w-])--[a-z][a-z-]*", rest):
                assert option in helps[command], f"{name_of(page)}: bough {command} has no {option}"
    assert set(helps) == commands


@pytest.mark.parametrize("block", EXAMPLES)
def test_examples_of_the_pages_run(block, tmp_path, forked, request):
    """Run each Python example of the README and the pages as a program of its own; the README's import all anew."""
    path = tmp_path / "example.py"  # a file, so that a kernel it may define has source
    path.write_text(block)
    if request.node.callspec.id.startswith("README") or not forked.suits():
        done = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, stdin=subprocess.DEVNULL)
    else:
        done = forked.run(path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("page", [pytest.param(p, id=name_of(p)) for p in PAGES])
def test_links_of_the_pages_lead_somewhere(page):
    """Find the file and the heading behind every link that stays in the repository."""
    for target in re.findall(r"\]\((?!https?:)([^)\s]+)\)", page.read_text()):
        file, _, heading = target.partition("#")
        path = (page.parent / file).resolve() if file else page
        assert path.exists(), f"{name_of(page)}: {target}"
        if heading:
            titles = re.findall(r"^#+ (.+)$", path.read_text(), re.MULTILINE)
            anchors = {re.sub(r"[^\w -]", "", t.lower()).strip().replace(" ", "-") for t in titles}
            assert heading in anchors, f"{name_of(page)}: {target}"


def test_site_lists_every_page():
    """Name each page of ``docs`` in the site's navigation, and no other."""
    listed = set(re.findall(r": ([\w/]+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.MULTILINE))
    written = [p for kind in ("*.md", "*.ipynb") for p in (ROOT / "docs").rglob(kind)]
    assert listed == {str(p.relative_to(ROOT / "docs").with_suffix(".md")) for p in written}


@pytest.mark.parametrize(
    "page", [pytest.param(p, id=name_of(p)) for p in [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md"]]
)
def test_paths_of_the_pages_exist(page):
    """Find every source file that a page names in the repository."""
    named = re.findall(r"`((?:kernels|sim|perception|learn|cli|tests|benchmarks)/[\w/]+\.(?:py|j2))`", page.read_text())
    assert [path for path in named if not (ROOT / path).exists()] == []


def test_names_of_the_pages_exist():
    """Find each ``bough.room.module.name`` that a page names: the module's file, and the name in it."""
    for page in [*PAGES, ROOT / "CONTRIBUTING.md", ROOT / "SECURITY.md"]:
        for dotted in re.findall(r"`bough((?:\.\w+)+)", page.read_text()):
            parts = dotted[1:].split(".")
            found = [n for n in range(1, len(parts) + 1) if (ROOT.joinpath(*parts[:n])).with_suffix(".py").exists()]
            path = ROOT.joinpath(*parts[: found[-1]]).with_suffix(".py") if found else None
            if path is None:  # a room, or a name that its __init__ offers
                rooms = [n for n in range(len(parts), -1, -1) if ROOT.joinpath(*parts[:n], "__init__.py").exists()]
                found, path = rooms[:1], ROOT.joinpath(*parts[: rooms[0]], "__init__.py")
            for name in parts[found[-1] :]:
                assert re.search(rf"\b{name}\b", path.read_text()), f"{name_of(page)}: bough{dotted}"


def test_walks_of_the_architecture_name_what_is_there():
    """Find each stop's name in its file; let no walk go back up the rooms, but for the leg that is said to go up."""
    page = (ROOT / "docs" / "architecture.md").read_text()
    walks = re.findall(r"^## (Walk [^\n]+)\n(.*?)(?=^## )", page, re.MULTILINE | re.DOTALL)
    assert len(walks) == 3
    for title, text in walks:
        legs = [re.findall(r"^\| \d+ \| `([\w/.]+)` \| `([\w.]+)`", leg, re.MULTILINE) for leg in text.split("\n### ")]
        assert 0 < sum(map(len, legs)) <= 10, title
        for leg in legs:
            for path, name in leg:
                assert re.search(rf"\b{name.split('.')[-1]}\b", (ROOT / path).read_text()), f"{path} has no {name}"
            order = [ORDER.index(room_of(path.removesuffix(".py"))) for path, _ in leg]
            assert order in (sorted(order), sorted(order, reverse=True)), title


def test_table_of_decisions_lists_every_record():
    """List each dated record in the table of decisions, with its room and its status, and no other."""
    listed = re.findall(r"^\| (\S+) \| \[(.+?)\]\((decisions/\w+\.md)#.+?\) \| `(.+?)` \| (\w+)", 
                        (ROOT / "docs" / "decisions.md").read_text(), re.MULTILINE)  # fmt: skip
    pages = sorted((ROOT / "docs" / "decisions").glob("*.md"))
    pattern = r"^### (\d{4}-\d\d-\d\d): (.+)\n\n\*`(.+?)` · (holds|extended|superseded)\b"
    records = [(d, title, f"decisions/{p.name}", room, status) for p in pages
               for d, title, room, status in re.findall(pattern, p.read_text(), re.MULTILINE)]  # fmt: skip
    assert sorted(listed) == sorted(records) and [row[0] for row in listed] == sorted(row[0] for row in listed)
    assert len(records) == sum(p.read_text().count("\n### ") for p in pages)
    assert all((ROOT / room).exists() for _, _, _, room, _ in records)


# ---- the lines the house keeps -----------------------------------------------------------------------------------


def test_files_are_short():
    """Keep files at 600 lines or fewer."""
    assert not [name_of(p) for p in SOURCES if len(p.read_text().splitlines()) > 600]


def room_of(module: str) -> str | None:
    """Return the room that a module or package (path from the root, no suffix) lies in; None above the rooms."""
    found = [room for room in ORDER if module == room or module.startswith(f"{room}/")]
    return max(found, key=len, default=None)


def imports(path: Path):
    """Yield (line, module path) of each import inside the package, those within functions too."""
    package = path.relative_to(ROOT).parts[:-1]
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level:
            base = [*package[: len(package) - node.level + 1], *(node.module.split(".") if node.module else [])]
            for alias in node.names:
                full = "/".join([*base, alias.name])
                yield node.lineno, full if full in MODULES else "/".join(base)


def test_rooms_of_the_table_are_those_of_the_repository():
    """List each folder that holds modules in the README's table, and no other."""
    folders = {name_of(p.parent) for p in PACKAGE if p.parent != ROOT and p.name != "__init__.py"}
    assert {room_of(f) for f in folders} == set(ORDER) and set(folders) == set(ORDER)


@pytest.mark.parametrize("path", [pytest.param(p, id=name_of(p)) for p in PACKAGE if p.parent != ROOT])
def test_imports_run_down(path):
    """Import only from rooms above in the README's table, as the room's ``__init__`` says, and from the version."""
    here = room_of(name_of(path.parent))
    if here is None:
        assert not list(imports(path)), "a package of rooms imports nothing"
        return
    stated = (ROOT / here / "__init__.py").read_text()
    for line, module in imports(path):
        there = room_of(module)
        if there in (here, None):
            assert there or module == "version", f"line {line} imports {module}"
            continue
        assert ORDER.index(there) < ORDER.index(here), f"line {line}: {here} imports {there}, which stands below it"
        assert f"`{there.replace('/', '.')}`" in stated, f"{here}/__init__.py does not say that it uses {there}"


def test_init_of_rooms_name_what_they_use():
    """State in each room's ``__init__`` only rooms that a file in it imports."""
    for room in ORDER:
        used = {room_of(m) for p in PACKAGE if name_of(p.parent) == room for _, m in imports(p)}
        stated = re.search(r"^Uses: (.*?)\.$", (ROOT / room / "__init__.py").read_text(), re.MULTILINE | re.DOTALL)
        assert stated, room
        assert set(re.findall(r"`([a-z0-9.]+)`", stated[1])) <= {r.replace("/", ".") for r in used if r}, room


def test_no_import_runs_in_a_circle():
    """Find no module that imports itself through others, function-level imports counted."""
    edges = {name_of(p.with_suffix("")).removesuffix("/__init__"): {m for _, m in imports(p)} for p in PACKAGE}
    done: set[str] = set()

    def visit(module: str, path: tuple[str, ...]) -> None:
        assert module not in path, " -> ".join([*path[path.index(module) :], module])
        if module not in done:
            for target in edges.get(module, set()) - {module}:
                visit(target, (*path, module))
            done.add(module)

    for module in edges:
        visit(module, ())


def test_folders_are_small():
    """Keep folders at twenty files or fewer, the folder of laws (one file each) aside."""
    folders = {p.parent for p in SOURCES} - {ROOT / "sim" / "effects"}
    assert not [name_of(f) for f in folders if len(list(f.glob("*.py"))) > 20]


@pytest.mark.parametrize("path", [pytest.param(p, id=name_of(p)) for p in PACKAGE])
def test_packages_that_are_imported(path):
    """Import the package relatively, nothing private of Newton's, and in device code nothing but Warp."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import | ast.ImportFrom) and not getattr(node, "level", 0):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else [node.module or ""]
            heads = {n.split(".")[0] for n in names}
            assert "bough" not in heads, f"line {node.lineno}: imports inside the package are relative"
            assert not name_of(path).startswith("kernels/") or not heads & HEAVY, f"line {node.lineno}: {heads}"
            assert not any(n.startswith("newton._src") for n in names), f"line {node.lineno}: a private Newton name"


def public_definitions(node: ast.AST, names: set[str] | None = None, prefix: str = ""):
    """Yield (name, node) of classes and functions without a leading underscore, those inside others too.

    At the top of a module with an ``__all__``, given as ``names``, yield what that holds instead.
    """
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            yield from public_definitions(child, names, prefix)
            continue
        if child.name in names if names is not None else not child.name.startswith("_"):
            yield f"{prefix}{child.name}", child
        yield from public_definitions(child, prefix=f"{prefix}{child.name}.")


def listed_names(module: ast.Module) -> set[str] | None:
    """Return what a module's ``__all__`` holds, None if it has none."""
    for node in module.body:
        if isinstance(node, ast.Assign) and any(isinstance(t, ast.Name) and t.id == "__all__" for t in node.targets):
            return set(ast.literal_eval(node.value))
    return None


@pytest.mark.parametrize("path", [pytest.param(p, id=name_of(p)) for p in PACKAGE])
def test_public_names_have_docstrings(path):
    """Document every module, and every class, function and method in it, nested ones too, that is not private."""
    module = ast.parse(path.read_text())
    assert ast.get_docstring(module), "the module"
    silent = [name for name, node in public_definitions(module, listed_names(module)) if not ast.get_docstring(node)]
    assert not silent
