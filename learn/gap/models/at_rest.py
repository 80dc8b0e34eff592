"""Noise of a joint's channels at rest, before any input acts: low-frequency noise that sample differences miss.

Wind sways a tree before anyone pulls it, slowly compared with the sampling, so differences of neighbouring samples are
far smaller than the sway. No law of the input explains this sway. If it were left out of the noise, it would count as
misfit that even the right effect cannot explain.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
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
