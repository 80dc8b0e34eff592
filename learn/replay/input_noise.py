"""Noise of the measured force, propagated through the model: it correlates the residuals of a perfect model.

A branch is driven by a force that is measured with white noise. The simulation is driven by the noisy force, so the
residual is sensor noise plus the response to noise of the force: to first order

    r = D e + B n,  e, n white,  cov r = D^2 + B B^T,

with D the channels' noise and B the response of the outputs to one standard deviation of the force at every sample.
Taking r for white would make intervals too narrow where the response lasts. With D^-1 B = U S V^T the residual is
whitened by e = (1 - U (1 - (1 + S^2)^-1/2) U^T) D^-1 r.

The recorded force contains its noise, so |e|^2 / 2 also contains the noise that each parameter vector transmits, on
average tr((D^2 + B B^T)^-1 B' B'^T) / 2 with B' its own response. Vectors that transmit less would be favoured; the
slope of this term is subtracted (errors in variables: to first order the profile likelihood over the true force has it
too).

Noise is assumed to cause no damage: effects whose damage lasts between recordings are left out of the response.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from numpy.typing import NDArray

from ...sim.base.types import Array
from ..cases.case import BranchCase
from ..systems.branch import Unknowns
from .recording import Recording
from .rollout import Rollout

#: Fewest and most pulses simulated per recording and axis, one in so many samples; between two of them a pulse is
#: answered between them.
PULSES, APART = (16, 64), 7
#: Independent noise values per recording and axis; in longer recordings each covers several samples. Averaging loses
#: fast noise, to which a branch that swings once in five samples responds most: of 545 samples at 100 Hz pairs left a
#: perfect model a reduced chi-squared of 2.2.
PIECES = 1000
#: Least squared singular value of a direction that is whitened: the others add less than a twentieth to a variance.
LEAST = 0.05


@dataclass(frozen=True)
class Colour:
    """How noise of the input correlates the outputs, for R recordings.

    Attributes:
        basis: Orthonormal columns U, shape [R, T C, M], in the precision of the simulation, which is single: products
            with it are most of the work of a diagnosis of long recordings.
        gain: Squared singular values S^2, shape [R, M].
        power: tr((D^2 + B B^T)^-1 B' B'^T) / 2 for the responses B' at other parameters, shape [S].
    """

    basis: torch.Tensor
    gain: torch.Tensor
    power: torch.Tensor

    def whiten(self, z: torch.Tensor, share: torch.Tensor) -> torch.Tensor:
        """Whiten residuals that are in units of the channels' noise.

        Args:
            z: Residuals, shape [P, ..., R, T, C].
            share: Squared ratio of the estimated to the inferred noise of the channels, shape [P]: noise of the force
                does not grow with that of the channels.
        """
        flat = z.flatten(-2).movedim(-2, 0)
        rows = flat.flatten(1, -2)
        shrink = 1.0 - (1.0 + share[:, None] * self.gain[:, None]).rsqrt()
        inside = (rows.to(self.basis) @ self.basis).unflatten(1, (len(share), -1)) * shrink.to(self.basis)[:, :, None]
        rows = rows - inside.flatten(1, 2) @ self.basis.transpose(1, 2)
        return rows.reshape(flat.shape).movedim(0, -2).unflatten(-1, z.shape[-2:])

    def of(self, chosen: Sequence[int]) -> Colour:
        """Return that of some of the recordings; their power is not told apart."""
        return replace(self, basis=self.basis[list(chosen)], gain=self.gain[list(chosen)])

    def log_volume(self, share: torch.Tensor) -> torch.Tensor:
        """Return half the log determinant of the covariance in units of the channels' noise, [P] from shares [P]."""
        return 0.5 * torch.log1p(share[:, None, None] * self.gain).sum((-1, -2))

    def variance(self, shape: tuple[int, int]) -> torch.Tensor:
        """Return the variance of the outputs by noise of the input, relative to the channels' noise, [R, T, C]."""
        return ((self.basis.double() ** 2) @ self.gain[..., None])[..., 0].unflatten(-1, shape)


def input_colour(
    case: BranchCase, chosen: Sequence[Recording], values: torch.Tensor, force_sigma: Array, sigma: torch.Tensor, *,
    nearby: torch.Tensor | None = None, unknowns: Unknowns | None = None, device: object = None,
) -> Colour:  # fmt: skip
    """Return how noise of the force correlates the residuals of recordings simulated with parameters ``values`` [n].

    Args:
        case: The branch.
        chosen: R recordings.
        values: Parameters about which the response is linear.
        force_sigma: Noise of the force [N], shape [3].
        sigma: Noise of the outputs, shape [C].
        nearby: Parameters at which the power of the response is computed, shape [S, n].
        unknowns: Unknowns that the values belong to.
        device: Warp device.
    """
    sets = values[None] if nearby is None else torch.cat([values[None], nearby])
    axes = np.flatnonzero(force_sigma > 0.0)
    pulsed, step = [], 5.0 * float(force_sigma.max())
    moments = [_moments(r.contact) for r in chosen]
    for r, at in zip(chosen, moments, strict=True):
        pulsed += [r, *(_pulse(r, int(k), int(a), step) for k in at for a in axes)]
    out = Rollout(case, pulsed, len(sets), unknowns=unknowns, device=device, alone=True)(sets)
    sigma = sigma.to(out.device)
    weight = torch.where(sigma > 0.0, 1.0 / torch.where(sigma > 0.0, sigma, 1.0), 0.0)[:, None]
    parts, first, power = [], 0, torch.zeros(len(sets) - 1, dtype=torch.float64, device=out.device)
    for r, at in zip(chosen, moments, strict=True):
        pulses = slice(first + 1, first + 1 + len(at) * len(axes))
        for k, one in enumerate(out):
            response = ((one[pulses] - one[first]).double() / step).unflatten(0, (len(at), len(axes)))
            scaled = (_columns(r, at, response, force_sigma[axes]) * weight).flatten(0, 1)
            if k == 0:
                parts.append(_decompose(scaled))
            else:
                power[k - 1] += _power(*parts[-1], scaled)
        first = pulses.stop
    return _stacked(parts, power)


def _moments(contact: NDArray[np.bool_]) -> Array:
    """Return the samples at which pulses act, where the force is known by its noise: while the gripper holds.

    The first sample's pulse only falls, all others rise and fall.
    """
    inside = np.flatnonzero(contact[1:-1]) + 1
    count = min(int(np.clip(len(inside) // APART, *PULSES)), len(inside))
    chosen = inside[np.linspace(0, len(inside) - 1, count).astype(int)]
    return np.unique(np.concatenate([[0], chosen]))


def _pulse(r: Recording, sample: int, axis: int, size: float) -> Recording:
    """Return a recording whose force is more in one sample: what acts, and what the sensor read where a law lags it."""
    more = np.zeros_like(r.input)
    more[sample, axis] = size
    return replace(r, input=r.input + more, sensed=None if r.sensed is None else r.sensed + more)


def _columns(r: Recording, at: Array, response: torch.Tensor, force_sigma: Array) -> torch.Tensor:
    """Response to one standard deviation of every independent noise value, [T, C, pieces]."""
    length, longest = len(r.t), response.shape[2]
    block = -(-length // PIECES)
    out = []
    for start in range(0, length, block):
        samples = [k for k in range(start, min(start + block, length)) if r.contact[k]]
        if not samples:
            continue
        total = torch.zeros_like(response[0])
        for k in samples:
            total[:, k:length] += _answer(at, response, k, length)
        scale = torch.as_tensor(force_sigma / np.sqrt(len(samples)), device=total.device)
        out.append(total * scale[:, None, None])
    if not out:
        return response.new_zeros(longest, response.shape[-1], 0)
    return torch.cat(out).permute(1, 2, 0)


def _answer(at: Array, response: torch.Tensor, k: int, length: int) -> torch.Tensor:
    """Return the response to a pulse in sample k from then on, [axes, length - k, C].

    Between two pulses it is between theirs, each shifted in time: a branch that swings far answers otherwise at every
    moment. What comes later than the later one's recording lasts is the earlier one's.
    """
    i = int(np.searchsorted(at, k, side="right")) - 1
    out = response[i][:, at[i] : at[i] + length - k]
    if 0 < i < len(at) - 1 and k > at[i]:
        share, seen = (k - at[i]) / (at[i + 1] - at[i]), length - at[i + 1]
        out = out.clone()
        out[:, :seen] += share * (response[i + 1][:, at[i + 1] : length] - out[:, :seen])
    return out


def _decompose(scaled: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """Columns U and squared singular values of D^-1 B, shape [T C, pieces]."""
    value, vector = torch.linalg.eigh(scaled.T @ scaled)
    keep = value > LEAST
    return scaled @ (vector[:, keep] * value[keep].rsqrt()), value[keep]


def _power(basis: torch.Tensor, gain: torch.Tensor, scaled: torch.Tensor) -> torch.Tensor:
    """Half the sum of squares of whitened columns: (1 + U S^2 U^T)^-1 = 1 - U S^2 / (1 + S^2) U^T."""
    inside = ((basis.T @ scaled) ** 2).sum(1)
    return 0.5 * ((scaled**2).sum() - (gain / (1.0 + gain) * inside).sum())


def _stacked(parts: list[tuple[torch.Tensor, torch.Tensor]], power: torch.Tensor) -> Colour:
    most = max(1, *(len(g) for _, g in parts))
    pad = torch.nn.functional.pad
    bases = torch.stack([pad(b, (0, most - b.shape[1])) for b, _ in parts]).float()
    return Colour(bases, torch.stack([pad(g, (0, most - len(g))) for _, g in parts]), power)
