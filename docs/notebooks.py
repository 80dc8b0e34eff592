"""A hook of mkdocs: notebooks of `docs/tutorials` become pages of the site, their pictures files beside them."""

from __future__ import annotations

import base64
import json
import re
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from mkdocs.structure.files import Files

_SUFFIX = {"image/png": "png", "image/gif": "gif"}


def page_of(notebook: dict[str, Any], stem: str) -> tuple[str, dict[str, bytes]]:
    """Return a notebook as a Markdown page, and its pictures by the names that the page gives them.

    Args:
        notebook: A notebook of format 4.
        stem: Name of its file without the suffix.
    """
    parts: list[str] = []
    pictures: dict[str, bytes] = {}
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        parts.append(source if cell["cell_type"] == "markdown" else _fenced(source))
        for output in cell.get("outputs", []):
            parts += _shown(output, stem, pictures)
    return "\n\n".join([*parts, f"[This page as a notebook]({stem}.ipynb)"]) + "\n", pictures


def _fenced(source: str) -> str:
    """Return a code cell as a block: what goes to a terminal as ``sh``, a file under its name, else Python."""
    magic, _, rest = source.partition("\n")
    if magic.startswith("%%sh"):
        return f"```sh\n{rest.strip()}\n```"
    if magic.startswith("%%writefile"):
        return f'```python title="{magic.split()[-1]}"\n{rest.strip()}\n```'
    return f"```python\n{source.strip()}\n```"


def _shown(output: dict[str, Any], stem: str, pictures: dict[str, bytes]) -> list[str]:
    """Return an output as Markdown; a picture is put beside those that are there."""
    if output["output_type"] == "stream":
        return [f"```text\n{''.join(output['text']).rstrip()}\n```"]
    for kind, suffix in _SUFFIX.items():
        if kind in output.get("data", {}):
            name = f"{stem}_{len(pictures) + 1}.{suffix}"
            pictures[name] = base64.b64decode("".join(output["data"][kind]))
            return [f"![what the code above draws]({name})"]
    return []


def on_files(files: Files, config: Any, **_: Any) -> Files:
    """Add a page and its pictures for every notebook; the notebook stays, to be downloaded."""
    from mkdocs.structure.files import File  # tests turn notebooks into pages where there is no mkdocs

    for file in [f for f in files if f.src_uri.endswith(".ipynb")]:
        path = PurePosixPath(file.src_uri)
        page, pictures = page_of(json.loads(file.content_string), path.stem)
        page = re.sub(r"\]\((\w+)\.ipynb(?=[)#])(?!\)\n\Z)", r"](\1.md", page)
        files.append(File.generated(config, str(path.with_suffix(".md")), content=page))
        for name, content in pictures.items():
            files.append(File.generated(config, str(path.with_name(name)), content=content))
    return files
