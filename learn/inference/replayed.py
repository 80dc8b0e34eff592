"""A case's recordings simulated by a model as it stands in ``model.yaml``, and what it misses of those held out.

`bough diagnose` claims its gap by `replay_model`, and `bough simulate --model` prints it: one computation, one number.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from ...sim.base.types import Array
from ..cases.case import BranchCase, JointCase
from ..replay.equation_error import noise_of, recordings_of, simulation_of, thinned
from ..replay.recording import Recording
from ..systems.acting import Acting
from ..systems.branch import Unknowns
from ..systems.joint_file import JointModel
from ..systems.model_file import BranchModel, Model, blown_by
from .fit import levenberg_marquardt
from .identify import pooled_sigma, split
from .predict import START_WINDOW, first_moments, main_channels
from .target import Target

#: Shares of a recording over which its start state is fitted one after the other, and steps of each: over a short one
#: oscillations that drift out of phase later make no local minimum.
HORIZONS, STEPS = (0.1, 0.4, 1.0), 5


@dataclass(frozen=True)
class Replayed:
    """What a model simulates of R recordings.

    Attributes:
        recordings: The recordings, of torque fits filtered and thinned.
        output: Simulated channels, zero past a recording's end, shape [R, T, C].
        train, test: Recordings that a model is fitted to and that are held out; of a single one, both are that.
        main: Channels that are scored.
    """

    recordings: list[Recording]
    output: Array
    train: tuple[int, ...]
    test: tuple[int, ...]
    main: tuple[int, ...]

    @property
    def rms(self) -> float:
        """Held-out RMSE of the main channels, in their unit."""
        return self.rms_over(np.ones(self.output.shape[-1]))

    def rms_over(self, noise: Array) -> float:
        """Held-out RMSE of the main channels, each in units of ``noise`` [C]."""
        parts = []
        for j in self.test:
            r = self.recordings[j]
            parts.append(((r.output - self.output[j, : len(r.t)]) / noise)[:, list(self.main)].ravel())
        return float(np.sqrt(np.mean(np.concatenate(parts) ** 2)))


def held_out(case: BranchCase | JointCase, model: Model | None = None) -> tuple[list[int], list[int]]:
    """Return the recordings that a model is fitted to and those held out; a single one is both.

    Held out are those that the model names, of a case that has them and others; else those of the case's split.
    """
    every = range(len(case.trajectories))
    names = model.held_out or () if isinstance(model, BranchModel) else ()
    test = [j for j in every if case.trajectories[j].file in names]
    if 0 < len(test) < len(every):
        return [j for j in every if j not in test], test
    return split(case) if len(every) > 1 else ([0], [0])


def replay_model(case: BranchCase | JointCase, model: Model, off: Sequence[Acting] = ()) -> Replayed:
    """Simulate all recordings of a case by a model.

    Start states of joints are fitted, at the model's parameters: over the whole of a recording that models are fitted
    to, and over the first 0.3 s of one that is held out.

    Args:
        case: The case.
        model: The model, of this case.
        off: Effects that the kernel has too, with known neutral parameters: they change no bit of the result, and a
            kernel that is there need not be compiled anew.
    """
    if isinstance(model, JointModel):
        assert isinstance(case, JointCase)
        case = model.as_fitted(case)
    case = blown_by(model, case)
    chosen = [thinned(case, r) for r in recordings_of(case)]
    unknowns = Unknowns(effects=(*model.effects, *off))
    train, test = held_out(case, model)
    rollout = simulation_of(case)(case, chosen, 1, unknowns=unknowns)
    values = torch.as_tensor(model.values[None], device=rollout.torch_device)
    start = _starts(case, chosen, test, values, unknowns) if rollout.num_locals else None
    output = rollout(values, start)[0].double().cpu().numpy()
    return Replayed(chosen, output, tuple(train), tuple(test), main_channels(case))


def _starts(
    case: BranchCase | JointCase, chosen: Sequence[Recording], test: Sequence[int], values: torch.Tensor,
    unknowns: Unknowns,
) -> torch.Tensor:  # fmt: skip
    """Return start states [1, R, J, 2] fitted with fixed parameters."""
    windows = [first_moments(r, START_WINDOW) if j in test else r for j, r in enumerate(chosen)]
    sigma = pooled_sigma(case, noise_of(case))
    target = Target(case, windows, torch.as_tensor(np.where(sigma > 0.0, sigma, 1.0)), unknowns=unknowns)
    rows = [target.free(values), target.start0.flatten()[None], target.log_noise0[None]]
    theta = torch.cat(rows, 1)
    for horizon in HORIZONS:
        theta = levenberg_marquardt(target, theta, iterations=STEPS, horizon=horizon, frozen=target.num_parameters)
    return target.split(theta)[1]
