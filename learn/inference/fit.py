"""Modes of a target by Levenberg-Marquardt from many starts in one batch, before particles are spread over them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from ..systems.system import least_precision
from .target import Target

#: Convergence: least gain in log density per round of six iterations, and most rounds.
SETTLED, ROUNDS = 0.1, 10
#: Steps towards the maximum-likelihood noise where noise of the force correlates the channels.
NOISE_STEPS = 20


@dataclass(frozen=True)
class Modes:
    """Modes that the starts converged to.

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
    derivative = derivative.double()
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
    """Maximise the Gaussian log posterior from every start [S, D], at each start's own noise.

    Only the first ``horizon`` share of every recording is used: on a short horizon, oscillations that drift out of
    phase later do not cause local minima. The first ``frozen`` entries stay fixed.
    """
    free = target.num_parameters + target.num_starts
    window, noise = _window(target, horizon), _noise(target, theta)
    # every other start omits the prior's curvature, which may lead all of them into one local minimum
    bent = (torch.arange(len(theta), device=theta.device) % 2 == 0).double()[:, None, None]
    damping = torch.full_like(theta[:, 0], 1e-2)
    best, best_cost = theta.clone(), torch.full_like(damping, torch.inf)
    trial = theta.clone()
    step_from: tuple[torch.Tensor, torch.Tensor] | None = None
    for _ in range(iterations):
        prediction, derivative = target.linearise(trial)
        residual = target.whiten(target.residual(prediction) * window, noise)
        cost = 0.5 * (residual**2).sum((-1, -2, -3)) - target.beside(trial)
        better = (cost < best_cost) & torch.isfinite(cost)
        rows = _white_rows(target, jacobian_rows(target, derivative) * window[..., None], noise)
        normal = rows.transpose(1, 2) @ rows + bent * prior_curvature(target, trial)[:, :free, :free]
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


def _window(target: Target, horizon: float) -> torch.Tensor:
    """One at every sample inside the horizon, else zero, shape [R, T, C]."""
    window = target.weight.clone()
    for j, r in enumerate(target.recordings):
        window[j, max(4, int(horizon * len(r.t))) :] = 0.0
    return window


def _noise(target: Target, theta: torch.Tensor) -> torch.Tensor:
    """Logarithm of the noise of every group, [S, g]: theta's own, or the estimate where none is inferred."""
    return target.split(theta)[2] if target.num_noise else target.log_noise0.expand(len(theta), -1)


def _white_rows(target: Target, rows: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
    """Jacobian [S, R, T, C, m] whitened like the residuals, [S, R T C, m]."""
    return target.whiten(rows.permute(0, 4, 1, 2, 3), noise).flatten(2).transpose(1, 2)


def _solve(normal: torch.Tensor, pull: torch.Tensor, damping: torch.Tensor) -> torch.Tensor:
    diagonal = normal.diagonal(dim1=1, dim2=2)
    floor = 1e-12 * diagonal.amax(1, keepdim=True).clamp(min=1e-12)
    scaled = normal + torch.diag_embed((diagonal + floor) * damping[:, None] + floor)
    step = torch.linalg.solve(torch.nan_to_num(scaled), torch.nan_to_num(pull)[..., None])[..., 0]
    longest = step.abs().amax(1, keepdim=True).clamp(min=1e-12)
    return torch.nan_to_num(step * torch.clamp(2.0 / longest, max=1.0))


def _prior_gradient(target: Target, theta: torch.Tensor) -> torch.Tensor:
    leaf = theta.detach().requires_grad_()
    return torch.autograd.grad(target.beside(leaf).sum(), leaf)[0]


def prior_curvature(target: Target, theta: torch.Tensor) -> torch.Tensor:
    """Return the negative Hessian of the log prior, without its negative directions, shape [S, D, D].

    Without it, a narrow prior (an earlier posterior, the edge of the box) would give a gradient without curvature.
    """
    leaf = theta.detach().requires_grad_()
    slope = torch.autograd.grad(target.prior(leaf).sum(), leaf, create_graph=True)[0]
    # densities of different vectors are independent: one batched backward pass per coordinate gives all Hessians
    each = torch.eye(theta.shape[1]).to(theta)[:, None].expand(-1, *theta.shape)
    hessian = torch.autograd.grad(slope, leaf, each, is_grads_batched=True)[0].transpose(0, 1)
    value, vector = torch.linalg.eigh(torch.nan_to_num(-0.5 * (hessian + hessian.transpose(1, 2))))
    return (vector * value.clamp(min=0.0)[:, None]) @ vector.transpose(1, 2)


def settle_noise(target: Target, theta: torch.Tensor) -> torch.Tensor:
    """Return theta with every group's noise at its maximum-likelihood value given the rest.

    There the group's sum of squared whitened residuals equals its number of samples, which gives the noise in one step
    if residuals are white. If groups are correlated, steps are taken while the likelihood rises.
    """
    if not target.num_noise:
        return theta
    prediction, noise = target.predict(theta), theta[:, -target.num_noise :]
    residual, value = target.residual(prediction), target.log_likelihood(prediction, noise)
    size = torch.ones_like(value)[:, None]
    for _ in range(1 if target.colour is None else NOISE_STEPS):
        trial = noise + size * _noise_step(target, residual, noise)
        found = target.log_likelihood(prediction, trial)
        better = found > value
        noise, value = torch.where(better[:, None], trial, noise), torch.where(better, found, value)
        size = torch.where(better[:, None], (2.0 * size).clamp(max=1.0), 0.4 * size)
    return torch.cat([theta[:, : -target.num_noise], noise], 1)


def _noise_step(target: Target, residual: torch.Tensor, noise: torch.Tensor) -> torch.Tensor:
    leaf = noise.detach().requires_grad_()
    share = -0.5 * torch.autograd.grad((target.whiten(residual, leaf) ** 2).sum(), leaf)[0]
    return 0.5 * torch.log((share / target.per_group).clamp(min=0.05))


def find_modes(target: Target, starts: torch.Tensor, progress: Callable[[int], None] = lambda _: None) -> Modes:
    """Maximise the log posterior from every start [S, D] over growing horizons and return the modes.

    After the last horizon the better half of the starts goes on, and of these the better half until convergence; the
    others are in local minima.
    """
    theta = starts
    horizons, iterations = ((0.03, 0.1, 0.3, 1.0), 10) if target.num_starts else ((0.15, 0.4, 1.0), 7)
    for horizon in horizons:
        theta = levenberg_marquardt(target, theta, iterations=iterations, horizon=horizon, progress=progress)
    ahead = _best(target, theta, len(theta) // 2)
    # the residuals determine the noise of the channels, which moves the mode
    theta[ahead] = levenberg_marquardt(target, settle_noise(target, theta[ahead]), iterations=12, progress=progress)
    ahead = _best(target, theta, len(theta) // 4)
    theta[ahead] = climb_until_converged(target, theta[ahead], progress)
    theta = settle_noise(target, theta)
    evaluation = target.evaluate(theta)
    return Modes(theta, torch.nan_to_num(evaluation.log_posterior, nan=-torch.inf), precision_at(target, theta))


def _best(target: Target, theta: torch.Tensor, count: int) -> torch.Tensor:
    """Return the indices of the best vectors, at least one."""
    density = torch.nan_to_num(target.log_density(settle_noise(target, theta)), nan=-torch.inf)
    return torch.argsort(density, descending=True)[: max(1, count)]


def climb_until_converged(
    target: Target, theta: torch.Tensor, progress: Callable[[int], None] = lambda _: None
) -> torch.Tensor:
    """Maximise from vectors [S, D], noise and the rest in turn, until none gains `SETTLED` in six iterations.

    Stiffnesses of neighbouring joints are strongly correlated, so that some starts need fifty iterations.
    """
    theta, before = settle_noise(target, theta), torch.full_like(theta[:, 0], -torch.inf)
    for _ in range(ROUNDS):
        theta = settle_noise(target, levenberg_marquardt(target, theta, iterations=6, progress=progress))
        now = torch.nan_to_num(target.log_density(theta), nan=-torch.inf)
        if not (now > before + SETTLED).any():
            break
        before = torch.maximum(before, now)
    return theta


def representatives(modes: Modes) -> list[int]:
    """Return for every start the best one at the same mode, within three standard deviations."""
    out = [-1] * len(modes.theta)
    found: list[int] = []
    for i in torch.argsort(modes.log_posterior, descending=True).tolist():
        away = [modes.theta[i] - modes.theta[j] for j in found]
        near = [j for j, d in zip(found, away, strict=True) if d @ modes.precision[j] @ d <= 9.0]
        out[i] = near[0] if near else i
        if not near:
            found.append(i)
    return out


def refine(target: Target, modes: Modes, keep: int = 4) -> Modes:
    """Refit the best few modes after the target's noise model has changed; every start follows its mode."""
    of = torch.tensor(representatives(modes), device=modes.theta.device)
    ranked = modes.log_posterior.argsort(descending=True)
    order = ranked[of[ranked] == ranked][:keep]
    theta = modes.theta[order]
    if target.num_noise:  # the old noise model counted as noise what the new one may explain
        theta = torch.cat([theta[:, : -target.num_noise], target.log_noise0.expand(len(theta), -1)], 1)
    theta = climb_until_converged(target, levenberg_marquardt(target, theta, iterations=12))
    found = torch.nan_to_num(target.log_density(theta), nan=-torch.inf)
    # modes that were not refitted keep their distance to the best refitted one
    log_posterior = modes.log_posterior + (found.max() - modes.log_posterior.max())
    moved, precision, fresh = modes.theta.clone(), modes.precision.clone(), precision_at(target, theta)
    for k, i in enumerate(order.tolist()):
        moved[of == i], precision[of == i], log_posterior[of == i] = theta[k], fresh[k], found[k]
    return Modes(moved, log_posterior, precision)


def precision_at(target: Target, theta: torch.Tensor) -> torch.Tensor:
    """Gauss-Newton precision of the log posterior at [S, D]: J^T J / sigma^2, 2 N for log noise, and the prior's."""
    _, derivative = target.linearise(theta)
    weighed = jacobian_rows(target, derivative) * target.weight[..., None]
    rows = _white_rows(target, weighed, _noise(target, theta))
    full = theta.new_zeros(len(theta), target.num_dims, target.num_dims)
    free = target.num_parameters + target.num_starts
    if target.loss == "published":
        rows = _published_rows(target, theta, derivative)
    full[:, :free, :free] = rows.transpose(1, 2) @ rows
    for g in range(target.num_noise):
        full[:, free + g, free + g] = 2.0 * target.per_group[g]
    floor = torch.ones(target.num_dims, dtype=torch.float64, device=theta.device)
    floor[: target.num_parameters] = least_precision(target.system.parameters)
    return full + prior_curvature(target, theta) + torch.diag(floor)


def _published_rows(target: Target, theta: torch.Tensor, derivative: torch.Tensor) -> torch.Tensor:
    """Jacobian whose Gram matrix is the curvature of the published loss, |J dx|^2 / (kT |r|) per recording and kind.

    At an exact fit the loss is a cone; its typical radius, D kT, replaces |r| there.
    """
    r = target.residual(target.predict(theta))
    rows = jacobian_rows(target, derivative).permute(0, 4, 1, 2, 3) * target.weight
    for g in target.groups.unique():
        own = target.groups == g
        size = (r[..., own] ** 2).sum((-1, -2)).sqrt().clamp(min=target.num_dims * target.temperature)
        rows[..., own] /= (target.temperature * size).sqrt()[:, None, :, None, None]
    return rows.flatten(2).transpose(1, 2)
