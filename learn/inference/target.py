"""The batched log posterior that every sampler climbs.

A vector theta holds, in this order: free coordinates of the system's parameters (n; logarithms of positive ones), start
states of every recording (coordinate and rate of each joint; none for a branch at rest), logarithms of the noise of
every group of channels (g; none under the published loss).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch

from ..cases.case import BranchCase, JointCase
from ..priors.prior import Blocks, Normal, Prior, box_prior
from ..replay.equation_error import simulation_of
from ..replay.input_noise import Colour
from ..replay.motion import about_rest
from ..replay.recording import Recording
from ..replay.rollout import Rollout
from ..systems.branch import Unknowns
from ..systems.system import box_of, free_of, values_of

Loss = Literal["gaussian", "published"]


@dataclass(frozen=True)
class Evaluation:
    """The target at P vectors: log posterior [P], gradient [P, D]; predictions, derivatives as of `linearise`."""

    log_posterior: torch.Tensor
    gradient: torch.Tensor
    prediction: torch.Tensor
    derivative: torch.Tensor


class Target:
    """Log posterior and its gradient for P vectors, by one batch of worlds: P x offsets x recordings.

    The simulator's Jacobian is taken by central differences; likelihood and prior are differentiated exactly. The
    Gaussian likelihood has one inferred noise for each group of channels. The published loss (thesis eq. 3.5, 3.9) is

        log p = -(1 / kT) sum over recordings of ||displacement error||_2 + ||velocity error||_2.

    Attributes:
        num_dims: Length D of theta.
        sigma0: Noise estimate of every channel, shape [C].
        box: Ends of the parameters' box in free coordinates, shapes [n].
        linear: Whether a parameter has no logarithm, shape [n].
        reach: One for a logarithm, half of the box of any other parameter, shape [n]: `SPACING` is a share of it.
        colour: How noise of the measured force correlates the residuals; None takes them for white.
        lean: Slope of the noise that the free coordinates let through, shape [n], and where it was taken; see
            `input_noise`.
    """

    SPACING = 0.01
    LOG_NOISE_SIGMA = 5.0

    def __init__(
        self, case: BranchCase | JointCase, chosen: Sequence[Recording], sigma: torch.Tensor, *,
        unknowns: Unknowns | None = None, prior: Prior | None = None, loss: Loss = "gaussian",
        temperature: float = 0.01, device: object = None,
    ) -> None:  # fmt: skip
        self.case, self.recordings, self.unknowns, self.device = case, list(chosen), unknowns, device
        self.loss, self.temperature = loss, temperature
        self.colour: Colour | None = None
        self.lean: tuple[torch.Tensor, torch.Tensor] | None = None
        self._rollouts: dict[int, Rollout] = {}
        self.system = self.rollout(1).system
        self.place = self.rollout(1).torch_device
        self.sigma0 = sigma.double().to(self.place)
        groups = torch.tensor([0, 0, 0, 1, 1, 1]) if isinstance(case, BranchCase) else torch.arange(len(sigma))
        self.groups = groups.to(self.place)
        self.num_parameters = len(self.system.parameters)
        self.start0 = torch.stack([torch.as_tensor(r.start) for r in chosen]).to(self.place)
        self.num_starts = self.start0.numel()
        self.num_noise = int(self.groups.max()) + 1 if loss == "gaussian" else 0
        self.num_dims = self.num_parameters + self.num_starts + self.num_noise
        self._stack_outputs()
        low, high = box_of(self.system.parameters)
        self.box = (low.to(self.place), high.to(self.place))
        self.linear = torch.tensor([p.scale == "linear" for p in self.system.parameters], device=self.place)
        self.reach = torch.where(self.linear, 0.5 * (self.box[1] - self.box[0]), 1.0)
        self.prior = self._prior(prior or box_prior(self.system.parameters))

    def _stack_outputs(self) -> None:
        longest = max(len(r.t) for r in self.recordings)
        channels = self.recordings[0].output.shape[1]
        active = self.sigma0 > 0.0  # a planar case has no motion and no noise across its plane
        self.measured = torch.zeros(len(self.recordings), longest, channels, dtype=torch.float64, device=self.place)
        self.weight = torch.zeros_like(self.measured)
        for j, r in enumerate(self.recordings):
            self.measured[j, : len(r.t)] = torch.as_tensor(r.output, device=self.place)
            self.weight[j, : len(r.t)] = active.double()
        motion = about_rest(self.case, self.recordings, self.measured)
        self.start_scale = max(float(motion.abs().max()), 1e-9)
        groups = range(int(self.groups.max()) + 1)
        self.per_group = torch.stack([self.weight[..., self.groups == g].sum() for g in groups])
        self.log_noise0 = torch.stack(
            [(self.sigma0[(self.groups == g) & active] ** 2).mean().sqrt().log() for g in groups]
        )
        self.sigma0 = torch.where(active, self.sigma0, 1.0)  # divided by, with weight zero

    def _prior(self, own: Prior) -> Prior:
        wide = torch.full_like(self.start0.flatten(), 10.0 * max(self.start_scale, 1.0))
        parts: list[tuple[int, Prior]] = [
            (self.num_parameters, own),
            (self.num_starts, Normal(self.start0.flatten(), wide)),
        ]
        if self.num_noise:
            # a misfit far above the measured noise must be able to raise it: a wide log-normal
            spread = torch.full_like(self.log_noise0, self.LOG_NOISE_SIGMA)
            parts.append((self.num_noise, Normal(self.log_noise0, spread)))
        return Blocks(parts).to(self.place)

    def rollout(self, num_sets: int) -> Rollout:
        """Return the rollout for a number of sets, built once."""
        if num_sets not in self._rollouts:
            self._rollouts[num_sets] = simulation_of(self.case)(
                self.case, self.recordings, num_sets, unknowns=self.unknowns, device=self.device
            )
        return self._rollouts[num_sets]

    @property
    def world_steps(self) -> int:
        """World-steps taken so far."""
        return sum(r.world_steps for r in self._rollouts.values())

    @property
    def simulation_seconds(self) -> float:
        """Wall time spent in simulation so far [s]."""
        return sum(r.seconds for r in self._rollouts.values())

    def split(self, theta: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Split [P, D] into free coordinates [P, n], start states [P, R, J, 2] and log noise [P, g]."""
        u, s, noise = torch.split(theta, [self.num_parameters, self.num_starts, self.num_noise], dim=-1)
        return u, s.reshape(len(theta), *self.start0.shape), noise

    def values(self, u: torch.Tensor) -> torch.Tensor:
        """Return parameters in SI units from their free coordinates, shapes [..., n]."""
        return values_of(self.system.parameters, u)

    def free(self, values: torch.Tensor) -> torch.Tensor:
        """Return free coordinates from parameters in SI units, shapes [..., n]."""
        return free_of(self.system.parameters, values)

    def predict(self, theta: torch.Tensor) -> torch.Tensor:
        """Return predictions [P, R, T, C]."""
        u, start, _ = self.split(theta)
        return self.rollout(len(theta))(self.values(u), start if self.num_starts else None).double()

    def linearise(self, theta: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Return predictions [P, R, T, C] and their derivatives [P, m, R, T, C] by central differences.

        At the end of a box differences are one-sided: nothing is simulated beyond it. Derivatives keep the simulator's
        precision: they are large, and far less exact than that.

        The m directions are the n parameters, then the entries of the start state, each moved in all recordings at
        once: a recording feels its own alone.
        """
        u, start, _ = self.split(theta)
        n, local = self.num_parameters, self.start0[0].numel()
        steps = torch.full((n + local,), self.SPACING, dtype=torch.float64, device=self.place)
        steps[:n] *= self.reach
        steps[n:] *= self.start_scale
        offsets = torch.diag(steps)
        offsets = torch.cat([torch.zeros_like(offsets[:1]), offsets, -offsets])
        us = self._inside(u, u[:, None] + offsets[:, :n])
        starts = start[:, None] + offsets[:, n:].reshape(len(offsets), 1, *self.start0.shape[1:])
        flat = self.rollout(len(theta) * len(offsets))(
            self.values(us.flatten(0, 1)), starts.flatten(0, 1) if local else None
        )
        out = flat.unflatten(0, (len(theta), len(offsets)))
        m = n + local
        scale = (0.5 / steps).expand(len(u), -1).clone()
        apart = (us[:, 1 : n + 1] - us[:, m + 1 : m + n + 1]).diagonal(dim1=1, dim2=2)
        scale[:, :n] = torch.where(self.linear, 1.0 / apart, scale[:, :n])
        return out[:, 0].double(), (out[:, 1 : m + 1] - out[:, m + 1 :]) * scale.to(out.dtype)[..., None, None, None]

    def _inside(self, u: torch.Tensor, us: torch.Tensor) -> torch.Tensor:
        """Return points [P, k, n] about u [P, n], none past the end of a box that no logarithm bounds, unless u is."""
        low, high = (torch.where(self.linear, end, free) for end, free in zip(self.box, (-torch.inf, torch.inf),
                     strict=True))  # fmt: skip
        return torch.maximum(torch.minimum(us, torch.maximum(high, u)[:, None]), torch.minimum(low, u)[:, None])

    def residual(self, prediction: torch.Tensor) -> torch.Tensor:
        """Return measured minus predicted, zero past a recording's end, [P, R, T, C]."""
        return (self.measured - prediction) * self.weight

    def log_likelihood(self, prediction: torch.Tensor, log_noise: torch.Tensor) -> torch.Tensor:
        """Return the log likelihood [P] of predictions [P, R, T, C]."""
        r = self.residual(prediction)
        if self.loss == "published":
            by_kind = torch.stack([(r[..., self.groups == g] ** 2).sum((-1, -2)) for g in self.groups.unique()], -1)
            return -(by_kind + 1e-30).sqrt().sum((-1, -2)) / self.temperature
        white = self.whiten(r, log_noise)
        value = -0.5 * (white**2).sum((-1, -2, -3)) - (self.per_group * log_noise).sum(-1)
        return value if self.colour is None else value - self.colour.log_volume(self._share(log_noise))

    def _share(self, log_noise: torch.Tensor) -> torch.Tensor:
        """Squared ratio of the estimated to the present noise, the geometric mean over the groups, [P]."""
        return torch.exp(-2.0 * (log_noise - self.log_noise0).mean(-1))

    def whiten(self, residual: torch.Tensor, log_noise: torch.Tensor) -> torch.Tensor:
        """Return residuals [P, ..., R, T, C] as white noise of deviation one, given the channels' noise [P, g]."""
        sigma = log_noise.exp()[:, self.groups]
        z = residual / sigma.reshape(len(sigma), *[1] * (residual.dim() - 2), -1)
        return z if self.colour is None else self.colour.whiten(z, self._share(log_noise))

    def beside(self, theta: torch.Tensor) -> torch.Tensor:
        """Return what the log posterior holds beside the likelihood of the residuals, shape [...]: prior and lean.

        Where noise is inferred to be larger than estimated, by a model's misfit, the force's share in it is smaller.
        The lean is a slope, and holds about where it was taken: within `reach`, an e-fold or half of a box. A damper
        that a worse mode has at a hundred-thousandth would be paid for 11 of them.
        """
        if self.lean is None:
            return self.prior(theta)
        slope, centre = self.lean
        share = self._share(theta[..., -self.num_noise :].detach()).clamp(max=1.0)
        away = torch.minimum(torch.maximum(theta[..., : self.num_parameters] - centre, -self.reach), self.reach)
        return self.prior(theta) + share * (away * slope).sum(-1)

    def log_density(self, theta: torch.Tensor) -> torch.Tensor:
        """Return the log posterior [P] of [P, D] alone, from one world a vector and recording."""
        return self.log_likelihood(self.predict(theta), self.split(theta)[2]) + self.beside(theta)

    def evaluate(self, theta: torch.Tensor, derivative: torch.Tensor | None = None) -> Evaluation:
        """Evaluate the log posterior and its gradient at [P, D].

        Args:
            theta: Vectors, shape [P, D].
            derivative: Derivatives of the predictions from vectors nearby, as an earlier evaluation returned them; the
                residuals are always those at theta. None takes them here, which costs 2 m more worlds a vector.
        """
        if derivative is None:
            prediction, derivative = self.linearise(theta)
        else:
            prediction = self.predict(theta)
        leaf, free = prediction.detach().requires_grad_(), theta.detach().requires_grad_()
        noise = self.split(free)[2]
        log_posterior = self.log_likelihood(leaf, noise) + self.beside(free)
        by_output, by_theta = torch.autograd.grad(log_posterior.sum(), (leaf, free))
        weight = by_output.to(derivative.dtype).transpose(0, 1).flatten(2)
        by_recording = torch.einsum("rpk,pmrk->pmr", weight, derivative.flatten(3)).double()
        n = self.num_parameters
        chained = [by_recording[:, :n].sum(-1), by_recording[:, n:].transpose(1, 2).flatten(1)]
        gradient = by_theta + torch.nn.functional.pad(torch.cat(chained, 1), (0, self.num_noise))
        return Evaluation(log_posterior.detach(), gradient, prediction, derivative)
