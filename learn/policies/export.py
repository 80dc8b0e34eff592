"""A trained policy as one TorchScript and one ONNX file, its normalisation inside, checked against torch."""

from __future__ import annotations

import json
import logging
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from ...sim.base.errors import InputError
from ...sim.base.types import Array
from ...version import __version__
from ..tasks.registry import TaskRegistry
from .evaluate import TrainedPolicy

if TYPE_CHECKING:
    from rsl_rl.models import MLPModel

TORCHSCRIPT, ONNX, DESCRIPTION = "policy.pt", "policy.onnx", "policy.json"
#: Observations that are tried, and most difference of an action from torch's: float32 sums of a few hundred products in
#: another order.
TRIED, SAME = 256, 1e-4
#: ONNX operator set: the newest that onnxruntime 1.17 (2024) reads.
OPSET = 18


def export_policy(folder: Path, policy: TrainedPolicy, registry: TaskRegistry) -> float:
    """Write ``policy.pt``, ``policy.onnx`` and ``policy.json`` into an existing folder.

    Both networks take observations [N, O] as the task gives them and return mean actions [N, A]; nothing else is
    needed beside them. ``policy.json`` says what the columns are.

    Args:
        folder: Where to write.
        policy: The policy of a run.
        registry: Knows what the columns of the task's observations are.

    Returns:
        The largest difference of an action from torch's, over random observations and both files.

    Raises:
        InputError: The saved network is damaged, or an exported one gives other actions.
    """
    network = _network(policy)
    network.eval()
    tried = _observations(network)
    with torch.no_grad():
        expected = network.as_jit()(tried).numpy()
    away = 0.0
    for write, name in ((_torchscript, TORCHSCRIPT), (_onnx, ONNX)):
        actions = write(network, folder / name)(tried.numpy())
        away = max(away, float(np.abs(actions - expected).max()))
        if not away <= SAME * max(1.0, float(np.abs(expected).max())):
            raise InputError(policy.checkpoint, name, f"actions {away:.2g} off torch's", f"at most {SAME:g}")
    described = json.dumps(_description(policy, registry, network, away), indent=2)
    (folder / DESCRIPTION).write_text(described + "\n")
    return away


def _network(policy: TrainedPolicy) -> MLPModel:
    """Return the policy's network, sized by its saved first and last layers."""
    from tensordict import TensorDict

    from .ppo_runner import network_of

    if policy.ppo.memory:
        raise InputError(policy.checkpoint, "memory", "a recurrent policy", "a policy without memory")
    try:
        layers = [v for k, v in policy.state["actor_state_dict"].items() if k.startswith("mlp.") and v.dim() == 2]
        seen = TensorDict({"policy": torch.zeros(1, layers[0].shape[1])}, batch_size=[1])
        return network_of(policy.state, policy.ppo, seen, layers[-1].shape[0]).to("cpu")
    except (RuntimeError, KeyError, TypeError, AttributeError, IndexError) as error:
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(policy.checkpoint, "", f"a damaged network ({first})", "what bough train wrote") from None


def _observations(network: MLPModel) -> torch.Tensor:
    """Return random observations [TRIED, O] spread as those of training were."""
    normaliser, generator = network.obs_normalizer, torch.Generator().manual_seed(0)
    draw = torch.randn(TRIED, network.obs_dim, generator=generator)
    return normaliser.mean + 2.0 * normaliser.std * draw


def _torchscript(network: MLPModel, path: Path) -> Callable[[Array], Array]:
    """Write the network as TorchScript, read it again and return it as a function of arrays."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # torch advises torch.export, which Isaac Lab's and ROS's loaders do not read
        torch.jit.script(network.as_jit()).save(str(path))
        read = torch.jit.load(str(path), map_location="cpu")

    def act(observations: Array) -> Array:
        """Return the actions of the network as it was read again, [N, actions]."""
        with torch.no_grad():
            actions: Array = read(torch.as_tensor(observations)).numpy()
        return actions

    return act


def _onnx(network: MLPModel, path: Path) -> Callable[[Array], Array]:
    """Write the network as ONNX, read it again and return it as a function of arrays by ONNX's own evaluator."""
    import onnx
    from onnx.reference import ReferenceEvaluator

    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network.as_onnx(verbose=False), (torch.zeros(2, network.obs_dim),), str(path), input_names=["observation"],
            output_names=["action"], opset_version=OPSET, external_data=False, verbose=False, dynamo=True,
            dynamic_shapes={"x": {0: torch.export.Dim("batch")}},
        )  # fmt: skip
    onnx.checker.check_model(str(path))
    read = ReferenceEvaluator(str(path))

    def act(observations: Array) -> Array:
        """Return the actions of the network as ONNX's evaluator finds them, [N, actions]."""
        (actions,) = read.run(["action"], {"observation": observations})
        return np.asarray(actions)

    return act


def _description(policy: TrainedPolicy, registry: TaskRegistry, network: MLPModel, away: float) -> dict[str, Any]:
    actions = network.as_jit()(torch.zeros(1, network.obs_dim)).shape[1]
    columns_of = registry.of(policy.name).columns
    columns = {} if columns_of is None else columns_of(policy.settings)
    return {
        "task": policy.name, "iteration": policy.iteration, "bough": __version__, "checkpoint": str(policy.checkpoint),
        "observation": {"name": "observation", "size": network.obs_dim, "columns": columns, "normalised_inside": True},
        "action": {"name": "action", "size": actions, "range": [-1.0, 1.0]},
        "difference_from_torch": away,
    }  # fmt: skip
