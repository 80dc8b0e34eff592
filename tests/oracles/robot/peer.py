"""A scripted rosbridge with a robot behind it: what the protocol says, written down without roslibpy.

github.com/RobotWebTools/rosbridge_suite, ROSBRIDGE_PROTOCOL.md: JSON objects with ``op`` advertise, subscribe, publish.
"""

from __future__ import annotations

import json
import threading
import time

import numpy as np
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import serve


class Peer:
    """Six joints that do what they are told, and three fingers.

    Attributes:
        published: Every message that was published, with the time of its coming [s].
        subscribed, advertised: Topics with their types.
        fields: What joint states hold beside the header; a test may spoil it.
        talks: Whether joint states are sent.
        freezes: Whether the same joint state is said again and again.
    """

    def __init__(self, names: list[str], speeds, port: int = 0) -> None:
        """Listen; ``speeds`` turns a published message into joint speeds [rad/s]."""
        self.names, self._speeds = names, speeds
        self.published: list[tuple[float, str, dict]] = []
        self.subscribed: dict[str, str] = {}
        self.advertised: dict[str, str] = {}
        self.talks, self.freezes, self.spoil = True, False, {}
        self.q, self.qd = np.arange(1.0, 7.0), np.zeros(6)
        self._open: list = []
        self._server = serve(self._serve, "127.0.0.1", port)
        self.port = self._server.socket.getsockname()[1]
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def close(self) -> None:
        """Cut all connections and listen no more."""
        self._server.shutdown()
        for connection in self._open:
            connection.close()

    def _serve(self, connection) -> None:
        self._open.append(connection)
        threading.Thread(target=self._talk, args=(connection,), daemon=True).start()
        try:
            for text in connection:
                message = json.loads(text)
                if message["op"] == "subscribe":
                    self.subscribed[message["topic"]] = message["type"]
                elif message["op"] == "advertise":
                    self.advertised[message["topic"]] = message["type"]
                elif message["op"] == "publish":
                    self.published.append((time.monotonic(), message["topic"], message["msg"]))
                    self.qd = np.array(self._speeds(message["msg"]))
        except ConnectionClosed:
            pass

    def _talk(self, connection) -> None:
        n, step = 0, 1 / 60
        while True:
            time.sleep(step)
            self.q = self.q + self.qd * step
            n += not self.freezes
            if not (self.talks and self.subscribed):
                continue
            count = len(self.names)
            rows = {"position": self.q, "velocity": self.qd, "effort": 0.1 * np.arange(6)}
            message = {"header": {"stamp": {"secs": 100 + n // 60, "nsecs": n}}, "name": self.names}
            message |= {k: [*v.tolist(), *[9.0] * (count - 6)] for k, v in rows.items()} | self.spoil
            try:
                for topic in list(self.subscribed):
                    connection.send(json.dumps({"op": "publish", "topic": topic, "msg": message}))
            except ConnectionClosed:
                return
