"""PPO under a constraint: a Lagrange multiplier holds the mean cost of a step at a limit.

    max_pi E[r]  subject to  E[c] <= d,   as   min_(l >= 0) max_pi  E[r] - l (E[c] - d)

PPO's advantage becomes A_r - l A_c, normalised; A_c is that of the cost, by generalised advantage estimation with a
critic of its own. Once an iteration the multiplier follows the constraint, l <- max(0, l + RATE (J / d - 1)) with J the
mean cost of the iteration's steps (Ray, Achiam and Amodei 2019, "PPO-Lagrangian"; there J is a sum over episodes).
Everything else is rsl-rl's PPO.
"""

from __future__ import annotations

import copy
from typing import Any

import torch
from rsl_rl.utils import reduce_gradients_in_buckets
from tensordict import TensorDict

from ..tasks.task import Task
from .ppo_runner import InPlacePPO

#: Change of the multiplier in an iteration with twice the cost that is allowed.
RATE = 0.05


def algorithm_for(task: Task) -> dict[str, Any]:
    """Return what a runner's configuration says of the algorithm for a task: nothing where it has no constraint."""
    limit = getattr(task, "cost_limit", None)
    return {} if limit is None else {"class_name": LagrangianPPO, "limit": limit}


class LagrangianPPO(InPlacePPO):
    """PPO for tasks whose extras hold ``cost`` [W], the mean of which is to be at most a limit.

    Attributes:
        limit: The limit d, above zero.
        multiplier: l, of 0 or more, in units of reward over cost.
        cost: J of the last iteration.
        cost_critic: Guesses the discounted cost to come.
    """

    def __init__(self, *args: Any, limit: float, rate: float = RATE, **options: Any) -> None:
        """Take what rsl-rl's PPO takes, a limit, and how fast the multiplier follows."""
        super().__init__(*args, **options)
        if not limit > 0.0:
            raise ValueError(f"a limit of {limit:g}: one above zero is needed")
        self.limit, self.rate, self.multiplier, self.cost = limit, rate, 0.0, 0.0
        self.cost_critic = copy.deepcopy(self._raw_critic)
        self.cost_optimizer = torch.optim.Adam(self.cost_critic.parameters(), lr=self.learning_rate)
        shape = self.storage.rewards.shape
        zeros = [torch.zeros(shape, device=self.device) for _ in range(4)]
        self._costs, self._left_out, self._values, self._returns = zeros

    def act(self, obs: TensorDict) -> torch.Tensor:
        """Sample actions, and guess the cost to come."""
        step = self.storage.step
        actions = super().act(obs)
        self._values[step].copy_(self.cost_critic(self.storage.observations[step]).detach())
        return actions

    def process_env_step(
        self, obs: TensorDict, rewards: torch.Tensor, dones: torch.Tensor, extras: dict[str, torch.Tensor]
    ) -> None:
        """Keep a step's costs; where an episode was cut by time what would have come is guessed."""
        step = self.storage.step
        super().process_env_step(obs, rewards, dones, extras)
        cut = extras.get("time_outs", torch.zeros_like(rewards)).to(self.device).view(-1, 1)
        self._costs[step].copy_(extras["cost"].to(self.device).view(-1, 1))
        self._left_out[step].copy_(self.gamma * self._values[step] * cut)

    def compute_returns(self, obs: TensorDict) -> None:
        """Move the multiplier, and compute returns of rewards and costs and the advantage of both together."""
        super().compute_returns(obs)
        self._follow()
        st = self.storage
        last = self.cost_critic(obs).detach()
        cost = gae(self._costs + self._left_out, self._values, last, st.dones, self.gamma, self.lam)
        self._returns.copy_(cost + self._values)
        both = (st.returns - st.values) - self.multiplier * cost
        st.advantages = (both - both.mean()) / (both.std() + 1e-8)

    def _follow(self) -> None:
        mean = self._costs.mean()
        if self.is_multi_gpu:
            torch.distributed.all_reduce(mean)
            mean = mean / self.gpu_world_size
        self.cost = float(mean)
        self.multiplier = max(0.0, self.multiplier + self.rate * (self.cost / self.limit - 1.0))

    def update(self) -> dict[str, float]:
        """Update policy and value as PPO does, then fit the critic of the costs; return mean losses."""
        losses = super().update()
        losses["cost_value"] = self._fit()
        self.cost_critic.update_normalization(self.storage.observations.flatten(0, 1))
        return losses

    def _fit(self) -> float:
        """Fit the critic to the returns of costs; return the mean squared error over all parts."""
        seen, wanted = self.storage.observations.flatten(0, 1), self._returns.flatten(0, 1)
        size, total = len(wanted) // self.num_mini_batches, 0.0
        for _ in range(self.num_learning_epochs):
            order = torch.randperm(self.num_mini_batches * size, device=self.device)
            for rows in order.split(size):
                loss = (self.cost_critic(seen[rows]) - wanted[rows]).pow(2).mean()
                self.cost_optimizer.zero_grad()
                loss.backward()
                if self.is_multi_gpu:
                    reduce_gradients_in_buckets(self.cost_critic.parameters(), self.gpu_world_size,
                                                self.grad_reduce_bucket_mb)  # fmt: skip
                torch.nn.utils.clip_grad_norm_(self.cost_critic.parameters(), self.max_grad_norm)
                self.cost_optimizer.step()
                total += loss.item()
        return total / (self.num_learning_epochs * self.num_mini_batches)

    def numbers(self) -> dict[str, float]:
        """Return what an iteration tells beside losses: mean cost of a step, and the multiplier."""
        return {"cost": self.cost, "multiplier": self.multiplier}

    def save(self) -> dict[str, Any]:
        """Return rsl-rl's state, the critic of the costs and the multiplier."""
        own = {"cost_critic": self.cost_critic.state_dict(), "cost_optimizer": self.cost_optimizer.state_dict(),
               "multiplier": self.multiplier}  # fmt: skip
        saved: dict[str, Any] = super().save() | own
        return saved

    def load(self, loaded_dict: dict[str, Any], load_cfg: dict[str, Any] | None, strict: bool) -> bool:
        """Take over a state that `save` returned."""
        done: bool = super().load(loaded_dict, load_cfg, strict)
        self.cost_critic.load_state_dict(loaded_dict["cost_critic"], strict=strict)
        self.cost_optimizer.load_state_dict(loaded_dict["cost_optimizer"])
        self.multiplier = float(loaded_dict["multiplier"])
        return done

    def broadcast_parameters(self) -> None:
        """Give all processes the first one's networks."""
        super().broadcast_parameters()
        for tensor in self.cost_critic.state_dict().values():
            torch.distributed.broadcast(tensor, src=0)


def gae(
    gains: torch.Tensor, values: torch.Tensor, last: torch.Tensor, dones: torch.Tensor, gamma: float, lam: float
) -> torch.Tensor:
    """Return generalised advantage estimates (Schulman et al. 2016), [T, W, 1].

    Args:
        gains: Reward or cost of every step, [T, W, 1].
        values: Guess of what is to come before each step, [T, W, 1].
        last: The same after the last step, [W, 1].
        dones: Where an episode ended with a step, [T, W, 1].
        gamma: Discount.
        lam: Weight of longer sums.
    """
    out, advantage, following = torch.empty_like(gains), torch.zeros_like(last), last
    for step in reversed(range(len(gains))):
        goes_on = 1.0 - dones[step].float()
        delta = gains[step] + gamma * goes_on * following - values[step]
        advantage = delta + gamma * lam * goes_on * advantage
        out[step], following = advantage, values[step]
    return out
