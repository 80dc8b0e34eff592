"""Ticks of a running ``bough robot serve``, over its WebSocket."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ...sim.base.errors import InputError, shortened
from ..robot.client import NEEDED, SILENT, connect_stream, trusted


def ticks(url: str, token: str | None, certificate: Path | None) -> Iterator[tuple[dict[str, Any], int]]:
    """Yield ticks as a service tells them, and when each was received [ns since 1970], until the service ends.

    Args:
        url: Address of the service, ``http://HOST:PORT`` or ``https://HOST:PORT``.
        token: What clients say, or None.
        certificate: PEM file that vouches for a service over https, None for those that the machine trusts.

    Raises:
        InputError: There is no service, it wants a token, or it speaks otherwise.
    """
    with connect_stream(url, token, trusted(url, certificate)) as socket:
        from websockets.exceptions import ConnectionClosed  # there: the connection needed it

        while True:
            try:
                message = json.loads(socket.recv(timeout=SILENT))
            except (ConnectionClosed, TimeoutError):
                return
            except ValueError:
                message = None
            if not isinstance(message, dict) or not set(NEEDED) <= set(message):
                raise InputError(url, "", f"{shortened(str(message))}", "ticks of bough robot serve")
            yield message, time.time_ns()
