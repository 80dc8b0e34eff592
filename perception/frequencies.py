"""Frequencies of random Fourier features."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def draw_frequencies(features: int, bandwidth: float = 1.0, seed: int = 0) -> NDArray[np.float32]:
    """Return w_r ~ N(0, 1/gamma^2), shape [features, 3] in rad/m: the spectrum of exp(-|x - y|^2 / (2 gamma^2)).

    Args:
        features: Number R of frequencies.
        bandwidth: gamma [m].
        seed: Of NumPy's default generator; the first frequencies of a longer draw are those of a shorter one.
    """
    draw = np.random.default_rng(seed).standard_normal((features, 3))
    return (draw / bandwidth).astype(np.float32)
