"""``bough camera``: what cameras see, with masks and cloud, to check a calibration by."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from ...sim.base.console import shown, start_warp, tell
from ...sim.base.errors import InputError
from ..base.exit_codes import ExitCode

if TYPE_CHECKING:
    from ...learn.cameras.calibration import Rig
    from ...learn.cameras.workers import Segmenter


@dataclass(frozen=True)
class Camera:
    """Check cameras: masks over a picture of each, and the cloud beside the arm.

    Writes masks.png (branches blue, line yellow, leaves green; the arm's model in magenta dots, which must cover the
    arm that is seen; depth on the right) and cloud.png. Masks go by colour, or by text with --weights, which needs
    pip install -e '.[vision]' in bough's folder. Exit code 0: done; 2: bad input.

    Attributes:
        source: twin, realsense:SERIAL[,SERIAL...], a folder with cameras.yaml and frames.csv, or a ROS bag.
        out: Folder to write.
        calibration: cameras.yaml: where cameras are. A folder has its own, a twin two by its sides.
        robot: Address of bough robot serve --backend twin, for twin.
        token_file: File whose first line the service wants clients to say; readable for its owner alone.
        certificate: PEM file that vouches for a service over https.
        wrist: Of the Jaco 2 that is cut out of the cloud.
        joints: Its joint positions [rad], where the pictures come without any.
        weights: Folder with a folder of safetensors each for Grounding DINO and SAM-HQ. Nothing is fetched.
        prompt: With --weights, two texts: what is a branch, what is the line.
        json: Print the result as JSON.
    """

    source: tyro.conf.Positional[str]
    out: Path
    calibration: Path | None = None
    robot: str | None = None
    token_file: Path | None = None
    certificate: Path | None = None
    wrist: Literal["curved", "spherical"] = "curved"
    joints: tuple[float, ...] = ()
    weights: Path | None = None
    prompt: tuple[str, ...] = ()
    json: bool = False

    def run(self) -> int:
        """Look; return 0."""
        import numpy as np

        from ...learn.cameras.check import look, spread
        from ...learn.cameras.open import open_source
        from ...learn.robot.access import read_token
        from ...sim.arms.jaco2 import jaco2

        arm = jaco2(self.wrist)
        if len(self.joints) not in (0, arm.num_dofs):
            raise InputError("camera", "--joints", f"{len(self.joints)} numbers", f"{arm.num_dofs}, one a joint")
        token = None if self.token_file is None else read_token(self.token_file)
        start_warp()
        source, rig = open_source(self.source, url=self.robot, token=token, certificate=self.certificate,
                                  calibration=self.calibration)  # fmt: skip
        found = look(source, rig, self._segmenter(rig), arm, np.array(self.joints) if self.joints else None, self.out)
        said = {"branches": len(found.clouds.branches), "line": len(found.clouds.line), "cameras": found.shares,
                "out": str(self.out)}  # fmt: skip
        tell(f"{spread(found.clouds)}. Look at {shown(self.out)}/masks.png and cloud.png", said, self.json)
        return ExitCode.DONE

    def _segmenter(self, rig: Rig) -> Segmenter:
        from ...learn.cameras.open import segmenter_of

        return segmenter_of(rig, self.weights, self.prompt)()
