"""The clock of a recording: its unit, whether it is uniform, and what to do about one that is not."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

from ...sim.base.errors import InputError
from ...sim.base.host import check_memory
from ...sim.base.types import Array
from .columns import MIN_ROWS, Columns

#: Seconds in the units that a column's name may state.
_UNITS = (("ms", "msec", "millis", "milliseconds"), ("us", "usec", "micros", "microseconds"),
          ("ns", "nsec", "nanos", "nanosec", "nanoseconds"))  # fmt: skip
_SCALES = (1e-3, 1e-6, 1e-9)
_WORDS = ("milliseconds", "microseconds", "nanoseconds")
#: Times above these are no seconds but the units' counts since 1970: 1e11 s is the year 5138.
_LARGEST = (1e11, 1e14, 1e17)
#: A step this many times as long as the usual one is a gap, not jitter.
GAP = 4.0


@dataclass(frozen=True)
class Clock:
    """What meta.yaml says of the clock.

    Attributes:
        columns: Its column, or two: seconds and nanoseconds (as ROS stamps a message).
        scale: Seconds per unit of its column, or None where that is not said.
    """

    columns: tuple[str, ...]
    scale: float | None = None


@dataclass(frozen=True)
class Timed:
    """Columns without their clock, and the clock in seconds.

    Attributes:
        columns: The columns as read, the clock's first.
        t: Times [s], shape [T]: as printed, or from the first row in use on where a scale or two columns are given.
        values: Numbers of the other columns, shape [T, C].
        rounding: How far a printed time may be from the true one [s].
        moved: Whether rows are no longer the file's: they were put on a grid.
    """

    columns: Columns
    t: Array
    values: Array
    rounding: float
    moved: bool = False

    @property
    def name(self) -> str:
        """Name of the clock's column."""
        return self.columns.names[0]

    @property
    def others(self) -> tuple[str, ...]:
        """Names of the columns of ``values``."""
        return self.columns.names[-self.values.shape[1] :]

    def place(self, row: int, column: str) -> str:
        """Name a cell as `Columns.place` does; on another clock than the file's, by its time."""
        return f"at {self.t[row]:.6g} s, column {column}" if self.moved else self.columns.place(row, column)


def timed(columns: Columns, clock: Clock) -> Timed:
    """Return columns whose clock is in seconds.

    Raises:
        InputError: The unit is not stated, and the column's name or its numbers say that it is not the second.
    """
    count = len(clock.columns)
    raw = columns.values[:, :count]
    last = 1.01 * 10.0 ** -float(columns.decimals[0])
    noise = 4.0 * float(np.spacing(np.abs(raw[:, 0]).max()))
    if count == 2:
        since = (raw - raw[0]) @ np.array([1.0, 1e-9])
        return Timed(columns, since, columns.values[:, 2:], 1.01e-9)
    if clock.scale is None:
        _check_seconds(columns)
        return Timed(columns, raw[:, 0], columns.values[:, 1:], last + noise)
    since = (raw[:, 0] - raw[0, 0]) * clock.scale
    return Timed(columns, since, columns.values[:, 1:], (last + noise) * clock.scale)


def _check_seconds(columns: Columns) -> None:
    """Refuse a clock without a stated unit that is not in seconds by its name, its size or its whole numbers."""
    t, name = columns.values[:, 0], columns.names[0]
    words = {word.lower() for word in re.split(r"[^A-Za-z]+", name)}
    for names, scale, unit in zip(_UNITS, _SCALES, _WORDS, strict=True):
        if words & set(names):
            raise _unit_error(columns, f"a clock in {unit}, by its name", scale)
    for least, scale, unit in zip(reversed(_LARGEST), reversed(_SCALES), reversed(_WORDS), strict=True):
        if np.abs(t).max() > least:
            raise _unit_error(columns, f"time {t[0]:.6g}, {unit} since 1970 by its size", scale)
    steps = np.diff(t)
    if columns.decimals[0] <= 0 and float(np.median(steps)) >= 1.0:
        found = f"whole numbers in steps of {float(np.median(steps)):.6g}"
        raise _unit_error(columns, found, 1e-3, "; time_scale: 1 if these are seconds")


def _unit_error(columns: Columns, found: str, scale: float, more: str = "") -> InputError:
    allowed = f"seconds, or the unit in meta.yaml: time_scale: {scale:.0e}{more}"
    return InputError(columns.path, f"column {columns.names[0]}", found, allowed)


def check_clock(timed: Timed, sample_rate: float | None = None) -> float:
    """Return the time step [s] of a uniform clock.

    A printed time is rounded: two of them may differ from the true step by one unit in their last decimal. A clock
    printed so coarsely that this exceeds a fifth of the step cannot show a lost sample and is refused as well.

    Args:
        timed: Columns and their clock [s].
        sample_rate: Stated rate [Hz] that the clock must have, if known.

    Raises:
        InputError: Time stands still or runs backwards, a step differs from the others, or all differ from the rate.
    """
    t, columns = timed.t, timed.columns
    steps = _increasing(timed)
    typical, mean = float(np.median(steps)), float(t[-1] - t[0]) / (len(t) - 1)
    slack = min(timed.rounding, 0.2 * typical) + 1e-3 * typical
    step = mean if abs(mean - typical) <= slack else typical
    wrong = np.abs(steps - step) > slack
    if wrong.any():
        i = int(np.argmax(wrong))
        if steps[i] >= GAP * typical:
            raise _gap(timed, steps, i)
        found = f"a step of {steps[i]:.9g} s"
        allowed = (
            f"{typical:.9g} s as elsewhere (uniform sampling, times with enough decimals), or "
            f"resample_hz: {round_rate(sample_rate or 1 / typical)} in meta.yaml"
        )
        raise InputError(columns.path, columns.place(i + 1, timed.name), found, allowed)
    if sample_rate is not None and abs((t[-1] - t[0]) * sample_rate - (len(t) - 1)) > slack * sample_rate:
        found = f"a sample every {mean:.9g} s ({1 / mean:.6g} Hz)"
        allowed = f"sample_rate_hz of meta.yaml, {sample_rate:.6g} Hz{_unit_hint(mean * sample_rate)}"
        raise InputError(columns.path, f"column {timed.name}", found, allowed)
    return mean


def _unit_hint(ratio: float) -> str:
    """Say that the clock may be in another unit where it is out by about a power of a thousand."""
    scale = next((s for s in _SCALES if abs(ratio * s - 1.0) < 0.01), None)
    return "" if scale is None else f"; for a clock in another unit, time_scale: {scale:.0e} there"


def round_rate(rate: float) -> str:
    """Return a sample rate [Hz] in words, whole where it is so to a thousandth."""
    return f"{round(rate)}" if abs(rate - round(rate)) < 1e-3 * rate else f"{rate:.6g}"


def resampled(timed: Timed, rate: float) -> Timed:
    """Return columns whose clock has jitter on a uniform grid from the first time on, linear between the samples.

    Args:
        timed: Columns and their clock [s].
        rate: Samples a second of the grid [Hz].

    Raises:
        InputError: Time stands still or runs backwards; a step is `GAP` times the usual one or longer; the grid has
            fewer than `MIN_ROWS` samples, or more than fit into memory.
    """
    t, columns = timed.t, timed.columns
    steps = _increasing(timed)
    long = steps >= GAP * np.median(steps)
    if long.any():
        raise _gap(timed, steps, int(np.argmax(long)))
    samples = (t[-1] - t[0]) * rate
    # the grid, a column more at a time, and the arrays that a trajectory is made of
    needed = 8.0 * samples * (3 * len(columns.names) + 1)
    check_memory(str(columns.path), f"{samples:.3g} samples at resample_hz {rate:g}", needed)
    count = int(np.floor(samples * (1 + 1e-12))) + 1
    if count < MIN_ROWS:
        raise InputError(columns.path, "", f"{count} samples at resample_hz {rate:g}", f"at least {MIN_ROWS}")
    grid = t[0] + np.arange(count) / rate
    values = interpolated(t, timed.values, grid)
    return replace(timed, t=grid, values=values, rounding=4.0 * float(np.spacing(np.abs(grid).max())), moved=True)


def interpolated(t: Array, rows: Array, grid: Array) -> Array:
    """Return columns [N, C] of times t [N] at the times of a grid [T], linear between the samples, [T, C]."""
    return np.stack([np.interp(grid, t, c) for c in rows.T], axis=-1)


def _gap(timed: Timed, steps: Array, i: int) -> InputError:
    """Name a gap after sample ``i`` in a clock with these steps [s], and the rows on either side of it."""
    typical, columns = float(np.median(steps)), timed.columns
    first = columns.first_row
    parts = [(first, first + i + 1), (first + i + 1, first + len(timed.t))]
    listed = " and ".join(f"rows: [{a}, {b}]" for a, b in parts if b - a >= MIN_ROWS)
    allowed = f"less than {GAP:g} steps of {typical:.9g} s between neighbours; cut there by {listed} in meta.yaml"
    found = f"a step of {steps[i]:.9g} s, a gap in the clock"
    return InputError(columns.path, columns.place(i + 1, timed.name), found, allowed)


def _increasing(timed: Timed) -> Array:
    """Return the steps of the clock [s], all above zero."""
    t, columns = timed.t, timed.columns
    steps: Array = np.diff(t)
    if (steps <= 0).any():
        i = int(np.argmax(steps <= 0))
        place = columns.place(i + 1, timed.name)
        if steps[i] < 0:
            found = f"time {t[i + 1]:.9g} s after {t[i]:.9g} s"
            cut = f"cut where the clock jumps back, by rows: [{columns.first_row}, {columns.first_row + i + 1}]"
            raise InputError(columns.path, place, found, f"times that increase from row to row; {cut} in meta.yaml")
        found = f"time {t[i]:.9g} s twice"
        many = int((steps == 0).sum())
        mend = "times with more decimals" if many > len(steps) / 20 else "the repeated row left out"
        raise InputError(columns.path, place, found, f"times that increase from row to row: {mend}")
    return steps
