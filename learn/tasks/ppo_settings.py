"""Numbers of proximal policy optimisation, and the two sizes that they come in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

from ...sim.base.errors import InputError

Preset = Literal["cpu", "gpu"]


@dataclass(frozen=True)
class PPOSettings:
    """Settings of PPO; symbols as in Schulman et al. (2017).

    Attributes:
        num_envs: Worlds in each process.
        iterations: Updates of the policy.
        horizon: Policy steps of every world between two updates, T.
        epochs: Passes over a batch, K.
        mini_batches: Parts that a pass is taken in.
        hidden: Widths of the hidden layers of policy and value, ELU between them.
        memory: Units of a GRU (Cho et al. 2014) before the hidden layers of both; empty for networks without memory.
        init_std: Standard deviation of the first actions.
        learning_rate: Adam's first step; it then follows the divergence.
        desired_kl: Divergence of the policy in an update that the learning rate is steered to.
        gamma: Discount.
        lam: Generalised advantage estimation, lambda.
        clip: Clipping of the probability ratio, epsilon.
        entropy: Weight of the entropy bonus, c2.
        value: Weight of the value's loss, c1.
        max_grad_norm: Longest gradient.
        checkpoint_every: Iterations between two checkpoints.
    """

    num_envs: int
    iterations: int
    horizon: int
    epochs: int = 5
    mini_batches: int = 4
    hidden: tuple[int, ...] = (256, 128, 64)
    init_std: float = 1.0
    learning_rate: float = 1e-3
    desired_kl: float = 0.01
    gamma: float = 0.99
    lam: float = 0.95
    clip: float = 0.2
    entropy: float = 0.002
    value: float = 1.0
    max_grad_norm: float = 1.0
    checkpoint_every: int = 25
    memory: tuple[int, ...] = ()

    def check(self) -> None:
        """Raise `InputError` for sizes that cannot be."""
        if self.num_envs < 1:
            raise InputError("train", "--num-envs", str(self.num_envs), "1 or more")
        if self.iterations < 1:
            raise InputError("train", "--iterations", str(self.iterations), "1 or more")
        if len(self.memory) > 1 or (self.memory and self.memory[0] < 1):
            raise InputError("train", "memory", ", ".join(map(str, self.memory)), "one number of 1 or more, or none")
        if self.memory and self.num_envs < self.mini_batches:
            raise InputError("train", "--num-envs", str(self.num_envs), f"{self.mini_batches} or more, for a memory")
        if self.num_envs * self.horizon < 2 * self.mini_batches:
            allowed = f"{-(-2 * self.mini_batches // self.horizon)} or more"
            raise InputError("train", "--num-envs", str(self.num_envs), allowed)

    def runner_config(self) -> dict[str, Any]:
        """Return the settings as rsl-rl's runner reads them."""
        return {
            "num_steps_per_env": self.horizon,
            "obs_groups": {"actor": ["policy"], "critic": ["policy"]},
            "check_for_nan": False,  # would wait for the device at every step; the losses are looked at instead
            "actor": self.actor_config(),
            "critic": self._network(),
            "algorithm": {
                "num_learning_epochs": self.epochs,
                "num_mini_batches": self.mini_batches,
                "clip_param": self.clip,
                "gamma": self.gamma,
                "lam": self.lam,
                "value_loss_coef": self.value,
                "entropy_coef": self.entropy,
                "learning_rate": self.learning_rate,
                "max_grad_norm": self.max_grad_norm,
                "schedule": "adaptive",
                "desired_kl": self.desired_kl,
            },
        }

    def actor_config(self) -> dict[str, Any]:
        """Return the policy's network as rsl-rl reads it: a Gaussian around a perceptron, behind a memory if any."""
        gaussian = {"class_name": "GaussianDistribution", "init_std": self.init_std, "std_type": "log"}
        return {**self._network(), "distribution_cfg": gaussian}

    def _network(self) -> dict[str, Any]:
        hidden = list(self.hidden)
        layers = {"class_name": "MLPModel", "hidden_dims": hidden, "activation": "elu", "obs_normalization": True}
        if not self.memory:
            return layers
        memory = {"rnn_type": "gru", "rnn_hidden_dim": self.memory[0], "rnn_num_layers": 1}
        return {**layers, **memory, "class_name": "RNNModel"}


def preset_of(device: str) -> Preset:
    """Return the preset that a device bears."""
    return "cpu" if device == "cpu" else "gpu"


PRESETS: dict[Preset, PPOSettings] = {
    "cpu": PPOSettings(num_envs=512, iterations=800, horizon=24, checkpoint_every=10),
    "gpu": PPOSettings(num_envs=6144, iterations=1250, horizon=24),
}
