"""From a case to a contest: noise of the channels, fit of the base model, nuisance columns of a branch."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ...sim.base.types import Array
from ..cases.case import BranchCase, JointCase
from ..inference.fit import find_modes, representatives
from ..inference.identify import force_noise, pooled_sigma
from ..inference.posterior import initial_vectors
from ..inference.target import Target
from ..replay.equation_error import noise_of, recordings_of, thinned
from ..replay.input_noise import input_colour
from .geometry import add_nuisances
from .models.at_rest import Noise, force_at_rest, noise_at_rest
from .models.candidates import names_for
from .models.contest import Batch, Contest
from .models.fitted import overdispersion
from .models.refit import Fits, evaluated, fit
from .run import Run
from .usable import nothing_moves, too_few, too_noisy

#: Starts of the base fit, and how many of the modes that they reach are fitted under the full noise model.
STARTS, MODES = 8, 3


@dataclass
class Base:
    """A case prepared for the search.

    Attributes:
        contest: What simulates and fits its models.
        fit: The base model's fit, a batch of one.
        noise: Noise of the channels.
        force_sigma: Noise of a branch's force [N], shape [3], or None.
        doubted: Whether the data say that the file's geometry or mountings are off; they are nuisances then.
        unusable: Why the data cannot support a verdict, with the missing probe; None where they can.
    """

    contest: Contest
    fit: Fits
    noise: Noise
    force_sigma: Array | None
    doubted: bool = False
    unusable: str | None = None

    @property
    def motion(self) -> float:
        """Rms of all measured channels in units of their noise: of joints' positions about their means.

        The zero of an encoder means nothing. That of the other channels is rest.
        """
        contest = self.contest
        used = contest.sigma > 0.0
        squares = ((contest.motion[..., used] / contest.sigma[used]) ** 2).sum()
        return float((squares / contest.num_samples).sqrt())


def prepare(case: BranchCase | JointCase, run: Run) -> Base:
    """Return the contest of a case with its noise and fitted base model, and whether the data can support a verdict."""
    with run.timed("base"):
        names, resting = names_for(case, run.settings.effects), nothing_moves(case)
        base = _typical(case, names) if resting else _fitted(case, names, run.settings.seed)
        base.unusable = resting or too_few(case) or too_noisy(base.motion)
        run.progress("base", 1)
    return base


def _typical(case: BranchCase | JointCase, names: Sequence[str]) -> Base:
    """Return a case with the base model at typical values, not fitted."""
    noise = noise_of(case)
    sigma, force_sigma = pooled_sigma(case, noise), force_noise(case, noise)
    weights = np.where(sigma > 0.0, sigma, 1.0)  # all-zero channels have no noise
    contest = Contest(case, [thinned(case, r) for r in recordings_of(case)], weights, names)
    return Base(contest, evaluated(contest, contest.base_batch(1)), Noise(sigma), force_sigma)


def _fitted(case: BranchCase | JointCase, names: Sequence[str], seed: int) -> Base:
    """Return a case with the base model fitted under the full noise model."""
    noise = noise_of(case)
    sigma, force_sigma = pooled_sigma(case, noise), force_noise(case, noise)
    if isinstance(case, BranchCase) and force_sigma is not None:
        force_sigma = force_at_rest(case, force_sigma)
    contest = Contest(case, [thinned(case, r) for r in recordings_of(case)], sigma, names)
    found = fit(contest, _modes(contest, seed), 3)
    base = Base(contest, found.one(int(found.cost.argmin())), Noise(sigma), force_sigma)
    settle(base)
    return base


def settle(base: Base) -> None:
    """Take the noise of channels and force, and the nuisances, about the base as it is fitted, and refit it."""
    contest, case = base.contest, base.contest.case
    base.noise = noise_at_rest(contest, base.fit.batch)
    if (base.noise.sigma != contest.sigma.cpu().numpy()).any():
        contest.set_noise(base.noise.sigma)
        base.fit = fit(contest, base.fit.batch, 3)
    if isinstance(case, BranchCase) and base.force_sigma is not None:
        answer_as(base, base.fit.batch)
        base.fit = fit(contest, base.fit.batch, 3)
        contest.overdispersion = overdispersion(contest, float(base.fit.chi2[0]))
        base.fit = fit(contest, base.fit.batch, 4)


def answer_as(base: Base, model: Batch) -> None:
    """Take the answer to noise of a branch's force, and the nuisances, about a model, a batch of one."""
    if base.force_sigma is not None:
        colour(base.contest, model, base.force_sigma)
        add_nuisances(base.contest, model, doubted=base.doubted)


def _modes(contest: Contest, seed: int) -> Batch:
    """Return starts of the base: the best modes of its posterior, and the best with typical dampers.

    A mode whose damper went to an end of its box may be no mode of the springs that it has.
    """
    target = Target(contest.case, contest.recordings, contest.sigma.cpu())
    modes = find_modes(target, initial_vectors(target, STARTS, torch.Generator().manual_seed(seed)))
    of = representatives(modes)
    order = [i for i in modes.log_posterior.argsort(descending=True).tolist() if of[i] == i][:MODES]
    u, start, _ = target.split(modes.theta[[order[0], *order]])
    model = contest.base_batch(len(u))
    model.free[:, : contest.num_base] = u
    dampers = [k for k in range(contest.num_base) if contest.parameters[k].name.startswith("damping")]
    model.free[0, dampers] = contest.centre[dampers]
    return Batch(model.free, model.active, start, model.weight)


def colour(contest: Contest, model: Batch, force_sigma: Array) -> None:
    """Set the correlation of the residuals by noise of the force, linearised about a model, a batch of one.

    Its effects act: a spring that creeps answers a fast force twice as stiff as it holds a lasting one.
    """
    if float(force_sigma.max()) <= 0.0:
        return
    assert isinstance(contest.case, BranchCase)
    acts = bool(model.active[0, contest.num_base :].any())
    values = contest.values(model)[0, : None if acts else contest.num_base]
    contest.colour = input_colour(
        contest.case, contest.recordings, values, force_sigma, contest.sigma,
        unknowns=contest.unknowns if acts else None, device=contest.device,
    )  # fmt: skip
