"""Measured cases: a folder with ``meta.yaml`` and one CSV per trajectory, loaded strictly.

Whatever a case states that cannot be so ends in one `InputError` that names file, place, finding and what is allowed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ...sim.base.errors import InputError, shortened
from ...sim.base.strict_yaml import YamlFile, nearest
from ...sim.base.types import Array
from ...sim.trees.measured import MeasuredBranch
from .clock import Clock, Timed, check_clock, resampled, round_rate, timed
from .columns import read_columns, resolution
from .joints import JointSetup, check_joint_meta, joint_setup
from .schema import (
    BranchMeta,
    BranchTrajectoryMeta,
    ColumnMeta,
    GraspMeta,
    InputMeta,
    JointMeta,
    JointTrajectoryMeta,
    OutputMeta,
    TimeColumn,
    read_meta,
)

BRANCH_COLUMNS = ("t_s", "fx_N", "fy_N", "fz_N", "x_m", "y_m", "z_m", "vx_mps", "vy_mps", "vz_mps")
MAX_FORCE = 1e5
#: Time that what acts by the clock has moved a branch before a recording in which it moves already [s].
LEAD = 3.0
"""Largest force component believed [N]."""


@dataclass(frozen=True)
class Trajectory:
    """What every recording has.

    Attributes:
        file: Name of its file in the case folder.
        t: Time since its first sample, uniform [s], shape [T].
        t_start: When it starts on the case's one absolute clock [s].
        replicate_of: Index (from 0) of the trajectory it repeats, or None.
    """

    file: str
    t: Array
    t_start: float
    replicate_of: int | None


@dataclass(frozen=True)
class BranchTrajectory(Trajectory):
    """One recording of a branch held at its grasp point, world frame, z up.

    Attributes:
        force: Force of the arm on the branch as the sensor records it [N], shape [T, 3].
        displacement: Displacement of the grasp point from its calm rest position [m], shape [T, 3].
        velocity: Velocity of the grasp point [m/s], shape [T, 3]; see `BranchCase.velocity_measured`.
        no_contact: Whether the gripper is known to be open, so that the true force is zero, shape [T].
        profile: Name of the force profile, may be empty.
        direction: Direction of the profile, shape [3], or None.
        grasp_segment: Index of the segment held in this recording.
        grasp_distance: Distance of the grasp point from that segment's lower end [m].
        course: Pressure of gusts over its rms, along x and y, at every sample from `BranchCase.lead` before the first,
            shape [lead + T, 2], where a model has one for this recording; else None.
    """

    force: Array
    displacement: Array
    velocity: Array
    no_contact: NDArray[np.bool_]
    profile: str
    direction: Array | None
    grasp_segment: int
    grasp_distance: float
    course: Array | None = None

    @property
    def grasp(self) -> tuple[int, Array]:
        """Link that is held and the grasp point in its body frame [m], shape [3]."""
        return self.grasp_segment, np.array([0.0, 0.0, self.grasp_distance])


@dataclass(frozen=True)
class JointTrajectory(Trajectory):
    """One recording of joints.

    Attributes:
        effort: Generalised forces on the driven joints [N m or N], columns as in `JointCase.inputs`, shape [T, I].
        output: Measured quantities, scaled, columns as in `JointCase.outputs`, shape [T, C].
        step: What each was rounded to before it was put on another grid, 0 where it was not, shape [C].
        effort_step: The same of the efforts, shape [I].
    """

    effort: Array
    output: Array
    step: Array
    effort_step: Array


@dataclass(frozen=True)
class BranchCase(MeasuredBranch):
    """A branch probed at a grasp point (``branch-gap-case/1``): its geometry and what was recorded.

    Attributes:
        folder: Where it was loaded from.
        dt: Sampling step [s].
        trajectories: Recordings in time order.
        noise_nominal: Stated noise as a fraction of channel RMS, or None.
        planar: Whether everything happens in the x-z plane.
        density: Density of the wood [kg/m^3].
        trunk_pivot_below_base: Where a trunk joint would sit if the trunk moved [m], or None.
        warnings: What is odd but possible, one line each.
        velocity_measured: Whether files hold velocities; else they are `derivative` of the displacement.
    """

    folder: Path
    dt: float
    trajectories: tuple[BranchTrajectory, ...]
    noise_nominal: float | None
    planar: bool
    density: float
    trunk_pivot_below_base: float | None
    warnings: tuple[str, ...]
    velocity_measured: bool = True

    @property
    def lead(self) -> int:
        """Samples for which what acts by the clock acts before a recording that begins in motion."""
        return round(LEAD / self.dt)


@dataclass(frozen=True)
class JointCase(JointSetup):
    """Joints measured directly (``joint-gap-case/1``): the mechanism and what was recorded.

    Attributes:
        name: Name of the case.
        folder: Where it was loaded from.
        dt: Sampling step [s].
        trajectories: Recordings.
        noise_nominal: Stated noise as a fraction of channel RMS, or None.
        train: Indices (from 0) of the trajectories to learn from, or None if the case does not say.
        test: Indices of the trajectories to test on, or None.
        warnings: What is odd but possible, one line each.
    """

    name: str
    folder: Path
    dt: float
    trajectories: tuple[JointTrajectory, ...]
    noise_nominal: float | None
    train: tuple[int, ...] | None
    test: tuple[int, ...] | None
    warnings: tuple[str, ...]


def load_case(folder: str | Path) -> BranchCase | JointCase:
    """Load a case folder of either form.

    Args:
        folder: With ``meta.yaml`` and a CSV file of each recording.

    Returns:
        A branch with its recordings (``branch-gap-case/1``), or joints that were measured directly
        (``joint-gap-case/1``); recordings in SI units, their arrays [samples, channels].

    Raises:
        InputError: The folder is missing, empty or unreadable; ``meta.yaml`` or a CSV breaks the format, contradicts
            itself or states what cannot be (see `schema`, `columns` and the checks in this module).
    """
    place = Path(folder)
    meta, file = read_meta(meta_path(place))
    check_trajectories(meta, file)
    if isinstance(meta, BranchMeta):
        return _load_branch(place, meta, file)
    if meta.mechanism.arm is not None:
        raise file.error(["mechanism", "arm"], "the recordings of an arm", "bough diagnose, or joints or mjcf here")
    if meta.commands is not None:
        raise file.error(["commands"], "commands without an arm", "mechanism: {arm: NAME, weight: in or out}")
    return _load_joints(place, meta, file)


def meta_path(folder: Path) -> Path:
    """Return the ``meta.yaml`` of a case folder; raise `InputError` where there is none."""
    allowed = "a case folder with meta.yaml and CSV files"
    try:
        names = sorted(item.name for item in folder.iterdir())
    except FileNotFoundError:
        raise InputError(folder, "", "no such folder", allowed) from None
    except NotADirectoryError:
        raise InputError(folder, "", "a file", allowed) from None
    except PermissionError:
        raise InputError(folder, "", "a folder without permission to read", "a readable folder") from None
    if "meta.yaml" not in names:
        raise InputError(folder, "meta.yaml", f"only {', '.join(names[:5])}" if names else "an empty folder", allowed)
    return folder / "meta.yaml"


def check_trajectories(meta: BranchMeta | JointMeta, file: YamlFile) -> None:
    """Check what both forms share: files inside the folder and used once, replicates of earlier recordings."""
    if isinstance(meta.time_column, list) and meta.time_scale is not None:
        raise file.error(["time_scale"], "a scale beside two columns", "none: they are seconds and nanoseconds")
    used: list[tuple[str, Sequence[float]]] = []
    items: Sequence[BranchTrajectoryMeta | JointTrajectoryMeta] = meta.trajectories
    if isinstance(meta, JointMeta) and meta.mechanism.mjcf is not None:
        _check_inside(file, ["mechanism", "mjcf"], meta.mechanism.mjcf)
    for i, item in enumerate(items):
        _check_inside(file, ["trajectories", i, "file"], item.file)
        rows = item.rows or (0, np.inf)
        if item.rows and item.rows[1] <= item.rows[0]:
            raise file.error(["trajectories", i, "rows"], f"{item.rows}", "[start, stop] with start < stop")
        if any(item.file == other and rows[0] < stop and start < rows[1] for other, (start, stop) in used):
            raise file.error(["trajectories", i, "file"], f"{item.file} a second time", "each recording once")
        used.append((item.file, rows))
        original = item.replicate_of
        if original is None:
            continue
        if not 1 <= original <= len(meta.trajectories) or original == i + 1:
            found = "itself" if original == i + 1 else f"trajectory {original}"
            allowed = f"null, or another trajectory (1 to {len(meta.trajectories)})"
            raise file.error(["trajectories", i, "replicate_of"], found, allowed)


def _check_inside(file: YamlFile, here: Sequence[str | int], name: str) -> None:
    """Refuse a file that lies outside the case folder, by its name or by where links lead."""
    path, folder = Path(name), file.path.parent
    try:
        inside = not path.is_absolute() and ".." not in path.parts and "\0" not in name
        inside = inside and (folder / path).resolve().is_relative_to(folder.resolve())
    except (OSError, RuntimeError):  # links that lead in a circle, a name that is too long: who reads it says so
        return
    if not inside:
        raise file.error(list(here), shortened(name), "a file inside the case folder")


def _load_branch(folder: Path, meta: BranchMeta, file: YamlFile) -> BranchCase:
    warnings = _check_segments(meta, file)
    names = [s.name for s in meta.segments]
    segments = meta.segments
    loaded = [_branch_trajectory(folder, meta, file, i) for i in range(len(meta.trajectories))]
    measured = _all_measured(folder, meta, [known for _, known in loaded])
    if not measured:
        warnings.append(f"{file.path}: no file has velocities: they are derivatives of the displacement")
    return BranchCase(
        name=meta.name or folder.resolve().name,
        segment_name=tuple(names),
        length=np.array([s.length_m for s in segments]),
        radius=np.array([[s.radius_base_m, s.radius_tip_m] for s in segments]),
        elevation=np.radians([s.elevation_deg for s in segments]),
        azimuth=np.radians([s.azimuth_deg for s in segments]),
        mass=np.array([s.mass_kg for s in segments]),
        base_position=np.array(meta.base_position_m, dtype=np.float64),
        gravity=float(meta.gravity_mps2),
        grasp_segment=names.index(meta.grasp.segment),
        grasp_distance=float(meta.grasp.distance_from_lower_end_m),
        folder=folder,
        dt=1.0 / meta.sample_rate_hz,
        trajectories=tuple(trajectory for trajectory, _ in loaded),
        noise_nominal=meta.noise_nominal,
        planar=meta.planar,
        density=float(meta.density_kgpm3),
        trunk_pivot_below_base=meta.trunk_pivot_below_base_m,
        warnings=tuple(warnings),
        velocity_measured=measured,
    )


def _all_measured(folder: Path, meta: BranchMeta, measured: list[bool]) -> bool:
    """Return whether files have velocities: all of them or none."""
    if len(set(measured)) > 1:
        i = measured.index(False)
        found = f"no velocities, which {meta.trajectories[measured.index(True)].file} has"
        raise InputError(folder / meta.trajectories[i].file, "line 1 (header)", found, "all files with them or none")
    return measured[0]


def _check_segments(meta: BranchMeta, file: YamlFile) -> list[str]:
    """Check columns, geometry, grasp point and order in time; return warnings."""
    warnings = []
    for key, given in meta.columns.items():
        if key not in BRANCH_COLUMNS[1:]:
            raise file.error(["columns", key], "a quantity that this format does not have",
                             nearest(key, BRANCH_COLUMNS[1:]))  # fmt: skip
        if isinstance(given, ColumnMeta) and given.scale == 0:
            raise file.error(["columns", key, "scale"], "0", "a number other than zero")
    if meta.resample_hz is not None and meta.resample_hz != meta.sample_rate_hz:
        raise file.error(["resample_hz"], f"{meta.resample_hz:g}", f"sample_rate_hz, {meta.sample_rate_hz:g}")
    names = [s.name for s in meta.segments]
    for i, s in enumerate(meta.segments):
        here: list[str | int] = ["segments", i]
        if s.name in names[:i]:
            raise file.error([*here, "name"], f"{s.name} a second time", "unique names")
        for key in ("radius_base_m", "radius_tip_m"):
            if getattr(s, key) >= s.length_m:
                found = f"{getattr(s, key):g} in a segment of {s.length_m:g} m"
                raise file.error([*here, key], found, "less than the length, in metres")
        a, b = s.radius_base_m, s.radius_tip_m
        wood = np.pi * s.length_m * (a * a + a * b + b * b) / 3 * meta.density_kgpm3
        text = f"{s.mass_kg:g} kg where length, radii and density give {wood:.3g} kg"
        if not 0.1 < s.mass_kg / wood < 10:
            raise file.error([*here, "mass_kg"], text, "within a factor of ten of that")
        if not 1 / 3 < s.mass_kg / wood < 3:
            warnings.append(f"{file.path}: segment {s.name}: {text}")
    _check_grasp(meta, file, ["grasp"], meta.grasp)
    for i, item in enumerate(meta.trajectories):
        if item.grasp is not None:
            _check_grasp(meta, file, ["trajectories", i, "grasp"], item.grasp)
    for i, (before, after) in enumerate(pairwise(meta.trajectories)):
        end = before.t_start_s + (meta.n_samples - 1) / meta.sample_rate_hz
        if after.t_start_s < end:
            found = f"{after.t_start_s:g} s, where trajectory {i + 1} lasts until {end:g} s"
            raise file.error(["trajectories", i + 1, "t_start_s"], found, "trajectories one after the other in time")
    return warnings


def _check_grasp(meta: BranchMeta, file: YamlFile, here: list[str | int], grasp: GraspMeta) -> None:
    lengths = {s.name: s.length_m for s in meta.segments}
    if grasp.segment not in lengths:
        raise file.error([*here, "segment"], repr(grasp.segment), f"one of {', '.join(lengths)}")
    if grasp.distance_from_lower_end_m > lengths[grasp.segment]:
        found = f"{grasp.distance_from_lower_end_m:g}"
        allowed = f"0 to {lengths[grasp.segment]:g}, the segment's length"
        raise file.error([*here, "distance_from_lower_end_m"], found, allowed)


def _branch_trajectory(folder: Path, meta: BranchMeta, file: YamlFile, index: int) -> tuple[BranchTrajectory, bool]:
    """Read one recording; return it and whether its velocities were measured."""
    item = meta.trajectories[index]
    grasp = item.grasp or meta.grasp
    names = [_column(meta, key).column for key in BRANCH_COLUMNS[1:]]
    own = not meta.columns and meta.time_column == "t_s"
    read = _read(folder, item, _clock(meta.time_column, meta.time_scale), tuple(names), meta.resample_hz, exact=own,
                 optional=tuple(names[6:]))  # fmt: skip
    if len(read.t) != meta.n_samples:
        found = f"{len(read.t)} rows"
        allowed = f"n_samples of meta.yaml, {meta.n_samples}"
        if len(read.t) > meta.n_samples:
            allowed += f", or rows: [0, {meta.n_samples}] of this trajectory there"
        raise InputError(read.columns.path, "", found, allowed)
    check_clock(read, meta.sample_rate_hz)
    quiet = _no_contact(read.t, item.no_contact, file, index)
    data, measured = _quantities(meta, read, quiet)
    _check_sizes(meta, read, data)
    _check_spans(meta, read, data if measured else data[:, :6])
    return BranchTrajectory(
        file=item.file,
        t=np.arange(len(data)) / meta.sample_rate_hz,
        t_start=float(item.t_start_s),
        replicate_of=None if item.replicate_of is None else item.replicate_of - 1,
        force=data[:, :3].copy(),
        displacement=data[:, 3:6].copy(),
        velocity=data[:, 6:].copy(),
        no_contact=quiet,
        profile=item.profile,
        direction=None if item.direction is None else np.array(item.direction, dtype=np.float64),
        grasp_segment=[s.name for s in meta.segments].index(grasp.segment),
        grasp_distance=float(grasp.distance_from_lower_end_m),
    ), measured


def _clock(column: TimeColumn, scale: float | None) -> Clock:
    return Clock((column,), scale) if isinstance(column, str) else Clock(tuple(column))


def _column(meta: BranchMeta, key: str) -> ColumnMeta:
    given = meta.columns.get(key, key)
    return ColumnMeta(column=given) if isinstance(given, str) else given


def _read(
    folder: Path, item: BranchTrajectoryMeta | JointTrajectoryMeta, clock: Clock, names: tuple[str, ...],
    resample_hz: float | None, *, exact: bool, optional: tuple[str, ...] = (),
) -> Timed:  # fmt: skip
    """Read columns and clock of one recording, on a uniform grid where one is asked for."""
    rows = (item.rows[0], item.rows[1]) if item.rows else None
    wanted = (*clock.columns, *dict.fromkeys(name for name in names if name not in clock.columns))
    columns = read_columns(folder / item.file, wanted, exact=exact, rows=rows, clocks=len(clock.columns),
                           optional=optional)  # fmt: skip
    read = timed(columns, clock)
    return read if resample_hz is None else resampled(read, resample_hz)


def _quantities(meta: BranchMeta, read: Timed, quiet: NDArray[np.bool_]) -> tuple[Array, bool]:
    """Return force, displacement and velocity in SI units, shape [T, 9], and whether the velocity was measured."""
    by_name = dict(zip(read.others, read.values.T, strict=True))
    chosen = [_column(meta, key) for key in BRANCH_COLUMNS[1:]]
    measured = any(c.column in by_name for c in chosen[6:])
    before = max(1, int(np.logical_and.accumulate(quiet).sum()))  # the first sample, where nothing is known to be quiet
    columns = []
    for c in chosen if measured else chosen[:6]:
        x = by_name[c.column]
        columns.append(c.scale * (x - (float(x[:before].mean()) if c.offset == "start" else c.offset)))
    data = np.stack(columns, axis=-1)
    return (data if measured else np.hstack([data, derivative(data[:, 3:6], 1.0 / meta.sample_rate_hz)])), measured


#: Deviation of `derivative` of white noise of deviation one, in 1 / dt: the root of (1 + 64 + 64 + 1) / 144.
DERIVATIVE_NOISE = float(np.sqrt(130.0)) / 12.0


def derivative(x: Array, dt: float) -> Array:
    """Return the time derivative of columns [T, C] by central differences of fourth order; of second at the ends."""
    out: Array = np.gradient(x, dt, axis=0, edge_order=2)
    if len(x) > 4:
        out[2:-2] = (8.0 * (x[3:-1] - x[1:-3]) - (x[4:] - x[:-4])) / (12.0 * dt)
    return out


def _check_sizes(meta: BranchMeta, read: Timed, data: Array) -> None:
    reach = 2 * sum(s.length_m for s in meta.segments)
    mend = "or its unit in columns of meta.yaml"
    _check_size(meta, read, data, slice(0, 3), MAX_FORCE, f"at most {MAX_FORCE:g} N in size, {mend}")
    far = f"at most {reach:.3g} m in size, twice the branch's length, {mend} (offset: start for positions)"
    _check_size(meta, read, data, slice(3, 6), reach, far)
    if meta.planar:
        _check_size(meta, read, data, slice(1, 9, 3), 1e-9, "0 in the y columns of a planar case")


def _check_size(meta: BranchMeta, read: Timed, data: Array, which: slice, limit: float, allowed: str) -> None:
    block = np.abs(data[:, which])
    if block.max() > limit:
        row, column = np.argwhere(block > limit)[0]
        name = _column(meta, BRANCH_COLUMNS[1:][which][column]).column
        raise InputError(read.columns.path, read.place(int(row), name), f"{data[row, which][column]:g}", allowed)


def _no_contact(t: Array, intervals: list[list[float]], file: YamlFile, index: int) -> NDArray[np.bool_]:
    """Mark the samples inside the intervals [s], both ends included, shape [T].

    An interval from a time after the last sample to the end of the recording is empty: contact lasted to the end.
    """
    mask = np.zeros(len(t), dtype=bool)
    slack = 1e-6 + 1e-9 * abs(t[-1])
    half_step = (t[-1] - t[0]) / (len(t) - 1) / 2
    for i, (start, stop) in enumerate(intervals):
        here: list[str | int] = ["trajectories", index, "no_contact", i]
        found = f"[{start:g}, {stop:g}]"
        if start > t[-1] and abs(stop - t[-1]) < half_step:
            continue
        if stop < start:
            raise file.error(here, found, "an interval that starts before it ends")
        if start < t[0] - half_step or stop > t[-1] + half_step:
            raise file.error(here, found, f"an interval inside the recording, {t[0]:g} to {t[-1]:g} s")
        mask |= (t >= start - slack) & (t <= stop + slack)
    return mask


def _load_joints(folder: Path, meta: JointMeta, file: YamlFile) -> JointCase:
    check_joint_meta(meta, file, folder)
    loaded = [joint_trajectory(folder, meta, item) for item in meta.trajectories]
    dt = max(loaded, key=lambda pair: len(pair[0].t))[1]
    for (trajectory, own), item in zip(loaded, meta.trajectories, strict=True):
        if abs(own - dt) * len(trajectory.t) > 0.5 * dt:
            path, found = folder / item.file, f"a sample every {own:.9g} s"
            name = _clock(meta.time_column, None).columns[0]
            allowed = f"{dt:.9g} s as in the other trajectories, or resample_hz: {round_rate(1.0 / dt)} in meta.yaml"
            raise InputError(path, f"column {name}", found, allowed)
    setup = joint_setup(meta, file, folder, dt)
    return JointCase(
        **vars(setup),
        name=meta.name or folder.resolve().name,
        folder=folder,
        dt=dt,
        trajectories=tuple(trajectory for trajectory, _ in loaded),
        noise_nominal=meta.noise_nominal,
        train=tuple(i - 1 for i in meta.split.train) if meta.split else None,
        test=tuple(i - 1 for i in meta.split.test) if meta.split else None,
        warnings=(),
    )


def _check_spans(meta: BranchMeta, read: Timed, data: Array) -> None:
    """Check each of a branch's quantities, three columns at a time: an axis along which nothing moves is rounding."""
    names = [_column(meta, key).column for key in BRANCH_COLUMNS[1:]]
    for first in range(0, data.shape[1], 3):
        _check_span(read.columns.path, names[first : first + 3], data[:, first : first + 3])


def _check_span(path: Path, names: Sequence[str], values: Array) -> None:
    """Refuse numbers beyond what single precision can square, and changes that it cannot; none at all is no fault.

    Args:
        path: The file.
        names: The columns of one quantity.
        values: Their numbers, shape [T, C].
    """
    most, span = np.abs(values).max(axis=0), np.ptp(values, axis=0)
    small = 0.0 < span.max() < 1.0 / LARGEST
    if not most.max() <= LARGEST or small:
        worst = int((span if small else most).argmax())
        found = f"changes of {span[worst]:.3g} in all" if small else f"{most[worst]:.3g}"
        allowed = f"numbers up to {LARGEST:g} that change by {1 / LARGEST:g} or more, or not at all (times scale)"
        raise InputError(path, f"column {names[worst]}", found, allowed)


#: Largest measured number, times its scale, in SI units, and the inverse of the least change of one.
LARGEST = 1.0e15


def joint_trajectory(folder: Path, meta: JointMeta, item: JointTrajectoryMeta) -> tuple[JointTrajectory, float]:
    """Read one recording; return it and its own time step [s]."""
    inputs = meta.input or []
    names = tuple(dict.fromkeys([*(i.column for i in inputs), *(o.column for o in meta.outputs)]))
    read = _read(folder, item, _clock(meta.time_column, meta.time_scale), names, meta.resample_hz, exact=False)
    step = check_clock(read)
    by_name = dict(zip(read.others, read.values.T, strict=True))
    for column, scale in [(i.column, i.scale) for i in inputs] + [(o.column, o.scale) for o in meta.outputs]:
        _check_span(folder / item.file, [column], by_name[column][:, None] * scale)
    efforts = [by_name[i.column] * i.scale for i in inputs]
    as_read = dict(zip(read.others, read.columns.values.T[-len(read.others) :], strict=True))

    def rounded(columns: Sequence[InputMeta] | Sequence[OutputMeta]) -> Array:
        """Return what columns were rounded to before they were put on another grid, 0 where they were not."""
        return np.array([resolution([as_read[c.column] * c.scale]) if read.moved else 0.0 for c in columns])

    trajectory = JointTrajectory(
        file=item.file,
        t=step * np.arange(len(read.t), dtype=np.float64),
        t_start=float(item.t_start_s),
        replicate_of=None if item.replicate_of is None else item.replicate_of - 1,
        effort=np.stack(efforts, axis=-1) if efforts else np.zeros((len(read.t), 0)),
        output=np.stack([(by_name[o.column] - o.offset) * o.scale for o in meta.outputs], axis=-1),
        step=rounded(meta.outputs),
        effort_step=rounded(inputs),
    )
    return trajectory, step
