"""Noise that differences of neighbouring samples miss, because it has a memory.

Of a joint it is seen at rest, before any input acts.

Wind sways a tree before anyone pulls it, slowly compared with the sampling, so differences of neighbouring samples are
far smaller than the sway. No law of the input explains this sway. If it were left out of the noise, it would count as
misfit that even the right effect cannot explain.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import torch
from scipy.signal import welch

from ....sim.base.types import Array
from ...cases.case import BranchCase
from ...replay.equation_error import fits_torque
from ...replay.motion_noise import motion_noise
from .contest import Batch, Contest

#: Largest input at rest, relative to its maximum; largest scatter of the model at rest, relative to the whole.
STILL = 0.05
#: Fewest samples at rest for an estimate.
LEAST = 50
#: Fewest samples of a stretch before a branch is touched; how much larger than known the noise must be to count:
#: three deviations of an estimate from 660 values, as two repeats of 110 samples along three axes have.
FEWEST_QUIET, LARGER = 4, 1.08
#: Reduced chi-squared up to which a model's residuals are looked at for noise, and the share of their differences that
#: is: the largest stand about a release. Of a normal distribution that share has `WITHIN` of the variance.
NEAR, SHARE, WITHIN = 1.5, 0.95, 0.7209
#: Repeats agree with rest where they show no more than this many times its deviation.
AGREE = 1.25


@dataclass(frozen=True)
class Noise:
    """Noise of the channels of a case.

    Attributes:
        sigma: Standard deviation, shape [C].
        spectrum: For channels that sway at rest, by index: frequencies [cycles per sample] and power, of any scale.
    """

    sigma: Array
    spectrum: dict[int, tuple[Array, Array]] = field(default_factory=dict)

    def draw(self, generator: np.random.Generator, shape: tuple[int, ...]) -> Array:
        """Return Gaussian noise of this standard deviation and spectrum, ``shape`` [..., T, C]."""
        out = generator.standard_normal(shape)
        frequency = np.fft.rfftfreq(shape[-2])
        for c, (known, power) in self.spectrum.items():
            gain = np.sqrt(np.interp(frequency, known, power))
            gain /= np.sqrt(np.mean(gain**2))
            out[..., c] = np.fft.irfft(np.fft.rfft(out[..., c]) * gain, shape[-2])
        return out * self.sigma


def noise_at_rest(contest: Contest, batch: Batch) -> Noise:
    """Return the noise of the channels, at least their scatter about the base model before any input acts.

    Args:
        contest: The contest of a case; branches keep their estimate, which knows when the gripper touches them. Efforts
            predicted from a measured motion have that motion's noise beside their own.
        batch: The base model, a batch of one.
    """
    sigma, spectrum = contest.data_sigma.copy(), {}
    if isinstance(contest.case, BranchCase):
        return Noise(sigma)
    if fits_torque(contest.case):
        return Noise(np.hypot(sigma, motion_noise(contest.case, contest.unknowns, contest.values(batch)[0])))
    leads = _leads(contest)
    if sum(leads) < LEAST:
        return Noise(sigma)
    simulated = contest.simulate(contest.values(batch), batch.start)[0].double()
    away, moving = (x.cpu().numpy() for x in (contest.measured - simulated, simulated))
    longest = int(np.argmax(leads))
    for c in range(len(sigma)):
        total = np.sqrt(np.mean([moving[j, : len(r.t), c].var() for j, r in enumerate(contest.recordings)]))
        scatter = _scatter(away[..., c], leads)
        if _scatter(moving[..., c], leads) < STILL * total and scatter > sigma[c]:
            sigma[c], spectrum[c] = scatter, _spectrum(away[longest, : leads[longest], c])
    return Noise(sigma, spectrum)


def noise_of_repeats(contest: Contest, batch: Batch, noise: Noise) -> Noise:
    """Return the noise of a branch's channels, at least what repeats and quiet stretches of its recordings show.

    A sensor that remembers its last reading changes little from sample to sample. Two recordings of one experiment
    nevertheless differ by all of its noise, and so does one from rest before anything has touched the branch. A model
    is subtracted first, so that a gust that it has is no noise, and of what repeats differ by what other springs and
    dampers in the second one would make: a branch that has changed in between is no noise either. Repeats are the
    longer ones; where they scatter more than rest does all the same, rest counts.

    Args:
        contest: The contest of a branch; joints keep their noise.
        batch: The best model, a batch of one.
        noise: The noise so far; returned itself where it is no larger.
    """
    if not isinstance(contest.case, BranchCase):
        return noise
    axes = noise.sigma.reshape(2, 3)[0] > 0.0
    left = _residuals(contest, batch)[0].cpu().numpy()
    repeats = _repeats(contest, batch, axes)
    rest = _quiet(contest, left.reshape(*left.shape[:2], 2, 3)[..., axes])
    seen = np.where((repeats < AGREE * rest) | np.isnan(rest), repeats, rest)
    ratio = (seen / noise.sigma.reshape(2, 3).max(1)).max(initial=0.0, where=np.isfinite(seen))
    if ratio < LARGER:
        return noise
    grown = np.maximum(np.nan_to_num(seen), noise.sigma.reshape(2, 3).max(1))
    return Noise(np.where(noise.sigma > 0.0, np.repeat(grown, 3), 0.0), noise.spectrum)


def noise_of_neighbours(contest: Contest, batch: Batch, noise: Noise) -> Noise:
    """Return the noise of a branch's channels, at least what neighbouring residuals of a good model show.

    Before any model is fitted the motion has to be taken out by differences of a high order, which are worth a fifth of
    the samples, and the smallest of several orders is a little too small. A model that leaves little takes the motion
    out, and what it misses changes slowly: the rms difference of neighbours over sqrt(2) is their noise (von Neumann
    1941, Ann. Math. Stat. 12:367). Of effects of a few percent, noise that is 5 % too small hides a third.

    Args:
        contest: The contest of a branch; joints keep their noise.
        batch: The best model, a batch of one.
        noise: The noise so far; returned itself where it is no larger.
    """
    if not isinstance(contest.case, BranchCase):
        return noise
    white = _residuals(contest, batch)[1].cpu().numpy()
    axes = noise.sigma.reshape(2, 3) > 0.0
    if float((white**2).sum()) > NEAR * contest.num_samples:
        return noise
    apart = [np.diff(white[i, : len(r.t)], axis=0).reshape(-1, 2, 3) for i, r in enumerate(contest.recordings)]
    steps = np.concatenate(apart)[:, 0, axes[0]]
    seen = np.full(2, _trimmed(steps))
    if contest.case.velocity_measured:
        seen[1] = _trimmed(np.concatenate(apart)[:, 1, axes[1]])
    if seen.max() <= 1.0:
        return noise
    return Noise(noise.sigma * np.repeat(np.maximum(seen, 1.0), 3), noise.spectrum)


def _residuals(contest: Contest, batch: Batch) -> tuple[torch.Tensor, torch.Tensor]:
    """Return measured less simulated channels, and the same whitened, [R, T, C] both."""
    left = contest.measured - contest.simulate(contest.values(batch), batch.start)[0].double()
    return left, contest.whiten(left[None])[0]


def _trimmed(steps: Array) -> float:
    """Return the deviation of white noise whose neighbours differ by these steps, the largest left out."""
    squares = np.sort(steps.ravel() ** 2)
    return float(np.sqrt(squares[: int(SHARE * len(squares))].sum() / (2.0 * WITHIN * len(squares))))


def _repeats(contest: Contest, batch: Batch, axes: Array) -> Array:
    """Return the deviation of each kind of channel between recordings of one experiment, NaN without any, [2].

    It is of residuals without their response to noise of the force, less what a change of the base parameters makes of
    the second recording.
    """
    pairs = [(i, t.replicate_of) for i, t in enumerate(contest.case.trajectories) if t.replicate_of is not None]
    if not pairs:
        return _deviation([])
    white, derivative, _ = contest.linearise(batch)
    apart = []
    for i, k in pairs:
        count = min(len(contest.recordings[n].t) for n in (i, k))
        by_base = derivative[0, : contest.num_base, i, :count]
        apart.append(_unchanged(white[0, i, :count] - white[0, k, :count], by_base))
    sigma = contest.sigma.cpu().numpy().reshape(2, 3)[:, axes]
    return _deviation([x.reshape(-1, 2, 3)[..., axes] * sigma for x in apart]) / np.sqrt(2.0)


def _unchanged(apart: torch.Tensor, derivative: torch.Tensor) -> Array:
    """Return a difference [T, C] less its regression on derivatives [p, T, C], enlarged by the freedom it lost."""
    rows, target = derivative.flatten(1).T.cpu(), apart.flatten()[:, None].cpu()
    rest = target - rows @ torch.linalg.lstsq(rows, target, driver="gelsd").solution
    count = max(int((target != 0.0).sum()), 1)
    freedom = max(count - len(derivative), 1) / count
    return (rest.view_as(apart) / freedom**0.5).numpy()


def _quiet(contest: Contest, left: Array) -> Array:
    """Return the deviation of each kind of channel from its mean before the branch is touched, NaN without any, [2].

    A branch that has taken a set rests elsewhere, and nobody knows how well the model has its place.
    """
    counts = [int(np.logical_and.accumulate(~r.contact).sum()) for r in contest.recordings]
    runs = [(x[:n] - x[:n].mean(0)) * np.sqrt(n / (n - 1)) for x, n in zip(left, counts, strict=True)
            if n >= FEWEST_QUIET]  # fmt: skip
    return _deviation(runs)


def force_at_rest(case: BranchCase, sigma: Array) -> Array:
    """Return the noise of a branch's force [N], shape [3], at least its scatter before the branch is touched."""
    axes = sigma > 0.0
    counts = [int(np.logical_and.accumulate(t.no_contact).sum()) for t in case.trajectories]
    runs = [t.force[:n, axes] - t.force[:n, axes].mean(0) for t, n in zip(case.trajectories, counts, strict=True)
            if n >= FEWEST_QUIET]  # fmt: skip
    seen = float(_deviation([x[:, None] for x in runs])[0])
    return np.where(axes, seen, 0.0) if seen > LARGER * float(sigma.max()) else sigma


def _deviation(runs: list[Array]) -> Array:
    """Return the rms of each kind of channel over runs of samples [T, 2, axes]; NaN below `LEAST` of them."""
    if sum(len(x) for x in runs) < LEAST:
        return np.full(runs[0].shape[1] if runs else 2, np.nan)
    return np.asarray(np.sqrt(np.mean(np.concatenate(runs) ** 2, axis=(0, 2))))


def _leads(contest: Contest) -> list[int]:
    """Return the number of samples of each recording before its input acts, 0 where it never does."""
    largest = max(float(np.abs(r.input).max(initial=0.0)) for r in contest.recordings)
    acts = [(np.abs(r.input) > STILL * largest).any(axis=1) for r in contest.recordings]
    return [int(np.argmax(a)) for a in acts]  # 0 where none is true


def _scatter(channel: Array, leads: list[int]) -> float:
    """Return the standard deviation of a channel [R, T] over the first samples of each recording, about their means."""
    squares = sum(lead * float(x[:lead].var()) for x, lead in zip(channel, leads, strict=True) if lead)
    return float(np.sqrt(squares / max(sum(leads) - sum(lead > 0 for lead in leads), 1)))


def _spectrum(x: Array) -> tuple[Array, Array]:
    """Return frequencies and power of a stretch of a channel (Welch); power is constant below the lowest frequency."""
    frequency, power = welch(x, nperseg=max(len(x) // 2, 2))
    return frequency[1:], power[1:]
