"""Simulation of all recordings of a case from rest, with its hidden effects."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .branch import Array, Branch
from .parts import AIR, Law, Now, Part
from .rig import Rig, engine, rig

#: Settling to rest: factor of the dampers, duration [s] and time step [s].
CALMING, CALM_TIME, CALM_STEP = 6.0, 3.2, 4e-3


@dataclass(frozen=True)
class Motion:
    """N recordings of T samples.

    Attributes:
        moved: Displacement of the point that is held from the grasp point's calm rest position [m], shape [N, T, 3].
        velocity: Of the point that is held [m/s], shape [N, T, 3].
        turn: Rotation of the held link from rest, w, x, y, z, shape [N, T, 4].
        angle: Size of each joint's rotation [rad], shape [N, T, R]; zero where laws acted in the steps.
        rate: Size of each joint's angular velocity [rad/s], shape [N, T, R]; zero where laws acted.
    """

    moved: Array
    velocity: Array
    turn: Array
    angle: Array
    rate: Array


def simulate(branch: Branch, forces: Array, rate: float, **options: Any) -> tuple[Array, Array]:
    """Drive the grasp point from rest.

    Args:
        branch: The branch.
        forces: World forces at the samples [N], linear between them, shape [N, T, 3].
        rate: Sampling rate [Hz].
        **options: Passed to `rig.build`.

    Returns:
        Displacement [m] and velocity [m/s] of the grasp point at the samples, each of shape [N, T, 3].
    """
    motion = drive(branch, forces, rate, **options)
    return motion.moved, motion.velocity


def drive(
    branch: Branch,
    forces: Array,
    rate: float,
    *,
    parts: Sequence[Part] = (),
    clock: Array | None = None,
    **options: Any,
) -> Motion:
    """Drive the grasp point from rest with effects; arguments as for `simulate`.

    Without laws that act in the steps MuJoCo steps by itself. With laws the recordings step side by side, and where
    damage lasts one after the other.

    Args:
        branch: The branch.
        forces: World forces at the samples [N], linear between them, shape [N, T, 3].
        rate: Sampling rate [Hz].
        parts: What is hidden.
        clock: Start of each recording on the absolute clock [s], shape [N]; zero if None.
        **options: Passed to `rig.build`.
    """
    forces = np.asarray(forces, dtype=float)
    clock = np.zeros(len(forces)) if clock is None else clock
    made = _assemble(branch, parts, options)
    laws = [part.law() for part in parts if part.law]
    windy = _windy(parts)
    if not laws:
        return _by_mujoco(made, forces, rate, _rested(made, [], 1)[0] if windy else made.data)
    if not any(law.lasting for law in laws):
        return _march(made, forces, rate, laws, clock, _rested(made, laws, 1) if windy else [made.data])
    return _one_by_one(made, forces, rate, laws, clock, windy)


def _windy(parts: Sequence[Part]) -> bool:
    """Return whether the branch rests elsewhere than without its effects."""
    return any(part.settled or part.wind is not None for part in parts)


class Live:
    """A branch with effects that is stepped as time goes by, under a force at its grasp point.

    `drive` runs a plan; here nobody knows the force beforehand, such as that of a hand that moves the point.

    Attributes:
        time: On the absolute clock [s].
        step: Of one call of `advance` [s].
    """

    def __init__(self, branch: Branch, parts: Sequence[Part] = (), *, step: float = 1e-3, **options: Any) -> None:
        """Compile the branch and let it come to rest.

        Args:
            branch: The branch.
            parts: What is hidden; what they do to readings is the caller's.
            step: [s].
            **options: Of `rig.build`.
        """
        made = _assemble(branch, parts, options | {"dt": step})
        self.time, self.step = 0.0, step
        self._laws = [part.law() for part in parts if part.law]
        self._origin = made.data.sensordata[:3].copy()
        data = _rested(made, self._laws, 1)[0] if _windy(parts) else made.data
        model = copy.copy(made.model)
        self._now = Now(Rig(branch, model, made.data, made.joints, made.frames), [copy.copy(data)], step)
        self._wind = model.opt.wind.copy()
        self._mujoco, _ = engine()
        self._mujoco.mj_forward(model, self._data)
        for law in self._laws:
            law.begin(self._now)

    @property
    def _data(self) -> Any:
        return self._now.datas[0]

    def advance(self, force: Array) -> None:
        """Step once under a force at the grasp point, world axes [N], [3]."""
        now, data, model = self._now, self._data, self._now.rig.model
        now.time, now.force = np.array([self.time]), force[None]
        gusts = [blown for law in self._laws if (blown := law.gust(now.time)) is not None]
        if gusts:
            model.opt.wind = self._wind + _thinned(model) * np.sum(gusts, axis=0)[0]
        self._mujoco.mj_step1(model, data)
        now.clear()
        for law in self._laws:
            law.act(now)
        data.ctrl[:], data.qfrc_applied[:] = now.push[0] + force, now.torque[0]
        data.xfrc_applied[now.rig.held, 3:], data.xfrc_applied[:, :3] = now.couple[0], now.wash[0]
        self._mujoco.mj_step2(model, data)
        self.time += self.step

    @property
    def moved(self) -> Array:
        """Displacement of the grasp point from its calm rest position at the start of the last step [m], [3]."""
        return np.asarray(self._data.sensordata[:3] - self._origin)

    @property
    def velocity(self) -> Array:
        """Velocity of the grasp point at the start of the last step [m/s], [3]."""
        return np.asarray(self._data.sensordata[3:6].copy())

    @property
    def astray(self) -> bool:
        """Whether the branch has left the finite."""
        return any(self._data.warning[kind].number for kind in _astray(self._mujoco))


def _assemble(branch: Branch, parts: Sequence[Part], options: dict[str, Any]) -> Rig:
    """Compile the branch with all that changes its structure."""
    trunk = next((part.trunk for part in parts if part.trunk), None)
    twig = tuple(ball for part in parts for ball in part.twig)
    made = rig(branch, trunk=trunk, tip_mass=sum(part.tip_mass for part in parts), twig=twig, **options)
    blows = any(part.wind is not None for part in parts)
    made.model.opt.density = max(AIR if blows else 0.0, *(part.density for part in parts), 0.0)
    for part in parts:
        if part.wind is not None:
            made.model.opt.wind += part.wind * _thinned(made.model)
    return made


def _thinned(model: Any) -> float:
    """Factor of the wind's speed that keeps its pressure in a fluid that is denser than air."""
    return float(np.sqrt(AIR / model.opt.density))


def between(forces: Array, rate: float, dt: float) -> tuple[Array, int, float]:
    """Return forces in the middle of each step [N, S, 3], steps per sample, and the step [s]: at most about ``dt``."""
    steps = max(1, round(1 / (rate * dt)))
    samples = forces.shape[1]
    # One more step so that the sensors see the last sample.
    middle = (np.arange((samples - 1) * steps + 1) + 0.5) / steps
    low = np.minimum(middle.astype(int), samples - 2)
    part = np.minimum(middle - low, 1.0)[None, :, None]
    return (1 - part) * forces[:, low] + part * forces[:, low + 1], steps, 1 / (rate * steps)


def _by_mujoco(made: Rig, forces: Array, rate: float, start: Any) -> Motion:
    """Let MuJoCo step all recordings by itself."""
    mujoco, rollout = engine()
    model, data = made.model, made.data
    control, steps, model.opt.timestep = between(forces, rate, model.opt.timestep)
    spec = mujoco.mjtState.mjSTATE_FULLPHYSICS
    state = np.zeros(mujoco.mj_stateSize(model, spec))
    mujoco.mj_getState(model, start, state, spec)
    origin = data.sensordata[:3].copy()
    states, sensors = rollout.rollout(model, data, np.tile(state, (len(forces), 1)), control)
    sampled, states = sensors[:, ::steps], states[:, ::steps]
    poses = states[..., 1 : 1 + model.nq].reshape(*states.shape[:2], -1, 4)[:, :, made.joints]
    rates = states[..., 1 + model.nq : 1 + model.nq + model.nv].reshape(*states.shape[:2], -1, 3)[:, :, made.joints]
    angle = 2 * np.arctan2(np.linalg.norm(poses[..., 1:], axis=-1), poses[..., 0])
    return Motion(
        sampled[..., :3] - origin, sampled[..., 3:6], sampled[..., 6:10], angle, np.linalg.norm(rates, axis=-1)
    )


def _one_by_one(made: Rig, forces: Array, rate: float, laws: list[Law], clock: Array, windy: bool) -> Motion:
    """Drive recordings in time order; between them the branch comes to rest with the damage it has."""
    done, elsewhere = [], windy
    for k in range(len(forces)):
        start = _rested(made, laws, 1) if elsewhere else [made.data]
        elsewhere = windy or any(law.setting for law in laws)
        done.append(_march(made, forces[k : k + 1], rate, laws, clock[k : k + 1], start))
    join = (np.concatenate([getattr(m, name) for m in done]) for name in Motion.__dataclass_fields__)
    return Motion(*join)


def _rested(made: Rig, laws: Sequence[Law], count: int) -> list[Any]:
    """Let the branch settle without force; fading memory of laws has decayed by then."""
    staying = [law for law in laws if not law.fading]
    calm = Rig(made.branch, copy.copy(made.model), made.data, made.joints, made.frames)
    calm.model.dof_damping *= CALMING
    samples = np.zeros((count, 2, 3))
    _, datas = _stepped(calm, samples, 1 / CALM_TIME, CALM_STEP, staying, np.zeros(count), [made.data])
    for data in datas:
        data.qvel[:] = 0.0
    return datas


def _march(made: Rig, forces: Array, rate: float, laws: Sequence[Law], clock: Array, start: list[Any]) -> Motion:
    """Step recordings side by side, asking the laws at every step."""
    sensors, _ = _stepped(made, forces, rate, made.model.opt.timestep, laws, clock, start, fresh=True)
    origin = made.data.sensordata[:3]
    none = np.zeros((*sensors.shape[:2], len(made.joints)))
    return Motion(sensors[..., :3] - origin, sensors[..., 3:6], sensors[..., 6:10], none, none)


def _stepped(
    made: Rig,
    forces: Array,
    rate: float,
    dt: float,
    laws: Sequence[Law],
    clock: Array,
    start: list[Any],
    fresh: bool = False,
) -> tuple[Array, list[Any]]:
    """Sensor readings at the samples, shape [N, T, 10], and the rigs as they are left."""
    mujoco, _ = engine()
    model = copy.copy(made.model)
    control, steps, model.opt.timestep = between(forces, rate, dt)
    datas = [copy.copy(start[min(k, len(start) - 1)]) for k in range(len(forces))]
    now = Now(Rig(made.branch, model, made.data, made.joints, made.frames), datas, model.opt.timestep)
    sensors = np.zeros((*forces.shape[:2], 10))
    gusts = [law for law in laws if law.gust(clock) is not None]
    for data in datas:
        data.time = 0.0
        mujoco.mj_forward(model, data)
    if fresh:
        for law in laws:
            law.begin(now)
    held, wind = now.rig.held, model.opt.wind.copy()
    inputs = [(d, d.ctrl, d.qfrc_applied, d.xfrc_applied[held, 3:], d.xfrc_applied[:, :3]) for d in datas]
    thinned = _thinned(model) if gusts else 0.0
    for n in range(control.shape[1]):
        now.time, now.force = clock + n * now.step, control[:, n]
        air = [wind + thinned * sum(blown) for blown in zip(*(law.gust(now.time) for law in gusts), strict=True)]
        for k, data in enumerate(datas):
            if gusts:
                model.opt.wind = air[k]
            mujoco.mj_step1(model, data)
        if n % steps == 0:
            sensors[:, n // steps] = [data.sensordata for data in datas]
            sensors[:, n // steps, :6] += sum(law.beside(now) for law in laws)
        now.clear()
        for law in laws:
            law.act(now)
        push = now.push + now.force
        for k, (data, control_k, torque, couple, wash) in enumerate(inputs):
            control_k[:], torque[:], couple[:], wash[:] = push[k], now.torque[k], now.couple[k], now.wash[k]
            mujoco.mj_step2(model, data)
    for k, data in enumerate(datas):
        if any(data.warning[kind].number for kind in _astray(mujoco)):
            sensors[k] = np.nan  # MuJoCo has put the branch back to rest without a word
    return sensors, datas


def _astray(mujoco: Any) -> tuple[Any, ...]:
    kinds = mujoco.mjtWarning
    return kinds.mjWARN_BADQPOS, kinds.mjWARN_BADQVEL, kinds.mjWARN_BADQACC
