"""How an arm's joint torques come out of its driver: a sensor with noise that grows with speed, drift, and a rate.

    effort = tau + c0 + c1 s + c2 v + drift + (n0 + n1 |v|) white,   rounded to whole quanta

with s = tanh(v / V0) and tau what the servo does beyond carrying the weight. The drift is a first-order process with
a standard deviation and a time constant. All of it is learnt from recordings of free motion (`fit_sensor`).
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from scipy.optimize import nnls

from ...kernels.touch.features import V0
from ...sim.base.errors import InputError
from ...sim.base.files import read_text
from ...sim.base.types import Array
from .free_motion import fit_free_motion
from .recording import Recording

FORMAT = "bough-torque-sensor/1"
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False)]
Number = Annotated[float, Field(allow_inf_nan=False)]


@dataclass(frozen=True)
class TorqueSensor:
    """A sensor of D joints.

    Attributes:
        rate: Samples a second [Hz].
        offset: c0 of every joint [N m].
        dry: c1, dry friction [N m].
        viscous: c2 [N m s/rad].
        still: n0, noise at rest [N m].
        moving: n1, noise for every rad/s [N m s/rad].
        drift: Standard deviation of the drift [N m].
        drift_time: Its time constant [s].
        torque_quantum: Step of what is told [N m], 0 for none.
        speed_quantum: Step of the speeds that are told [rad/s], 0 for none.
    """

    rate: float
    offset: tuple[float, ...]
    dry: tuple[float, ...]
    viscous: tuple[float, ...]
    still: tuple[float, ...]
    moving: tuple[float, ...]
    drift: tuple[float, ...]
    drift_time: tuple[float, ...]
    torque_quantum: tuple[float, ...]
    speed_quantum: tuple[float, ...]

    def measure(self, torque: Array, velocity: Array, rng: np.random.Generator, scale: float = 1.0) -> Array:
        """Return what the driver tells of torques and speeds at its rate, [R, T, D] each, R recordings.

        Args:
            torque: Beyond carrying the weight [N m].
            velocity: True joint speeds [rad/s].
            rng: Source of noise.
            scale: Factor on noise and drift.
        """
        still, moving, dry, viscous, offset = (
            np.array(v) for v in (self.still, self.moving, self.dry, self.viscous, self.offset)
        )
        white = (still + moving * np.abs(velocity)) * rng.standard_normal(torque.shape)
        told = torque + offset + dry * np.tanh(velocity / V0) + viscous * velocity
        return rounded(told + scale * (white + self._drifts(torque.shape, rng)), np.array(self.torque_quantum))

    def _drifts(self, shape: tuple[int, ...], rng: np.random.Generator) -> Array:
        keep = np.exp(-1.0 / (self.rate * np.array(self.drift_time)))
        out = rng.standard_normal(shape)
        for t in range(1, shape[1]):
            out[:, t] = keep * out[:, t - 1] + np.sqrt(1.0 - keep**2) * out[:, t]
        return out * np.array(self.drift)

    def speeds(self, velocity: Array) -> Array:
        """Return what the driver tells of speeds [rad/s], [..., D]."""
        return rounded(velocity, np.array(self.speed_quantum))

    def write(self, path: Path) -> None:
        """Write the sensor as JSON."""
        path.write_text(json.dumps({"format": FORMAT, **asdict(self)}, indent=1) + "\n")


#: A Jaco 2 with a curved wrist, its driver's joint states: fitted by `fit_sensor` to the 18 free recordings of set p3
#: of github.com/jayadeepj/pcap (commit cbecf391), 1656 rows. Its torques come without
#: gravity; no quanta were seen.
JACO2 = TorqueSensor(
    rate=10.0,
    offset=(0.638, -0.516, -0.009, 0.056, 0.188, -0.167),
    dry=(-0.088, 0.134, -0.004, 0.013, 0.019, 0.041),
    viscous=(0.252, 0.755, -0.043, 0.041, 0.010, 0.057),
    still=(0.236, 0.412, 0.205, 0.041, 0.038, 0.018),
    moving=(0.554, 0.837, 0.770, 0.357, 0.246, 0.236),
    drift=(0.380, 0.443, 0.287, 0.045, 0.052, 0.076),
    drift_time=(1.29, 1.69, 1.92, 4.49, 3.51, 60.0),
    torque_quantum=(0.0,) * 6,
    speed_quantum=(0.0,) * 6,
)


def rounded(x: Array, quantum: Array) -> Array:
    """Return x in whole quanta, as it is where a quantum is zero."""
    whole = np.where(quantum > 0.0, quantum, 1.0)
    out: Array = np.where(quantum > 0.0, whole * np.round(x / whole), x)
    return out


class _File(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)
    format: str
    rate: Annotated[float, Field(gt=0.0, allow_inf_nan=False)]
    offset: list[Number]
    dry: list[Number]
    viscous: list[Number]
    still: list[NotNegative]
    moving: list[NotNegative]
    drift: list[NotNegative]
    drift_time: list[Annotated[float, Field(gt=0.0, allow_inf_nan=False)]]
    torque_quantum: list[NotNegative]
    speed_quantum: list[NotNegative]


def read_sensor(path: Path, joints: int) -> TorqueSensor:
    """Read a sensor that `TorqueSensor.write` wrote, for an arm of so many joints.

    Raises:
        InputError: The file is no such sensor, or one of another number of joints.
    """
    try:
        held = _File.model_validate_json(read_text(path))
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(str(p) for p in first["loc"])
        raise InputError(path, place, first["msg"].lower(), "a sensor that bough touch fit wrote") from None
    if held.format != FORMAT:
        raise InputError(path, "format", f"'{held.format}'", FORMAT)
    kept = held.model_dump(exclude={"format"}).items()
    values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in kept}
    for name, value in values.items():
        if isinstance(value, tuple) and len(value) != joints:
            raise InputError(path, name, f"{len(value)} joints", f"{joints}, as the arm has")
    return TorqueSensor(**values)


def fit_sensor(recordings: Sequence[Recording], source: str) -> TorqueSensor:
    """Learn a sensor from recordings in which nothing touches the arm.

    White noise is what neighbouring samples differ by; what is left of the scatter is drift, and its time constant that
    of its autocovariance between one and six samples.

    Raises:
        InputError: There are too few rows known to be without contact.
    """
    free = fit_free_motion(recordings, source)
    still, moving, drift, times = [], [], [], []
    rate = float(np.median([r.rate for r in recordings]))
    for j in range(free.num_dofs):
        parts = [((r.torque - free.needed(r.expected, r.velocity))[:, j], r.velocity[:, j], r.contact == 0)
                 for r in recordings]  # fmt: skip
        steps = [np.diff(x)[k[1:] & k[:-1]] / np.sqrt(2.0) for x, _, k in parts]
        speed = [((v[1:] + v[:-1]) / 2)[k[1:] & k[:-1]] for _, v, k in parts]
        white = fit_noise(np.concatenate(steps), np.concatenate(speed))
        near, far = (_covariance([x[k] for x, _, k in parts], lag) for lag in (1, 6))
        still.append(float(white[0]))
        moving.append(float(white[1]))
        drift.append(float(np.sqrt(max(near, 0.0))))
        times.append(float(np.clip(5.0 / rate / np.log(max(near / max(far, 1e-12), 1.0001)), 1.0 / rate, 60.0)))
    rows = lambda name: np.concatenate([getattr(r, name)[r.contact == 0] for r in recordings])  # noqa: E731
    quanta = [tuple(quantum(column) for column in rows(name).T) for name in ("torque", "velocity")]
    offset, dry, viscous = (tuple(free.mean[:, k].tolist()) for k in range(3))
    return TorqueSensor(rate, offset, dry, viscous, *map(tuple, (still, moving, drift, times)), *quanta)


def fit_noise(residual: Array, velocity: Array) -> Array:
    """Return n0 and n1 of a standard deviation n0 + n1 |v|, from residuals about zero, [T] each.

    For normal noise E|r| = (n0 + n1 |v|) sqrt(2 / pi): a regression with weights that are not negative. n0 is at least
    a thousandth of the rms (a sensor that stands still has no noise at all).
    """
    rms = float(np.sqrt(np.mean(residual**2)))
    a = np.stack([np.ones_like(velocity), np.abs(velocity)], axis=1)
    found, _ = nnls(a, np.abs(residual) * np.sqrt(np.pi / 2))
    return np.array([max(found[0], 1.0e-3 * rms, 1.0e-6), found[1]])


def _covariance(parts: Sequence[Array], lag: int) -> float:
    """Autocovariance about zero at a lag, over all parts that are long enough."""
    total = sum(float(np.sum(x[lag:] * x[:-lag])) for x in parts if len(x) > lag)
    return total / max(sum(len(x) - lag for x in parts if len(x) > lag), 1)


def quantum(x: Array) -> float:
    """Return the step that all values are whole multiples of, 0 if there is none larger than rounding's, [T]."""
    gaps = np.diff(np.unique(np.round(x, 9)))
    gaps = gaps[gaps > 1.0e-8]
    if not len(gaps):
        return 0.0
    step = float(np.quantile(gaps, 0.05))
    off = np.abs(gaps / step - np.round(gaps / step))
    return step if len(gaps) < 0.5 * len(x) and np.mean(off < 0.1) > 0.9 else 0.0
