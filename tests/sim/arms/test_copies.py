"""Copies of worlds: they go where their worlds go, and what is tried in them moves nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from bough.sim.arms.copies import WorldCopies
from bough.sim.arms.jaco2 import jaco2
from bough.sim.arms.simulator import ArmSimulator, Contacts
from bough.sim.base.errors import InputError
from oracles.contact_case import LAWS, STRETCHED, post, ternary

SETTINGS = (("plastic_set", "share", 0.6), ("plastic_set", "yield_rad", 0.02),
            ("quadratic_drag", "coefficient_kgpm3", 5.0), ("wind_gust", "sine_x_Pa", 30.0),
            ("wind_gust", "frequency_Hz", 1.3))  # fmt: skip
WORLDS, COUNT = 6, 3
#: Its first servo is at its limit when it sweeps through branches, which a step remembers for the next.
WEAK = replace(jaco2(), torque_limit=np.r_[12.0, jaco2().torque_limit[1:]])


def grove(effects: tuple[str, ...]) -> ArmSimulator:
    """Return worlds with trees of three sizes, which break, remember and are blown at, under a sweeping arm."""
    rng = np.random.default_rng(3)
    trees = [ternary(rng, order=order) for order in (3, 1, 2, 3)] + [post((-0.5, 0.2, 0.2)), post((-0.4, 0.1, 0.1))]
    contacts = Contacts(arm_line=False, arm_arm=True, branch_branch=True, ground=-0.3)
    sim = ArmSimulator(trees, WEAK, contacts=contacts, device="cpu", breakable=True, effects=effects)
    if effects:
        for name, parameter, value in SETTINGS:
            sim.effects.fill(name, parameter, value)
    sim.rupture.strength.fill_(8.0)
    sim.start_q.copy_(torch.tensor(STRETCHED))
    sim.reset()
    return sim


def swept(sim: ArmSimulator, steps: int, sign: float = 1.0) -> None:
    """Turn the shoulder, each world at its own speed."""
    sim.target[:, 0] = sign * torch.linspace(0.4, 1.2, len(sim.q))
    sim.step(steps)


def told(sim: ArmSimulator) -> dict[str, torch.Tensor]:
    """Return what can be seen of all worlds, copied."""
    seen = {"qpos": sim.tensors.get("qpos"), "qvel": sim.tensors.get("qvel"), "stiffness": sim.tensors.get("stiffness"),
            "q": sim.q, "qd": sim.qd, "torque": sim.torque, "force": sim.arm_force, "hand": sim.end_position,
            "broken": sim.rupture.broken, "peak": sim.arm_peak}  # fmt: skip
    return {name: tensor.clone() for name, tensor in seen.items()}


def spoilt(sim: ArmSimulator) -> None:
    """Leave nothing as it was: other places and memories, and states, parameters and servos that are no numbers."""
    swept(sim, 30, -1.0)
    for name in ("offset", "com", "inertia", "axis"):
        sim.model.arrays[name].torch.mul_(2.0)
    for name in ("qpos", "qvel", "stiffness", "damping", "mass", "armature", "preload"):
        sim.tensors.set(name, torch.full_like(sim.tensors.get(name), float("nan")))
    for tensor in (sim.q, sim.qd, sim.torque, sim.rupture.strength, sim.friction):
        tensor.fill_(float("nan"))
    sim.state.alive.torch.fill_(-1.0)


@pytest.mark.parametrize("effects", [tuple(LAWS), ()])
def test_copies_go_where_their_worlds_go(effects):
    """Poison copies, take the worlds' state in the middle of a sweep, go on in both: the same bits in every copy.

    By then joints are broken, wood has set and the gust's clock stands at 0.5 s. A parameter that was set in
    between is the copies' too.
    """
    sim = grove(effects)
    copies = WorldCopies(sim, COUNT)
    swept(sim, 120)
    sim.tensors.set("stiffness", 0.7 * sim.tensors.get("stiffness"))
    spoilt(copies.simulator)
    before = told(sim)
    copies.take()
    for mine, theirs in zip(told(copies.simulator).values(), before.values(), strict=True):
        assert torch.equal(mine, theirs.repeat_interleave(COUNT, 0))
    swept(sim, 90)
    copies.simulator.target[:, 0] = torch.linspace(0.4, 1.2, WORLDS).repeat_interleave(COUNT)
    copies.simulator.step(90)
    after = told(sim)
    for mine, theirs in zip(told(copies.simulator).values(), after.values(), strict=True):
        assert torch.equal(mine, theirs.repeat_interleave(COUNT, 0))
    assert after["broken"].any() and after["force"].abs().max() > 1.0 and torch.isfinite(after["qpos"]).all()
    assert not torch.equal(before["qpos"], after["qpos"])


@pytest.mark.parametrize("effects", [tuple(LAWS), ()])
def test_what_is_tried_in_copies_moves_nothing_else(effects):
    """Sweep one copy of each world the other way: its siblings and the worlds themselves stay as they are."""
    sim = grove(effects)
    swept(sim, 30)
    copies = WorldCopies(sim, COUNT)
    before = told(sim)
    copies.simulator.target.zero_()
    copies.simulator.target[::COUNT, 0] = -1.0
    copies.simulator.step(30)
    for name, tensor in told(sim).items():
        assert torch.equal(tensor, before[name]), name
    q = copies.simulator.q.unflatten(0, (-1, COUNT))
    assert torch.equal(q[:, 1], q[:, 2]) and ((q[:, 0, 0] - q[:, 1, 0]).abs() > 0.01).all()


def test_none_of_a_world_are_refused():
    """Say what is allowed."""
    with pytest.raises(InputError, match="copies: count: found 0; allowed: 1 or more of every world"):
        WorldCopies(grove(()), 0)
