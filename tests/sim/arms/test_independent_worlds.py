"""Worlds do not see each other: no number in one, however bad, changes a bit of another."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from bough.learn.tasks.memory import copies, put_back, simulator_tensors
from bough.sim.arms.simulator import ArmSimulator
from bough.sim.base.host import simd_width
from bough.sim.trees.tree import Tree
from oracles.contact_case import post, simulator, ternary

LAWS = ("cubic_stiffness", "dry_friction", "plastic_set", "quadratic_drag", "tip_mass", "wind_gust")
#: Values of all effects' parameters that switch them on.
ON = {
    "cubic_stiffness": {"cubic_radm2": 2.0},
    "dry_friction": {"torque_Nm": 0.4},
    "plastic_set": {"share": 0.5, "yield_rad": 0.03},
    "quadratic_drag": {"coefficient_kgpm3": 2.0},
    "tip_mass": {"mass_kg": 0.05},
    "wind_gust": {"sine_x_Pa": 40.0, "frequency_Hz": 0.7},
}
#: Each value goes into a world of its own; worlds 3 and 12 are of another group of lanes than the first.
ROUNDS = ({1: np.nan, 3: np.inf, 6: 1e30}, {2: -np.inf, 6: -1.0, 12: 0.0})
WORLDS, STEPS = 13, 50


def scene(width: int, effects: tuple[str, ...]) -> ArmSimulator:
    """Make arms that sweep through 13 trees of two shapes, every contact, effect and strength on, one spring stiff."""
    trees = [ternary(np.random.default_rng(k), order=1 + k % 3 % 2, root=(-0.5, 0.3, -0.1)) for k in range(WORLDS)]
    trees[5].stiffness[-1] = 4.0e3
    sim = simulator(
        trees, width=width, contacts={"arm_arm": True, "branch_branch": True, "ground": -0.2}, breakable=True,
        effects=effects,
    )  # fmt: skip
    for name in effects:
        for parameter, value in ON[name].items():
            sim.effects.fill(name, parameter, value)
            sim.effects[name][parameter][::4] = 0.0 if parameter != "yield_rad" else value
    rng = np.random.default_rng(7)
    sim.state.set_qvel([rng.normal(0.0, 1.0, tree.num_dofs) for tree in trees])
    sim.target[:, 0] = 1.2
    sim.line_mask.fill_(1)
    sim.line_start.copy_(torch.tensor([-0.8, 0.5, 0.35]))
    sim.line_end.copy_(torch.tensor([-0.2, 0.7, 0.35]))
    assert sim.rupture is not None
    sim.rupture.strength.fill_(3.0)
    sim.step(90)  # until the arms are among the branches
    return sim


def arrays_of(sim: ArmSimulator) -> dict[str, torch.Tensor]:
    """Return every array of numbers that differ from world to world, views [worlds or slots, ...] by name."""
    assert sim.rupture is not None
    m, touch = sim.model, sim._touch
    lanes = {name: array.torch for name, array in m.arrays.items()}
    lanes |= {"coordinate": sim.state.coordinate.torch, "velocity": sim.state.velocity.torch}
    lanes |= {"damping in effect": sim._damping.torch, "limit": sim._limit.torch}
    lanes |= {f"capsules' {name}": array.torch for name, array in touch._lanes.items()}
    by_world = {name: getattr(sim, name) for name in ("q", "qd", "target", "friction", "line_start", "line_end")}
    by_world |= {f"{n} {p}": t for n, effect in sim.effects.items() for p, t in effect.items()}
    return lanes | by_world | {"strength": sim.rupture.strength}


def spoil(sim: ArmSimulator, array: torch.Tensor, world: int, value: float) -> None:
    """Write a value to all numbers of one world, lane arrays [groups, lanes, places, components] too."""
    if array.dim() == 4:
        group, lane = divmod(int(sim.model.world_slot[world]), sim.model.width)
        array[group, lane, 1 if array.shape[2] > 1 else 0 :] = value
    else:
        array[world] = value


def everything(sim: ArmSimulator) -> dict[str, torch.Tensor]:
    """Return all that a step reads and writes, apart from its working memory, which no world may rely on."""
    assert sim.rupture is not None
    return simulator_tensors(sim) | {f"array {n}": t for n, t in arrays_of(sim).items() if n not in ("q", "qd")} | {
        "broken": sim.rupture.broken
    }  # fmt: skip


def worlds(sim: ArmSimulator) -> list[bytes]:
    """Return what every world came to, as bytes: signs of zeros count."""
    m, parts = sim.model, []
    for field in (sim.state.coordinate, sim.state.velocity):
        parts.append(field.torch.numpy().reshape(m.groups * m.width, -1)[m.world_slot])
    state = sim.state.alive.torch.numpy().reshape(m.groups * m.width, -1)[m.world_slot]
    read = ("q", "qd", "torque", "arm_force", "arm_peak", "branch_force", "depth", "overflow", "unsettled")
    parts += [state, *(getattr(sim, name).numpy() for name in read)]
    return [b"".join(part[w].tobytes() for part in parts) for w in range(m.num_worlds)]


@pytest.mark.parametrize(("width", "effects"), [(1, LAWS), (8, LAWS), (simd_width(), ())])
def test_no_number_of_a_world_reaches_another(width, effects):
    """Spoil each array in three worlds of 13 with NaN, infinities, 1e30, -1 and 0, and step 50 times.

    The other worlds end in the same bits as without, signs of zeros too. Trees differ in their shape from lane to lane,
    arms, branches, line and ground touch, joints break. Working memory is left as the worlds before have made it.
    """
    sim = scene(width, effects)
    fields = everything(sim)
    start = copies(fields)
    sim.step(STEPS)
    sound = worlds(sim)
    assert sim.faults() == []
    assert float(sim.arm_peak.max()) > 1.0 and int(sim.rupture.broken.sum()) > 0
    found, lost = [], 0
    for name, array in arrays_of(sim).items():
        for values in ROUNDS:
            put_back(fields, start)
            for world, value in values.items():
                spoil(sim, array, world, value)
            sim.step(STEPS)
            lost += len(sim.faults())
            now = worlds(sim)
            found += [(name, w) for w in range(WORLDS) if w not in values and now[w] != sound[w]]
    assert found == []
    assert lost > 50


def row(apart: float) -> Tree:
    """Make two upright posts of 10 mm radius, the second ``apart`` [m] from the first."""
    tree = post((0.0, 0.0, 0.0), stiffness=5.0, damping=0.05)
    twice = "parent joint position rotation mass com inertia stiffness damping axis shape_start shape_end shape_radius"
    both = {name: np.concatenate([getattr(tree, name)] * 2) for name in twice.split()}
    both["position"][1, 0] += apart
    return Tree(name="row", link_name=["one", "two"], shape_link=[0, 1], **both)


@pytest.mark.parametrize("width", [1, 8])
def test_branches_that_overlap_in_one_world_touch_in_the_others(width):
    """Throw two posts at each other in 8 worlds; in world 3 they overlap at the start, so that they never touch there.

    In the other seven they meet, with the same bits as where world 3 is like them.
    """
    ends = []
    for odd in (0.03, 0.01):
        trees = [row(odd if w == 3 else 0.03) for w in range(8)]
        sim = simulator(trees, width=width, contacts={"branch_branch": True, "arm_branch": False})
        sim.state.set_qvel([[0.0, 4.0, 0.0, 0.0, -4.0, 0.0]] * 8)
        met = np.zeros(8, bool)
        for _ in range(24):
            sim.step()
            met |= (sim.branch_force.abs().sum(dim=(1, 2)) > 0).numpy()
        ends.append((met, worlds(sim)))
    (all_met, sound), (met, now) = ends
    assert all_met.all()
    assert met.tolist() == [w != 3 for w in range(8)]
    assert [now[w] == sound[w] for w in range(8)] == [w != 3 for w in range(8)]
