"""The line is found in what is seen of it."""

import numpy as np
import pytest
from bough.learn.deploy.line import LineFit

START, END = np.array([0.2, -0.7, 0.5]), np.array([0.6, -0.1, 0.55])


def along(share):
    return START + np.asarray(share)[:, None] * (END - START)


def test_points_on_the_axis_give_it_back_in_their_order():
    """Fit float32 points on a line: both ends within float32's rounding, in the order of the points."""
    for order in (slice(None), slice(None, None, -1)):
        line = LineFit()
        assert not line.known
        line.add(along(np.linspace(0, 1, 200))[order].astype(np.float32))
        assert line.known and line.ends == pytest.approx(np.array([START, END])[order], abs=1e-6)
        line.forget()
        assert not line.known


def test_a_half_hidden_line_is_put_together_from_pictures_with_outliers():
    """See three tenths, then the other seven, with a surface of 1 cm, 2 mm of noise and a tenth of stray points.

    The axis of the seen side lies up to the surface's radius off; ends by the extreme of noise: 2 cm.
    """
    rng, line = np.random.default_rng(0), LineFit()
    for low, high in ((0.0, 0.3), (0.3, 1.0), (0.3, 1.0)):
        seen = along(rng.uniform(low, high, 300)) + np.array([0.0, 0.0, 0.01]) + rng.normal(0.0, 0.002, (300, 3))
        stray = along(rng.uniform(low, high, 30)) + rng.normal(0.0, 0.2, (30, 3))
        line.add(np.concatenate([seen, stray, [[np.nan] * 3]]))
    off = min(np.linalg.norm(line.ends - [START, END], axis=1).max(),
              np.linalg.norm(line.ends - [END, START], axis=1).max())  # fmt: skip
    assert off < 0.02 + 0.01
    line.add(np.zeros((0, 3)))
    assert line.known
