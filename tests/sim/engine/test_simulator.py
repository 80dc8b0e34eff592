"""The simulator: accuracy, springs, conservation, and that its memory stays where it is."""

import re
from dataclasses import fields

import mujoco
import numpy as np
import pytest
import torch
import warp as wp
from bough.sim.base.errors import InputError
from bough.sim.engine.model import Model
from bough.sim.engine.simulator import Simulator
from bough.sim.trees.tree import Joint, Tree
from oracles.mujoco_tree import compiled, converged, trajectory
from oracles.random_tree import random_qpos, random_tree
from scipy.spatial.transform import Rotation

DT = 1.0 / 240.0


def recorded(tree: Tree, qpos, dt: float, steps: int, substeps: int = 1, precision: int = 64) -> np.ndarray:
    """Body positions [steps, L, 3] after every ``dt`` from rest at ``qpos``."""
    simulator = Simulator(Model([tree], precision=precision), dt=dt, substeps=substeps, threads=1)
    simulator.state.set_qpos(qpos)
    simulator.refresh()
    out = []
    for _ in range(steps):
        simulator.step()
        out.append(simulator.observe()[0][0].numpy().copy())
    assert simulator.state.faults() == []
    return np.array(out)


def rms(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum((a - b) ** 2, axis=-1))))


def damped(seed: int, links: int) -> tuple[Tree, np.ndarray]:
    """Make a tree that explicit springs can step at `DT`, and a bent start."""
    rng = np.random.default_rng(seed)
    tree = random_tree(rng, links, damping_ratio=(0.3, 2.0), stiffness=(20.0, 300.0))
    return tree, random_qpos(rng, tree, 0.2)


# ---- accuracy ------------------------------------------------------------------------------------------------------


def test_error_is_mujoco_s_where_mujoco_is_stable():
    """Compare rms body positions over 1 s at 1/240 s with a converged run: float32, at most 1.05 times MuJoCo's error.

    Ten random trees of 2 to 40 links; converged means Richardson-extrapolated from 16 and 32 substeps.
    """
    ratio = []
    for seed, links in enumerate([2, 3, 3, 5, 8, 8, 13, 20, 30, 40]):
        tree, start = damped(seed, links)
        truth = converged(tree, start, DT, 240, substeps=16)
        theirs = trajectory(tree, start, DT, 240)
        if truth is not None and theirs is not None:
            ratio.append(rms(recorded(tree, start, DT, 240, precision=32), truth) / rms(theirs, truth))
    assert len(ratio) >= 6
    assert np.median(ratio) <= 1.05
    assert max(ratio) <= 1.5


def test_halving_the_step_halves_the_error():
    """Take steps of dt, dt/2 and dt/4: the error falls by 2 each time (order 1; 1.8 to 2.2 over four trees)."""
    for seed, links in ((1, 3), (2, 6), (3, 12), (4, 20)):
        tree, start = damped(seed, links)
        truth = converged(tree, start, DT, 120, substeps=32)
        error = [rms(recorded(tree, start, DT, 120, substeps=n), truth) for n in (2, 4, 8)]
        assert 1.8 < error[0] / error[1] < 2.2
        assert 1.8 < error[1] / error[2] < 2.2


def test_substeps_are_smaller_steps():
    """Take a step in four parts: the bits of four steps of a quarter."""
    tree, start = damped(5, 7)
    np.testing.assert_array_equal(recorded(tree, start, DT, 8, 4), recorded(tree, start, DT / 4, 32)[3::4])


# ---- the ball spring ------------------------------------------------------------------------------------------------


def stout_chain(links: int, stiffness: float) -> Tree:
    """Make a chain of undamped stout links on ball joints, none of whose motions is too fast for a step of 1 ms."""
    n = links
    inertia = [[0.02, 0.001, 0.0], [0.001, 0.03, -0.002], [0.0, -0.002, 0.015]]
    return Tree(
        name="chain", link_name=[f"link{i}" for i in range(n)], parent=np.arange(n) - 1,
        joint=[Joint.SPHERICAL] * n, position=[[0.0, 0.0, 0.4 * (i > 0)] for i in range(n)],
        rotation=[[1.0, 0, 0, 0]] * n, mass=[0.8] * n, com=[[0.02, 0.1, 0.3]] * n, inertia=[inertia] * n,
        stiffness=[stiffness] * n, damping=[0.0] * n,
    )  # fmt: skip


@pytest.mark.parametrize(("precision", "tolerance"), [(64, 1e-7), (32, 1e-4)])
def test_ball_spring_is_the_gradient_of_its_energy(precision, tolerance):
    """Accelerate from rest at turns of up to 3 rad: I dw/dt equals -grad K |phi|^2 / 2, by central differences.

    The gradient is taken along small turns q exp(e) with SciPy's logarithm. One step of 1e-6 s gives the acceleration.
    """
    tree, h, rng = stout_chain(1, 40.0), 1e-6, np.random.default_rng(0)
    d = tree.com[0]
    inertia = tree.inertia[0] + tree.mass[0] * (d @ d * np.eye(3) - np.outer(d, d))
    axes = rng.normal(size=(25, 3))
    vectors = axes / np.linalg.norm(axes, axis=1, keepdims=True) * np.linspace(0.05, 3.0, 25)[:, None]
    turns = Rotation.from_rotvec(vectors)
    model = Model([tree] * 25, precision=precision, gravity=(0.0, 0.0, 0.0))
    simulator = Simulator(model, dt=h)
    simulator.state.set_qpos(list(np.roll(turns.as_quat(), 1, axis=1)))
    simulator.step()
    torque = np.array(simulator.state.qvel()) / h @ inertia

    def energy(e: np.ndarray) -> np.ndarray:
        return 0.5 * tree.stiffness[0] * ((turns * Rotation.from_rotvec(e)).as_rotvec() ** 2).sum(axis=1)

    eps = 1e-6
    gradient = np.stack([(energy(eps * e) - energy(-eps * e)) / (2 * eps) for e in np.eye(3)], axis=1)
    scale = np.linalg.norm(gradient, axis=1, keepdims=True)
    np.testing.assert_allclose(torque / scale, -gradient / scale, rtol=0, atol=tolerance)


@pytest.mark.parametrize(("width", "precision"), [(1, 64), (8, 32)])
def test_sign_of_a_quaternion_changes_nothing(width, precision):
    """Flip the signs of all quaternions: velocities keep their bits, quaternions are the flipped ones."""
    rng = np.random.default_rng(1)
    trees = [random_tree(rng, 6, joints=(Joint.SPHERICAL,)) for _ in range(8)]
    starts, out = [random_qpos(rng, t, 1.0) for t in trees], []
    for sign in (1.0, -1.0):
        simulator = Simulator(Model(trees, width=width, precision=precision), dt=DT)
        simulator.state.set_qpos(starts)
        simulator.state.coordinate.torch.mul_(sign)
        simulator.step(50)
        out.append((simulator.state.coordinate.torch * sign, simulator.state.velocity.torch))
    assert torch.equal(out[0][0], out[1][0])
    assert torch.equal(out[0][1], out[1][1])


# ---- conservation ---------------------------------------------------------------------------------------------------


def test_energy_of_an_undamped_chain_is_held_to_first_order():
    """Swing an undamped chain of four ball joints for 2 s: the energy error halves with the step.

    Semi-implicit Euler holds the energy to O(h) for all times. Stated bound: 50 h / s of the energy that moves
    (5 % at 1 ms, here); the trend over three steps is 2 within 10 %.
    """
    tree = stout_chain(4, 20.0)
    start, errors = random_qpos(np.random.default_rng(3), tree, 0.3), []
    steps = (1e-3, 5e-4, 2.5e-4)
    for h in steps:
        simulator = Simulator(Model([tree], precision=64), dt=h)
        assert torch.equal(simulator._damping.torch, simulator.model.arrays["damping"].torch)
        simulator.state.set_qpos(start)
        energies = []
        for _ in range(200):
            energies.append(simulator.energy()[0][0])
            simulator.step(round(0.01 / h))
        energies = np.array(energies)
        total, moving = energies.sum(axis=1), np.ptp(energies, axis=0).max()
        errors.append(np.abs(total - total[0]).max() / moving)
    assert all(e < 50.0 * h for e, h in zip(errors, steps, strict=True))
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 2.0, rtol=0.1)


def free_tree(seed: int) -> Tree:
    """Make a tree of eight links with springs and dampers, whose root floats: three massless slides and a ball."""
    tree = random_tree(np.random.default_rng(seed), 8, stiffness=(5.0, 50.0), damping_ratio=(0.1, 0.5))
    joint, rest = tree.joint.copy(), tree.rest.copy()
    joint[0], rest[0] = Joint.SPHERICAL, [1.0, 0.0, 0.0, 0.0]
    floating, bound = np.zeros(3), np.r_[0.0, np.ones(7)]
    slide = [[1.0, 0, 0, 0]] * 3
    return Tree(
        name="free", link_name=["x", "y", "z", *tree.link_name],
        parent=np.r_[-1, 0, 1, np.where(tree.parent < 0, 2, tree.parent + 3)],
        joint=np.r_[[Joint.PRISMATIC] * 3, joint], position=np.r_[np.zeros((3, 3)), tree.position],
        rotation=np.r_[slide, tree.rotation], mass=np.r_[floating, tree.mass],
        com=np.r_[np.zeros((3, 3)), tree.com], inertia=np.r_[np.zeros((3, 3, 3)), tree.inertia],
        stiffness=np.r_[floating, tree.stiffness * bound], damping=np.r_[floating, tree.damping * bound],
        anchor=np.r_[np.zeros((3, 3)), tree.anchor], axis=np.r_[np.eye(3), tree.axis],
        rest=np.r_[np.zeros((3, 4)), rest],
    ).validate()  # fmt: skip


def momentum_after(tree: Tree, qpos, qvel, h: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Linear and angular momentum [2, 3] before and after ``steps`` steps without gravity."""
    simulator = Simulator(Model([tree], precision=64, gravity=(0.0, 0.0, 0.0)), dt=h)
    simulator.state.set_qpos(qpos)
    simulator.state.set_qvel(qvel)
    before = simulator.energy()[1][0].copy()
    simulator.step(steps)
    return before, simulator.energy()[1][0].copy()


def test_momentum_of_a_free_tree_is_mujoco_s():
    """Compare both momenta of a moving tree with MuJoCo's sums over bodies."""
    tree, rng = random_tree(np.random.default_rng(4), 9), np.random.default_rng(5)
    qpos, qvel = random_qpos(rng, tree), rng.normal(0.0, 2.0, tree.num_dofs)
    model, data = compiled(tree)
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    total = model.body_subtreemass[0]
    linear = total * data.subtree_linvel[0]
    angular = data.subtree_angmom[0] + np.cross(data.subtree_com[0], linear)
    got, _ = momentum_after(tree, qpos, qvel, 1e-9, 1)
    np.testing.assert_allclose(got, [linear, angular], rtol=0, atol=1e-11 * np.abs(angular).max())


def pivoted_tree(seed: int) -> Tree:
    """Make the same tree on an unsprung ball at its root."""
    free = free_tree(seed)
    kept = {
        f.name: getattr(free, f.name)[3:]
        for f in fields(free)
        if f.name not in ("name", "parent") and not f.name.startswith("shape")
    }
    return Tree(name="pivoted", parent=np.maximum(free.parent[3:] - 3, -1), **kept).validate()


@pytest.mark.parametrize(("width", "precision"), [(1, 64), (1, 32), (8, 32)])
def test_a_free_tree_keeps_its_momentum_to_round_off(width, precision):
    """Let a floating tree tumble for two seconds: both momenta stay, up to one rounding a step.

    480 steps at machine epsilon, with a factor of fifty for the sums over eight links.
    """
    tree, rng = free_tree(6), np.random.default_rng(7)
    model = Model([tree] * width, precision=precision, width=width, gravity=(0.0, 0.0, 0.0))
    simulator = Simulator(model, dt=1 / 240)
    simulator.state.set_qpos([random_qpos(rng, tree, 0.5) for _ in range(width)])
    simulator.state.set_qvel([rng.normal(0.0, 2.0, tree.num_dofs) for _ in range(width)])
    simulator.refresh()
    before = simulator.energy()[1].copy()
    simulator.step(480)
    drift = np.linalg.norm(simulator.energy()[1] - before, axis=2) / np.linalg.norm(before, axis=2)
    assert drift.max() < 50 * 480 * (2.2e-16 if precision == 64 else 1.2e-7)


def test_a_pivoted_tree_keeps_its_angular_momentum_to_round_off():
    """Keep the angular momentum about an unsprung ball at the root, where the pivot's force has no arm."""
    tree, rng = pivoted_tree(6), np.random.default_rng(7)
    simulator = Simulator(Model([tree], precision=64, gravity=(0.0, 0.0, 0.0)), dt=1 / 240)
    simulator.state.set_qvel(rng.normal(0.0, 2.0, tree.num_dofs))
    pivot = simulator.model.links.offset[0]

    def about_pivot():
        linear, angular = simulator.energy()[1][0]
        return angular - np.cross(pivot, linear)

    before = about_pivot()
    simulator.step(480)
    assert np.linalg.norm(about_pivot() - before) < 5e-12 * np.linalg.norm(before)


def test_impulses_change_momentum_by_exactly_themselves():
    """Drop a floating tree for a second while a force and a torque act on links: it gains (m g + F) t, nothing else."""
    tree, rng = free_tree(6), np.random.default_rng(7)
    simulator = Simulator(Model([tree], precision=64), dt=1 / 240)
    simulator.state.set_qvel(rng.normal(0.0, 1.0, tree.num_dofs))
    place = int(simulator.model.link_place[7])
    force = np.array([1.0, -2.0, 3.0])
    simulator.load.force.torch[..., place, :] = torch.as_tensor(force)
    simulator.load.torque.torch[..., place, :] = torch.as_tensor([0.01, 0.0, 0.02])
    before = simulator.energy()[1][0].copy()
    simulator.step(240)
    gained = simulator.energy()[1][0][0] - before[0]
    np.testing.assert_allclose(gained, force + tree.mass.sum() * np.array([0.0, 0.0, -9.81]), rtol=0, atol=1e-10)


def test_keeping_momentum_keeps_the_order_of_the_step():
    """Halve the error of a floating tree's joint coordinates with the step, against a run at a 64th of it."""
    tree, rng = free_tree(6), np.random.default_rng(7)
    qpos, qvel = random_qpos(rng, tree, 0.2), rng.normal(0.0, 1.0, tree.num_dofs)

    def run(h):
        simulator = Simulator(Model([tree], precision=64, gravity=(0.0, 0.0, 0.0)), dt=h)
        simulator.state.set_qpos(qpos)
        simulator.state.set_qvel(qvel)
        simulator.refresh()
        assert simulator.implicit_worlds() == 0
        simulator.step(round(0.25 / h))
        return simulator.observe()[0].numpy().copy()

    exact = 2 * run(1e-3 / 128) - run(1e-3 / 64)
    errors = [np.abs(run(h) - exact).max() for h in (1e-3, 5e-4, 2.5e-4)]
    np.testing.assert_allclose(np.divide(errors[:-1], errors[1:]), 2.0, rtol=0.15)


def test_free_and_held_trees_share_no_thread():
    """Step free trees among held ones: each has the bits it has alone."""
    trees = [free_tree(6), *forest(5)[0], pivoted_tree(3), free_tree(9)]
    together = Simulator(Model(trees, width=8))
    starts = [random_qpos(np.random.default_rng(i), t, 0.2) for i, t in enumerate(trees)]
    together.state.set_qpos(starts)
    together.refresh()
    together.step(50)
    for i, (tree, start) in enumerate(zip(trees, starts, strict=True)):
        alone = Simulator(Model([tree], width=1))
        alone.state.set_qpos(start)
        alone.refresh()
        alone.step(50)
        assert np.array_equal(alone.state.qpos()[0], together.state.qpos()[i])


# ---- independent worlds ---------------------------------------------------------------------------------------------


def forest(count: int) -> tuple[list[Tree], list[np.ndarray]]:
    """Make different small trees with every kind of joint, some of which need implicit springs, and bent starts."""
    rng = np.random.default_rng(8)
    trees = [random_tree(rng, int(rng.integers(1, 9)), joints=tuple(Joint)) for _ in range(count)]
    return trees, [random_qpos(rng, t, 0.3) for t in trees]


def run(trees: list[Tree], starts: list[np.ndarray], width: int, threads: int, steps: int = 20) -> list[bytes]:
    """Return the bits of every world's coordinates, velocities and body frames."""
    simulator = Simulator(Model(trees, width=width), threads=threads)
    simulator.state.set_qpos(starts)
    simulator.refresh()
    simulator.step(steps)
    assert simulator.state.faults() == []
    return bits(simulator)


def bits(simulator: Simulator) -> list[bytes]:
    m, (position, turn) = simulator.model, simulator.observe()
    coordinate, velocity = (m.gather(f.numpy()) for f in (simulator.state.coordinate, simulator.state.velocity))
    out = []
    for w, tree in enumerate(m.trees):
        a, b = m.first_link[w : w + 2]
        frames = [x[w, : tree.num_links].numpy().tobytes() for x in (position, turn)]
        out.append(b"".join([coordinate[a:b].tobytes(), velocity[a:b].tobytes(), *frames]))
    return out


def test_worlds_do_not_see_each_other():
    """Step 512 different trees at widths 1, 8, 16, on one and two threads, permuted, some alone: the same bits."""
    trees, starts = forest(512)
    reference = run(trees, starts, 1, 1)
    assert len(set(reference)) > 500
    for width, threads in ((1, 2), (8, 1), (8, 2), (16, 1), (16, 2)):
        assert run(trees, starts, width, threads) == reference, (width, threads)
    for w in range(0, 512, 37):
        assert run([trees[w]], [starts[w]], 1, 1) == [reference[w]]
    order = np.random.default_rng(9).permutation(512)
    shuffled = run([trees[w] for w in order], [starts[w] for w in order], 16, 2)
    assert shuffled == [reference[w] for w in order]


@pytest.mark.parametrize("width", [1, 8, 16])
@pytest.mark.parametrize("field", ["coordinate", "velocity"])
def test_nan_in_one_world_stays_there(width, field):
    """Put NaN into one world: it alone is flagged, at that tick; a masked reset heals it to the bits of a fresh run."""
    trees, starts = forest(40)
    hurt = 17
    simulators = [Simulator(Model(trees, width=width), threads=2) for _ in range(2)]
    for s in simulators:
        s.state.set_qpos(starts)
        s.refresh()
        s.mark_start()
        s.step(10)
    sick, sound = simulators
    m = sick.model
    link = m.first_link[hurt] + trees[hurt].num_links - 1
    group, lane = divmod(int(m.link_slot[link]), width)
    getattr(sick.state, field).torch[group, lane, m.link_place[link], 1 if field == "coordinate" else 0] = torch.nan
    for s in simulators:
        s.step(10)
    ((world, name, tick),) = sick.state.faults()
    assert (world, tick) == (hurt, 10)
    assert name in trees[hurt].link_name
    assert sound.state.faults() == []
    others = [w for w in range(40) if w != hurt]
    got, want = bits(sick), bits(sound)
    assert [got[w] for w in others] == [want[w] for w in others]
    mask = torch.zeros(40, dtype=torch.bool)
    mask[hurt] = True
    sick.reset(mask)
    assert sick.state.faults() == []
    sick.step(10)
    got = bits(sick)
    assert got[hurt] == run(trees, starts, width, 1, steps=10)[hurt]
    sound.step(10)
    want = bits(sound)
    assert [got[w] for w in others] == [want[w] for w in others]


def test_guard_names_the_joint_that_is_too_fast():
    """Spin one leaf beyond ``max_speed``: the fault names it and the tick, and the world keeps its last state."""
    tree = stout_chain(5, 20.0)
    simulator = Simulator(Model([tree] * 3), dt=1e-5, max_speed=50.0)
    simulator.step(4)
    qvel = [np.zeros(15) for _ in range(3)]
    qvel[1][-3:] = 60.0
    simulator.state.set_qvel(qvel)
    simulator.step(6)
    assert simulator.state.faults() == [(1, "link4", 4)]
    np.testing.assert_allclose(simulator.state.qvel()[1][-3:], 60.0, rtol=1e-6)
    assert [np.abs(v).max() < 1 for v in simulator.state.qvel()] == [True, False, True]


# ---- memory ---------------------------------------------------------------------------------------------------------


def views(simulator: Simulator) -> dict[str, torch.Tensor]:
    state, load = simulator.state, simulator.load
    named = {"coordinate": state.coordinate, "velocity": state.velocity, "alive": state.alive, "force": load.force,
             "point": load.point, "effort": load.effort, **simulator.model.arrays}  # fmt: skip
    out = {name: array.torch for name, array in named.items()}
    return out | {"position": simulator.position, "rotation": simulator.rotation, "fault_tick": state.fault_tick}


@pytest.mark.parametrize("width", [1, 8])
def test_views_keep_their_memory(width):
    """Hold torch views over 1000 steps, resets, observations: their pointers stay, and they see what happens."""
    trees, starts = forest(8)
    simulator = Simulator(Model(trees, width=width), dt=1e-3)
    simulator.state.set_qpos(starts)
    simulator.mark_start()
    held = views(simulator)
    pointer = {name: t.data_ptr() for name, t in held.items()}
    start = held["coordinate"].clone()
    for k in range(1000):
        simulator.step()
        if k % 100 == 50:
            simulator.reset(torch.arange(8) == k // 100 % 8)
            simulator.observe()
    assert not torch.equal(held["coordinate"], start)
    assert simulator.observe()[0].data_ptr() == pointer["position"]
    simulator.reset()
    assert torch.equal(held["coordinate"], start)
    assert {name: t.data_ptr() for name, t in views(simulator).items()} == pointer
    ball = simulator.model.gather(simulator.state.coordinate.numpy())
    held["coordinate"].zero_()
    assert ball.any() and not simulator.state.coordinate.numpy().any()


def allocations(action) -> int:
    """Count what ``action`` takes from Warp's allocators (native ones included) and from torch's."""
    reports: list[str] = []
    with wp.ScopedMemoryTracker("step", report_func=reports.append) as tracker:
        tracker.clear()
        with torch.profiler.profile(activities=[torch.profiler.ProfilerActivity.CPU], profile_memory=True) as profile:
            action()
    warps = sum(int(n) for n in re.findall(r"^ +cpu +(\d+) \(", reports[0], re.MULTILINE))
    return warps + sum(e.key == "[memory]" for e in profile.events())


def test_a_step_allocates_nothing():
    """Count allocations over 50 steps and observations on two threads: none; the counter sees one of each library."""
    trees, starts = forest(16)
    simulator = Simulator(Model(trees, width=8), threads=2)
    simulator.state.set_qpos(starts)
    simulator.load.force.torch.fill_(0.1)

    def act() -> None:
        for _ in range(50):
            simulator.step()
            simulator.observe()

    act()
    assert allocations(act) == 0
    assert allocations(lambda: wp.zeros(7, device="cpu")) == 1
    assert allocations(lambda: torch.zeros(9)) == 1


@pytest.mark.parametrize(("width", "precision"), [(1, 64), (8, 32)])
def test_a_captured_graph_replays_the_same_bits(width, precision):
    """Replay steps and observation as one graph, resets in between: the bits of plain steps."""
    trees, starts = forest(8)
    plain, graph = (Simulator(Model(trees, width=width, precision=precision), substeps=2) for _ in range(2))
    for s in (plain, graph):
        s.state.set_qpos(starts)
        s.refresh()
        s.mark_start()
    before = graph.state.coordinate.torch.clone()
    replay = graph.capture(3)
    assert torch.equal(graph.state.coordinate.torch, before), "capturing moves nothing"
    for k in range(5):
        replay()
        plain.step(3)
        position, turn = (x.clone() for x in (graph.position, graph.rotation))
        assert torch.equal(position, plain.observe()[0]) and torch.equal(turn, plain.rotation)
        if k == 2:
            for s in (plain, graph):
                s.reset(torch.arange(8) % 2 == 0)
    assert torch.equal(graph.state.velocity.torch, plain.state.velocity.torch)


@pytest.mark.parametrize("options", [{"dt": 0.0}, {"dt": np.nan}, {"dt": -1.0}, {"substeps": 0}, {"max_speed": 0.0}])
def test_senseless_options_are_refused(options):
    """Refuse steps and limits that are not positive, by name."""
    with pytest.raises(InputError, match=f"simulator: {next(iter(options))}: found .*; allowed: a number above zero"):
        Simulator(Model(random_tree(np.random.default_rng(0), 1)), **options)
