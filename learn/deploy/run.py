"""A trained policy on an arm behind a service: what `bough run` does."""

from __future__ import annotations

import contextlib
import gc
import os
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import numpy as np

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ..cameras.frames import CloudSource
from ..policies.film import Film
from ..robot.client import SILENT, RobotClient, RobotError, State
from ..runs.threads import one_thread
from ..tasks.registry import TaskRegistry
from .feel import Feel
from .film import Footage
from .log import LOG, RunLog
from .loop import Episode, Link, Runner, Senses, prepare
from .plan import REACHES, Driver, read_driver
from .report import summary, write
from .truth import FAST, SLOW, TruthClouds, TwinTruth

TRUTH, NONE = "truth", "none"
_HOME = 0.1  # rad from home that an arm may begin at
_FREE = 3.0  # s that another controller may still hold the arm
_PHASE = 0.006  # s: what finding an action takes on a busy machine, well below the 16.7 to the next tick
_SWITCH = 5e-4  # s that another thread may keep the interpreter from the loop


@dataclass(frozen=True)
class Order:
    """What is to be run.

    Attributes:
        policy: Folder of a run of `bough train`.
        url: Address of the service.
        out: Folder for log, report and film.
        token: What the service wants to hear, None for nothing.
        certificate: PEM file that vouches for it, or None.
        camera: ``truth``, or what `learn.cameras` opens; None for a policy that sees none.
        calibration: ``cameras.yaml`` of the camera; None for its own.
        weights: Folder with the weights of a segmenter; None for colours.
        prompts: What it looks for; empty for its own.
        touch: ``truth``, ``none``, or a model of `bough touch train`; None for what the run's own settings name.
        target: Where the hand is to go [m]; None for where the twin says.
        episodes: How many.
        seconds: Longest episode [s]; None for the task's own.
        most_age: Age of clouds beyond which the arm is stopped [s].
        film: Form of a film of the first episode, None for none.
        fps: Pictures a second of it.
    """

    policy: Path
    url: str
    out: Path
    token: str | None = None
    certificate: Path | None = None
    camera: str | None = None
    calibration: Path | None = None
    weights: Path | None = None
    prompts: tuple[str, ...] = ()
    touch: str | None = None
    target: tuple[float, float, float] | None = None
    episodes: int = 1
    seconds: float | None = None
    most_age: float = 0.5
    film: Film | None = None
    fps: float = 10.0


@dataclass(frozen=True)
class Ended:
    """How a run ended: what it came to, and what ended it before its time, "" for nothing."""

    result: dict[str, Any]
    trouble: str


def read_order(order: Order, registry: TaskRegistry) -> tuple[Driver, str]:
    """Read an order's policy, and say what tells it of touch: ``truth``, ``none``, or a file.

    Raises:
        InputError: There is no such policy, or what it needs to see or feel is not given.
    """
    driver = read_driver(order.policy, registry)
    plan, touch = driver.plan, order.touch
    if touch is None:
        touch = getattr(plan.settings, "classifier", "") or (NONE if not plan.feeling else "")
    if not touch:
        raise InputError("run", "--touch", "none given for a policy that feels",
                         "a model.npz of bough touch train, truth (of a twin), or none")  # fmt: skip
    if any(group.name == "skin" for group in plan.parts.groups) and touch != TRUTH:
        raise InputError("run", "--touch", touch, f"{TRUTH}: no arm has a skin")
    if touch not in (TRUTH, NONE) and not Path(touch).is_file():
        raise InputError("run", "--touch", f"{touch}, which does not exist", "a model.npz of bough touch train")
    if plan.seeing != (order.camera is not None):
        found = "none given for a policy that sees" if plan.seeing else f"{order.camera} for a policy that sees nothing"
        raise InputError("run", "--camera", found, "a camera for clearing policies, none for reach")
    if plan.name == REACHES and touch != TRUTH:
        driver = read_driver(order.policy, registry, told=True)
    return driver, touch


@dataclass
class Hooks:
    """What a run tells while it goes on.

    Attributes:
        told: Called with a line about every episode.
        advance: Called with the number of episodes done since the last call.
    """

    told: Callable[[str], None]
    advance: Callable[[int], None] = lambda done: None


class Session:
    """An arm, what is seen and what is true, opened for an order; close it."""

    def __init__(self, order: Order, driver: Driver, touch: str, *, moves: bool = True) -> None:
        """Connect.

        Args:
            order: What is to be run.
            driver: Its policy.
            touch: What `read_order` said.
            moves: Whether the arm is to move.

        Raises:
            InputError: There is no service, no camera, no twin where one is needed, or the arm is not at home.
        """
        self.order, self.driver, self.touch = order, driver, touch
        self.clouds: CloudSource | None = None
        self.truth: TwinTruth | None = None
        self.robot = RobotClient(order.url, order.token, order.certificate)
        try:
            self.truth = self._open_truth()
            self.clouds = self._open_clouds()
            self.target()  # said before anything is written
            if self.truth is None:
                self._check_home()
            if moves:
                self._check_free()
        except BaseException:
            self.close()
            raise

    def _open_truth(self) -> TwinTruth | None:
        order = self.order
        needed = TRUTH in (order.camera, self.touch)
        wanted = needed or order.episodes > 1 or (self.driver.plan.name == REACHES and order.target is None)
        fast = needed or order.film is not None
        try:
            return TwinTruth(
                self.robot.url, order.token or _token_of(order.url), order.certificate, FAST if fast else SLOW
            )
        except InputError:
            if wanted:
                raise
            return None

    def _open_clouds(self) -> CloudSource | None:
        if self.order.camera is None:
            return None
        if self.order.camera == TRUTH:
            assert self.truth is not None
            return TruthClouds(self.truth)
        from ..cameras.open import open_clouds

        order = self.order
        return open_clouds(
            self.order.camera, arm=self.driver.plan.arm, url=self.robot.url, token=order.token or _token_of(order.url),
            certificate=order.certificate, calibration=order.calibration, weights=order.weights, prompts=order.prompts,
            limit=order.most_age,
        )  # fmt: skip

    def _check_home(self) -> None:
        home, q = self.driver.plan.arm.home, self.robot.latest.q
        if (np.abs(q - home) > _HOME).any():
            found = ", ".join(f"{x:.3f}" for x in q)
            allowed = ", ".join(f"{x:.3f}" for x in home)
            raise InputError(self.order.url, "joints", f"[{found}] rad", f"[{allowed}], where the policy begins")

    def _check_free(self) -> None:
        """Raise `InputError` where a stop holds, which is not ours to re-arm, or another controller the arm."""
        try:
            self.robot.wait_free(_FREE)
        except RobotError as error:
            raise InputError(self.order.url, "", str(error), "an arm that is armed and that nobody holds") from None

    def runner(self, link: Link, log: RunLog | None) -> Runner:
        """Return what runs episodes."""
        order, plan = self.order, self.driver.plan
        feel = None if self.touch in (TRUTH, NONE) else Feel(Path(self.touch), plan.arm.num_dofs)
        senses = Senses(self.clouds, self.truth, feel, self.touch == TRUTH and plan.feeling, order.most_age)
        out = Runner(self.driver, link, senses, time.monotonic, log, seconds=order.seconds)
        out.phase = _PHASE
        target = self.target()
        if target is not None:
            out.aim(target)
        return out

    def target(self) -> Array | None:
        """Return where the hand is to go [m], [3]; None for a policy that goes nowhere.

        Raises:
            InputError: The twin's scene has no target.
        """
        if self.driver.plan.name != REACHES:
            return None
        if self.order.target is not None:
            return np.array(self.order.target)
        assert self.truth is not None
        facts = self.truth.told()[1]
        if "target" not in facts:
            raise InputError(self.order.url, "", "a twin's scene without a target", "bough robot serve --scene reach")
        return facts["target"]

    def close(self) -> None:
        """Let go of everything; the arm comes to a standstill."""
        for part in (self.clouds, self.truth, self.robot):
            if part is not None:
                part.close()


def _token_of(url: str) -> str | None:
    """Return the token that an address says, as the client does."""
    password = urlsplit(url).password
    return None if password is None else unquote(password)


def run(order: Order, registry: TaskRegistry, hooks: Hooks) -> Ended:
    """Run episodes, write log, report and film.

    Returns:
        What it came to; what was written before something went wrong stays.

    Raises:
        InputError: The order cannot be carried out; nothing has moved.
        OSError: There is no room for the log; the arm was stopped.
    """
    driver, touch = read_order(order, registry)
    prepare(driver)
    session = Session(order, driver, touch)
    try:
        order.out.mkdir(parents=True, exist_ok=True)
        log = RunLog(order.out / LOG, driver.plan.arm.num_dofs)
        with contextlib.closing(log):
            return _run(session, log, hooks)
    finally:
        session.close()


def _run(session: Session, log: RunLog, hooks: Hooks) -> Ended:
    order, runner = session.order, session.runner(session.robot, log)
    footage = Footage(session.driver.plan.arm, 1.0 / order.fps)
    runner.frames = footage.take if order.film else None
    episodes: list[Episode] = []
    trouble = ""
    with one_thread():
        try:
            with first_in_line():
                for number in range(order.episodes):
                    _one(session, runner, number, episodes)
                    runner.frames = None
                    hooks.told(_said(episodes[-1]))
                    hooks.advance(1)
        except RobotError as error:
            trouble = str(error)
        except KeyboardInterrupt:
            trouble = "interrupted"
    result = summary(episodes, _about(session, trouble))
    if footage.moments:
        result["film"] = _filmed(session, footage)
    write(order.out, result)
    return Ended(result, trouble)


def _filmed(session: Session, footage: Footage) -> str:
    """Write the film of an episode; return the name of what was written."""
    from ..policies.play import write_frames

    order, settings = session.order, session.driver.plan.settings
    assert order.film is not None
    frames = footage.frames(session.target(), getattr(settings, "within", 0.0))
    return write_frames(order.out, frames, order.film, order.fps)


def _one(session: Session, runner: Runner, number: int, episodes: list[Episode]) -> None:
    """Run one episode: on a twin that holds scenes in the scene of that number."""
    if session.truth is not None:
        runner.begin(number)
    found = runner.run(number)
    episodes.append(found)
    if session.truth is None and found.ended not in ("done", "time"):
        raise RobotError(found.ended)


def _about(session: Session, trouble: str) -> dict[str, Any]:
    order, trained = session.order, session.driver.trained
    return {"task": trained.name, "policy": str(order.policy), "iteration": trained.iteration,
            "robot": session.robot.url, "camera": order.camera or NONE, "touch": session.touch,
            "most_age_s": order.most_age, "trouble": trouble}  # fmt: skip


def _said(e: Episode) -> str:
    truth = "" if e.success is None else ", success" if e.success else ", no success"
    return f"episode {e.number}: {e.seconds:.1f} s, ended by {e.ended}{truth}"


class Withheld:
    """A link that tells what it would send instead of sending it (`learn.deploy.loop.Link`)."""

    def __init__(self, link: Link, told: Callable[[State, Array], None]) -> None:
        """Take the link, and what is called with every answer."""
        self._link, self._told = link, told

    @property
    def latest(self) -> State:
        """The arm's newest state."""
        return self._link.latest

    def next(self, after: State | None = None, timeout: float = SILENT) -> State:
        """Return the arm's next state."""
        return self._link.next(after, timeout)

    def send(self, velocity: Array, state: State) -> int:
        """Tell what would be sent."""
        self._told(state, velocity)
        return 0

    def stop(self) -> int:
        """Stop nothing: nothing moves by this."""
        return 0

    def arm(self, number: int | None = None) -> None:
        """Arm nothing."""


def dry_run(order: Order, registry: TaskRegistry, told: Callable[[State, Array], None]) -> Episode:
    """Look, decide and tell for an episode; the arm is asked for nothing.

    Raises:
        InputError: As `run`.
        RobotError: The camera or the service is gone.
    """
    driver, touch = read_order(order, registry)
    prepare(driver)
    session = Session(order, driver, touch, moves=False)
    try:
        with one_thread():
            runner = session.runner(Withheld(session.robot, told), None)
            return runner.run(0)
    finally:
        session.close()


@contextlib.contextmanager
def first_in_line() -> Iterator[None]:
    """Let nothing in this process keep its loop waiting, and where the system allows it, no other either."""
    before, own = sys.getswitchinterval(), None
    sys.setswitchinterval(_SWITCH)
    gc.collect()
    gc.freeze()
    with contextlib.suppress(AttributeError, OSError):
        own = os.sched_getscheduler(0)
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(1))
    try:
        yield
    finally:
        if own is not None:
            with contextlib.suppress(OSError):
                os.sched_setscheduler(0, own, os.sched_param(0))
        gc.unfreeze()
        sys.setswitchinterval(before)
