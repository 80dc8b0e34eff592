"""Unknowns of a branch, written on the device, against the same branch built on the host."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from bough.learn.cases.case import load_case
from bough.learn.cases.noise import estimate_noise
from bough.learn.replay.recording import Recording, recordings
from bough.learn.replay.rollout import Rollout
from bough.learn.replay.simulated_case import Experiment, random_branch, write_simulated_case
from bough.learn.systems import weight
from bough.learn.systems.branch import BranchSystem, Unknowns, substep_of
from bough.sim.base.errors import InputError
from bough.sim.engine.model import Model
from bough.sim.engine.simulator import Simulator
from bough.sim.trees.measured import axis_rotation, measured_tree
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.branch_case import make_branch_case

STIFFNESS, DAMPING = np.array([90.0, 40.0, 15.0]), np.array([2.0, 0.8, 0.3])
SHARE, TILT = np.array([0.6, 1.3, 2.0]), np.array([0.2, -0.15, 0.1])
ALL = ("stiffness", "damping", "density", "rest_angle")
FIELDS = ("mass", "com", "inertia", "turn", "offset", "axis", "stiffness", "damping", "armature", "preload")


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    meta = random_branch(np.random.default_rng(8), 3)
    truth = {"stiffness": STIFFNESS, "damping": DAMPING}
    folder = tmp_path_factory.mktemp("system") / "case"
    return write_simulated_case(folder, meta, truth, Experiment(samples=20), trajectories=1, seed=0)


def written(system: BranchSystem, rows: np.ndarray) -> Model:
    """Return a float64 model, one world a row of parameter values [W, n], with the unknowns written into it."""
    model = Model([system.tree] * len(rows), gravity=system.gravity, precision=64)

    def write(field: str, place: int | list[int], component: int, values: torch.Tensor) -> None:
        model.arrays[field].torch[:, 0, place, component] = values

    system.write(torch.as_tensor(rows), model, write)
    return model


def built(case, joints, density, tilt, stiffness, damping) -> Model:
    """Return a float64 model of the branch as if it had been measured with these values.

    About its own axis a segment on a ball joint has an inertia of h^2 K / 2 at least, h the step, and of h^2 K - 2 h D
    of the joints at both of its ends.
    """
    branch = replace(case, mass=case.mass * density / case.density, elevation=case.elevation + tilt)
    tree = measured_tree(branch, stiffness, damping, joints)
    if joints == "spherical":
        h, inertia = substep_of(case), tree.inertia.copy()
        lacks = np.append(np.maximum(h * h * stiffness - 2 * h * damping, 0.0), 0.0)
        inertia[:, 2, 2] = np.maximum(inertia[:, 2, 2], 0.5 * h * h * stiffness + lacks[:-1] + lacks[1:])
        tree = tree.with_(inertia=inertia)
    return Model([tree], gravity=(0.0, 0.0, -case.gravity), precision=64)


def same_arrays(a: Model, b: Model, world: int = 0) -> None:
    """Compare every array of a world of the first model with the second's only world; q and -q are one orientation."""
    for field in FIELDS:
        x, y = a.arrays[field].torch[world, 0].numpy(), b.arrays[field].torch[0, 0].numpy()
        if field == "turn":
            y = y * np.where((x * y).sum(-1, keepdims=True) < 0, -1.0, 1.0)
        np.testing.assert_allclose(x, y, rtol=1e-10, atol=1e-12, err_msg=field)


@pytest.mark.parametrize("joints", ["spherical", "revolute"])
def test_everything_unknown(case, joints):
    """Write springs, dampers, densities and rest angles: arrays as of a branch measured so, two worlds at once."""
    system = BranchSystem(case, Unknowns(joints, ALL))
    rows = np.stack([np.concatenate([STIFFNESS, DAMPING, case.density * SHARE, TILT]),
                     np.concatenate([2 * STIFFNESS, DAMPING, case.density / SHARE, -TILT])])  # fmt: skip
    model = written(system, rows)
    same_arrays(model, built(case, joints, case.density * SHARE, TILT, STIFFNESS, DAMPING), 0)
    same_arrays(model, built(case, joints, case.density / SHARE, -TILT, 2 * STIFFNESS, DAMPING), 1)


@pytest.mark.parametrize("kind", ["density", "rest_angle"])
def test_one_kind_alone(case, kind):
    """Keep typical springs and dampers, and the case's own geometry, where only one other kind is inferred."""
    system = BranchSystem(case, Unknowns(infer=(kind,)))
    values = case.density * SHARE if kind == "density" else TILT
    density, tilt = (values, np.zeros(3)) if kind == "density" else (np.full(3, case.density), values)
    spring, damper = system.tree.stiffness, system.tree.damping
    same_arrays(written(system, values[None]), built(case, "spherical", density, tilt, spring, damper))


def test_shared_unknowns(case):
    """Give all joints the one number of a shared kind, and each its own of the others."""
    system = BranchSystem(case, Unknowns(infer=("stiffness", "damping"), shared=("damping",)))
    assert [p.name.split()[0] for p in system.parameters] == ["stiffness"] * 3 + ["damping"]
    row = np.array([*STIFFNESS, 0.7])
    model = written(system, row[None])
    same_arrays(model, built(case, "spherical", np.full(3, case.density), np.zeros(3), STIFFNESS, np.full(3, 0.7)))
    np.testing.assert_array_equal(system.values("stiffness", row), STIFFNESS)
    np.testing.assert_array_equal(system.values("damping", row), [0.7, 0.7, 0.7])
    assert np.isnan(system.values("density", row)).all()


def test_rest_stays_at_rest(case):
    """Hold random densities and rest angles against gravity: without a force nothing moves.

    In single precision torques of newton metres balance to 1e-6 of them, which bends springs of 10 N m/rad by 1e-6 rad.
    """
    rng = np.random.default_rng(0)
    unknowns = Unknowns(infer=ALL)
    still = Recording(np.arange(40) * case.dt, np.zeros((40, 3)), np.zeros((40, 6)), np.zeros((0, 2)),
                      np.zeros(40, dtype=bool), case.trajectories[0].grasp)  # fmt: skip
    rows = np.concatenate([np.tile([*STIFFNESS, *DAMPING], (8, 1)), case.density * rng.uniform(0.4, 2.5, (8, 3)),
                           rng.uniform(-0.5, 0.5, (8, 3))], axis=1)  # fmt: skip
    out = Rollout(case, [still], 8, unknowns=unknowns)(torch.as_tensor(rows))
    assert out[..., :3].abs().max() < 1e-5 and out[..., 3:].abs().max() < 1e-4


@settings(max_examples=20, deadline=None)
@given(
    st.lists(st.floats(-0.8, 0.8), min_size=3, max_size=3),
    st.lists(st.floats(0.05, 5.0), min_size=3, max_size=3),
    st.lists(st.floats(-1.2, 1.2), min_size=3, max_size=3),
)
def test_holding_torque(case, tilt, mass, elevation):
    """Hold any chain with the pre-loads that `hold_rest_pose` finds by its own recursion."""
    elevation = np.array(elevation)
    branch = replace(case, mass=np.array(mass), elevation=elevation + tilt)
    tree = measured_tree(branch, STIFFNESS, DAMPING)
    world, turn = weight.turned_chain(
        torch.as_tensor(axis_rotation(elevation, case.azimuth)), torch.tensor(tilt, dtype=torch.float64)[None]
    )
    held = weight.holding_torque(
        torch.as_tensor(branch.mass)[None], torch.as_tensor(tree.com), torch.as_tensor(case.length), world, case.gravity
    )
    np.testing.assert_allclose(held[0].numpy(), tree.preload, atol=1e-10)
    aligned = (turn[0].numpy() * tree.rotation).sum(-1)
    np.testing.assert_allclose(np.abs(aligned), 1.0, atol=1e-12)


def test_light_dampers_do_not_split_the_dynamics(case):
    """Keep every ball joint's spring explicit, whatever springs and dampers the box allows.

    Explicit springs are stable where h K / 2 <= D + I / h, I the inertia that a joint feels: below, all springs of a
    world would be partly implicit, and the motion, and the posterior with it, would jump. Written dampers stop at 0.1
    substeps, and at half a substep less I / (4 h) of the lighter segment; what is above stays as it is.
    """
    system = BranchSystem(case)
    low, high = (np.array([getattr(p, end) for p in system.parameters]) for end in ("low", "high"))
    rng = np.random.default_rng(1)
    rows = np.exp(rng.uniform(np.log(low), np.log(high), (64, 6)))
    model, substeps = written(system, rows), int(np.ceil(case.dt / system.substep))
    assert Simulator(model, dt=case.dt, substeps=substeps).implicit_worlds() == 0
    bare = [measured_tree(case, *np.split(row, 2)) for row in rows]
    assert Simulator(Model(bare, precision=64), dt=case.dt, substeps=substeps).implicit_worlds() > 5
    place = model.link_place[:3]
    found = model.arrays["damping"].torch[:, 0, place, 0].numpy()
    h, across = system.substep, system.tree.inertia[:, 0, 0]
    smaller = np.minimum(across, [np.inf, *across[:-1]])
    least = np.maximum(0.1 * h * rows[:, :3], 0.5 * h * rows[:, :3] - smaller / (4 * h))
    np.testing.assert_allclose(found, np.maximum(rows[:, 3:], least))
    assert (found > rows[:, 3:]).any() and (found == rows[:, 3:]).any()


SWINGS = ((15.0, 5e-3, 0.002), (110.0, 0.1 / 110.0, 0.002))


@pytest.mark.parametrize(("swing", "step", "left"), SWINGS)
def test_steps_follow_the_swing(tmp_path, swing, step, left):
    """Take steps of a tenth of a radian of a stiff rod's swing, sqrt(K / I), and long ones where it is soft.

    Force over displacement knows the stiffness to what inertia adds, 20 %. A scheme of second order is then off by
    0.1^2 / 24 of the phase, and four radians of swing and its damper make that 0.2 % of the motion at most.
    """
    meta = random_branch(np.random.default_rng(7), 1)
    inertia = meta["segments"][0]["mass_kg"] * meta["segments"][0]["length_m"] ** 2 / 3.0
    truth = {"stiffness": np.array([swing**2 * inertia]), "damping": np.array([0.2 * swing * inertia])}
    experiment = Experiment(samples=100, deflection=0.03)
    case = write_simulated_case(tmp_path / "case", meta, truth, experiment, trajectories=2, seed=3)
    assert BranchSystem(case).substep == pytest.approx(step, rel=0.2)
    values = torch.tensor([[truth["stiffness"][0], truth["damping"][0]]])
    coarse, fine = (Rollout(case, recordings(case), 1, finer=n)(values)[0, ..., :3].double() for n in (1, 8))
    assert float((coarse - fine).norm() / fine.norm()) < left


@pytest.mark.parametrize(
    ("box", "place"),
    [("stiffness=200:5", "200:5"), ("stiffness=-1:5", "stiffness"), ("mass=1:2", "mass"), ("damping=x:2", "damping=x")],
)
def test_bounds_that_cannot_be(case, box, place):
    """Refuse swapped ends, a spring that may vanish, an unknown that is none, and what is no number, in one line."""
    with pytest.raises(InputError) as caught:
        BranchSystem(case, Unknowns(box=(box,)))
    assert place in str(caught.value) and "\n" not in str(caught.value)


def test_box_and_typical_values(case):
    """Take K = E pi r^4 / (2 l) (thesis eq. 4.2) at 1 MPa, 0.5 GPa and 100 GPa, and a user's bounds instead."""
    system = BranchSystem(case, Unknowns(box=("stiffness=5:200",)))
    radius = case.radius.mean(axis=1)
    beam = np.pi * radius**4 / (2 * case.length)
    spring = BranchSystem(case).parameters[:3]
    np.testing.assert_allclose([[p.low, p.typical, p.high] for p in spring], beam[:, None] * [1e6, 5e8, 1e11])
    assert [(p.low, p.high) for p in system.parameters[:3]] == [(5.0, 200.0)] * 3
    assert system.parameters[3].low == BranchSystem(case).parameters[3].low


def test_what_an_open_gripper_reads(tmp_path):
    """Read an offset of the open gripper by its median, and none where it is no more than noise."""
    folder = tmp_path / "c"
    make_branch_case(folder, 4, segments=1, samples=400, dt=0.01)
    case = load_case(folder)
    sigma, t = estimate_noise(case).force, case.trajectories[0]
    count = int(t.no_contact.sum())
    assert count > 20
    rng, offset = np.random.default_rng(0), 0.5 * np.abs(t.force).max() * np.array([1.0, -0.5, 0.2])
    for shift, told in ((offset, True), (0.0 * offset, False)):
        t.force[t.no_contact] = shift + sigma * rng.normal(size=(count, 3))
        read = recordings(case)[0].opened
        np.testing.assert_allclose(read, shift, atol=5.0 * 1.2533 * sigma.max() / np.sqrt(count) if told else 0.0)
