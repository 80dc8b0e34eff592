"""Who may speak to the service: the token, and what a browser is kept from."""

from __future__ import annotations

import asyncio
import base64
import binascii
import contextlib
import hashlib
import hmac
import ipaddress
import json
from collections.abc import Awaitable, Callable, MutableMapping
from pathlib import Path
from typing import Any

from ...sim.base.errors import InputError
from ...sim.base.files import read_text

SHORTEST = 16
"""Characters of a token at least."""

_BODY = 1.0  # s for a rejected request's body

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]


def read_token(path: Path) -> str:
    """Read a token: the file's first line.

    Raises:
        InputError: It cannot be read, is too short, is not plain, or others may read it.
    """
    token = (read_text(path, 1 << 16).splitlines() or [""])[0].strip()
    if len(token) < SHORTEST or not token.isascii() or not token.isprintable() or " " in token:
        found = f"{len(token)} characters" if len(token) < SHORTEST else "characters that no header holds"
        raise InputError(path, "line 1", found, f"{SHORTEST} or more plain characters")
    if path.stat().st_mode & 0o077:
        raise InputError(path, "", "a file that others may read", "one for its owner alone: chmod 600")
    return token


def is_loopback(host: str) -> bool:
    """Whether a host is this machine alone."""
    try:
        return ipaddress.ip_address(host.strip("[]")).is_loopback
    except ValueError:
        return host == "localhost"


class Access:
    """Lets through who has the token, where there is one; on a machine without one, whoever speaks to loopback by name.

    A page in a browser could reach a loopback port behind its user's back. It cannot leave its ``Origin`` out, nor
    (when a name is rebound to 127.0.0.1) say another ``Host``: both are refused.
    """

    def __init__(self, app: App, token: str | None, count: Callable[[str], object]) -> None:
        """Wrap an ASGI application.

        Args:
            app: The application.
            token: What a client must say, as ``Authorization: Bearer TOKEN`` or as the password of
                ``http://user:TOKEN@host``; None for loopback.
            count: Called with the reason of every rejection.
        """
        self._app = app
        self._digest = None if token is None else _digest(token.encode())
        self._count = count

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or answer it with 401 or 403."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        problem = self._problem(scope.get("headers", []))
        if problem is None:
            await self._app(scope, receive, send)
            return
        self._count(problem[1])
        with contextlib.suppress(asyncio.TimeoutError):
            # what the client has sent is taken first: a socket that is closed on unread bytes loses the answer
            await asyncio.wait_for(receive(), _BODY)
        if scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008})  # before it is accepted: HTTP 403
            return
        await _answer(send, *problem)

    def _problem(self, headers: list[tuple[bytes, bytes]]) -> tuple[int, str] | None:
        said = dict(headers)
        if b"origin" in said:
            return 403, "pages in a browser are not served"
        if self._digest is None:
            host = said.get(b"host", b"").decode("latin-1")
            name = host if host.endswith("]") else host.rsplit(":", 1)[0]
            return None if is_loopback(name) else (403, "without a token this machine is spoken to as localhost")
        # digests of equal length, compared in constant time
        given = _digest(_token_of(said.get(b"authorization", b"")))
        return None if hmac.compare_digest(given, self._digest) else (401, "a token is needed")


def _digest(token: bytes) -> bytes:
    return hashlib.sha256(token).digest()


def _token_of(header: bytes) -> bytes:
    kind, _, value = header.partition(b" ")
    if kind.lower() == b"bearer":
        return value.strip()
    if kind.lower() == b"basic":
        try:
            return base64.b64decode(value.strip(), validate=True).partition(b":")[2]
        except binascii.Error:
            return b""
    return b""


async def _answer(send: Send, status: int, text: str) -> None:
    headers = [(b"content-type", b"application/json")]
    if status == 401:
        headers.append((b"www-authenticate", b"Bearer"))
    await send({"type": "http.response.start", "status": status, "headers": headers})
    await send({"type": "http.response.body", "body": json.dumps({"error": text}).encode()})
