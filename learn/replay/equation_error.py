"""Equation error of a mechanism: efforts predicted by inverse dynamics from the measured motion.

A chaotic mechanism cannot be replayed for long, whatever its parameters, but its equations of motion hold at every
time. Coordinates, rates and accelerations are taken from the measured motion, and inverse dynamics predicts the efforts
(equation error; Gautier & Khalil 1988; Swevers, Verdonck & De Schutter 2007). Motion and efforts pass
through one zero-phase low-pass filter first: a Butterworth filter of second order, run forward and backward.

For fits that filter is three times as wide, and measured and predicted efforts pass a second one at the cut-off, a
symmetric window, before samples are left out (parallel filtering and decimation; Gautier 1997, Proc. IEEE ICRA). A
torque that jumps, as friction does where a joint turns back, is thus rounded in the prediction as in the measurement.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import torch
import warp as wp

from ...kernels.effects.inverse import effect_efforts_kernel
from ...kernels.tree.inverse import inverse_kernels
from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ...sim.engine.arrays import LaneArray
from ..cases.case import BranchCase, JointCase, JointTrajectory
from ..cases.noise import NoiseEstimate, estimate_noise
from ..systems.branch import BranchSystem
from .effect_rollout import EffectArrays
from .recording import Recording, recordings
from .rollout import Rollout

ORDER = 2
#: Cut-off of the first filter relative to that of the second one. A low pass rounds the kink that friction makes in a
#: rate that changes sign, and moves where it does.
WIDE = 3.0
_QUANTITIES = ("position", "velocity", "acceleration")


def fits_torque(case: BranchCase | JointCase) -> bool:
    """Return whether a case is fitted to efforts (equation error) instead of replayed motion."""
    return isinstance(case, JointCase) and case.fit == "torque"


def simulation_of(case: BranchCase | JointCase) -> type[Rollout]:
    """Return the class that predicts a case's recordings: `EquationError` for torque fits, else `Rollout`."""
    return EquationError if fits_torque(case) else Rollout


def recordings_of(case: BranchCase | JointCase) -> list[Recording]:
    """Return a case's trajectories in the form that `simulation_of` takes."""
    return torque_recordings(case) if isinstance(case, JointCase) and fits_torque(case) else recordings(case)


def torque_recordings(case: JointCase) -> list[Recording]:
    """Return trajectories for `EquationError`, one period of the cut-off shorter at both ends, where filters err.

    ``input`` holds coordinate, rate and acceleration of every joint, shape [T, 3 J]; ``output`` the filtered efforts,
    columns as in `JointCase.inputs`, shape [T, I]; those held between samples are centred first. There is no start
    state to be known.

    Raises:
        InputError: A trajectory is shorter than three periods of the cut-off.
    """
    sigma = estimate_noise(case).sigma
    sources = [_sources(case, joint.name, sigma) for joint in case.joints]
    return [_recording(case, t, sources) for t in case.trajectories]


def _recording(case: JointCase, trajectory: JointTrajectory, sources: list[list[tuple[int, int]]]) -> Recording:
    period, count = int(np.ceil(1.0 / (case.filter_hz * case.dt))), len(trajectory.t)
    if count < 3 * period:
        allowed = f"{3 * period} or more, three periods of filter_hz {case.filter_hz:g}"
        raise InputError(case.folder / trajectory.file, "", f"{count} samples", allowed)
    inner = slice(period, count - period)
    motion = np.concatenate([_motion(case, trajectory, columns) for columns in sources], axis=1)
    effort = low_pass(_at_samples(case, trajectory.effort), case.dt, case.filter_hz)
    wide = wider(case)
    fine = [_motion(wide, trajectory, columns) for columns in sources]
    fine.append(low_pass(_at_samples(case, trajectory.effort), case.dt, wide.filter_hz))
    return Recording(
        trajectory.t[inner], motion[inner], effort[inner], np.zeros((0, 2)), np.zeros(count - 2 * period, dtype=bool),
        None, trajectory.t_start, fine=np.concatenate(fine, axis=1)[inner],
    )  # fmt: skip


def wider(case: JointCase) -> JointCase:
    """Return a case with the cut-off that motion and efforts pass before `averaged` takes them to the case's own."""
    return replace(case, filter_hz=min(WIDE * case.filter_hz, max(0.4 / case.dt, case.filter_hz)))


def noise_of(case: BranchCase | JointCase) -> NoiseEstimate:
    """Return the noise of the channels that `simulation_of` predicts, in the order of the recordings' output."""
    if not isinstance(case, JointCase) or not fits_torque(case):
        return estimate_noise(case)
    return torque_noise(case, second=window(case))


def thinned(case: BranchCase | JointCase, recording: Recording) -> Recording:
    """Return every n-th sample of a filtered recording, so that noise of neighbouring samples is nearly independent.

    A signal with cut-off f Hz is determined by 2 f samples per second. More samples are redundant, and a posterior that
    took them as independent would be too narrow. The efforts are averaged about the samples that are kept, see
    `averaged`. Recordings that are replayed are returned unchanged.
    """
    if not isinstance(case, JointCase) or case.fit == "replay":
        return recording
    every = _every(case)
    columns = {name: getattr(recording, name)[::every] for name in ("t", "input", "contact")}
    if recording.fine is None:
        return replace(recording, **columns, output=recording.output[::every])
    effort = averaged(case, torch.as_tensor(recording.fine[:, recording.input.shape[1] :])).numpy()
    return replace(recording, **columns, output=effort, every=every)


def _every(case: JointCase) -> int:
    return max(1, int(0.5 / (case.filter_hz * case.dt)))


def averaged(case: JointCase, effort: torch.Tensor) -> torch.Tensor:
    """Return efforts [..., T, C] averaged with `window` about every n-th sample, as `thinned` keeps them.

    At the ends the mean is over what there is.
    """
    taps = torch.as_tensor(window(case), dtype=effort.dtype, device=effort.device)[None, None]
    rows = effort.transpose(-1, -2)
    every, beyond = _every(case), taps.shape[-1] // 2
    flat = torch.nn.functional.conv1d(rows.reshape(-1, 1, rows.shape[-1]), taps, stride=every, padding=beyond)
    share = torch.nn.functional.conv1d(
        torch.ones_like(rows.reshape(-1, 1, rows.shape[-1])[:1]), taps, stride=every, padding=beyond
    )
    return (flat / share).reshape(*rows.shape[:-1], -1).transpose(-1, -2)


def window(case: JointCase) -> Array:
    """Return the weights of the second filter: a Hamming-windowed low pass of gain one half at the cut-off, sum one."""
    from scipy.signal import firwin

    period = int(np.ceil(1.0 / (case.filter_hz * case.dt)))
    taps: Array = firwin(2 * period + 1, case.filter_hz, fs=1.0 / case.dt)
    return taps


def torque_noise(case: JointCase, second: Array | None = None) -> NoiseEstimate:
    """Return the noise of the filtered efforts: that of the raw ones times the filter's gain for white noise.

    ``second`` holds the weights of a symmetric second filter. Errors of the measured motion come on top in a fit; they
    are smaller the lower the cut-off.
    """
    from scipy.signal import freqz, sosfreqz  # slow to import, and bad input is refused before it is needed

    efforts = tuple(replace(t, output=t.effort, step=t.effort_step) for t in case.trajectories)
    raw = estimate_noise(replace(case, outputs=case.channels, trajectories=efforts))
    cutoff = case.filter_hz if second is None else wider(case).filter_hz
    _, response = sosfreqz(_filter(case.dt, cutoff), 4096)
    after = 1.0 if second is None else np.abs(freqz(second, worN=4096)[1]) ** 2
    gain = np.sqrt(np.mean(np.abs(response) ** 4 * after))  # two passes have the gain |H|^2, power |H|^4
    return NoiseEstimate(raw.channel, gain * raw.sigma, {name: gain * sigma for name, sigma in raw.by_method.items()})


def _at_samples(case: JointCase, effort: Array) -> Array:
    """Return efforts [T, I] centred at their samples: one that is held until the next acts half a step later."""
    held = np.array([item.hold == "zero_order" for item in case.inputs])
    before = np.concatenate([effort[:1], effort[:-1]])
    return np.where(held, 0.5 * (before + effort), effort)


def low_pass(values: Array, dt: float, cutoff: float) -> Array:
    """Filter columns [T, C] sampled every ``dt`` [s] with zero phase; the gain at ``cutoff`` [Hz] is one half."""
    from scipy.signal import sosfiltfilt

    pad = min(len(values) - 1, int(1.0 / (cutoff * dt)))
    return np.ascontiguousarray(sosfiltfilt(_filter(dt, cutoff), values, axis=0, padlen=pad))


def _filter(dt: float, cutoff: float) -> Array:
    from scipy.signal import butter

    sections: Array = butter(ORDER, cutoff, fs=1.0 / dt, output="sos")
    return sections


def _sources(case: JointCase, joint: str, sigma: Array) -> list[tuple[int, int]]:
    """Return column and order of derivative from which coordinate, rate and acceleration of a joint are taken.

    White noise ``sigma`` of a column, differentiated d times and cut off at w, has the power sigma^2 w^2d / (2 d + 1).
    Each quantity is taken from the column with the least noise. Coordinates come from positions.
    """
    cutoff = 2.0 * np.pi * case.filter_hz
    columns = [(c, _QUANTITIES.index(o.quantity)) for c, o in enumerate(case.outputs) if o.joint == joint]
    out = []
    for wanted in range(3):
        noise = {(c, wanted - order): sigma[c] * cutoff ** (wanted - order) / np.sqrt(2 * (wanted - order) + 1)
                for c, order in columns if order <= wanted}  # fmt: skip
        out.append(min(noise, key=lambda key: noise[key]))
    return out


def _motion(case: JointCase, trajectory: JointTrajectory, columns: list[tuple[int, int]]) -> Array:
    """Coordinate, rate and acceleration of one joint, shape [T, 3]: derivatives of a quintic spline."""
    from scipy.interpolate import make_interp_spline

    smooth = low_pass(trajectory.output, case.dt, case.filter_hz)
    splines = [make_interp_spline(trajectory.t, smooth[:, c], k=min(5, len(smooth) - 1)) for c, _ in columns]
    return np.stack([s(trajectory.t, nu=d) for s, (_, d) in zip(splines, columns, strict=True)], axis=-1)


class EquationError(Rollout):
    """Predicts the efforts that R recorded motions need for S sets of parameters, all in one launch.

    As a `Rollout`, with `torque_recordings` for recordings and efforts of the driven joints for channels [N m or N].
    Those of `thinned` recordings are predicted at all samples, then averaged and thinned as the measured ones. One
    sample of one world is counted as one world-step.
    """

    def _prepare(self) -> None:
        m, sim, dev, case = self.model, self.simulator, self.device, self.case
        assert isinstance(case, JointCase) and not isinstance(self.system, BranchSystem)
        place = {joint.name: int(m.link_place[joint.link]) for joint in self.system.joints}
        moves = [r.fine[:, : r.input.shape[1]] if r.every and r.fine is not None else r.input for r in self.recordings]
        self.kept, self.samples = self.samples, np.array([len(x) for x in moves])
        longest, count = int(self.samples.max()), len(self.recordings)
        motion = np.zeros((count, longest * len(place), 3))
        for j, x in enumerate(moves):
            motion[j, : len(x) * len(place)] = x.reshape(-1, 3)
        watched = [place[item.joint] for item in case.inputs]
        trajectory = np.repeat(np.arange(count), self.blocks)
        integers: list[Any] = [
            wp.array(v, dtype=int, device=dev) for v in (list(place.values()), watched, trajectory, self.samples)
        ]
        self.substeps, self.channels = 1, len(watched)
        self._acceleration, self._effort = m.field("Vec"), m.field("Vec")
        self._output: LaneArray = m.field("Real", places=longest * self.channels)
        before = [m.kernel, sim.state.kernel, sim.load.kernel, self._acceleration.kernel, *integers]
        before.append(wp.array(motion, dtype=wp.vec3d, device=dev))
        kernel = inverse_kernels(m.width, m.precision).replay
        replay = sim._launcher.prepare(kernel, before, [self._effort.kernel, self._output.kernel])
        self._replay = replay if not self.system.acting.names else self._with_effects(replay, integers, before[-1])

    @property
    def _damper_ahead(self) -> float:
        """Nothing: efforts are predicted at the samples, without a step."""
        return 0.0

    def _watched(self, out: torch.Tensor) -> torch.Tensor:
        """Average and thin the efforts [S, R, T, C] of thinned recordings."""
        if not self.recordings[0].every:
            return out
        assert isinstance(self.case, JointCase)
        found = out.new_zeros(*out.shape[:2], int(self.kept.max()), out.shape[-1])
        for j, (samples, kept) in enumerate(zip(self.samples.tolist(), self.kept.tolist(), strict=True)):
            found[:, j, :kept] = averaged(self.case, out[:, j, :samples])
        return found

    def _with_effects(self, replay: Callable[[], None], integers: list[Any], motion: wp.array) -> Callable[[], None]:
        """Return a replay that subtracts the efforts of laws at joints; refuse effects of any other kind."""
        m, acting = self.model, self.system.acting
        for name, law in acting.laws.items():
            if law.kind != "joint":
                allowed = "effects at joints, such as dry_friction: the measured efforts are what is predicted"
                raise InputError(self.case.folder / "meta.yaml", "effects", f"{name} in a torque fit", allowed)
        self.effects = EffectArrays(self)
        starts = [r.t_start + float(r.t[0]) for r in self.recordings]
        begins: wp.array = wp.array(starts, dtype=wp.float64, device=self.device)
        r = self.recordings[0]
        spacing = float(r.t[1] - r.t[0]) / max(1, r.every)
        kernel = effect_efforts_kernel(m.width, m.precision, self.effects.terms)
        before = [m.kernel, self.effects.kernel, *integers, begins, motion]
        laws = self.simulator._launcher.prepare(kernel, before, [spacing, self._output.kernel])

        def both() -> None:
            """Replay the plain efforts, then take off what the laws at joints give."""
            replay()
            laws()

        return both
