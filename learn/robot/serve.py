"""An arm, served: loop, log and network brought together, until Ctrl-C or SIGTERM."""

from __future__ import annotations

import gc
import signal
import socket
import ssl
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ...sim.arms.arm import Arm
from ...sim.base.errors import InputError
from ...sim.base.files import check_output
from .access import Access, is_loopback
from .backend import Backend
from .guard import Guard
from .limits import Limits, check_joints, written
from .log import check_new
from .service import Service
from .wire import LARGEST
from .workspace import Workspace

if TYPE_CHECKING:
    import uvicorn

    from .touch import Feeler

_SWITCH = 5e-4  # s that a thread may keep the interpreter from the control loop
_CLIENTS = 64


@dataclass(frozen=True)
class Address:
    """Where a service listens, and to whom.

    Attributes:
        host: An address of this machine; anything but loopback needs a token.
        port: TCP port; 0 takes one that is free.
        token: What clients must say, None for nothing.
        certificate, key: PEM files for TLS, None without.
    """

    host: str = "127.0.0.1"
    port: int = 3738
    token: str | None = None
    certificate: Path | None = None
    key: Path | None = None

    def check(self) -> Address:
        """Return self if it may be listened at.

        Raises:
            InputError: Others could reach it without a token, the port is none, or a key or certificate is missing.
        """
        if not is_loopback(self.host) and self.token is None:
            found = f"{self.host} without --token-file"
            raise InputError("robot serve", "--host", found, "127.0.0.1, or a token that every client must say")
        if not 0 <= self.port < 65536:
            raise InputError("robot serve", "--port", str(self.port), "0 to 65535")
        if (self.certificate is None) != (self.key is None):
            raise InputError("robot serve", "--certificate", "one without the other", "--certificate with --key")
        for name, path in (("--certificate", self.certificate), ("--key", self.key)):
            if path is not None and not path.is_file():
                raise InputError("robot serve", name, f"{path}, which does not exist", "a PEM file")
        if self.certificate is not None:
            try:
                ssl.create_default_context(ssl.Purpose.CLIENT_AUTH).load_cert_chain(self.certificate, self.key)
            except (ssl.SSLError, OSError) as error:
                found = f"files that make no pair ({error.strerror or error})"
                raise InputError("robot serve", "--certificate", found, "a PEM certificate and its key") from None
        return self

    def open(self) -> socket.socket:
        """Return a socket that listens there.

        Raises:
            InputError: The address is taken, or none of this machine's.
        """
        found = None
        try:
            kind, _, _, _, where = socket.getaddrinfo(self.host, self.port, type=socket.SOCK_STREAM)[0]
            # asyncio turns Nagle's algorithm off for sockets that say that they are TCP; with it ticks come 40 ms late
            found = socket.socket(kind, socket.SOCK_STREAM, socket.IPPROTO_TCP)
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            found.bind(where)
            found.listen()  # clients that come before the network runs wait
        except OSError as error:
            if found is not None:
                found.close()
            said = f"{self.host}:{self.port}: {(error.strerror or 'an error').lower()}"
            raise InputError("robot serve", "--port", said, "an address of this machine that is free") from None
        return found

    def url(self, port: int) -> str:
        """Return where clients find it."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"http{'s' if self.certificate else ''}://{host}:{port}"


def serve(
    connect: Callable[[], Backend], arm: Arm, limits: Limits, address: Address, folder: Path, *, armed: bool,
    feeler: Feeler | None = None, ready: Callable[[str], None] = print,
) -> None:  # fmt: skip
    """Serve an arm until Ctrl-C or SIGTERM; then it comes to a standstill. Of a process's main thread.

    Args:
        connect: Returns the arm; called once all else is known to be right.
        arm: Its description, whose capsules are kept in the workspace.
        limits: What it is held to.
        address: Where to listen.
        folder: Where ``ticks.csv`` and ``limits.yaml`` go.
        armed: Whether commands are taken from the start; otherwise the first stop is re-armed first.
        feeler: Tells touch; None for none.
        ready: Called with the address once the service listens.

    Raises:
        InputError: The address, the folder, a number of joints, or an extra that is not installed.
    """
    from .app import check_app

    check_app()
    check_output(folder)
    check_new(folder)
    with address.check().open() as listening:
        backend = connect()
        check_joints(limits, backend.num_dofs, "robot serve")
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "limits.yaml").write_text(written(limits))
        guard = Guard(limits, Workspace(arm, limits.workspace_low, limits.workspace_high).clearance, armed)
        service = Service(backend, guard, folder, feeler)
        network = _network(service, address)
        _give_way()
        service.start()
        try:
            ready(address.url(listening.getsockname()[1]))
            network.run(sockets=[listening])
        except KeyboardInterrupt:
            pass
        finally:
            for number in (signal.SIGINT, signal.SIGTERM):  # a second one must not break off the way to standstill
                signal.signal(number, signal.SIG_IGN)
            service.close()


def _network(service: Service, address: Address) -> uvicorn.Server:
    import uvicorn

    from .app import make_app

    app = Access(make_app(service), address.token, partial(service.refuse, "not let in"))
    return uvicorn.Server(uvicorn.Config(
        app, log_level="warning", access_log=False, server_header=False, proxy_headers=False, lifespan="off",
        ws="websockets-sansio", ws_max_size=LARGEST, ws_ping_interval=5.0, ws_ping_timeout=5.0,
        ws_per_message_deflate=False, limit_concurrency=_CLIENTS, timeout_graceful_shutdown=1,
        ssl_certfile=address.certificate, ssl_keyfile=address.key,
    ))  # fmt: skip


def _give_way() -> None:
    """Let nothing in this process keep the control loop waiting, nor SIGTERM end it without a standstill."""
    sys.setswitchinterval(_SWITCH)
    gc.collect()
    gc.freeze()  # what was imported is not looked through again while the loop runs
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # uvicorn raises it again once it has closed
