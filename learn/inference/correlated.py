"""Covariance of a least-squares fit whose residuals are correlated, in time and between channels.

A model that is not quite right leaves residuals that follow the motion. Curvature at the fit takes them for white
noise, so that its intervals are too narrow. With whitened residuals z, their derivatives J by the parameters and the
prior's precision P, the covariance of the fit is the sandwich (Huber 1967; White 1980)

    (J^T J + P)^-1 (V + P) (J^T J + P)^-1,   V = sum over samples s, t of J_s^T G(t - s) J_t,

with G(k) the autocovariances of the residuals. White residuals of deviation one have V = J^T J, which gives the
curvature's covariance. G is estimated from the residuals of all recordings, which are taken for independent
realisations of one stationary process, and set to zero past a lag that the residuals themselves tell (a flat-top
window: Politis 2003, "Adaptive bandwidth choice"). No autocovariance is used that noise may have made, so white
residuals give V = J^T J times their mean square.

Sums of products of residuals and derivatives (Newey and West 1987) would vanish in the fit that made the sum of
all products zero; the autocovariances of the residuals hardly feel it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

#: A correlation counts from sqrt(`CERTAIN` log n) standard deviations on, n the number of values: 4.6 in a thousand.
#: White noise then shows one at some lag of some channels in about one of a thousand experiments.
CERTAIN = 3.0
#: Squared deviations from which a correlation counts that goes on from lag to lag where another is certain.
LIKELY = 4.0
#: Longest lag, as a share of the longest recording.
LONGEST = 1.0 / 3.0


@dataclass(frozen=True)
class Correlation:
    """Autocovariances of residuals.

    Attributes:
        spectrum: Their Fourier transform at the frequencies of `torch.fft.rfft` of ``length`` samples, shape [F, C, C].
        length: Number of samples of the transform, padded so that nothing wraps round.
        longest: Longest lag at which samples are correlated; 0 where residuals are white.
        white: Whether no two samples and no two channels are correlated.
    """

    spectrum: torch.Tensor
    length: int
    longest: int
    white: bool


def correlation(z: torch.Tensor, lengths: Sequence[int], used: int = 0) -> Correlation:
    """Estimate the autocovariances of residuals.

    Args:
        z: Whitened residuals, shape [R, T, C], zero past the end of a recording.
        lengths: Samples of each recording, length R.
        used: Number of fitted parameters; the fit has taken as many degrees of freedom.
    """
    count, channels = z.shape[1], z.shape[2]
    length = 2 * count
    spectrum = torch.fft.rfft(z, length, dim=1)
    power = torch.einsum("rfc,rfd->fcd", spectrum.conj(), spectrum)
    lags = torch.fft.irfft(power, length, dim=0)  # sum over t of z_c(t) z_d(t + k), negative k at the end
    k = torch.arange(length, device=z.device)
    k = torch.minimum(k, length - k)
    pairs = sum((n - k).clamp(min=0) for n in lengths).clamp(min=1).to(z)  # type: ignore[union-attr]
    total = float(sum(lengths))
    covariance = lags / pairs[:, None, None]
    variance = covariance[0].diagonal()
    active = variance > 0.0
    scale = torch.where(active, variance, 1.0).sqrt()
    size = covariance / (scale[:, None] * scale)
    excess = size**2 * pairs[:, None, None] / _scatter(size, k)
    certain = excess > CERTAIN * torch.tensor(total * channels).log().clamp(min=1.0).to(z)
    certain &= (k <= LONGEST * max(lengths))[:, None, None]
    own = torch.eye(channels, dtype=torch.bool, device=z.device)
    certain[0] &= ~own
    reach = torch.where(certain, k[:, None, None], -1).amax(0)  # longest lag of every pair of channels
    run = (excess[: count // 2] > LIKELY).long().cumprod(0).sum(0) - 1  # last lag of what begins at lag 0
    reach = torch.where(reach > 0, torch.maximum(reach, run), reach)
    reach = torch.where(own, reach.clamp(min=0), reach)
    free = total * max(int(active.sum()), 1)
    covariance = covariance * (free / max(free - used, 1.0)) * _window(k, reach)
    found = torch.fft.rfft(covariance, dim=0)
    return Correlation(_positive(found), length, max(int(reach.max()), 0), not bool(certain.any()))


def _scatter(size: torch.Tensor, k: torch.Tensor) -> torch.Tensor:
    """Return the variance of an estimated correlation times the pairs that it is of, [K, C, C] (Bartlett 1946).

    At lag k it is 1 + 2 sum over j < k of the product of both channels' own correlations at lag j.
    """
    own = size.diagonal(dim1=1, dim2=2)
    product = own[:, :, None] * own[:, None]
    before = torch.cumsum(product[: len(k) // 2 + 1], 0) - product[: len(k) // 2 + 1]
    return (2.0 * before[k] - 1.0).clamp(min=1.0)


def _window(k: torch.Tensor, reach: torch.Tensor) -> torch.Tensor:
    """Return one up to the reach of two channels and a fall to zero at twice that; zero for reach -1, [K, C, C]."""
    fall = 2.0 - k[:, None, None] / reach.clamp(min=1)
    flat = torch.where(k[:, None, None] <= reach, 1.0, fall.clamp(0.0, 1.0))
    return torch.where(reach > 0, flat, ((k[:, None, None] == 0) & (reach == 0)).to(flat)).double()


def _positive(spectrum: torch.Tensor) -> torch.Tensor:
    """Return the nearest positive matrices; a flat-top window may leave slightly negative powers."""
    value, vector = torch.linalg.eigh(0.5 * (spectrum + spectrum.mH))
    return (vector * value.clamp(min=0.0)[..., None, :]) @ vector.mH


def drawn_as(seen: Correlation, white: torch.Tensor) -> torch.Tensor:
    """Return white noise [..., R, T, C] of deviation one with the correlations of residuals of T samples.

    Its mean square stays one: of the residuals only the shape of the spectrum is taken. It is filtered in a circle, so
    that it has the same power at every sample.
    """
    value, vector = torch.linalg.eigh(seen.spectrum[::2])  # that of twice as many samples, padded
    power = value.clamp(min=0.0)
    weight = torch.full_like(power[:, :1], 2.0)
    weight[0] = 1.0
    power = power * weight.sum() * power.shape[1] / (weight * power).sum()
    root = (vector * power.sqrt()[..., None, :]) @ vector.mH
    spectrum = torch.fft.rfft(white, dim=-2)
    return torch.fft.irfft(torch.einsum("...fc,fdc->...fd", spectrum, root), white.shape[-2], dim=-2)


def score_covariance(seen: Correlation, derivative: torch.Tensor) -> torch.Tensor:
    """Return V, the covariance of J^T z, shape [m, m], from derivatives of the whitened residuals [m, R, T, C]."""
    spectrum = torch.fft.rfft(derivative, seen.length, dim=2)
    weight = torch.full((spectrum.shape[2],), 2.0, dtype=derivative.dtype, device=derivative.device)
    weight[0] = 1.0
    if seen.length % 2 == 0:
        weight[-1] = 1.0
    through = torch.einsum("arfc,fcd->arfd", spectrum, seen.spectrum * weight[:, None, None])
    out: torch.Tensor = torch.einsum("arfd,brfd->ab", through, spectrum.conj()).real / seen.length
    return 0.5 * (out + out.T)


def sandwich(precision: torch.Tensor, curvature: torch.Tensor, scores: torch.Tensor) -> torch.Tensor:
    """Return the covariance of a fit [D, D], in no direction smaller than the inverse of ``precision``.

    Args:
        precision: J^T J and the prior's precision together, shape [D, D].
        curvature: J^T J, shape [D, D].
        scores: V, shape [D, D].
    """
    factor = torch.linalg.cholesky(precision)
    half = torch.linalg.solve_triangular(factor.T, widening(factor, curvature, scores), upper=True)
    return half @ half.T


def widening(factor: torch.Tensor, curvature: torch.Tensor, scores: torch.Tensor) -> torch.Tensor:
    """Return the symmetric matrix [D, D] by which deviations in coordinates L^T (x - centre) are to be multiplied.

    Draws of a density of precision L L^T get the sandwich's covariance (Shaby 2014, the open-faced sandwich
    adjustment). Correlations that would make an interval narrower are not used.

    Args:
        factor: Lower Cholesky factor L of the precision, shape [D, D].
        curvature: J^T J, shape [D, D].
        scores: V, shape [D, D].
    """
    more = torch.linalg.solve_triangular(factor, scores - curvature, upper=False)
    more = torch.linalg.solve_triangular(factor, more.T, upper=False)
    value, vector = torch.linalg.eigh(0.5 * (more + more.T))
    return (vector * (1.0 + value.clamp(min=0.0)).sqrt()) @ vector.T
