"""A page in the browser: its server, ground, light, camera and how to reach it."""

from __future__ import annotations

import contextlib
import getpass
import html
import io
import logging
import socket
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..base.errors import InputError
from ..base.extras import install_hint
from ..base.types import Array
from ..pictures.scale import round_length
from .wood import MANY

#: Slant of the camera: it looks along +y from the front right, a little from above.
_FROM = np.array([0.42, -0.87, 0.26])
_FIELD = np.radians(40.0)


@dataclass
class Page:
    """A page that is served.

    Attributes:
        server: viser's server (`viser.ViserServer`); what is added to its ``scene`` and ``gui`` is on the page.
        legend: What is said below the scene of an exported page, lines of HTML.
        floor: Height of the ground [m].
    """

    server: Any
    legend: list[str]
    floor: float = 0.0

    @property
    def port(self) -> int:
        """Port that the page is served at."""
        return int(self.server.get_port())

    def title(self, text: str) -> None:
        """Say what the page shows, above its controls."""
        self.server.gui.set_panel_label(text)
        self.legend.append(f"<b>{html.escape(text)}</b>")

    def note(self, text: str) -> None:
        """Say something in the controls and under an exported page; plain HTML."""
        self.server.gui.add_html(f'<div style="padding:2px 14px;font-size:14px;line-height:1.4">{text}</div>')
        self.legend.append(text)

    def ground(self, low: Array, high: Array) -> None:
        """Lay a grid under a box whose corners are given [m], and put the camera so that the box fills the view."""
        height, middle = min(0.0, float(low[2])), (low + high) / 2.0
        self.floor = height
        size = max(float(np.max(high - low)), 1e-3)
        cell = round_length(0.35 * size)
        wide = cell * np.ceil(2.5 * size / cell)
        self.server.scene.add_grid(
            "/ground", width=wide, height=wide, cell_size=cell, section_size=wide, cell_color=(178, 186, 170),
            section_color=(178, 186, 170), plane_color=(214, 221, 205), plane_opacity=1.0, shadow_opacity=0.35,
            position=(float(middle[0]), float(middle[1]), height),
        )  # fmt: skip
        self.note(f"A square on the ground is {cell:g} m wide.")
        self._look(np.array([low[0], low[1], height]), high)

    def _look(self, low: Array, high: Array) -> None:
        middle, reach = (low + high) / 2.0, np.maximum(high - low, 1e-3) / 2.0
        across = float(np.hypot(reach[0] * 0.9, reach[1] * 0.45))
        along = float(np.hypot(reach[0] * 0.42, reach[1] * 0.87))
        half = np.tan(_FIELD / 2.0)
        away = 1.1 * max(across / half / 1.25, reach[2] / half) + along
        camera = self.server.initial_camera
        camera.position = tuple(middle + away * _FROM / np.linalg.norm(_FROM))
        camera.look_at, camera.up, camera.fov = tuple(middle), (0.0, 0.0, 1.0), _FIELD
        camera.near, camera.far = away / 200.0, 30.0 * away

    def post(self, name: str, top: Array, radius: float) -> None:
        """Stand a grey post under a point that holds something [m]; ``radius`` in m."""
        height = max(float(top[2]) - self.floor, 1e-3)
        self.server.scene.add_cylinder(
            name, radius=radius, height=height, color=(150, 152, 155),
            position=(float(top[0]), float(top[1]), float(top[2]) - 0.5 * height),
        )  # fmt: skip

    def shadows(self, capsules: int) -> None:
        """Let things cast shadows, at first where there are few: they take three passes more; a control switches it."""
        scene, first = self.server.scene, capsules <= MANY
        scene.configure_default_lights(cast_shadow=first)
        control = self.server.gui.add_checkbox("shadows", first)
        control.on_update(lambda _event: scene.configure_default_lights(cast_shadow=control.value))

    def stop(self) -> None:
        """Close the page; viser's own farewell is left unsaid."""
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()


def open_page(port: int) -> Page:
    """Serve an empty page on the loopback interface.

    Args:
        port: Port to serve at; 0 takes any that is free.

    Raises:
        InputError: viser is not installed, or the port is taken or not allowed.
    """
    try:
        import viser
    except ModuleNotFoundError:
        raise InputError("view", "", "no viser", install_hint("view")) from None
    _check_port(port)
    logging.getLogger("websockets").setLevel(logging.CRITICAL)  # a tab that is closed is no error
    with contextlib.redirect_stdout(io.StringIO()):  # viser's own table of addresses
        server = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
    server.gui.configure_theme(show_logo=False, show_share_button=False, control_width="medium")
    server.gui.main_panel.dock_right()
    server.scene.set_up_direction("+z")
    server.scene.set_background_image(_sky(), format="png")
    return Page(server, [])


def _sky() -> Array:
    """Return a picture of a clear sky, lighter towards the horizon, [64, 4, 3] bytes."""
    share = np.linspace(0.0, 1.0, 64)[:, None, None]
    colors = (1.0 - share) * np.array([176.0, 205.0, 232.0]) + share * np.array([244.0, 247.0, 249.0])
    return np.tile(np.round(colors), (1, 4, 1)).astype(np.uint8)


def _check_port(port: int) -> None:
    if not 0 <= port <= 65535:
        raise InputError("view", "--port", str(port), "1 to 65535, or 0 for any that is free")
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", port))
        except PermissionError:
            raise InputError("view", "--port", f"{port}, which only root may use", "1024 to 65535") from None
        except OSError:
            allowed = "one that is free, or 0 for any that is"
            raise InputError("view", "--port", f"{port}, which is taken", allowed) from None


def directions(port: int) -> str:
    """Return two lines: where the page is, and how to reach it from another machine."""
    there = f"{getpass.getuser()}@{socket.gethostname()}"
    return f"Open http://localhost:{port} (Ctrl-C ends)\nOver SSH, first: ssh -L {port}:localhost:{port} {there}"
