"""Showing a scene: served frame after frame, or recorded into one file."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Protocol

from ..base.errors import InputError
from ..base.files import check_output
from .page import Page

FRAMES = 30.0
"""Frames a second at most."""
_LONGEST = 0.1  # a frame that took longer is not made up for [s]


class Scene(Protocol):
    """What a page shows.

    Attributes:
        seconds: Length of its motion [s]; of one without an end, as long as a recording of it is to be.
    """

    seconds: float

    def tick(self, seconds: float) -> None:
        """Draw the next frame; so much real time [s] has gone by since the last."""


class Loop:
    """Draws a scene for whoever has the page open.

    Attributes:
        rate: Frames a second, averaged over about a second.
    """

    def __init__(self, page: Page, scene: Scene) -> None:
        self.page, self.scene, self.rate = page, scene, 0.0

    def run(self, ended: Callable[[], bool]) -> None:
        """Draw frames while somebody looks, until ``ended`` returns True; it is asked before every frame."""
        last = time.perf_counter()
        while not ended():
            begun = time.perf_counter()
            if self.page.server.get_clients():
                with self.page.server.atomic():
                    self.scene.tick(min(begun - last, _LONGEST))
                self.rate += (1.0 / max(begun - last, 1e-3) - self.rate) / FRAMES
            last = begun
            time.sleep(max(0.0, 1.0 / FRAMES - (time.perf_counter() - begun)))


def export(page: Page, scene: Scene, path: Path, fps: float = FRAMES) -> int:
    """Record a scene's motion into one HTML file that needs no server and no network; return its bytes.

    Raises:
        InputError: The file cannot be written there.
    """
    check_page(path)
    recorder = page.server.get_scene_serializer()
    for _ in range(max(1, round(scene.seconds * fps))):
        recorder.insert_sleep(1.0 / fps)
        scene.tick(1.0 / fps)
    text = _with_legend(recorder.as_html(), page.legend)
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f".{path.name}.part")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)
    return len(text.encode())


def check_page(path: Path) -> None:
    """Raise `InputError` where no page can be written."""
    if path.suffix.lower() not in (".html", ".htm"):
        raise InputError("view", "--export", str(path), "a file that ends in .html")
    if path.is_dir():
        raise InputError("view", "--export", f"{path}, a folder", "a file that ends in .html")
    check_output(path.parent)


def _with_legend(text: str, lines: list[str]) -> str:
    box = (
        '<div style="position:fixed;left:12px;bottom:56px;max-width:min(24em,80vw);padding:8px 12px;z-index:10;'
        "font:14px/1.4 system-ui,sans-serif;color:#222;background:rgba(255,255,255,.85);border-radius:6px;"
        f'pointer-events:none">{"<br>".join(lines)}</div>'
    )
    at = text.rindex("</body>")
    return text[:at] + box + text[at:]
