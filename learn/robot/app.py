"""HTTP and WebSocket of a service, with FastAPI. There is no way in it to end the process or to load anything."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
from typing import Any

from fastapi import FastAPI, Request, WebSocket, WebSocketDisconnect
from fastapi.responses import JSONResponse, Response
from starlette.exceptions import HTTPException

from ...sim.base.errors import InputError
from ...sim.base.extras import install_hint
from .guard import Command, Reply
from .log import Tick
from .service import Service
from .wire import FIELDS, LARGEST, Ask, Episode, Rearm, UnreadableError, metrics, packed, read, streamed

_WATCHERS = 16
_BODY = 2.0  # s for a body to arrive
_KEEP = 0.03  # s between two renewals of a move
_SLOWEST = 3.0  # times the time that a move would take at the speed limit, and as many seconds


class Hub:
    """Hands the newest tick from the log's thread to whoever watches: a slow one misses ticks and delays nobody."""

    def __init__(self) -> None:
        self.text = ""
        self._loop: asyncio.AbstractEventLoop | None = None
        self._watchers: set[asyncio.Event] = set()

    def enter(self) -> asyncio.Event | None:
        """Return an event that is set at every tick, None where too many watch."""
        if len(self._watchers) >= _WATCHERS:
            return None
        self._loop = asyncio.get_running_loop()
        event = asyncio.Event()
        self._watchers.add(event)
        return event

    def leave(self, event: asyncio.Event) -> None:
        """Stop watching."""
        self._watchers.discard(event)

    def tell(self, tick: Tick) -> None:
        """Hand on a tick; called in the log's thread."""
        if self._loop is None or not self._watchers:
            return
        self.text = streamed(tick)
        try:
            self._loop.call_soon_threadsafe(self._wake)
        except RuntimeError:  # the network has ended already
            self._loop = None

    def _wake(self) -> None:
        for event in self._watchers:
            event.set()


def make_app(service: Service) -> FastAPI:
    """Return the application of a service, whose clients are let in by `learn.robot.access.Access`."""
    app = FastAPI(title="bough robot", docs_url=None, redoc_url=None, openapi_url=None)

    @app.exception_handler(HTTPException)
    async def _failed(_request: Request, error: HTTPException) -> JSONResponse:
        return JSONResponse({"error": error.detail}, error.status_code)

    for add in (_add_state, _add_commands, _add_twin, _add_stream, _add_scene):
        add(app, service)
    return app


def _add_state(app: FastAPI, service: Service) -> None:
    """Add what tells how the arm and the service are."""

    @app.get("/fetch_kinova_metrics")
    async def _metrics() -> JSONResponse:
        tick = service.latest
        return _error(503, "no tick yet") if tick is None else JSONResponse(metrics(tick))

    @app.get("/status")
    async def _status() -> JSONResponse:
        return JSONResponse(status_of(service))


def _add_commands(app: FastAPI, service: Service) -> None:
    """Add what moves, stops and arms."""

    @app.post("/set_dof_vel")
    async def _velocity(request: Request) -> JSONResponse:
        return await _commanded(service, request, "velocity")

    @app.post("/set_dof_pos")
    async def _position(request: Request) -> JSONResponse:
        return await _commanded(service, request, "position")

    @app.post("/set_gripper")
    async def _gripper(request: Request) -> JSONResponse:
        return await _commanded(service, request, "gripper")

    @app.post("/stop")
    async def _stop() -> JSONResponse:
        service.stop("asked for over HTTP")
        return JSONResponse({"message": "stopped", "stop": service.guard.stop and service.guard.stop.number})

    @app.post("/arm")
    async def _arm(request: Request) -> JSONResponse:
        try:
            message = read(Rearm, await _body(request))
        except UnreadableError as error:
            return _refused(service.refuse("malformed", str(error)))
        reply = service.arm(message.stop)
        return JSONResponse({"message": "armed"}) if reply.accepted else _refused(reply)


def _add_twin(app: FastAPI, service: Service) -> None:
    """Add what a twin tells and does that no arm could."""

    @app.get("/twin/truth")
    async def _truth() -> Response:
        if service.twin is None:
            return _error(404, "no twin that holds a scene: bough robot serve --scene")
        data = packed(await asyncio.to_thread(service.twin.truth))
        return Response(data, media_type="application/octet-stream")

    @app.post("/twin/episode")
    async def _episode(request: Request) -> JSONResponse:
        if service.twin is None:
            return _error(404, "no twin that holds a scene: bough robot serve --scene")
        try:
            message = read(Episode, await _body(request))
        except UnreadableError as error:
            return _refused(service.refuse("malformed", str(error)))
        try:
            reply = await asyncio.to_thread(service.stage, message.number)
        except InputError as error:
            return _error(400, str(error))
        return JSONResponse({"message": "a new scene"}) if reply.accepted else _refused(reply)


def _add_stream(app: FastAPI, service: Service) -> None:
    """Add the socket that tells every tick and hears velocities."""
    hub, names = Hub(), itertools.count(1)
    service.listen(hub.tell)

    @app.websocket("/stream")
    async def _stream(socket: WebSocket) -> None:
        event = hub.enter()
        if event is None:
            await socket.close(1013)
            return
        name = f"stream {next(names)}"
        try:
            await socket.accept()
            told, heard = asyncio.create_task(_tell(socket, hub, event)), asyncio.create_task(
                _hear(socket, service, name))  # fmt: skip
            done, pending = await asyncio.wait({told, heard}, return_when=asyncio.FIRST_COMPLETED)
            for task in pending:
                task.cancel()
            await asyncio.gather(*done, *pending, return_exceptions=True)
        finally:
            hub.leave(event)
            service.release(name)


def _add_scene(app: FastAPI, service: Service) -> None:
    """Add the socket of the twin's camera."""

    @app.websocket("/twin/scene")
    async def _scene(socket: WebSocket) -> None:
        if service.scene is None:
            await socket.close(1008)
            return
        await socket.accept()
        with contextlib.suppress(WebSocketDisconnect):
            while True:  # one answer for every message, so that a slow camera delays itself alone
                await socket.receive_text()
                await socket.send_bytes(await asyncio.to_thread(service.scene))


def status_of(service: Service) -> dict[str, Any]:
    """Return state, stop, counts and pace of a service as plain values."""
    guard, tick = service.guard, service.latest
    stop = guard.stop
    return {
        "state": "starting" if tick is None else tick.state, "stop": 0 if stop is None else stop.number,
        "cause": "" if stop is None else stop.cause, "danger": guard.danger, "controller": guard.controller,
        "accepted": guard.accepted, "clipped": guard.clipped, "refused": dict(guard.refused), "pace": service.pace,
    }  # fmt: skip


def _error(status: int, text: str) -> JSONResponse:
    return JSONResponse({"error": text}, status)


def _refused(reply: Reply) -> JSONResponse:
    """Return 400 for what no state of the arm would make right, 409 for what is refused now."""
    status = 409 if reply.reason in ("stopped", "held", "duplicate", "out of order", "late", "not stopped") else 400
    return JSONResponse({"error": reply.text, "reason": reply.reason}, status)


async def _body(request: Request) -> bytes:
    async def collect() -> bytes:
        """Return the request's bytes; raise `UnreadableError` as soon as there are more than `LARGEST`."""
        data = b""
        async for part in request.stream():
            data += part
            if len(data) > LARGEST:
                raise UnreadableError(f"more than {LARGEST} bytes")
        return data

    try:
        return await asyncio.wait_for(collect(), _BODY)
    except asyncio.TimeoutError:
        raise UnreadableError("a body that does not end") from None


def _ask(data: bytes) -> Ask:
    message: Ask = read(Ask, data)
    if message.kind is None:
        raise UnreadableError(f"{', '.join(FIELDS.values())}: one of them is needed")
    return message


async def _commanded(service: Service, request: Request, kind: str) -> JSONResponse:
    try:
        message = _ask(await _body(request))
        if message.kind != kind:
            raise UnreadableError(f"{FIELDS[kind]} is needed")
    except UnreadableError as error:
        return _refused(service.refuse("malformed", str(error)))
    assert message.kind is not None
    who = f"http {request.client.host if request.client else ''} {message.controller or ''}".strip()
    reply, command = service.command(who, message.kind, message.values, message.seq, message.tick)
    if not reply.accepted:
        return _refused(reply)
    if kind == "position":
        return await _moved(service, request, command)
    if kind == "gripper":
        return JSONResponse({"message": "gripper set"})
    return JSONResponse({"message": "joint velocities set", "clipped": reply.clipped})


async def _moved(service: Service, request: Request, command: Command) -> JSONResponse:
    """Keep a move's lease until it has arrived: the request is the lease, and ends with its client."""
    loop, limits, tick = asyncio.get_running_loop(), service.guard.limits, service.latest
    way = 0.0 if tick is None else float((abs(command.values - tick.q) / limits.speed).max())
    end = loop.time() + _SLOWEST * (1.0 + way)
    while service.keep(command):
        if service.guard.arrived:
            service.release(command.controller)
            return JSONResponse({"message": "joint angles set"})
        if loop.time() > end or await request.is_disconnected():
            service.release(command.controller)
            return _error(409, "the position was not reached in time")
        await asyncio.sleep(_KEEP)
    stop = service.guard.stop
    return _error(409, "another command came" if stop is None else f"stop {stop.number}: {stop.cause}")


async def _tell(socket: WebSocket, hub: Hub, event: asyncio.Event) -> None:
    while True:
        await event.wait()
        event.clear()
        await socket.send_text(hub.text)


async def _hear(socket: WebSocket, service: Service, name: str) -> None:
    """Take commands from a stream; each is answered with its number and, where it is refused, the reason."""
    while True:
        try:
            message = await socket.receive()
        except WebSocketDisconnect:
            return
        if message["type"] == "websocket.disconnect":
            return
        data = message.get("bytes") or (message.get("text") or "").encode()
        await socket.send_text(json.dumps(_answered(service, name, data)))


def _answered(service: Service, name: str, data: bytes) -> dict[str, Any]:
    try:
        message = _ask(data)
    except UnreadableError as error:
        service.refuse("malformed", str(error))
        return {"seq": None, "accepted": False, "reason": "malformed", "error": str(error)}
    assert message.kind is not None
    reply, _ = service.command(name, message.kind, message.values, message.seq, message.tick)
    out: dict[str, Any] = {"seq": message.seq, "accepted": reply.accepted}
    return out | ({"clipped": reply.clipped} if reply.accepted else {"reason": reply.reason, "error": reply.text})


def check_app() -> None:
    """Raise `InputError` where what the network needs is not installed."""
    try:
        import uvicorn  # noqa: F401
        import websockets  # noqa: F401
    except ModuleNotFoundError as error:
        raise InputError("robot", "", f"no {error.name}", install_hint("robot")) from None
