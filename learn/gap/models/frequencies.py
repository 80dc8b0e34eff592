"""Candidate frequencies of an oscillating load: those at which a horizontal force would explain the residual.

A gust is coherent on the absolute clock over all recordings, so its frequency is resolved to a fraction of the inverse
of the whole session: too many frequencies to simulate one by one. The branch responds almost linearly to a force at the
grasp point, so one pulse per recording and axis gives the response to any force by convolution. The search is coarse to
fine: first the frequencies that one recording resolves, with a free phase per recording; then, about the best of them,
those that the whole session resolves.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import torch

from ....sim.base.types import Array
from ...cases.case import BranchCase
from ...replay.recording import Recording
from ...replay.rollout import Rollout
from .candidates import Candidate, Probe
from .contest import Contest
from .scan import Basis

#: Coarse frequencies that are refined, and fine ones that are simulated.
COARSE, FINE = 3, 3
#: Numbers of responses that are held at once.
TOGETHER = 2_000_000
#: Size of the pulse, as a share of the largest force.
PULSE = 0.1


def frequency_probes(contest: Contest, basis: Basis, without: Sequence[int] = ()) -> tuple[list[Probe], int]:
    """Return probes at the best frequencies of the oscillating candidates, and how many frequencies were compared.

    Candidates in ``without`` are skipped. Effects that the model has already are left out of the response, because the
    frequency is determined by its phase over the session.
    """
    oscillate = [(i, c) for i, c in enumerate(contest.candidates) if any(s.unit == "Hz" for s in c.specs)]
    own = [(i, c) for i, c in oscillate if i not in without]
    if not own or not isinstance(contest.case, BranchCase):
        return [], 1
    probes, tried = [], 1
    response = _pulse_response(contest, basis)
    for index, candidate in own:
        at = next(k for k, s in enumerate(candidate.specs) if s.unit == "Hz")
        parameter = contest.parameters[candidate.columns[at]]
        found, tried = _likeliest(contest, basis, response, (parameter.low, parameter.high))
        probes += [_probe(index, candidate, at, f) for f in found]
    return probes, tried


def _probe(index: int, candidate: Candidate, at: int, frequency: float) -> Probe:
    values = [s.neutral for s in candidate.specs]
    values[at] = frequency
    return Probe(index, tuple(values), tuple(k for k in range(len(values)) if k != at))


def _pulse_response(contest: Contest, basis: Basis) -> torch.Tensor:
    """Change of the channels after one newton at the second sample of every recording, x and y, [2, R, T, C]."""
    case = contest.case
    size = PULSE * max(float(np.abs(r.input).max()) for r in contest.recordings)
    pulsed = [*contest.recordings, *(_pulsed(r, a, size) for a in (0, 1) for r in contest.recordings)]
    values = contest.values(basis.fit.batch)[:, : contest.num_base]
    out = Rollout(case, pulsed, 1, device=contest.device)(values)[0].double()
    plain, x, y = out.chunk(3)
    return torch.stack([x - plain, y - plain]) / size


def _pulsed(r: Recording, axis: int, size: float) -> Recording:
    changed = r.input.copy()
    changed[1, axis] += size
    return replace(r, input=changed)


def _likeliest(
    contest: Contest, basis: Basis, response: torch.Tensor, ends: tuple[float, float]
) -> tuple[list[float], int]:
    """Return the frequencies between two ends that explain most of the residual, and how many were compared."""
    t = torch.as_tensor(contest.recordings[0].t, device=contest.place)
    span = contest.recordings[-1].t_start + float(t[-1]) - contest.recordings[0].t_start
    coarse = np.arange(ends[0], ends[1], 0.3 / float(t[-1]))
    left = basis.free_of(basis.residual[None])[0]
    alone = _gains(contest, response, coarse, lambda waves: _gain_apart(left, waves))
    top = coarse[_separate(alone, COARSE)]
    near = np.arange(-0.15 / float(t[-1]), 0.15 / float(t[-1]), 0.25 / span)
    fine = (top[:, None] + near).ravel()
    gains = _gains(contest, response, fine, lambda waves: _gain_together(basis, left, waves))
    return [float(fine[k]) for k in np.argsort(-gains)[:FINE]], len(coarse) + len(fine)


def _gains(
    contest: Contest, response: torch.Tensor, frequencies: Array, gain: Callable[[torch.Tensor], torch.Tensor]
) -> Array:  # fmt: skip
    """Return the gains of frequencies [F], as many at once as `TOGETHER` allows: one at a time reads the basis anew."""
    spectra = torch.fft.rfft(response, 2 * response.shape[2], dim=2)
    size = max(1, TOGETHER // (2 * response.numel()))
    parts = [gain(contest.whiten(_waves(contest, response, spectra, frequencies[k : k + size])).unflatten(0, (-1, 4)))
             for k in range(0, len(frequencies), size)]  # fmt: skip
    return torch.cat(parts).nan_to_num().cpu().numpy()


def _separate(gain: np.ndarray, count: int) -> list[int]:
    """Return the indices of the highest values of which none are neighbours."""
    out: list[int] = []
    for k in np.argsort(-gain):
        if all(abs(k - j) > 1 for j in out):
            out.append(int(k))
        if len(out) == count:
            break
    return out


def _gain_together(basis: Basis, left: torch.Tensor, waves: torch.Tensor) -> torch.Tensor:
    """Gain for a residual [N] of forces with one phase in all recordings, [F]; ``waves`` [F, 4, R, T, C]."""
    own = waves.flatten(2)
    pull, normal = own @ left, own @ basis.free_of(own.flatten(0, 1)).view_as(own).transpose(1, 2)
    return (pull * torch.linalg.lstsq(normal, pull[..., None]).solution[..., 0]).sum(1)


def _gain_apart(left: torch.Tensor, waves: torch.Tensor) -> torch.Tensor:
    """Gain for a residual [N] of forces with a phase of their own in each recording, [F]; ``waves`` [F, 4, R, T, C]."""
    own = waves.flatten(3).transpose(1, 2)
    pull = (own @ left.view(own.shape[1], -1)[..., None])[..., 0]
    normal = own @ own.transpose(-2, -1)
    ridge = 1e-9 * normal.diagonal(dim1=-2, dim2=-1).amax(-1).clamp(min=1e-12)
    normal = normal + ridge[..., None, None] * torch.eye(own.shape[2], dtype=own.dtype, device=own.device)
    return (pull * torch.linalg.solve(normal, pull[..., None])[..., 0]).sum((1, 2))


def _waves(contest: Contest, response: torch.Tensor, spectra: torch.Tensor, frequencies: Array) -> torch.Tensor:
    """Response [4 F, R, T, C] to sine and cosine forces along x and y on the absolute clock.

    ``spectra`` [2, R, T + 1, C] are the Fourier transforms of the responses to a pulse along x and y [2, R, T, C].
    """
    length, rates = response.shape[2], 2.0 * np.pi * torch.as_tensor(frequencies, device=response.device)
    out = []
    for j, r in enumerate(contest.recordings):
        clock = rates[:, None] * torch.as_tensor(r.t_start + r.t, device=response.device)
        spectrum = torch.fft.rfft(torch.stack([clock.sin(), clock.cos()], 1), 2 * length)
        both = torch.fft.irfft(spectrum[:, None, :, :, None] * spectra[:, j, None], 2 * length, dim=3)
        out.append(both[:, :, :, :length].flatten(0, 2))
    return torch.stack(out, 1)
