"""Noise of the measured force, seen through the model: it colours what a perfect model would leave over.

A branch is driven by a force that a sensor reads with white noise. The simulation feels that noise, so that measured
minus simulated motion is sensor noise plus the noise's response: to first order

    r = D e + B n,  e, n white,  cov r = D^2 + B B^T,

with D the channels' noise and B the response of the outputs to one standard deviation of the force at every sample.
Taking r for white would make intervals too narrow where the response lasts. With D^-1 B = U S V^T the residual is
whitened by e = (1 - U (1 - (1 + S^2)^-1/2) U^T) D^-1 r.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from ..sim.tree import Array
from .case import BranchCase
from .plant_branch import Unknowns
from .rollout import Recording, Rollout

#: Moments of a recording at which a pulse is simulated; between them the earlier one's response is shifted.
PULSES = 16
#: Independent pieces of noise a recording and axis; longer recordings take means over neighbouring samples. Means lose
#: what is faster than they are, and a branch that swings once in five samples answers to just that.
PIECES = 160


@dataclass(frozen=True)
class Colour:
    """How noise of the input correlates the outputs, for R recordings.

    Attributes:
        basis: Orthonormal columns U, shape [R, T C, M].
        gain: Squared singular values S^2, shape [R, M].
    """

    basis: torch.Tensor
    gain: torch.Tensor

    def whiten(self, z: torch.Tensor) -> torch.Tensor:
        """Whiten residuals [..., R, T, C] that are in units of the channels' noise."""
        flat = z.flatten(-2).transpose(0, -2) if z.dim() > 3 else z.flatten(-2)[:, None]
        rows = flat.reshape(len(self.basis), -1, flat.shape[-1])
        shrink = 1.0 - (1.0 + self.gain).rsqrt()
        rows = rows - ((rows @ self.basis) * shrink[:, None]) @ self.basis.transpose(1, 2)
        out = rows.reshape(flat.shape)
        return (out.transpose(0, -2) if z.dim() > 3 else out[:, 0]).unflatten(-1, z.shape[-2:])

    def variance(self, shape: tuple[int, int]) -> torch.Tensor:
        """Return what the input's noise adds to the variance of every output, in units of the noise's, [R, T, C]."""
        return ((self.basis**2) @ self.gain[..., None])[..., 0].unflatten(-1, shape)


def input_colour(
    case: BranchCase, chosen: Sequence[Recording], values: torch.Tensor, force_sigma: Array, sigma: torch.Tensor, *,
    unknowns: Unknowns | None = None, device: object = None,
) -> Colour:  # fmt: skip
    """Return the colour that noise of the force gives to recordings simulated with parameters ``values`` [n].

    Args:
        case: The branch.
        chosen: R recordings.
        values: Parameters about which the response is linear.
        force_sigma: Noise of the force [N], shape [3].
        sigma: Noise of the outputs, shape [C].
        unknowns: What the values are.
        device: Warp device.
    """
    axes = np.flatnonzero(force_sigma > 0.0)
    pulsed, step = [], 5.0 * float(force_sigma.max())
    moments = [_moments(len(r.t)) for r in chosen]
    for r, at in zip(chosen, moments, strict=True):
        pulsed += [r, *(_pulse(r, int(k), int(a), step) for k in at for a in axes)]
    out = Rollout(case, pulsed, 1, unknowns=unknowns, device=device)(values[None])[0].double()
    parts, first = [], 0
    for r, at in zip(chosen, moments, strict=True):
        change = (out[first + 1 : first + 1 + len(at) * len(axes)] - out[first]) / step
        response = change.unflatten(0, (len(at), len(axes)))
        parts.append(_columns(r, at, response, force_sigma[axes]))
        first += 1 + len(at) * len(axes)
    return _decompose(parts, sigma.to(out.device))


def _moments(length: int) -> Array:
    """Return the samples that are pulsed, the first among them: its pulse only falls, all others rise and fall."""
    return np.unique(np.concatenate([[0], np.linspace(1, length - 2, PULSES).astype(int)]))


def _pulse(r: Recording, sample: int, axis: int, size: float) -> Recording:
    changed = r.input.copy()
    changed[sample, axis] += size
    return replace(r, input=changed)


def _columns(r: Recording, at: Array, response: torch.Tensor, force_sigma: Array) -> torch.Tensor:
    """Response to one deviation of every independent piece of noise, [T, C, pieces]."""
    length, longest = len(r.t), response.shape[2]
    block = -(-length // PIECES)
    out = []
    for start in range(0, length, block):
        samples = [k for k in range(start, min(start + block, length)) if r.contact[k]]
        if not samples:
            continue
        total = torch.zeros_like(response[0])
        for k in samples:
            i = int(np.searchsorted(at, k, side="right")) - 1
            total[:, k:length] += response[i][:, at[i] : at[i] + length - k]
        scale = torch.as_tensor(force_sigma / np.sqrt(len(samples)), device=total.device)
        out.append(total * scale[:, None, None])
    if not out:
        return response.new_zeros(longest, response.shape[-1], 0)
    return torch.cat(out).permute(1, 2, 0)


def _decompose(parts: list[torch.Tensor], sigma: torch.Tensor) -> Colour:
    active = sigma > 0.0
    bases, gains = [], []
    for columns in parts:
        scaled = torch.where(active[:, None], columns / torch.where(active, sigma, 1.0)[:, None], 0.0).flatten(0, 1)
        value, vector = torch.linalg.eigh(scaled.T @ scaled)
        keep = value > 1e-2  # what adds less than a percent to the variance of any combination
        bases.append(scaled @ (vector[:, keep] * value[keep].rsqrt()))
        gains.append(value[keep])
    most = max(1, *(len(g) for g in gains))
    pad = torch.nn.functional.pad
    return Colour(
        torch.stack([pad(b, (0, most - b.shape[1])) for b in bases]),
        torch.stack([pad(g, (0, most - len(g))) for g in gains]),
    )
