"""What the servos of an arm may lack, as columns and curves of a channel (`channels`).

| name | of the torque | of the speed |
| --- | --- | --- |
| dry_friction | F tanh(v / v0) where the sensor feels the motor's friction | a speed F / K less, none below it |
| gravity_comp_error | a share e of the arm's weight g | e g / K less |
| time_delay | - | the command of d seconds ago |
| backlash | - | b radians that the motor turns alone where the joint turns back (play operator) |
| servo_gain | - | m (1 / K' - 1 / K) less |
| servo_lag | - | the command behind a lag of first order |
| speed_scale | - | the command times a number |

A servo with gain K that has to overcome friction F follows a command c with c - F / K, wherever torques are measured;
they show the friction where the sensor feels the motor's side of the gear.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...sim.base.types import Array
from ..cases.arm import ArmCase
from .channels import Kind, Rows, recorded

#: Speed at which dry friction has reached three quarters of itself [rad/s].
CREEP = 0.02
#: Greatest delay that is looked for [s]: rows that begin earlier than this in their recording tell nothing of speeds.
LATEST = 0.3
#: What is tried: delays [s], speeds that friction takes [rad/s], lags [s], widths of a play [rad]. The first is none.
GRIDS: dict[str, Array] = {
    "time_delay": np.arange(0.0, LATEST + 1e-9, 0.005),
    "dry_friction": np.arange(0.0, 0.1501, 0.0025),
    "servo_lag": np.arange(0.0, 0.601, 0.02),
    "backlash": np.concatenate([[0.0], np.geomspace(5e-4, 0.08, 30)]),
}
NAMES: dict[Kind, tuple[str, ...]] = {
    "torque": ("dry_friction", "gravity_comp_error"),
    "speed": ("time_delay", "dry_friction", "backlash", "gravity_comp_error", "servo_gain", "servo_lag", "speed_scale"),
}
#: Name and unit of the parameter of each effect.
PARAMETERS = {
    "dry_friction": ("torque_Nm", "N m"), "gravity_comp_error": ("share", ""), "time_delay": ("delay_s", "s"),
    "backlash": ("width_rad", "rad"), "servo_gain": ("gain_Nmsprad", "N m s/rad"),
    "servo_lag": ("lag_s", "s"), "speed_scale": ("scale", ""),
}  # fmt: skip


@dataclass(frozen=True)
class Curve:
    """A joint's way from command to motion: values of delay [s], friction's speed [rad/s], lag [s], play [rad], [G]."""

    time_delay: Array
    dry_friction: Array
    servo_lag: Array
    backlash: Array

    @staticmethod
    def none() -> Curve:
        """Return the way of a servo that lacks nothing."""
        return Curve(*(np.zeros(1) for _ in GRIDS))

    def beside(self, name: str) -> Curve:
        """Return all values of one effect's grid, beside those that the others have here, and their neighbours."""
        axes = []
        for key, grid in GRIDS.items():
            own = float(getattr(self, key)[0])
            at = int(np.abs(grid - own).argmin())
            near = grid[max(1, at - 2) : at + 3] if own > 0.0 else grid[:1]
            axes.append(grid if key == name else near)
        mesh = np.meshgrid(*axes, indexing="ij")
        return Curve(*(m.ravel() for m in mesh))

    @staticmethod
    def together(*names: str) -> Curve:
        """Return every fourth value of some effects' grids with each of the others'; what they lack is none."""
        axes = [grid[::4] if key in names else grid[:1] for key, grid in GRIDS.items()]
        return Curve(*(m.ravel() for m in np.meshgrid(*axes, indexing="ij")))

    def at(self, index: int) -> Curve:
        """Return one of the ways."""
        return Curve(*(getattr(self, key)[index : index + 1] for key in GRIDS))


def speeds(case: ArmCase, rows: Rows, joint: int, way: Curve) -> Array:
    """Return the speeds of a joint that its commands make, means over the rows' windows [rad/s], [G, N]."""
    out = np.zeros((len(way.time_delay), len(rows.start)))
    for r, trajectory in enumerate(recorded(case)):
        assert trajectory.command is not None
        here = rows.recording == r
        asked = np.clip(trajectory.command[:, joint], *(s * case.arm.velocity_limit[joint] for s in (-1, 1)))
        slowed = np.sign(asked) * np.maximum(np.abs(asked) - way.dry_friction[:, None], 0.0)
        path = np.cumsum(lagging(slowed, way.servo_lag, case.dt) * case.dt, axis=1)
        path = played(path, way.backlash)
        span = rows.end[here] - rows.start[here]
        for g, delay in enumerate(way.time_delay):
            ends = np.interp(np.stack([rows.start[here], rows.end[here]]) - delay, trajectory.t, path[g])
            out[g, here] = (ends[1] - ends[0]) / span
    return out


def played(path: Array, width: Array) -> Array:
    """Return what lies behind a play of widths [G] that paths [G, T] drive (Krejci 1996), in its middle at first."""
    if not width.any():
        return path
    out = np.empty_like(path)
    at, half = path[:, 0].copy(), 0.5 * width
    for k in range(path.shape[1]):
        at = np.clip(at, path[:, k] - half, path[:, k] + half)
        out[:, k] = at
    return out


def lagging(values: Array, lag: Array, dt: float) -> Array:
    """Return what follows values [G, T], constant between rows, with time constants [G] [s], means over rows."""
    if not lag.any():
        return values
    out, at = np.empty_like(values), values[:, 0].copy()
    pace = dt / np.maximum(lag, 1e-12)
    keep = np.where(lag > 0.0, np.exp(-pace), 0.0)
    share = np.where(lag > 0.0, (1.0 - keep) / pace, 0.0)
    for k in range(values.shape[1]):
        out[:, k] = values[:, k] + (at - values[:, k]) * share
        at = values[:, k] + (at - values[:, k]) * keep
    return out


def column(kind: Kind, name: str, rows: Rows, joint: int, gain: float, commanded: Array) -> Array:
    """Return the column of an effect that is linear in its parameter, [N]; ``commanded`` is what commands make."""
    if name == "speed_scale":
        return commanded
    if name == "dry_friction":
        out: Array = np.tanh(rows.speed[:, joint] / CREEP)
        return out
    if name == "gravity_comp_error":
        return rows.weight[:, joint] * (1.0 if kind == "torque" else -1.0 / gain)
    return -rows.needed[:, joint]


def anything(kind: Kind, rows: Rows, commanded: Array, joint: int) -> Array:
    """Return columns that say no name: what a channel could also depend on, [N, M].

    Poses and weights of all joints and powers of the speed for torques; commands of the last windows, the pose and the
    torque for speeds.
    """
    v, q = rows.speed[:, joint], rows.position
    turned = [np.sin(q), np.cos(q)]
    if kind == "torque":
        return np.column_stack(
            [*turned, rows.weight, v, v * np.abs(v), np.tanh(v / CREEP), rows.acceleration[:, joint]]
        )
    late = [commanded]
    for _ in range(3):
        before = np.roll(late[-1], 1)
        before[np.diff(rows.recording, prepend=-1) != 0] = 0.0
        late.append(before)
    own = [np.sin(q[:, joint]), np.cos(q[:, joint]), rows.needed[:, joint], rows.weight[:, joint]]
    return np.column_stack([*late, np.tanh(commanded / CREEP), commanded * np.abs(commanded), *own])
