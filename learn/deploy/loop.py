"""The loop between a trained policy and an arm: see, decide, ask for speeds, 60 times a second.

A policy step begins with the newest state and clouds; the control periods in it follow the ticks of the service, which
comes once a sixtieth of a second. Whatever keeps the loop from seeing ends the motion: it stops the arm, and nothing in
it starts the arm again.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import torch

from ...sim.arms.arm import forward_kinematics
from ...sim.base.types import Array
from ..cameras.frames import Clouds, CloudSource
from ..robot.client import SILENT, LostError, RefusedError, RobotError, State, StoppedError
from ..robot.guard import PERIOD
from .feel import Feel
from .log import Answer, RunLog
from .observer import Observer
from .plan import Driver
from .steering import Steering
from .truth import Facts, Truth, succeeded

PATIENCE = 60.0
"""How long the first clouds are waited for [s]: a segmenter loads its weights."""


_REST = 2.0  # s that the arm may take to rest in a new scene
_LATEST = 0.0185  # s after an answer that the next one waits for its tick


class BlindError(RobotError):
    """What the policy sees is too old, or not there."""


class Link(Protocol):
    """What a loop steers: `learn.robot.client.RobotClient`, or a twin without a network."""

    @property
    def latest(self) -> State:
        """The newest state."""
        ...

    def next(self, after: State | None = None, timeout: float = SILENT) -> State:
        """Return a state later than another; `LostError` where none comes in time [s]."""
        ...

    def send(self, velocity: Array, state: State) -> int:
        """Ask for joint speeds [rad/s] in answer to a state."""
        ...

    def stop(self) -> int:
        """Stop the arm."""
        ...

    def arm(self, number: int | None = None) -> None:
        """Re-arm the stop of a number."""
        ...


@dataclass
class Episode:
    """How one episode went.

    Attributes:
        number: Of the scene.
        seconds: From its first action to its last.
        seen: Whether the task was done as the arm itself saw it.
        success: Whether it was done in truth; None where nobody knows.
        ended: Why it ended: ``done``, ``time``, or what stopped the arm.
        measures: The task's own measures, where they are known.
        ages: Of the clouds at every policy step [s].
        periods: Between two answers [s].
        latencies: From a tick's arrival to its answer [s].
        missed: Ticks that were not answered.
    """

    number: int
    seconds: float = 0.0
    seen: bool = False
    success: bool | None = None
    ended: str = "time"
    measures: dict[str, float] = field(default_factory=dict)
    ages: list[float] = field(default_factory=list)
    periods: list[float] = field(default_factory=list)
    latencies: list[float] = field(default_factory=list)
    missed: int = 0


@dataclass
class Senses:
    """What a loop has beside the arm's own measurements.

    Attributes:
        clouds: Where clouds come from; None for a policy that sees none.
        truth: What is true, on a twin; None elsewhere.
        feel: Tells touch from joint torques; None where nothing does.
        true_touch: Whether touch is told by the true forces.
        most_age: Age of clouds beyond which the arm is stopped [s].
    """

    clouds: CloudSource | None
    truth: Truth | None
    feel: Feel | None = None
    true_touch: bool = False
    most_age: float = 0.5


class Runner:
    """Runs episodes of a policy on an arm.

    Attributes:
        phase: Time from a tick's arrival to its answer [s], where less is needed: answers that an action had to be
            found for come no later than others then, and the service looks at all of them in its next tick anyway.
        frames: Called with every state that was answered and what is true or None, for a film.
    """

    def __init__(self, driver: Driver, link: Link, senses: Senses, clock: Callable[[], float], log: RunLog | None,
                 *, seed: int = 0, seconds: float | None = None) -> None:  # fmt: skip
        """Take all that takes part.

        Args:
            driver: The policy.
            link: The arm.
            senses: What else is known.
            clock: Returns the time [s], that of clouds and states.
            log: Where answers go; None for nowhere.
            seed: Of drawn points.
            seconds: Longest episode [s]; the task's own if None.
        """
        self.driver, self.link, self.senses, self._clock, self._log = driver, link, senses, clock, log
        plan = driver.plan
        self.observer = Observer(plan, plan.arm, seed=seed)
        self.steering = Steering(plan.arm, plan.pace)
        steps = plan.pace.episode_steps
        self._longest = steps if seconds is None else max(1, min(steps, round(seconds / plan.step_seconds)))
        self._target: Array | None = None
        self._answered, self._since = 0, -np.inf
        self._began = clock()
        self.phase = 0.0
        self.frames: Callable[[State, Facts | None], None] | None = None

    def aim(self, target: Array) -> None:
        """Say where the hand is to go in the arm's base frame [m], [3]."""
        self._target = np.asarray(target, np.float64)
        self.observer.aim(self._target)

    # ---- an episode --------------------------------------------------------------------------------------------------

    def restart(self) -> None:
        """Forget the last episode."""
        self.observer.restart()
        self.steering.restart()
        self.driver.restart()
        if self.senses.feel is not None:
            self.senses.feel.restart()
        self._clouds: Clouds | None = None
        self._clear = 0
        self._probability = np.nan
        self._action: Array = np.zeros(self.driver.plan.arm.num_dofs)

    def run(self, number: int) -> Episode:
        """Run an episode from where the arm is; the arm stands still afterwards.

        A stop of the service ends the episode and is told in it. What makes the loop itself fail stops the arm.

        Raises:
            BlindError: What the policy sees is too old.
            LostError, RefusedError: The service is gone, or does not take commands.
            OSError: The log cannot be written.
        """
        episode = Episode(number)
        self.restart()
        try:
            self._wait_for_clouds()
            self._drive(episode)
            self._rest()
        except StoppedError as stop:
            episode.ended = str(stop)
        except BaseException:
            self._stop()
            raise
        self._judge(episode)
        return episode

    def _stop(self) -> None:
        """Stop the arm; where that cannot be said any more, its lease ends without us."""
        try:
            self.link.stop()
        except RobotError:
            return

    def _wait_for_clouds(self) -> None:
        source, end = self.senses.clouds, self._clock() + PATIENCE
        state = self.link.next()
        while source is not None and not self._fresh(source, self._clock()):
            if self._clock() > end:
                raise BlindError(f"nothing was seen for {PATIENCE:g} s{_because(source)}")
            source.tell(state.received, state.q)
            state = self.link.next(state)

    def _fresh(self, source: CloudSource, now: float) -> bool:
        clouds = source.latest()
        return clouds is not None and clouds.time >= self._since and now - clouds.time <= self.senses.most_age

    def _drive(self, episode: Episode) -> None:
        state, last, steps = self.link.next(), None, 0
        first, start = self._clock(), state.tick
        self._answered = 0
        while True:
            now = self._clock()
            self._sense(state, now)
            if self.steering.period == 0:
                if steps == self._longest or self._done(episode):
                    break
                self._decide(state, now, episode)
                steps += 1
            period = self.steering.period
            asked = self.steering.ask(state.qd)
            if self.phase > 0.0:
                late = last is not None and state.received < last  # the state was answered already
                due = last + PERIOD if last is not None and late else state.received + self.phase
                time.sleep(max(0.0, due - self._clock()))
            self.link.send(asked, state)
            answered = self._clock()
            episode.seconds = answered - first
            self._note(state, answered, steps, period, asked, episode, last)
            last = answered
            self._answered += 1
            state = self._await(state, start, answered)
            self._catch_up(state.tick - start, episode)

    def _await(self, state: State, start: int, answered: float) -> State:
        """Return the next tick's state; where that is late, the newest one again, so that the loop keeps its rate.

        A tick that was answered before it came is passed over when it comes.

        Raises:
            LostError: The service is gone or silent.
        """
        while True:
            wait = answered + (_LATEST - self.phase) - self._clock()
            try:
                state = self.link.next(state, max(wait, 1e-3))
            except LostError:
                state = self.link.latest
                if self._clock() - state.received > SILENT:
                    raise
                return state
            if state.tick - start >= self._answered:
                return state

    def _catch_up(self, passed: int, episode: Episode) -> None:
        """Pass over the control periods of ticks that were missed, up to the next action."""
        missed = passed - self._answered
        if missed > 0:
            episode.missed += missed
            self._answered += missed
        for _ in range(missed):
            if self.steering.period:
                self.steering.ask(self.link.latest.qd)

    def _sense(self, state: State, now: float) -> None:
        """Look at clouds and touch as they are at a tick.

        Raises:
            BlindError: The clouds are too old.
        """
        s = self.senses
        if s.clouds is not None:
            s.clouds.tell(state.received, state.q)
            found = s.clouds.latest()
            self._clouds = self._clouds if found is None or found.time < self._since else found
            age = np.inf if self._clouds is None else now - self._clouds.time
            if age > s.most_age:
                found_age = f"what the policy sees is {age:.2f} s old, {s.most_age:g} s at most"
                raise BlindError(found_age + _because(s.clouds))
        if s.feel is not None:
            self._probability, flag = s.feel.told(state, self.steering.asked)
            self.observer.touched(flag)

    def _decide(self, state: State, now: float, episode: Episode) -> None:
        if self.senses.true_touch and self.senses.truth is not None:
            facts = self.senses.truth.told()[1]
            self.observer.pushed(facts["force"], float(facts["felt"]))
        if self._clouds is not None:
            self.observer.look(self._clouds)
            episode.ages.append(now - self._clouds.time)
        seen = self.observer.observe(state)
        action = self.driver.act(seen)
        if not bool(torch.isfinite(action).all()):
            raise BlindError("the policy's action is not finite")
        self._action = action[0].numpy().astype(np.float64)
        self.steering.act(action)
        self._see_success(state)

    def _see_success(self, state: State) -> None:
        """Count policy steps in which the task is done as the arm sees it."""
        plan = self.driver.plan
        if self._target is not None:
            near = float(np.linalg.norm(self._target - state.hand_position)) < plan.settings.within
            self._clear = self._clear + 1 if near else 0
        elif plan.seeing:
            self._clear = self._clear + 1 if self.observer.seen("occlusion") == 0.0 else 0

    def _done(self, episode: Episode) -> bool:
        """Whether the task is done: in truth, where it is known, else as the arm sees it."""
        plan = self.driver.plan
        needed = 1 if self._target is not None else getattr(plan.settings, "success_steps", 1)
        episode.seen = episode.seen or self._clear >= needed
        truth = self.senses.truth
        done = episode.seen if truth is None else succeeded(truth.told()[1])
        if done:
            episode.ended = "done"
        return done

    def _note(self, state: State, answered: float, step: int, period: int, asked: Array, episode: Episode,
              last: float | None) -> None:  # fmt: skip
        if last is not None:
            episode.periods.append(answered - last)
        latency = answered - state.received
        episode.latencies.append(latency)
        away = np.nan if self._target is None else float(np.linalg.norm(self._target - state.hand_position))
        age = np.nan if self._clouds is None else answered - self._clouds.time
        if self._log is not None:
            self._log.put(Answer(
                answered - self._began, state.tick, episode.number, step, period, age, latency, state.q, state.qd,
                self._action, asked, state.hand_position, self.observer.seen("occlusion"), away, self._probability,
            ))  # fmt: skip
        if self.frames is not None:
            truth = self.senses.truth
            self.frames(state, None if truth is None else truth.told()[1])

    def _rest(self) -> None:
        """Ask for zero speed until the arm stands."""
        still = np.zeros(self.driver.plan.arm.num_dofs)
        state = self.link.next()
        for _ in range(60):
            self.link.send(still, state)
            if (np.abs(state.qd) < 0.02).all():
                return
            state = self.link.next(state)

    def _judge(self, episode: Episode) -> None:
        truth = self.senses.truth
        if truth is None:
            return
        facts = truth.told()[1]
        episode.measures = {name[8:]: float(x) for name, x in facts.items() if name.startswith("measure ")}
        episode.success = succeeded(facts)

    def begin(self, number: int) -> None:
        """Begin a new scene of a twin, armed; the arm is at home there.

        Raises:
            RobotError: The twin does not.
        """
        assert self.senses.truth is not None
        stop = self.link.stop()
        facts = self.senses.truth.begin(number)
        self._since = self._clock()  # pictures from before are of another scene
        self._rearm(stop)
        if "target" in facts:
            self.aim(facts["target"])

    def _rearm(self, stop: int) -> None:
        """Re-arm our own stop as soon as the service has seen the arm at rest in the new scene."""
        end, state = self._clock() + _REST, self.link.next()
        while True:
            try:
                self.link.arm(stop)
                return
            except RefusedError:
                if self._clock() > end:
                    raise
                state = self.link.next(state)


def _because(source: CloudSource) -> str:
    return f": {source.trouble}" if source.trouble else ""


def prepare(driver: Driver) -> None:
    """Compile and load whatever an answer takes: before an arm is connected, so that neither waits for the other."""
    arm = driver.plan.arm
    _, _, (hand, turn) = forward_kinematics(arm, arm.home)
    still = np.zeros(arm.num_dofs)
    observer, steering = Observer(driver.plan, arm), Steering(arm, driver.plan.pace)
    steering.act(
        driver.act(observer.observe(State(0, 0.0, 0.0, arm.home, still, still, hand, turn, 0.0, "", 0, "", {})))
    )
    steering.ask(still)
    driver.restart()
