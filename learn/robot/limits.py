"""Limits of an arm's service, and the YAML file that they are read from.

    format: robot-limits/1
    speed_degps: [36, 36, 36, 48, 48, 48]
    workspace_low_m: [-1.2, -1.2, 0.0]

What a file leaves out keeps its default (`default_limits`); `written` writes all of them. No file can raise a speed or
a joint's range above what the arm's description allows, a torque far above (`STRONGEST`), or a lease above its 100 ms.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from ...sim.arms.arm import Arm
from ...sim.base.errors import InputError
from ...sim.base.strict_yaml import Strict, YamlFile, validated
from ...sim.base.types import Array

FORMAT = "robot-limits/1"

LEASE = 0.100
"""How long a velocity command holds [s]."""

RAMP = 0.030
"""How long the way to standstill may take after a lease or at a stop [s]: with a tick it ends within 150 ms."""

FASTEST = 30.0
"""Most that a file may let a joint speed up by [rad/s^2]."""

STRONGEST = 1.25
"""Most that a file may let a joint's torque be, over what its servo gives: it is told without the arm's weight, which
servos carry besides."""


@dataclass(frozen=True)
class Limits:
    """What a `Guard` holds an arm of D joints to. Host NumPy, float64.

    Attributes:
        lower, upper: Joint positions [rad], infinite where a joint is continuous, [D].
        speed: Joint speeds [rad/s], [D].
        acceleration: How fast a joint's speed may grow or follow a command [rad/s^2], [D]. Stopping is faster.
        torque: Joint torque above which the arm stops [N m], [D].
        touch: Probability of touch above which the arm stops; 1 for never.
        workspace_low, workspace_high: Corners of the box that the whole arm beyond its shoulder stays in, base frame
            [m], [3].
        lease: How long a command holds [s].
        hold: How long after its last command a controller keeps others out [s].
        stale: Age of a measurement at which the arm stops [s].
        stall: Time between two ticks at which the arm stops [s].
        approach: Rate at which the distance to a joint's limit, the workspace's edge or a goal may shrink [1/s].
    """

    lower: Array
    upper: Array
    speed: Array
    acceleration: Array
    torque: Array
    touch: float
    workspace_low: Array
    workspace_high: Array
    lease: float = LEASE
    hold: float = 1.0
    stale: float = 0.25
    stall: float = 0.15
    approach: float = 5.0

    @property
    def num_dofs(self) -> int:
        """Number of joints D."""
        return len(self.speed)


Numbers = list[float]
Ends = list[Annotated[float, Field(allow_inf_nan=True)]]  # a continuous joint has none
Share = Annotated[float, Field(gt=0.0, le=1.0)]


class _File(Strict):
    """A limits file; what is None keeps its default."""

    format: Literal["robot-limits/1"]
    lower_deg: Ends | None = None
    upper_deg: Ends | None = None
    speed_degps: Numbers | None = None
    acceleration_degps2: Numbers | None = None
    torque_Nm: Numbers | None = None  # noqa: N815
    touch: Share | None = None
    workspace_low_m: Numbers | None = None
    workspace_high_m: Numbers | None = None
    lease_s: Annotated[float, Field(ge=0.03, le=LEASE)] | None = None
    hold_s: Annotated[float, Field(ge=LEASE, le=60.0)] | None = None
    stale_s: Annotated[float, Field(ge=0.03, le=1.0)] | None = None
    stall_s: Annotated[float, Field(ge=0.03, le=0.5)] | None = None
    approach_per_s: Annotated[float, Field(ge=0.5, le=10.0)] | None = None


#: Keys of a file, what they are in `Limits`, and what the field's unit is in SI.
_FIELDS: dict[str, tuple[str, float]] = {
    "lower_deg": ("lower", math.pi / 180.0), "upper_deg": ("upper", math.pi / 180.0),
    "speed_degps": ("speed", math.pi / 180.0), "acceleration_degps2": ("acceleration", math.pi / 180.0),
    "torque_Nm": ("torque", 1.0), "touch": ("touch", 1.0), "workspace_low_m": ("workspace_low", 1.0),
    "workspace_high_m": ("workspace_high", 1.0), "lease_s": ("lease", 1.0), "hold_s": ("hold", 1.0),
    "stale_s": ("stale", 1.0), "stall_s": ("stall", 1.0), "approach_per_s": ("approach", 1.0),
}  # fmt: skip


def default_limits(arm: Arm) -> Limits:
    """Return the limits of an arm when nobody says others; docs/robot.md says why each is what it is."""
    return Limits(
        lower=arm.lower, upper=arm.upper, speed=arm.velocity_limit,
        acceleration=np.full(arm.num_dofs, 5.0), torque=0.8 * arm.torque_limit, touch=0.9,
        workspace_low=np.array([-1.2, -1.2, 0.0]), workspace_high=np.array([1.2, 1.2, 1.5]),
    )  # fmt: skip


def read_limits(path: Path, arm: Arm) -> Limits:
    """Read a limits file for an arm.

    Raises:
        InputError: The file is missing or no such file; a key is unknown; numbers are too many, too few, or beyond
            what the arm's description allows.
    """
    file = YamlFile(path, FORMAT)
    given = validated(file, _File).model_dump(exclude={"format"}, exclude_none=True)
    found: dict[str, Any] = {}
    for key, value in given.items():
        name, unit = _FIELDS[key]
        found[name] = np.array(value) * unit if isinstance(value, list) else value * unit
    out = replace(default_limits(arm), **found)
    for key, (name, unit) in _FIELDS.items():
        problem = _problem(name, out, arm, unit)
        if problem:
            raise file.error((key,), *problem)
    return out


def _problem(name: str, limits: Limits, arm: Arm, unit: float) -> tuple[str, str] | None:
    """Return what is wrong with one field and what is allowed, None where nothing is."""
    value = getattr(limits, name)
    most = {"speed": arm.velocity_limit, "torque": STRONGEST * arm.torque_limit,
            "acceleration": np.full(arm.num_dofs, FASTEST)}  # fmt: skip
    if name.startswith("workspace"):
        good = np.shape(value) == (3,) and bool((limits.workspace_low < limits.workspace_high).all())
        return None if good else (f"{_listed(value, unit)}", "three numbers, low below high")
    if name in ("lower", "upper"):
        good = np.shape(value) == (arm.num_dofs,) and not np.isnan(value).any()
        good = good and bool((limits.lower >= arm.lower).all() and (limits.upper <= arm.upper).all())
        allowed = f"{_listed(arm.lower, unit)} to {_listed(arm.upper, unit)}"
        return None if good and (limits.lower < limits.upper).all() else (_listed(value, unit), allowed)
    if name in most:
        good = np.shape(value) == (arm.num_dofs,) and bool((value > 0).all() and (value <= most[name] * 1.000001).all())
        return None if good else (_listed(value, unit), f"above zero, {_listed(most[name], unit)} at most")
    return None


def _listed(values: Array | Sequence[float], unit: float) -> str:
    return "[" + ", ".join(_number(v / unit) for v in np.ravel(values)) + "]"


def _number(value: float) -> str:
    return f"{'-' if value < 0 else ''}.inf" if math.isinf(value) else f"{value:.6g}"


def written(limits: Limits) -> str:
    """Return limits as the YAML text that `read_limits` reads."""
    lines, values = [f"format: {FORMAT}"], asdict(limits)
    for key, (name, unit) in _FIELDS.items():
        value = values[name]
        lines.append(f"{key}: {_listed(value, unit) if np.ndim(value) else _number(value / unit)}")
    return "\n".join(lines) + "\n"


def check_joints(limits: Limits, count: int, source: str) -> None:
    """Raise `InputError` where limits are for another number of joints than a backend has."""
    if limits.num_dofs != count:
        raise InputError(source, "", f"{count} joints", f"{limits.num_dofs}, as the arm's description has")
