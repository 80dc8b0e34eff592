"""What noise of a measured motion does to the efforts that are predicted from it.

Accelerations are second derivatives of an encoder's counts, so their noise is often larger than that of the torques
themselves. It is drawn, filtered and differentiated as the motion was, and sent through the fitted model.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

from ...sim.base.types import Array
from ..cases.case import JointCase
from ..cases.noise import estimate_noise
from ..systems.branch import Unknowns
from .equation_error import EquationError, recordings_of, thinned
from .recording import Recording

#: Noisy copies of each recording.
COPIES = 3


def motion_noise(case: JointCase, unknowns: Unknowns, values: torch.Tensor, *, seed: int = 0) -> Array:
    """Return the rms change of the predicted efforts by noise of the motion, shape [I], in the efforts' units.

    Args:
        case: A case whose torques are fitted.
        unknowns: What the model of ``values`` has.
        values: A model's parameters in SI units, shape [n].
        seed: Of the noise.
    """
    sigma, rng = estimate_noise(case).sigma, np.random.default_rng(seed)
    every = [_as_fitted(case)]
    for _ in range(COPIES):
        noisy = [replace(t, output=t.output + sigma * rng.standard_normal(t.output.shape)) for t in case.trajectories]
        every.append(_as_fitted(replace(case, trajectories=tuple(noisy))))
    flat = [r for own in every for r in own]
    out = EquationError(case, flat, 1, unknowns=unknowns)(values[None])[0].double().cpu().numpy()
    apart = out.reshape(1 + COPIES, len(case.trajectories), *out.shape[1:])
    squares = [np.mean((apart[1:, j, : len(r.t)] - apart[0, j, : len(r.t)]) ** 2, axis=(0, 1))
               for j, r in enumerate(every[0])]  # fmt: skip
    return np.sqrt(np.mean(squares, axis=0))


def _as_fitted(case: JointCase) -> list[Recording]:
    return [thinned(case, r) for r in recordings_of(case)]
