"""Simulations of many sets of parameters of one case, with the laws of every set and no joint that it does not need."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import torch

from ....sim.effects import effect_of
from ...cases.case import BranchCase, JointCase
from ...replay.equation_error import simulation_of
from ...replay.recording import Recording
from ...replay.rollout import Rollout
from ...systems.branch import Unknowns

#: Sets per launch. The last is a group of lanes; every launch costs as much besides as some hundred steps of it.
SIZES = (128, 64, 32, 16)
#: Effect that adds joints below the branch: with them a step of three segments takes twice as long.
JOINTED = "base_compliance"


class Simulations:
    """Simulates sets of parameters in launches of a few sizes.

    A group of lanes computes a law at a joint where one of its sets has it, so sets with the same laws at the same
    joints stand side by side. Sets whose trunk does not give way are branches without the trunk's joint.

    Args:
        case: The case.
        recordings: R recordings.
        unknowns: All that may be unknown: the columns of the values that are given.
        device: Warp device.
        finer: How many times as short as the system's own steps are.

    Attributes:
        whole: Worlds with all effects, of the least size.
    """

    def __init__(
        self, case: BranchCase | JointCase, recordings: Sequence[Recording], unknowns: Unknowns, *,
        device: Any = None, finer: int = 1,
    ) -> None:  # fmt: skip
        self._case, self._recordings, self._device, self.finer = case, recordings, device, finer
        rigid = tuple(a for a in unknowns.effects if a.name != JOINTED)
        self._unknowns = {True: unknowns, False: replace(unknowns, effects=rigid)}
        self._rollouts: dict[tuple[bool, int], Rollout] = {}
        self.whole = self._rollout(True, SIZES[-1])

    def finely(self) -> Simulations:
        """Return the same simulations with steps half as long."""
        return Simulations(
            self._case, self._recordings, self._unknowns[True], device=self._device, finer=2 * self.finer
        )

    def smoothly(self) -> Simulations:
        """Return the same simulations with inputs less an eighth of their second differences.

        By so much a smooth input is beside the line between two samples, in the middle between them.
        """
        bent = []
        for r in self._recordings:
            ahead = np.diff(r.input, 2, axis=0, prepend=r.input[:1], append=r.input[-1:]) / 8.0
            bent.append(replace(r, input=r.input - ahead))
        return Simulations(self._case, bent, self._unknowns[True], device=self._device, finer=self.finer)

    @property
    def world_steps(self) -> int:
        """World-steps taken so far."""
        return sum(r.world_steps for r in self._rollouts.values())

    def __call__(self, values: torch.Tensor, start: torch.Tensor) -> torch.Tensor:
        """Return the channels [S, R, T, C] of parameter values [S, n] from start states [S, R, J, 2]."""
        acting = self.whole.system.acting
        columns = values[:, values.shape[1] - len(acting.parameters) :]
        on = acting.switched_on(columns)
        order = _side_by_side(torch.cat([on, acting.bent(columns)], 1))
        jointed = on[order, acting.names.index(JOINTED)] if acting.has(JOINTED) else torch.ones_like(order).bool()
        precedes = torch.tensor([effect_of(n).law(acting.form).precedes for n in acting.names], device=on.device)
        waiting = (on[order] & precedes).any(1)  # a whole group of lanes waits for what acts before a recording begins
        parts = [(kind, order[(jointed == kind) & (waiting == w)]) for kind in (False, True) for w in (False, True)]
        found = [self._simulated(kind, values[rows], start[rows]) for kind, rows in parts if len(rows)]
        out = torch.cat(found)
        return out[torch.argsort(torch.cat([rows for _, rows in parts]))]

    def _simulated(self, jointed: bool, values: torch.Tensor, start: torch.Tensor) -> torch.Tensor:
        """Simulate sets with or without the trunk's joint, in the fewest launches that leave less than one unused."""
        if not jointed:
            values = values[:, self._rigid_columns()]
        parts, done = [], 0
        while done < len(values):
            size = next((s for s in SIZES if s <= len(values) - done), SIZES[-1])
            rollout, taken = self._rollout(jointed, size), slice(done, done + size)
            own = [_padded(x[taken], size) for x in (values, start)]
            out = rollout(own[0], own[1] if rollout.num_locals else None)
            parts.append(out[: len(values) - done].clone())
            done += size
        return torch.cat(parts)

    def _rigid_columns(self) -> list[int]:
        names = [p.name for p in self.whole.system.parameters]
        return [n for n, name in enumerate(names) if not name.startswith(JOINTED)]

    def _rollout(self, jointed: bool, size: int) -> Rollout:
        if (jointed, size) not in self._rollouts:
            self._rollouts[jointed, size] = simulation_of(self._case)(
                self._case, self._recordings, size, unknowns=self._unknowns[jointed], device=self._device,
                finer=self.finer,
            )  # fmt: skip
        return self._rollouts[jointed, size]


def _side_by_side(on: torch.Tensor) -> torch.Tensor:
    """Return an order [S] in which sets with the same effects and joints [S, names + joints] stand side by side."""
    code = torch.unique(on.to(torch.int8), dim=0, return_inverse=True)[1]
    return torch.argsort(code, stable=True)


def _padded(values: torch.Tensor, size: int) -> torch.Tensor:
    return torch.cat([values, values[-1:].expand(size - len(values), *values.shape[1:])])
