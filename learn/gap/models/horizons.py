"""Starts of fits to long recordings of joints: first to their beginnings, then to more and more of them.

Over many swings a model whose period is slightly wrong drifts out of phase, and squares have a local minimum at every
swing that it gains or loses. Over the first swings there is one minimum, near enough to that over more of them.
"""

from __future__ import annotations

from .contest import Batch, Contest
from .refit import fit

#: Shares of the recordings that are fitted one after the other before all of them, and steps of each fit: what has been
#: led through them must compete after its last with fits that never left a mode.
SHARES, STEPS = (0.03, 0.1, 0.3, 0.6), 8


def led(contest: Contest, batch: Batch) -> Batch:
    """Return models fitted to growing shares of every recording, from their guessed start states.

    Branches and torque fits, which have no start states to learn, are returned as they are.
    """
    return led_on(contest, batch) if batch.start.numel() else batch


def led_on(contest: Contest, batch: Batch) -> Batch:
    """Return models fitted to growing shares of every recording, from their guessed start states if they have any."""
    out = Batch(batch.free, batch.active, contest.start0.expand_as(batch.start).clone(), batch.weight)
    for share in SHARES:
        out = fit(contest.beginnings(share), out, STEPS).batch
    return fit(contest, out, STEPS).batch
