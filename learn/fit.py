"""Finding the modes of a target before particles are spread over them: Levenberg-Marquardt from many starts at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from .target import Target


@dataclass(frozen=True)
class Modes:
    """Where the starts ended.

    Attributes:
        theta: Vectors [S, D]; the noise entries are at their conditional optimum.
        log_posterior: Shape [S].
        precision: Gauss-Newton precision matrix of the log posterior at each, shape [S, D, D].
    """

    theta: torch.Tensor
    log_posterior: torch.Tensor
    precision: torch.Tensor


def jacobian_rows(target: Target, derivative: torch.Tensor) -> torch.Tensor:
    """Return d(prediction)/d(log parameters, start states) as [S, R, T, C, n + starts]."""
    n, starts = target.num_parameters, target.start0[0].numel()
    shared = derivative[:, :n].permute(0, 2, 3, 4, 1)
    if not starts:
        return shared
    own = derivative[:, n:].permute(0, 2, 3, 4, 1)
    count = own.shape[1]
    local = own.new_zeros(*own.shape[:-1], count, starts)
    for j in range(count):
        local[:, j, ..., j, :] = own[:, j]
    return torch.cat([shared, local.flatten(-2)], -1)


def levenberg_marquardt(
    target: Target,
    theta: torch.Tensor,
    *,
    iterations: int,
    horizon: float = 1.0,
    frozen: int = 0,
    progress: Callable[[int], None] = lambda _: None,
) -> torch.Tensor:
    """Climb the Gaussian log posterior at the estimated noise from every start, shape [S, D].

    Only the first ``horizon`` share of every recording counts: oscillations that are out of step further on do not pull
    a start into a side minimum. The first ``frozen`` entries stay as they are.
    """
    free = target.num_parameters + target.num_starts
    weight = _weights(target, horizon)
    damping = torch.full_like(theta[:, 0], 1e-2)
    best, best_cost = theta.clone(), torch.full_like(damping, torch.inf)
    trial = theta.clone()
    step_from: tuple[torch.Tensor, torch.Tensor] | None = None
    for _ in range(iterations):
        prediction, derivative = target.linearise(trial)
        residual = target.residual(prediction) * weight
        cost = 0.5 * (residual**2).sum((-1, -2, -3)) - target.prior(trial)
        better = (cost < best_cost) & torch.isfinite(cost)
        rows = (jacobian_rows(target, derivative) * weight[..., None]).flatten(1, 3)
        normal = rows.transpose(1, 2) @ rows
        pull = (rows.transpose(1, 2) @ residual.flatten(1)[..., None])[..., 0] + _prior_gradient(target, trial)[
            :, :free
        ]
        pull[:, :frozen] = 0.0
        normal[:, :frozen], normal[:, :, :frozen] = 0.0, 0.0
        if step_from is None:
            step_from = (normal, pull)
        step_from = (
            torch.where(better[:, None, None], normal, step_from[0]),
            torch.where(better[:, None], pull, step_from[1]),
        )
        best = torch.where(better[:, None], trial, best)
        best_cost = torch.where(better, cost, best_cost)
        damping = torch.where(better, damping * 0.2, damping * 8.0).clamp(1e-9, 1e9)
        trial = best.clone()
        trial[:, :free] += _solve(step_from[0], step_from[1], damping)
        progress(1)
    return best


def _weights(target: Target, horizon: float) -> torch.Tensor:
    """1 / sigma of every sample of every channel inside the horizon, shape [R, T, C]."""
    weight = target.weight.clone()
    for j, r in enumerate(target.recordings):
        weight[j, max(4, int(horizon * len(r.t))) :] = 0.0
    return weight / target.sigma0


def _solve(normal: torch.Tensor, pull: torch.Tensor, damping: torch.Tensor) -> torch.Tensor:
    diagonal = normal.diagonal(dim1=1, dim2=2)
    floor = 1e-12 * diagonal.amax(1, keepdim=True).clamp(min=1e-12)
    scaled = normal + torch.diag_embed((diagonal + floor) * damping[:, None] + floor)
    step = torch.linalg.solve(torch.nan_to_num(scaled), torch.nan_to_num(pull)[..., None])[..., 0]
    longest = step.abs().amax(1, keepdim=True).clamp(min=1e-12)
    return torch.nan_to_num(step * torch.clamp(2.0 / longest, max=1.0))


def _prior_gradient(target: Target, theta: torch.Tensor) -> torch.Tensor:
    leaf = theta.detach().requires_grad_()
    return torch.autograd.grad(target.prior(leaf).sum(), leaf)[0]


def settle_noise(target: Target, theta: torch.Tensor) -> torch.Tensor:
    """Return theta with every group's noise at its most likely value given the rest."""
    if not target.num_noise:
        return theta
    r = target.residual(target.predict(theta))
    squares = torch.stack([(r[..., target.groups == g] ** 2).sum((-1, -2, -3)) for g in range(target.num_noise)], -1)
    out = theta.clone()
    out[:, -target.num_noise :] = 0.5 * torch.log(squares / target.per_group)
    return out


def find_modes(target: Target, starts: torch.Tensor, progress: Callable[[int], None] = lambda _: None) -> Modes:
    """Climb from every start [S, D] over growing horizons and return where they end."""
    theta = starts
    horizons = (0.03, 0.1, 0.3, 1.0) if target.num_starts else (1.0,)
    for horizon in horizons:
        theta = levenberg_marquardt(
            target, theta, iterations=24 if horizon == 1.0 else 10, horizon=horizon, progress=progress
        )
    theta = settle_noise(target, theta)
    evaluation = target.evaluate(theta)
    return Modes(theta, torch.nan_to_num(evaluation.log_posterior, nan=-torch.inf), precision_at(target, theta))


def precision_at(target: Target, theta: torch.Tensor) -> torch.Tensor:
    """Gauss-Newton precision of the log posterior at [S, D]: J^T J / sigma^2, 2 N for log noise, and the prior's."""
    _, derivative = target.linearise(theta)
    noise = target.split(theta)[2] if target.num_noise else target.log_noise0.expand(len(theta), -1)
    sigma = noise.exp()[:, target.groups]
    rows = (jacobian_rows(target, derivative) * (target.weight / sigma[:, None, None])[..., None]).flatten(1, 3)
    full = theta.new_zeros(len(theta), target.num_dims, target.num_dims)
    free = target.num_parameters + target.num_starts
    full[:, :free, :free] = rows.transpose(1, 2) @ rows
    for g in range(target.num_noise):
        full[:, free + g, free + g] = 2.0 * target.per_group[g]
    # a floor of one e-fold on what the data do not determine, so that no particle is thrown across decades
    return full + torch.eye(target.num_dims, dtype=torch.float64, device=theta.device)
