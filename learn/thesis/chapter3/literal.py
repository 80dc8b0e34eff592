"""SVGD to the letter of the thesis: what its own algorithm gives, beside what `bough identify` does.

Parameters are springs and dampers themselves, no logarithms (3.3.3), drawn uniformly from the box. Gradients are
central differences of the published loss over kT, 0.5 either way (table A.1). The kernel is
exp(-|x - y|^2 / (2 sigma^2)) with sigma the median of the distances of pairs (2.3.4, table A.1). The direction is
followed by Adam with a step of 3.0 (3.5.1, table A.1) for as many iterations as tables A.1 and A.2 say.
The inequality prior is eq. 3.17 in N m/rad, learnt by the one-hidden-layer network.

What the thesis leaves open is chosen here: eta, Adam's other numbers (torch's), and the box's sigma, with the Normal
tails of GPyTorch's code. That sigma decides whether the letter's algorithm moves freely, see `BOX_SIGMAS`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from scipy import stats

from ...cases.case import BranchCase
from ...inference.target import Target
from ...priors.learnt import POSITION, InequalityPrior, chain_pairs
from ...replay.recording import Recording, recordings
from .bench import BOX, CLIMB, DISPLACEMENT, SAMPLES, TRAINING, UNKNOWNS, Bench, Scores, interval_of
from .prior import Advance
from .robust import GRASP_NOISE, STAND_IN_NOISE, STAND_INS, TESTED_AT, TRAINED_AT, make_case

STEP, SPACING = 3.0, 0.5
"""Adam's step and the finite-difference spacing (table A.1) [N m/rad, N m s/rad]."""
BOX_SIGMAS = (0.01, 1.0)
"""Deviations of the smoothed box's tails [N m/rad]; the first is GPyTorch's default. With it one particle that Adam's
first step puts 3 outside has a gradient of 30,000; the kernel hands a share of it to all others, and it stays in Adam's
second moment for a thousand iterations, in which steps are far below 3. With the second they are not."""
LEAST = 0.05
"""Springs and dampers are simulated as at least this: a particle outside the box may be below zero."""
SEEDS = 5
"""Branches, each with starts of its own, that the gain of the prior is measured on."""
MARKS = (70, 200)
"""Iterations at which a run is scored: the thesis's for R = 3, and its longest."""
ETAS = (10.0, 100.0)
"""Sharpness of eq. 3.17 per N m/rad; the thesis does not state its own."""
STUDY = (1.0, 10.0)
"""The box and the sharpness of figures 3.7 to 3.9: particles that move."""
STUDY_KT = {1: 1 / 20, 2: 1 / 40}
"""Temperature by number of segments (tables A.1 and A.2)."""
STUDY_ITERATIONS = 90
STAND_IN_ITERATIONS = (60, 200, 60)
"""Iterations of the stand-ins, in the order of `robust.STAND_INS`; and of figures 3.7 and 3.8 (tables A.1 and A.2)."""
_FOLD = BOX[1] / POSITION
"""Eq. 3.17 doubles with its arguments: the network, trained up to `POSITION`, serves the box in this unit."""


Variant = tuple[float, float | None]
"""Deviation of the box's tails, and the sharpness of eq. 3.17 or None without it."""


@dataclass(frozen=True)
class Gain:
    """What the prior of sharpness ``eta`` gains after some iterations, over seeds: without over with it.

    Attributes:
        sigma: Deviation of the box's tails [N m/rad].
        eta: Sharpness, per N m/rad.
        iterations: Iterations.
        width, nll: Ratios of every seed, shapes [S].
    """

    sigma: float
    eta: float
    iterations: int
    width: np.ndarray
    nll: np.ndarray


@dataclass(frozen=True)
class LiteralStudy:
    """What the letter's posterior predicts of held-out trajectories: no sensor noise is added to the particles' own.

    Attributes:
        label: Which noise, place or branch.
        kt: Temperature.
        iterations: Iterations.
        width: Mean width of the 95 % interval of the displacement [m].
        outside: Share of measured points outside it.
    """

    label: str
    kt: float
    iterations: int
    width: float
    outside: float


def direction(x: torch.Tensor, gradient: torch.Tensor) -> torch.Tensor:
    """Return eq. 2.22 with the kernel of 2.3.4, its sigma the median distance of pairs, shape [P, D]."""
    difference = x[:, None] - x[None, :]
    squared = (difference**2).sum(-1)
    sigma = torch.pdist(x).median().clamp(min=1e-9)
    k = torch.exp(-squared / (2.0 * sigma**2))
    repulsion = -(k[..., None] * difference).sum(0) / sigma**2
    return (k.T @ gradient + repulsion) / len(x)


def log_prior(x: torch.Tensor, pairs: Sequence[tuple[int, int]], variant: Variant) -> torch.Tensor:
    """Return the smoothed box's log density and, with an eta, eq. 3.17's, at springs and dampers [..., D]."""
    sigma, eta = variant
    box = -((x - x.clamp(*BOX)) ** 2).sum(-1) / (2.0 * sigma**2)
    return box if eta is None or not pairs else box + _FOLD * InequalityPrior(pairs, eta).to(x.device)(x / _FOLD)


def gradient(target: Target, x: torch.Tensor, variant: Variant) -> torch.Tensor:
    """Return the gradient [P, D] of the log posterior at springs and dampers [P, D]; zero where a world diverges."""
    offsets = SPACING * torch.eye(x.shape[1]).to(x)
    points = torch.cat([x[:, None] + offsets, x[:, None] - offsets], 1)
    logs = points.flatten(0, 1).clamp(min=LEAST).log()
    value = target.log_likelihood(target.predict(logs), logs.new_zeros(len(logs), 0))
    ahead, behind = value.unflatten(0, points.shape[:2]).chunk(2, 1)
    leaf = x.detach().clone().requires_grad_()
    pairs = chain_pairs([p.name for p in target.system.parameters])
    with torch.enable_grad():
        (own,) = torch.autograd.grad(log_prior(leaf, pairs, variant).sum(), leaf)
    return torch.nan_to_num((ahead - behind) / (2.0 * SPACING)) + own


def follow(target: Target, variant: Variant, *, particles: int, marks: Sequence[int], seed: int) -> list[torch.Tensor]:
    """Run the letter's SVGD and return the particles after each number of iterations, springs and dampers [P, D]."""
    generator = torch.Generator().manual_seed(seed)
    start = torch.rand(particles, target.num_parameters, generator=generator, dtype=torch.float64)
    x = (BOX[0] + (BOX[1] - BOX[0]) * start).to(target.place)
    optimiser = torch.optim.Adam([x], lr=STEP)
    out = []
    for k in range(1, max(marks) + 1):
        x.grad = -direction(x, gradient(target, x, variant))
        optimiser.step()
        if k in marks:
            out.append(x.detach().clone())
    return out


def table_3_1(
    folder: Path, benches: Sequence[Bench], seeds: int, *, particles: int, marks: Sequence[int], unseen: int, seed: int,
    advance: Advance,
) -> dict[Variant, list[list[Scores]]]:  # fmt: skip
    """Run the letter's SVGD on branches with starts of their own, without and with the inequality prior.

    Args:
        folder: Where cases of branches beyond ``benches`` are written.
        benches: Branches that are there already, the first ``seeds`` of them are used.
        seeds: Number of branches.
        particles: Particles.
        marks: Iterations to score at.
        unseen: Trajectories to predict.
        seed: Of everything random.
        advance: Called after each run.

    Returns:
        Scores by variant, lists over branches of lists over marks.
    """
    out: dict[Variant, list[list[Scores]]] = {(sigma, eta): [] for sigma in BOX_SIGMAS for eta in (None, *ETAS)}
    for k in range(seeds):
        bench = benches[k] if k < len(benches) else Bench(folder / f"literal_{k}", seed + k, unseen=unseen)
        for variant, scores in out.items():
            found = follow(bench.target(), variant, particles=particles, marks=marks, seed=seed + k)
            scores.append([bench.score(x.clamp(min=LEAST).log()) for x in found])
            advance()
    return out


def gains(scores: dict[Variant, list[list[Scores]]], marks: Sequence[int]) -> list[Gain]:
    """Return the ratios without over with the prior, seed by seed, for every box, eta and mark."""

    def ratio(sigma: float, eta: float, m: int, name: str) -> np.ndarray:
        """Return a score without the prior over the same with it, at mark m, one value a seed."""
        pairs = zip(scores[sigma, None], scores[sigma, eta], strict=True)
        return np.array([getattr(a[m], name) / getattr(b[m], name) for a, b in pairs])

    return [Gain(sigma, eta, mark, ratio(sigma, eta, m, "width"), ratio(sigma, eta, m, "nll"))
            for sigma, eta in scores if eta is not None for m, mark in enumerate(marks)]  # fmt: skip


def interval(ratios: np.ndarray) -> tuple[float, float, float]:
    """Return the geometric mean of ratios [S] and its 95 % interval by Student's t on their logarithms.

    One ratio has no interval: its ends are 0 and infinity.
    """
    logs = np.log(ratios)
    middle = float(logs.mean())
    if len(logs) < 2:
        return float(np.exp(middle)), 0.0, float("inf")
    half = float(stats.t.ppf(0.975, len(logs) - 1)) * float(logs.std(ddof=1)) / len(logs) ** 0.5
    return float(np.exp(middle)), float(np.exp(middle - half)), float(np.exp(middle + half))


class _Letter:
    """A case that springs are learnt from by the letter: revolute joints, published loss, eq. 3.17."""

    def __init__(self, case: BranchCase, kt: float, iterations: int, particles: int, seed: int) -> None:
        self.case, self.kt, self.iterations, self.particles, self.seed = case, kt, iterations, particles, seed
        self.every = recordings(case)

    def _target(self, chosen: Sequence[Recording]) -> Target:
        return Target(self.case, chosen, CLIMB, unknowns=UNKNOWNS, loss="published", temperature=self.kt)

    def learn(self, train: Sequence[Recording]) -> torch.Tensor:
        """Return particles, logarithms of springs and dampers [P, D]."""
        target = self._target(train)
        x = follow(target, STUDY, particles=self.particles, marks=(self.iterations,), seed=self.seed)[0]
        return x.clamp(min=LEAST).log()

    def held_out(self, label: str, theta: torch.Tensor, test: Sequence[Recording]) -> LiteralStudy:
        """Return what particles predict of recordings that they have not seen."""
        unseen = self._target(test)
        low, high = interval_of(unseen, theta)
        seen = unseen.measured[..., DISPLACEMENT]
        outside = float(((seen < low) | (seen > high)).double().mean())
        return LiteralStudy(label, self.kt, self.iterations, float((high - low).mean()), outside)


@dataclass(frozen=True)
class Studies:
    """Figures 3.7 to 3.9 by the letter: revolute joints, published loss, kT and iterations of tables A.1 and A.2.

    Attributes:
        folder: Where cases are written.
        unseen: Trajectories to predict in figures 3.7 and 3.8.
        scale: Of the numbers of iterations; 1 is the thesis's.
        particles: Particles.
        seed: Of everything random.
    """

    folder: Path
    unseen: int
    scale: float
    particles: int
    seed: int

    def _made(
        self, name: str, segments: int, iterations: int, *, own: int, noise: float, grasps: Sequence[float],
        samples: int = SAMPLES,
    ) -> _Letter:  # fmt: skip
        folder = self.folder / f"literal_{name}"
        case, _ = make_case(folder, own, segments, noise=noise, samples=samples, grasps=grasps, planar=True)
        count = max(2, round(self.scale * iterations))
        return _Letter(case, STUDY_KT[segments], count, self.particles, self.seed)

    def noise(self, noises: Sequence[float]) -> list[LiteralStudy]:
        """Repeat figure 3.7 for shares of noise on force and motion."""
        out = []
        for noise in noises:
            places = [TRAINED_AT] * (TRAINING + self.unseen)
            made = self._made(f"noise_{noise:g}", 2, STUDY_ITERATIONS, own=self.seed, noise=noise, grasps=places)
            theta = made.learn(made.every[:TRAINING])
            out.append(made.held_out(f"{100 * noise:g} %", theta, made.every[TRAINING:]))
        return out

    def grasp(self) -> list[LiteralStudy]:
        """Repeat figure 3.8: learnt at one place, predicted at others."""
        places = [TRAINED_AT] * TRAINING + [p for p in TESTED_AT for _ in range(self.unseen)]
        made = self._made("grasp", 2, STUDY_ITERATIONS, own=self.seed, noise=GRASP_NOISE, grasps=places)
        theta = made.learn(made.every[:TRAINING])
        firsts = range(TRAINING, len(places), self.unseen)
        return [made.held_out(f"{place:g} of the length", theta, made.every[first : first + self.unseen])
                for place, first in zip(TESTED_AT, firsts, strict=True)]  # fmt: skip

    def stand_ins(self) -> list[LiteralStudy]:
        """Repeat figure 3.9 on the stand-ins: three trajectories learnt from, three predicted, and the other way."""
        out = []
        for k, (name, segments, samples, _) in enumerate(STAND_INS):
            made = self._made(f"stand_in_{k}", segments, STAND_IN_ITERATIONS[k], own=self.seed + k,
                              noise=STAND_IN_NOISE, grasps=[TRAINED_AT] * 6, samples=samples)  # fmt: skip
            folds = [made.held_out(name, made.learn(made.every[a::2]), made.every[1 - a :: 2]) for a in (0, 1)]
            width, outside = (float(np.mean([getattr(f, n) for f in folds])) for n in ("width", "outside"))
            out.append(LiteralStudy(name, folds[0].kt, folds[0].iterations, width, outside))
        return out
