"""The last states of a frozen world: which are kept, at what cost, and that a replay comes to the same fault."""

import numpy as np
import pytest
import torch
from bough.sim.base.errors import InputError
from bough.sim.engine.last_states import Fault
from bough.sim.engine.model import Model
from bough.sim.engine.replay_fault import replay
from bough.sim.engine.simulator import Simulator
from oracles.contact_case import ternary

WORLDS, KEPT, BEFORE, AFTER = 11, 16, 40, 30


def lost(width, spoil, **options):
    """Step 11 worlds of two shapes 40 times, spoil world 6, step 30 times more; return simulator and ring."""
    trees = [ternary(np.random.default_rng(k), order=1 + k % 2) for k in range(WORLDS)]
    sim = Simulator(Model(trees, width=width), threads=1, **options)
    rng = np.random.default_rng(0)
    sim.state.set_qvel([rng.normal(0.0, 1.0, tree.num_dofs) for tree in trees])
    last = sim.keep_last(KEPT)
    for _ in range(BEFORE):
        sim.step()
    kept = sim.state.coordinate.torch.clone()
    group, lane = divmod(int(sim.model.world_slot[6]), width)
    spoil(sim, group, lane, int(sim.model.link_place[sim.model.first_link[6] + 2]))
    for _ in range(AFTER):
        sim.step()
    return sim, last, kept[group, lane]


def heavy(sim, group, lane, place):
    """Make the mass of one link no number."""
    sim.model.arrays["mass"].torch[group, lane, place] = torch.nan


def thrown(sim, group, lane, place):
    """Turn one joint faster than the guard lets it."""
    sim.state.velocity.torch[group, lane, place, 0] = 1e4


@pytest.mark.parametrize("width", [1, 8])
@pytest.mark.parametrize(("spoil", "quantity"), [(heavy, "response to the parent's motion"), (thrown, "")])
def test_a_replay_comes_to_the_same_fault(tmp_path, width, spoil, quantity):
    """Keep the 16 states up to the fault and none after; the replay has their bits and names what was lost first.

    A velocity from outside shows as a difference. Of what a step writes down, a leaf's mass is first in its response
    to the parent's acceleration, through m c.
    """
    sim, last, kept = lost(width, spoil)
    assert [(world, tick) for world, _, tick in sim.state.faults()] == [(6, BEFORE)]
    (file,) = last.write(tmp_path)
    fault = Fault.read(file)
    assert fault.tick.tolist() == list(range(BEFORE + 1 - KEPT, BEFORE + 1))
    place = sim.model.link_place[slice(*sim.model.first_link[6:8])]
    np.testing.assert_array_equal(fault.coordinate[-1], kept.numpy()[place])
    found = replay(fault)
    assert found.quantity == quantity
    if spoil is thrown:
        assert (found.tick, found.link) == (BEFORE, fault.link)
        assert [m.astray for m in found.moments[:-1]] == [0.0] * (KEPT - 1)
        assert found.moments[-1].astray == pytest.approx(1e4, rel=1e-3)  # it came from outside
        assert found.moments[-1].speed == pytest.approx(1e4, rel=1e-3)
    else:  # the mass is wrong from the first kept state on in a replay: it is lost at once
        assert found.tick == BEFORE + 1 - KEPT and found.place == "link2"


def test_the_ring_costs_what_it_says_and_nothing_when_off():
    """Seven numbers a link, state and world; a simulator that keeps none has none, and the bits are the same."""
    sim, last, _ = lost(8, thrown, effects=("dry_friction",))
    assert last.nbytes == KEPT * sim.model.groups * 8 * (4 * 7 * (sim.model.places + 1) + 4)
    plain = Simulator(Model(ternary(np.random.default_rng(0), order=1)))
    assert plain._last is None


def test_files_that_are_no_faults(tmp_path):
    """Refuse text, other archives, arrays of other shapes and trees that cannot be, in one line each."""
    _, last, _ = lost(1, thrown)
    (file,) = last.write(tmp_path)
    with np.load(file) as data:
        good = dict(data)
    cases = {
        "text": None, "other": {"x": np.zeros(3)}, "short": good | {"velocity": good["velocity"][:3]},
        "none": {k: v for k, v in good.items() if k != "dt" and k != "tick"},
        "cycle": good | {"tree parent": good["tree parent"] + 1},
        "pickle": good | {"tick": np.array([{}], dtype=object)},
    }  # fmt: skip
    for name, arrays in cases.items():
        path = tmp_path / f"{name}.npz"
        if arrays is None:
            path.write_text("PK no")
        else:
            np.savez(path, **arrays)
        with pytest.raises(InputError):
            Fault.read(path)
