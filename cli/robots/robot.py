"""``bough robot``: an arm behind a service that keeps it to its limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
import yaml

from ...sim.base.console import shown, start_warp, tell, warn
from ...sim.base.errors import InputError, check_seed
from ..base.exit_codes import ExitCode

if TYPE_CHECKING:
    from ...learn.robot.backend import Backend
    from ...learn.robot.limits import Limits
    from ...learn.robot.touch import Feeler
    from ...sim.arms.arm import Arm

Wrist = Literal["curved", "spherical"]


@dataclass(frozen=True)
class Serve:
    """Serve an arm over HTTP and WebSocket, 60 times a second, within limits, until Ctrl-C.

    GET /fetch_kinova_metrics, POST /set_dof_vel and /set_dof_pos as jayadeepj/pcap has them; /stream, /status, /stop
    and /arm beside them. A velocity holds for 100 ms. A stop holds until it is re-armed. Writes ticks.csv, a line for
    every tick, and limits.yaml. Needs pip install -e '.[robot]' in bough's folder. Exit code 0: done; 2: bad input.

    Attributes:
        out: Folder for the log; it must not hold one yet.
        backend: The twin is bough's own Jaco 2 before a tree, in real time; branch is one that grasps a branch to be
            measured (bough probe), and writes branch.yaml beside the log; rosbridge is a robot.
        wrist: Of the Jaco 2.
        host: Address to listen at. Anything but this machine itself needs --token-file.
        port: Port to listen at; 0 takes any that is free.
        token_file: File whose first line every client must say, as "Authorization: Bearer ..." or in the address,
            http://user:TOKEN@host:port; readable for its owner alone.
        certificate: PEM file, for https.
        key: Its key.
        limits: limits.yaml; `bough robot limits` prints one.
        touch: model.npz that bough touch train wrote: the arm stops above the limits' probability of touch.
        scene: What the twin holds: powerline or reach, an unseen test world of the task (bough evaluate's), or the
            folder of a run, for that of its task. Needs the extra train. A tree as of reach if none is given.
        seed: Of the twin's tree and where it stands, or of its branch.
        segments: Of the branch.
        away: How much further off the twin's tree stands [m]; 10 leaves the arm alone.
        effect: A hidden effect of the twin's branches, NAME:PARAMETER=VALUE[,PARAMETER=VALUE...] in SI units, such as
            dry_friction:torque_Nm=0.05; once for each effect. Of a branch NAME[:joint=J][,size=S], such as
            dry_friction:joint=1,size=0.2; the size is the change of the motion over its rms.
        rosbridge: HOST:PORT of rosbridge.
        driver: What is behind rosbridge.
        robot_name: The robot's name in Kinova's driver.
        joints: Names of the joints in joint states, in the arm's order; the first that are no fingers if none is given.
    """

    out: Path
    backend: Literal["twin", "branch", "rosbridge"] = "twin"
    wrist: Wrist = "curved"
    host: str = "127.0.0.1"
    port: int = 3738
    token_file: Path | None = None
    certificate: Path | None = None
    key: Path | None = None
    limits: Path | None = None
    touch: Path | None = None
    scene: str | None = None
    seed: int = 0
    segments: int = 3
    away: float = 0.0
    effect: tyro.conf.UseAppendAction[tuple[str, ...]] = ()
    rosbridge: str = "127.0.0.1:9090"
    driver: Literal["kinova", "ros2_control"] = "kinova"
    robot_name: str = "j2n6s300"
    joints: tuple[str, ...] = ()

    def run(self) -> int:
        """Serve; return 0 after Ctrl-C or SIGTERM."""
        check_seed("robot serve", self.seed)
        if not 0.0 <= self.away <= 1000.0:
            raise InputError("robot serve", "--away", f"{self.away:g}", "0 to 1000 m")
        if self.scene is not None and (self.backend != "twin" or self.away or self.effect or self.wrist != "curved"):
            raise InputError("robot serve", "--scene", "with --backend, --away, --effect or --wrist",
                             "a twin's scene alone: the task says what is in it")  # fmt: skip
        from ...learn.robot.access import is_loopback, read_token
        from ...learn.robot.app import check_app
        from ...learn.robot.limits import default_limits, read_limits
        from ...learn.robot.serve import Address, serve
        from ...sim.arms.jaco2 import jaco2

        check_app()
        arm = jaco2(self.wrist)
        token = None if self.token_file is None else read_token(self.token_file)
        address = Address(self.host, self.port, token, self.certificate, self.key).check()
        limits = default_limits(arm) if self.limits is None else read_limits(self.limits, arm)
        if not is_loopback(self.host) and self.certificate is None:
            warn(f"{self.host} without --certificate: the token can be read on its way")
        start_warp()
        feeler = self._feeler(arm)
        armed = self.backend != "rosbridge"
        serve(lambda: self._arm(arm), arm, limits, address, self.out, armed=armed, feeler=feeler, ready=self._said)
        print(f"The arm stands still. Every tick is in {shown(self.out)}/ticks.csv", flush=True)
        return ExitCode.DONE

    def _feeler(self, arm: Arm) -> Feeler | None:
        from ...learn.robot.touch import Feeler
        from ...learn.touch.model import read_model

        if self.touch is None:
            return None
        model = read_model(self.touch)
        if model.num_dofs != arm.num_dofs:
            raise InputError(self.touch, "", f"a model for {model.num_dofs} joints", f"{arm.num_dofs}, as the arm has")
        return Feeler(model)

    def _arm(self, arm: Arm) -> Backend:
        if self.backend == "rosbridge":
            from ...learn.robot.rosbridge import RosBridge

            host, colon, port = self.rosbridge.rpartition(":")
            if not (colon and host and port.isdigit() and 0 < int(port) < 65536):
                raise InputError("robot serve", "--rosbridge", f"'{self.rosbridge}'", "HOST:PORT")
            return RosBridge(arm, host, int(port), self.driver, name=self.robot_name, joints=self.joints)
        if self.backend == "branch":
            return self._branch(arm)
        if self.scene is not None:
            from ...learn.deploy.stage import Stage, scene_plan

            return Stage(scene_plan(self.scene, "robot serve"), self.seed)
        from ...learn.robot.twin import Twin
        from ...sim.engine.effect_words import read_effects

        return Twin(arm, seed=self.seed, away=self.away, effects=read_effects(self.effect))

    def _branch(self, arm: Arm) -> Backend:
        from ...learn.robot.twin_branch import BranchTwin, read_hidings

        if not 1 <= self.segments <= 6:
            raise InputError("robot serve", "--segments", str(self.segments), "1 to 6")
        hidings = read_hidings(self.effect, self.segments)
        twin = BranchTwin(arm, seed=self.seed, segments=self.segments, hidings=hidings)
        self.out.mkdir(parents=True, exist_ok=True)
        twin.write_structure(self.out / "branch.yaml")
        return twin

    def _said(self, url: str) -> None:
        armed = "armed" if self.backend != "rosbridge" else 'not armed yet: POST /arm with {"stop": 1}'
        print(f"Serving {url} ({self.backend}, {armed}). Ctrl-C ends", flush=True)


@dataclass(frozen=True)
class PrintLimits:
    """Print limits of the Jaco 2, as a file for --limits. Exit code 0: done; 2: bad input.

    Attributes:
        scene: powerline or reach, or the folder of a run of bough train, as for serve: the limits within which its
            policies learn. Joints speed up as fast as actions can ask for, and servos give all of their torque. The
            defaults are narrower; with them such a policy is slower and is stopped now and then.
        wrist: Of the Jaco 2; a scene has its own.
        json: Print them as JSON instead of YAML; null where a joint turns without end.
    """

    scene: str | None = None
    wrist: Wrist = "curved"
    json: bool = False

    def run(self) -> int:
        """Print; return 0."""
        from ...learn.robot.limits import written

        text = written(self._limits())
        tell(text, {key: _finite(value) for key, value in yaml.safe_load(text).items()}, self.json)
        return ExitCode.DONE

    def _limits(self) -> Limits:
        from ...learn.robot.limits import default_limits
        from ...sim.arms.jaco2 import jaco2

        if self.scene is None:
            return default_limits(jaco2(self.wrist))
        from ...learn.deploy.plan import limits_of
        from ...learn.deploy.stage import scene_plan

        return limits_of(scene_plan(self.scene, "robot limits"))


def _finite(value: Any) -> Any:
    """Return what JSON can hold: null in the place of an infinite number."""
    if isinstance(value, list):
        return [_finite(v) for v in value]
    return None if isinstance(value, float) and math.isinf(value) else value


@dataclass(frozen=True)
class Robot:
    """Serve an arm within limits over the network; print its limits.

    Attributes:
        work: What to do.
    """

    work: (
        Annotated[Serve, tyro.conf.subcommand("serve", prefix_name=False)]
        | Annotated[PrintLimits, tyro.conf.subcommand("limits", prefix_name=False)]
    )

    def run(self) -> int:
        """Do it; return the exit code."""
        return self.work.run()
