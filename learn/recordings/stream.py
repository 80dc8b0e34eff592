"""Ticks of a running ``bough robot serve``, over its WebSocket."""

from __future__ import annotations

import json
import ssl
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

from ...sim.base.errors import InputError, shortened
from ...sim.base.extras import install_hint

#: Longest wait for a tick [s]; a service ticks 60 times a second.
SILENT = 3.0
_NEEDED = ("tick", "time_s", "robot_dof_pos", "robot_dof_vel", "robot_dof_torque", "hand_pos", "hand_rot")


def ticks(url: str, token: str | None, certificate: Path | None) -> Iterator[tuple[dict[str, Any], int]]:
    """Yield ticks as a service tells them, and when each was received [ns since 1970], until the service ends.

    Args:
        url: Address of the service, ``http://HOST:PORT`` or ``https://HOST:PORT``.
        token: What clients say, or None.
        certificate: PEM file that vouches for a service over https, None for those that the machine trusts.

    Raises:
        InputError: There is no service, it wants a token, or it speaks otherwise.
    """
    try:
        from websockets.exceptions import ConnectionClosed, InvalidStatus, WebSocketException
        from websockets.sync.client import connect
    except ImportError:
        raise InputError("record", "", "no websockets library", install_hint("robot")) from None
    options: dict[str, Any] = {"additional_headers": {"Authorization": f"Bearer {token}"} if token else {}}
    if urlsplit(url).scheme == "https":
        options["ssl"] = ssl.create_default_context(cafile=None if certificate is None else str(certificate))
    try:
        socket = connect(_stream_of(url), open_timeout=10, **options)
    except InvalidStatus as error:
        allowed = "a running bough robot serve, and its --token-file"
        raise InputError(url, "", f"status {error.response.status_code}", allowed) from None
    except (OSError, WebSocketException, ValueError) as error:
        found = f"nothing that answers ({' '.join(str(error).split())[:80]})"
        raise InputError(url, "", found, "the address of a running bough robot serve") from None
    with socket:
        while True:
            try:
                message = json.loads(socket.recv(timeout=SILENT))
            except (ConnectionClosed, TimeoutError):
                return
            except ValueError:
                message = None
            if not isinstance(message, dict) or not set(_NEEDED) <= set(message):
                raise InputError(url, "", f"{shortened(str(message))}", "ticks of bough robot serve")
            yield message, time.time_ns()


def _stream_of(url: str) -> str:
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname:
        raise InputError("record", "URL", shortened(url), "http://HOST:PORT or https://HOST:PORT")
    return f"{'wss' if parts.scheme == 'https' else 'ws'}://{parts.netloc}/stream"
