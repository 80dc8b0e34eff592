"""What a joint is measured to do while nothing acts on it: noise that no estimate from single samples sees.

Wind sways a tree before anyone pulls it, slowly beside the sampling: differences of neighbouring samples are far
smaller than the sway. A law that answers to the input cannot explain it; left out of the noise, it passes for what is
missing, and a law that explains all there is to be explained seems to explain little.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy.signal import welch

from ....sim.base.types import Array
from ...cases.case import BranchCase
from ...replay.equation_error import fits_torque
from .contest import Contest, Rows

#: Largest input at rest, in its largest ever; largest scatter of the model there, in its scatter over all.
STILL = 0.05
#: Least samples at rest for an estimate.
LEAST = 50


@dataclass(frozen=True)
class Noise:
    """Noise of the channels of a case.

    Attributes:
        sigma: Deviation, shape [C].
        spectrum: Of channels that sway at rest: frequencies [cycles a sample] and power there, of any scale.
    """

    sigma: Array
    spectrum: dict[int, tuple[Array, Array]] = field(default_factory=dict)

    def draw(self, generator: np.random.Generator, shape: tuple[int, ...]) -> Array:
        """Return Gaussian noise of this deviation and spectrum, ``shape`` [..., T, C]."""
        out = generator.standard_normal(shape)
        frequency = np.fft.rfftfreq(shape[-2])
        for c, (known, power) in self.spectrum.items():
            gain = np.sqrt(np.interp(frequency, known, power))
            gain /= np.sqrt(np.mean(gain**2))
            out[..., c] = np.fft.irfft(np.fft.rfft(out[..., c]) * gain, shape[-2])
        return out * self.sigma


def noise_at_rest(contest: Contest, rows: Rows) -> Noise:
    """Return the noise of the channels, no less than they scatter about a model before anything acts.

    Args:
        contest: The contest of a case of joints; a branch's estimates know when it is touched.
        rows: The base model, one row.
    """
    sigma, spectrum = contest.sigma.cpu().numpy().copy(), {}
    if isinstance(contest.case, BranchCase) or fits_torque(contest.case):
        return Noise(sigma)
    leads = _leads(contest)
    if sum(leads) < LEAST:
        return Noise(sigma)
    simulated = contest.simulate(contest.values(rows), rows.start)[0].double()
    away, moving = (x.cpu().numpy() for x in (contest.measured - simulated, simulated))
    longest = int(np.argmax(leads))
    for c in range(len(sigma)):
        total = np.sqrt(np.mean([moving[j, : len(r.t), c].var() for j, r in enumerate(contest.recordings)]))
        scatter = _scatter(away[..., c], leads)
        if _scatter(moving[..., c], leads) < STILL * total and scatter > sigma[c]:
            sigma[c], spectrum[c] = scatter, _spectrum(away[longest, : leads[longest], c])
    return Noise(sigma, spectrum)


def _leads(contest: Contest) -> list[int]:
    """Return how many samples of every recording pass before its input acts; none where no input ever does."""
    largest = max(float(np.abs(r.input).max(initial=0.0)) for r in contest.recordings)
    acts = [(np.abs(r.input) > STILL * largest).any(axis=1) for r in contest.recordings]
    return [int(np.argmax(a)) for a in acts]  # 0 where none is true


def _scatter(channel: Array, leads: list[int]) -> float:
    """Return the deviation of a channel [R, T] about its means over the first samples of every recording."""
    squares = sum(lead * float(x[:lead].var()) for x, lead in zip(channel, leads, strict=True) if lead)
    return float(np.sqrt(squares / max(sum(leads) - sum(lead > 0 for lead in leads), 1)))


def _spectrum(x: Array) -> tuple[Array, Array]:
    """Return frequencies and power of a stretch of a channel; below the lowest, power is taken to be as there."""
    frequency, power = welch(x, nperseg=max(len(x) // 2, 2))
    return frequency[1:], power[1:]
