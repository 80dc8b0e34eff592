"""``bough run``: a trained policy on an arm."""

from __future__ import annotations

import signal
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import tyro

from ...learn.policies.film import Film
from ...learn.tasks.registry import TaskRegistry, known_tasks
from ...learn.tasks.task import require_rsl_rl
from ...sim.base.console import bar, shown, start_warp, tell, warn
from ...sim.base.errors import InputError
from ..base.exit_codes import ExitCode

if TYPE_CHECKING:
    from ...learn.deploy.run import Order
    from ...learn.robot.client import State
    from ...sim.base.types import Array


@dataclass(frozen=True)
class Run:
    """Run a trained clearing or reaching policy on an arm behind bough robot serve, 60 times a second.

    The policy sees what it saw in training. What it cannot see any more stops the arm, and nothing here starts it
    again. On a twin (bough robot serve --scene) every episode is an unseen scene, and success is the task's own.
    Writes run.csv (every tick), run.json, report.html and, if asked for, a film. Needs pip install -e '.[robot,train]'
    in bough's folder. Exit code 0: done; 1: the camera, the service or the disk failed, or the arm was stopped; 2: bad
    input.

    Attributes:
        policy: Folder that bough train wrote, of powerline or reach.
        robot: Address of the service.
        out: Folder to write to; it must not hold a run's log yet. Not needed with --dry-run.
        camera: Where a clearing policy's clouds come from: truth (what is there in the twin), twin (cameras that look
            at it), realsense:SERIAL, or another one of docs/cameras.md.
        calibration: cameras.yaml of the camera, where it has none of its own.
        weights: Folder with the weights of a segmenter (docs/cameras.md); one that goes by colour if not given.
        prompt: What the weights look for: branches, and the line.
        touch: What tells a policy of touch: model.npz that bough touch train wrote, truth (the twin's forces), or none.
            The run's own classifier if not given.
        target: x y z where the hand is to go, in the arm's base frame [m]; the twin's if not given.
        episodes: How many; more than one takes a twin.
        seconds: Longest episode; the task's own if not given.
        most_age: Age of what the policy sees [s] beyond which the arm is stopped.
        dry_run: Print what would be sent, for a second if --seconds says nothing else, and send nothing.
        film: Film the first episode: gif, an animation, or png, numbered pictures.
        fps: Pictures a second of the film.
        token_file: File whose first line the service wants to hear.
        certificate: PEM file that vouches for a service over https.
        json: Print the result as JSON instead of a sentence.
    """

    policy: tyro.conf.Positional[Path]
    robot: str
    out: Path | None = None
    camera: str | None = None
    calibration: Path | None = None
    weights: Path | None = None
    prompt: tuple[str, ...] = ()
    touch: str | None = None
    target: tuple[float, float, float] | None = None
    episodes: int = 1
    seconds: float | None = None
    most_age: float = 0.5
    dry_run: bool = False
    film: Film | None = None
    fps: float = 10.0
    token_file: Path | None = None
    certificate: Path | None = None
    json: bool = False

    def run(self, registry: TaskRegistry | None = None) -> int:
        """Run, say what it came to; return the exit code."""
        self._check()
        require_rsl_rl()
        start_warp()
        registry = registry or known_tasks()
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        return self._dry(registry) if self.dry_run else self._wet(registry)

    def _check(self) -> None:
        """Raise `InputError` for options that cannot be."""
        if not self.policy.is_dir():
            raise InputError(self.policy, "", "no such folder", "a folder that bough train wrote")
        for name, value, least, most in (
            ("--episodes", float(self.episodes), 1.0, 1e6), ("--most-age", self.most_age, 0.02, 10.0),
            ("--fps", self.fps, 0.1, 30.0), ("--seconds", 1.0 if self.seconds is None else self.seconds, 0.02, 3600.0),
        ):  # fmt: skip
            if not least <= value <= most:
                raise InputError("run", name, f"{value:g}", f"{least:g} to {most:g}")
        if self.out is None and not self.dry_run:
            raise InputError("run", "--out", "nothing", "a folder to write to, or --dry-run")
        if self.dry_run and (self.episodes > 1 or self.film):
            raise InputError("run", "--dry-run", "with --episodes or --film", "one of them: nothing moves")
        if self.out is not None and (self.out / "run.csv").exists():
            raise InputError(self.out, "--out", "a log", "a folder without one: logs are never overwritten")

    def _order(self) -> Order:
        from ...learn.deploy.run import Order
        from ...learn.robot.access import read_token

        token = None if self.token_file is None else read_token(self.token_file)
        seconds = 1.0 if self.seconds is None and self.dry_run else self.seconds
        return Order(
            self.policy, self.robot, self.out or Path(), token=token, certificate=self.certificate, camera=self.camera,
            calibration=self.calibration, weights=self.weights, prompts=self.prompt, touch=self.touch,
            target=self.target, episodes=self.episodes, seconds=seconds, most_age=self.most_age, film=self.film,
            fps=self.fps,
        )  # fmt: skip

    def _wet(self, registry: TaskRegistry) -> int:
        from ...learn.deploy.report import sentence
        from ...learn.deploy.run import Hooks, run

        assert self.out is not None
        with bar("running", self.episodes) as advance:
            ended = run(self._order(), registry, Hooks(lambda line: None, advance))
        if ended.trouble:
            warn(f"the run ended early, the arm stands: {ended.trouble}")
        tell(f"{sentence(ended.result)} Wrote {shown(self.out)}/report.html", ended.result, self.json)
        if ended.trouble == "interrupted":
            return ExitCode.INTERRUPTED
        return ExitCode.FAILED if ended.trouble else ExitCode.DONE

    def _dry(self, registry: TaskRegistry) -> int:
        from ...learn.deploy.run import dry_run
        from ...learn.robot.client import RobotError

        said: list[list[float]] = []
        try:
            dry_run(self._order(), registry, lambda state, speeds: self._would(state, speeds, said))
        except RobotError as error:
            warn(str(error))
            return ExitCode.FAILED
        tell(f"Sent nothing in {len(said)} ticks", {"would_send_rad_s": said}, self.json)
        return ExitCode.DONE

    def _would(self, state: State, speeds: Array, said: list[list[float]]) -> None:
        said.append([float(v) for v in speeds])
        if not self.json:
            print(f"tick {state.tick}: would send {' '.join(f'{v:+.4f}' for v in speeds)} rad/s", flush=True)
