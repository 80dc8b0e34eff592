"""Run the tutorials and the gallery again, and keep what they print and draw: `make pages`.

A notebook keeps its standard output and its pictures; a block of the gallery leaves the picture that the page shows
below it. Pictures are kept with a palette, small enough for a repository.
"""

from __future__ import annotations

import base64
import io
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from PIL import Image

DOCS = Path(__file__).resolve().parent
TUTORIALS = DOCS / "tutorials"
GALLERY = DOCS / "gallery.md"
_WIDEST = 900  # pixels of a picture that is kept


def executed(path: Path, folder: Path) -> Any:
    """Return a notebook as it is after all its cells have run in a folder; a cell that fails raises."""
    notebook = nbformat.read(path, as_version=4)
    beside = str(Path(sys.executable).parent)  # where `bough` is, as in an activated environment
    where = {"metadata": {"path": str(folder)}}
    client = NotebookClient(notebook, timeout=1800, kernel_name="python3", resources=where)
    client.execute(env={**os.environ, "PATH": f"{beside}{os.pathsep}{os.environ['PATH']}"})
    notebook.metadata["language_info"] = {"name": "python"}  # not the version that happened to run it
    for cell in notebook.cells:
        if cell.cell_type == "code":
            cell.outputs, cell.execution_count, cell.metadata = _kept(cell.outputs), None, {}
    return notebook


def _kept(outputs: list[Any]) -> list[Any]:
    """Return what a reader is shown: standard output as one text, and pictures."""
    text = "".join(o.text for o in outputs if o.output_type == "stream" and o.name == "stdout")
    text = re.sub(r"^(Writing|Overwriting) \S+\n", "", text)  # what %%writefile says
    kept = [nbformat.v4.new_output("stream", name="stdout", text=text)] if text else []
    for output in outputs:
        data = output.get("data", {})
        if "image/png" in data:
            small = base64.b64encode(smaller(base64.b64decode(data["image/png"]))).decode()
            kept.append(nbformat.v4.new_output("display_data", data={"image/png": small}))
    return kept


def smaller(png: bytes) -> bytes:
    """Return a PNG with a palette, no wider than `_WIDEST`."""
    image = Image.open(io.BytesIO(png)).convert("RGB")
    if image.width > _WIDEST:
        image = image.resize((_WIDEST, round(image.height * _WIDEST / image.width)), Image.Resampling.LANCZOS)
    out = io.BytesIO()
    image.quantize(96, dither=Image.Dither.NONE).save(out, "PNG", optimize=True)
    return out.getvalue()


def blocks_of_the_gallery() -> list[tuple[str, str]]:
    """Return the gallery's blocks of code, each with the name of the picture that the page shows below it."""
    pattern = r"```python\n(.*?)```\n\n!\[[^\]]*\]\(images/(gallery_\w+\.png)\)"
    return re.findall(pattern, GALLERY.read_text(), re.DOTALL)


def drawn(code: str, name: str, folder: Path) -> bytes:
    """Return the picture that a block of the gallery leaves under its name in a folder."""
    (folder / "block.py").write_text(code)
    subprocess.run([sys.executable, "block.py"], cwd=folder, check=True, stdin=subprocess.DEVNULL)
    return (folder / name).read_bytes()


def main() -> None:
    """Run what is named on the command line, notebooks and gallery_NAME.png, or all of it."""
    named = set(sys.argv[1:])
    for path in sorted(TUTORIALS.glob("*.ipynb")):
        if not named or path.name in named:
            with tempfile.TemporaryDirectory() as folder:
                nbformat.write(executed(path, Path(folder)), path)
            print(path.name, flush=True)
    for code, name in blocks_of_the_gallery():
        if not named or name in named:
            with tempfile.TemporaryDirectory() as folder:
                (DOCS / "images" / name).write_bytes(smaller(drawn(code, name, Path(folder))))
            print(name, flush=True)


if __name__ == "__main__":
    main()
