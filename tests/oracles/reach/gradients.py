"""Train the point mass under torchrun; every process notes its gradients before and after they are averaged.

Into the folder given: ``run``, two iterations at one go; ``cut``, one and then the second; ``rank-R.pt``, the notes.
"""

import sys
from dataclasses import replace
from pathlib import Path

import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bough.learn.policies.ppo_runner import InPlacePPO
from bough.learn.policies.train import Plan, train
from bough.learn.runs.processes import Processes
from bough.learn.tasks.ppo_settings import PPOSettings
from oracles.reach.task import ReachSettings, registry

PPO = PPOSettings(num_envs=8, iterations=2, horizon=32, hidden=(16,), checkpoint_every=1)
NOTED: dict[str, list[torch.Tensor]] = {"before": [], "after": []}


def gradients(ppo: InPlacePPO) -> torch.Tensor:
    """Return all gradients in a row."""
    parameters = [*ppo.actor.parameters(), *ppo.critic.parameters()]
    return torch.cat([p.grad.flatten() for p in parameters])


def noting(reduce):
    """Return the averaging of gradients with notes around it."""

    def noted(self):
        NOTED["before"].append(gradients(self).clone())
        reduce(self)
        NOTED["after"].append(gradients(self).clone())

    return noted


if __name__ == "__main__":
    folder, processes = Path(sys.argv[1]), Processes.of_torchrun()
    processes.connect("cpu")
    disconnect = Processes.disconnect
    Processes.disconnect = lambda self: None  # three runs in one process
    plain = InPlacePPO.reduce_parameters
    InPlacePPO.reduce_parameters = noting(plain)
    whole = Plan("reach", ReachSettings(), PPO, 0, "cpu")
    alg = train(whole, folder / "run", registry()).runner.alg
    networks = {f"{n}.{k}": v for n in ("actor", "critic") for k, v in getattr(alg, n).state_dict().items()}
    torch.save({**NOTED, "networks": networks}, folder / f"rank-{processes.rank}.pt")
    InPlacePPO.reduce_parameters = plain
    train(replace(whole, ppo=replace(PPO, iterations=1)), folder / "cut", registry())
    train(whole, folder / "cut", registry(), resume=True)
    disconnect(processes)
