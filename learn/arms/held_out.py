"""Least squares in which every block of rows is predicted from the others.

Of linear columns Z and a target y that may depend on a parameter t on a grid, y_t, the fit without block b is

    beta_t = (A - A_b)^-1 (c_t - c_tb),   A_b = Z_b^T Z_b,   c_tb = Z_b^T y_tb,

at the t that leaves least of the other blocks, and its error is what it leaves of block b. All of it follows from sums
over blocks. How the estimates scatter over the blocks left out is the jackknife's standard error (Efron & Tibshirani
1993, ch. 11).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...sim.base.types import Array, IntArray

#: Added to the diagonal of normal equations, as a share of it: columns that say the same are told apart no further.
_RIDGE = 1e-9


@dataclass(frozen=True)
class HeldOut:
    """A fit and what it leaves of blocks that it has not seen.

    Attributes:
        error: Sum of squares left of every block by the fit to the others, [B].
        beta: Coefficients of the columns by the fit to all, [p].
        at: Index of the grid that it chose.
        left: Rows that the fit to all leaves, [N].
        betas: Coefficients by the fits without each block, [B, p].
        chosen: Indices of the grid by the fits without each block, [B].
    """

    error: Array
    beta: Array
    at: int
    left: Array
    betas: Array
    chosen: IntArray


def held_out(targets: Array, columns: Array, block: IntArray) -> HeldOut:
    """Fit targets [G, N] by columns [N, p], on a grid of G values of a parameter; ``block`` counts from 0, [N]."""
    count = int(block.max()) + 1
    gram = np.stack([columns[block == b].T @ columns[block == b] for b in range(count)])
    cross = np.stack([targets[:, block == b] @ columns[block == b] for b in range(count)])  # [B, G, p]
    square = np.stack([(targets[:, block == b] ** 2).sum(axis=1) for b in range(count)])  # [B, G]
    total, crossed, squared = gram.sum(axis=0), cross.sum(axis=0), square.sum(axis=0)
    betas = _solved(total - gram, crossed - cross)
    seen = squared - square - (betas * (crossed - cross)).sum(axis=-1)
    chosen = seen.argmin(axis=1)
    rows = np.arange(count)
    mine = betas[rows, chosen]
    error = square[rows, chosen] - 2.0 * (mine * cross[rows, chosen]).sum(axis=-1)
    error = error + np.einsum("bi,bij,bj->b", mine, gram, mine)
    beta = _solved(total[None], crossed[None])[0]
    at = int((squared - (beta * crossed).sum(axis=-1)).argmin())
    return HeldOut(error, beta[at], at, targets[at] - columns @ beta[at], mine, chosen)


def _solved(gram: Array, cross: Array) -> Array:
    """Solve normal equations [B, p, p] for right-hand sides [B, G, p]."""
    if not gram.shape[-1]:
        return np.zeros_like(cross)
    size = np.einsum("bii->bi", gram)
    eased = gram + np.eye(gram.shape[-1]) * (_RIDGE * size + 1e-300)[:, None, :]
    return np.swapaxes(np.linalg.solve(eased, np.swapaxes(cross, 1, 2)), 1, 2)


def centred(values: Array, recording: IntArray) -> Array:
    """Return columns [N, ...] less their means over each recording."""
    out = values.astype(np.float64)
    for r in np.unique(recording):
        out[recording == r] -= out[recording == r].mean(axis=0)
    return out


#: Share of the usual error that is added to both sides of a ratio: blocks in which little moves say little.
_QUIET = 0.1


def chance(before: Array, after: Array, block: IntArray) -> float:
    """Return the probability of so clear a gain over blocks by chance: one-sided t test of log error ratios.

    Ratios, so that a block in which much moves counts no more than another.

    Args:
        before: Sums of squares of the blocks by one model, [B].
        after: The same by another, [B].
        block: Index of the block of every row, [N].
    """
    from scipy.stats import t

    rows = np.bincount(block, minlength=len(before))
    quiet = _QUIET * before.sum() / rows.sum()
    gain = np.log((before / rows + quiet) / (after / rows + quiet))
    spread = float(gain.std(ddof=1)) / np.sqrt(len(gain))
    if not spread > 0.0:
        return 1.0
    return float(t.sf(float(gain.mean()) / spread, len(gain) - 1))


def spread_of(estimates: Array) -> Array:
    """Return the jackknife's standard error of estimates [B, ...] by the fits without each block."""
    count = len(estimates)
    out: Array = np.sqrt((count - 1) / count * ((estimates - estimates.mean(axis=0)) ** 2).sum(axis=0))
    return out
