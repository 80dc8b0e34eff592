"""Where pictures come from: what every source of frames is, and the twin."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
from numpy.typing import NDArray

from ...sim.base.errors import InputError, shortened
from ...sim.base.extras import install_hint
from ...sim.base.types import Array
from ...sim.cameras.stereo import D405_HEIGHT, D405_WIDTH, StereoDepth
from .calibration import Mounted, Rig

if TYPE_CHECKING:
    from ...sim.cameras.pinhole import Pinhole

RATE = 30.0
"""Pictures a second."""


@dataclass(frozen=True)
class Taken:
    """A picture as it comes from its source, whose place in the base frame is not worked out yet.

    Attributes:
        camera: Number of the camera in the rig.
        time: When it was taken, on the clock of `time.monotonic` [s].
        colour: sRGB, uint8 [H, W, 3].
        depth: [m], float32 [H, W]; 0 where there is none.
        intrinsics: fx, fy, cx, cy [pixels].
        q: Joint positions then [rad], [D], where the source knows them.
        ground: Height of the ground [m], where the source knows it and cameras.yaml may not.
    """

    camera: int
    time: float
    colour: NDArray[np.uint8]
    depth: NDArray[np.float32]
    intrinsics: tuple[float, float, float, float]
    q: Array | None = None
    ground: float = np.nan


class Source(Protocol):
    """Something that takes pictures. It is described in one process and opened in another.

    Attributes:
        sizes: Height and width of each camera's pictures [pixels].
    """

    sizes: tuple[tuple[int, int], ...]

    def frames(self) -> Iterator[Taken]:
        """Open the cameras and yield pictures as they are taken.

        Raises:
            InputError: A camera cannot be opened, or what is recorded cannot be read.
        """
        ...


class TwinSource:
    """D405s that look at the twin of a service: it tells its world, and the pictures are traced here."""

    def __init__(
        self, url: str, rig: Rig, *, token: str | None = None, certificate: str | None = None, seed: int = 0
    ) -> None:  # fmt: skip
        """Take the address.

        Args:
            url: Of ``bough robot serve --backend twin``: ``http://HOST:PORT`` or ``https://HOST:PORT``.
            rig: Where the cameras are; without ``size_px`` their pictures are 424 x 240.
            token: What clients of the service say.
            certificate: PEM file that vouches for the service, None for what the system trusts.
            seed: Of the noise.
        """
        self._url, self._rig, self._token, self._certificate, self._seed = url, rig, token, certificate, seed
        sizes = {tuple(c.size_px or (D405_WIDTH // 2, D405_HEIGHT // 2)) for c in rig.cameras}
        if len(sizes) > 1:
            raise InputError("cameras.yaml", "size_px", f"{sorted(sizes)}", "one size for all cameras of a twin")
        self._width, self._height = sizes.pop()
        self.sizes = ((self._height, self._width),) * len(rig.cameras)

    def frames(self) -> Iterator[Taken]:
        """Yield what each camera sees, about 30 times a second."""
        from ...sim.cameras.camera import Cameras
        from ...sim.cameras.described import unpacked

        batch = Cameras(self._width, self._height, seed=self._seed)
        with self._connected() as socket:
            while True:
                due = time.monotonic() + 1.0 / RATE
                asked = time.monotonic()
                socket.send("next")
                try:
                    scene = unpacked(socket.recv())
                except (ValueError, TypeError, json.JSONDecodeError) as error:
                    raise InputError(self._url, "/twin/scene", shortened(str(error)), "a scene of a twin") from None
                taken = asked - max(scene.age, 0.0)  # no later than it was: the scene was told after it was asked for
                shot = batch.shoot(scene.world, [self._eye(c, scene.hand_position, scene.hand_rotation)
                                                 for c in self._rig.cameras])  # fmt: skip
                for k, camera in enumerate(self._rig.cameras):
                    yield Taken(k, taken, shot.colour[k], shot.depth[k], self._lens(camera), None, scene.world.ground)
                time.sleep(max(0.0, due - time.monotonic()))

    def _connected(self):  # type: ignore[no-untyped-def]  # websockets' own type, where it is installed
        try:
            from websockets.exceptions import WebSocketException
            from websockets.sync.client import connect
        except ImportError:
            raise InputError(self._url, "", "no websockets library", install_hint("robot")) from None
        scheme, _, rest = self._url.partition("://")
        if scheme not in ("http", "https") or not rest:
            raise InputError("camera twin", "URL", shortened(self._url), "http://HOST:PORT or https://HOST:PORT")
        headers = {} if self._token is None else {"Authorization": f"Bearer {self._token}"}
        trust = None
        if scheme == "https":
            import ssl

            trust = ssl.create_default_context(cafile=self._certificate)
        try:
            return connect(f"{'wss' if trust else 'ws'}://{rest.rstrip('/')}/twin/scene", additional_headers=headers,
                           ssl=trust, open_timeout=10, close_timeout=0.5)  # fmt: skip
        except (OSError, WebSocketException) as error:
            found = f"no twin that answers ({shortened(' '.join(str(error).split()))})"
            raise InputError(self._url, "/twin/scene", found, "a running bough robot serve --backend twin") from None

    def _lens(self, camera: Mounted) -> tuple[float, float, float, float]:
        if camera.intrinsics_px is not None:
            fx, fy, cx, cy = camera.intrinsics_px
            return fx, fy, cx, cy
        focal = StereoDepth().focal * self._width / D405_WIDTH
        return focal, focal, (self._width - 1) / 2, (self._height - 1) / 2

    def _eye(self, camera: Mounted, hand: Array, turn: Array) -> Pinhole:
        from ...sim.cameras.pinhole import Pinhole

        pose = camera.pose((hand, turn))
        assert pose is not None
        (x, y, z), (a, b, c, d) = pose[0].tolist(), (pose[1] / np.linalg.norm(pose[1])).tolist()
        return Pinhole(self._width, self._height, self._lens(camera), (x, y, z), (a, b, c, d))
