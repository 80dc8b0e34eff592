"""The processes of a training run: one, or those that torchrun has started on this and other machines."""

from __future__ import annotations

import os
from dataclasses import dataclass

import torch

from ...sim.base.errors import InputError


@dataclass(frozen=True)
class Processes:
    """Where this process stands among those of its run.

    Attributes:
        rank: Number of this process among all.
        local_rank: Number of this process among those of its machine.
        count: Processes of the run.
    """

    rank: int = 0
    local_rank: int = 0
    count: int = 1

    @staticmethod
    def of_torchrun() -> Processes:
        """Return what torchrun has put into the environment; one process without it."""
        get = os.environ.get
        return Processes(int(get("RANK", "0")), int(get("LOCAL_RANK", "0")), int(get("WORLD_SIZE", "1")))

    @property
    def first(self) -> bool:
        """Whether this process writes what is written once."""
        return self.rank == 0

    def device(self, wanted: str | None) -> str:
        """Return the torch device of this process: with several on GPUs, each has its own.

        Raises:
            InputError: There is no such device.
        """
        name = wanted or ("cuda" if torch.cuda.is_available() else "cpu")
        kind, _, index = name.partition(":")
        if name == "cpu":
            return name
        if kind != "cuda" or not (index or "0").isdigit():
            raise InputError("train", "--device", name, "cpu, cuda or cuda:N")
        number = self.local_rank if self.count > 1 else int(index or 0)
        if number >= torch.cuda.device_count():
            raise InputError("train", "--device", name, f"cpu, or one of {torch.cuda.device_count()} CUDA devices")
        return f"cuda:{number}"

    def connect(self, device: str) -> None:
        """Wait until all processes are there: over gloo on CPU, NCCL on GPU."""
        if self.count == 1 or torch.distributed.is_initialized():
            return
        if device.startswith("cuda"):
            torch.cuda.set_device(device)
        torch.distributed.init_process_group("nccl" if device.startswith("cuda") else "gloo")

    def disconnect(self) -> None:
        """Let the other processes go."""
        if self.count > 1 and torch.distributed.is_initialized():
            torch.distributed.destroy_process_group()

    def wait(self) -> None:
        """Wait until every process has come here."""
        if self.count > 1:
            torch.distributed.barrier()

    def sum(self, values: torch.Tensor) -> torch.Tensor:
        """Return the sum over all processes, in place."""
        if self.count > 1:
            torch.distributed.all_reduce(values)
        return values
