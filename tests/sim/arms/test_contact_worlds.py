"""Contact in many worlds: nothing passes through anything, lanes and graphs change no bit, full buffers are counted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
import warp as wp
from bough.kernels.contact.collide import nearest_on_segments
from bough.sim.arms.arrays import arm_capsules
from bough.sim.arms.jaco2 import jaco2
from bough.sim.arms.simulator import Contacts
from bough.sim.base.errors import InputError
from bough.sim.base.host import simd_width
from bough.sim.trees.tree import Joint, Tree
from oracles.contact_case import DT, STRETCHED, act, bits, busy, contacts_of, post, same, simulator, ternary

ARM = jaco2()
RADIUS = np.r_[ARM.base_radius, ARM.tree.shape_radius.mean(axis=1)]
LINK = np.r_[-1, ARM.tree.shape_link]
FAR = post((50.0, 0.0, 1.0))


# ---- nearest points ------------------------------------------------------------------------------------------------


@wp.kernel(enable_backward=False)
def nearest(p: wp.array2d(dtype=wp.vec3), share_out: wp.array2d(dtype=float)):
    i = wp.tid()
    s, t = nearest_on_segments(p[i, 0], p[i, 1], p[i, 2], p[i, 3])
    share_out[i, 0] = s
    share_out[i, 1] = t


def brute_force(p: np.ndarray) -> np.ndarray:
    """Distance of segments by ternary search in float64: the distance from a point that moves along one is convex."""

    def apart(s):
        x = p[:, 0] + s[:, None] * (p[:, 1] - p[:, 0])
        v = p[:, 3] - p[:, 2]
        t = np.clip(((x - p[:, 2]) * v).sum(1) / np.maximum((v * v).sum(1), 1e-300), 0.0, 1.0)
        return np.linalg.norm(x - p[:, 2] - t[:, None] * v, axis=1)

    a, b = np.zeros(len(p)), np.ones(len(p))
    for _ in range(100):
        left, right = (2 * a + b) / 3, (a + 2 * b) / 3
        less = apart(left) < apart(right)
        a, b = np.where(less, a, left), np.where(less, right, b)
    return apart((a + b) / 2)


def test_nearest_points_are_those_of_a_search():
    """Compare distances of 8000 pairs: skew, parallel, in line, points, to 2 um for axes of up to 3 m.

    Nearly parallel ones (1 mrad) differ by 0.2 mm: there the kernel goes over to the middle of what they share.
    """
    rng = np.random.default_rng(0)
    p = rng.uniform(-1.0, 1.0, (8000, 4, 3))
    p[1000:2000, 3] = p[1000:2000, 2] + rng.uniform(-1, 1, (1000, 1)) * (p[1000:2000, 1] - p[1000:2000, 0])
    p[2000:3000, 3] = p[2000:3000, 2] + 1e-3 * rng.normal(size=(1000, 3)) + p[2000:3000, 1] - p[2000:3000, 0]
    along = p[3000:4000, 1] - p[3000:4000, 0]
    p[3000:4000, 2:] = p[3000:4000, :1] + rng.uniform(-2, 3, (1000, 2, 1)) * along[:, None]
    p[4000:5000, 1] = p[4000:5000, 0]
    p[5000:6000, 3] = p[5000:6000, 2]
    p[6000:6500, 1], p[6000:6500, 3] = p[6000:6500, 0], p[6000:6500, 2]
    shares = wp.full((8000, 2), float("nan"), dtype=float)
    wp.launch(nearest, dim=8000, inputs=[wp.array(p.astype(np.float32), dtype=wp.vec3)], outputs=[shares])
    share, p = shares.numpy().astype(np.float64), p.astype(np.float32).astype(np.float64)
    assert ((share >= 0) & (share <= 1)).all()
    between = p[:, 0] + share[:, :1] * (p[:, 1] - p[:, 0]) - p[:, 2] - share[:, 1:] * (p[:, 3] - p[:, 2])
    found = np.linalg.norm(between, axis=1)
    excess = found - brute_force(p)
    assert excess.min() > -1e-9
    nearly = np.isin(np.arange(8000), np.arange(2000, 3000))
    assert excess[~nearly].max() < 2e-6
    assert excess[nearly].max() < 2e-4


# ---- nothing passes through ----------------------------------------------------------------------------------------


def deepest(sim, seconds: float, target) -> np.ndarray:
    """Step under ``target(t)`` and return the deepest penetration of every world [m].

    No world is lost, none overflows, and nowhere does a branch pass through the arm: the vector between the nearest
    points of two axes never turns round from one step to the next while they are nearer than their radii.
    """
    depth, before = np.zeros(sim.model.num_worlds), None
    for k in range(round(seconds / DT)):
        sim.target.copy_(torch.as_tensor(np.asarray(target(k * DT)), dtype=torch.float32))
        sim.step()
        depth = np.maximum(depth, sim.depth.numpy())
        now, inside = apart(sim)
        assert before is None or not ((now * before[0]).sum(axis=-1)[inside & before[1]] < 0.0).any()
        before = now, inside
    assert sim.faults() == []
    assert int(sim.overflow.sum()) == 0
    return depth


def apart(sim) -> tuple[np.ndarray, np.ndarray]:
    """Vectors between nearest points of the axes of all arm capsules and the first branch's [worlds, C, 3], float64.

    And whether they are nearer than their radii.
    """
    sim.look()
    n, reach = sim.capsules.num_arm, sim.capsules.radius.numpy()
    start, end = (a.numpy().astype(np.float64) for a in (sim.capsules.start, sim.capsules.end))
    branch = [np.broadcast_to(a[:, n : n + 1], (len(a), n, 3)) for a in (start, end)]
    p = np.stack([start[:, :n], end[:, :n], *branch], axis=2).reshape(-1, 4, 3)
    shares = wp.full((len(p), 2), float("nan"), dtype=float)
    wp.launch(nearest, dim=len(p), inputs=[wp.array(p.astype(np.float32), dtype=wp.vec3)], outputs=[shares])
    s, t = shares.numpy().T[:, :, None]
    between = (p[:, 2] + t * (p[:, 3] - p[:, 2]) - p[:, 0] - s * (p[:, 1] - p[:, 0])).reshape(-1, n, 3)
    return between, np.linalg.norm(between, axis=-1) < reach[:, :n] + reach[:, n : n + 1]


def beside(rng: np.random.Generator, q: np.ndarray, c: int, radius: float, gap: float):
    """Return a point beside the arm's capsule c and a direction across it, at random."""
    start, end = arm_capsules(ARM, q)
    u = (end[c] - start[c]) / np.linalg.norm(end[c] - start[c])
    side = np.cross(u, rng.normal(size=3))
    side /= np.linalg.norm(side)
    middle = start[c] + rng.uniform(0.2, 0.8) * (end[c] - start[c])
    return middle + side * (RADIUS[c] + radius + gap), np.cross(u, side)


def thin_posts(count: int, radius: float, stiffness: float, seed: int = 0):
    """Return posts beside random links of random poses, none touching at the start: (trees, q)."""
    rng, trees, poses = np.random.default_rng(seed), [], []
    while len(trees) < count:
        q = np.r_[rng.uniform(-3, 3), rng.uniform(1.5, 4.7), rng.uniform(1.5, 4.7), rng.uniform(-3, 3, 3)]
        point, across = beside(rng, q, int(rng.integers(2, 10)), radius, rng.uniform(0.005, 0.03))
        across = (across + 0.3 * rng.normal(size=3)) / 1.2
        tree = post(point - 0.25 * across, direction=across, length=0.5, radius=radius, stiffness=stiffness,
                    damping=stiffness / 20, mass=0.05 + stiffness * 1e-4)  # fmt: skip
        a, b = tree.position[0], tree.position[0] + 0.5 * across / np.linalg.norm(across)
        start, end = arm_capsules(ARM, q)
        pairs = np.stack([np.broadcast_to(a, start.shape), np.broadcast_to(b, start.shape), start, end], axis=1)
        if (brute_force(pairs) - RADIUS - radius).min() > 0.003:
            trees.append(tree)
            poses.append(q)
    return trees, np.array(poses)


@pytest.mark.parametrize("stiffness", [3.0, 100.0, 1e5])
def test_arms_at_full_speed_pass_no_thin_branch(stiffness):
    """Drive 64 arms at their speed limits, to and fro, at branches of 2 mm radius: they pass none of them.

    Soft ones give way, the stiffest do not at all: there the arm stalls at its torque limits. The deepest are those
    that an elbow or the fingers close upon.
    """
    trees, q = thin_posts(64, 0.002, stiffness)
    sim = simulator(trees, q=q, width=simd_width())
    rng = np.random.default_rng(1)
    signs = rng.choice([-1.0, 1.0], (4, 64, 6))
    depth = deepest(sim, 2.0, lambda t: signs[int(t / 0.5)] * ARM.velocity_limit)
    assert (sim.arm_peak.norm(dim=1) > 0.1).sum() > 40
    assert depth.max() < 0.02
    assert np.median(depth) < 0.003


def test_an_arm_stalls_where_it_is_not_strong_enough():
    """Press against a post of 1e5 N m/rad with every joint at full speed, near the shaft and far out, from both sides.

    Joint 1 reaches its 40 N m and stops; the force is what the lever gives, the depth what the stiffness of the contact
    gives, 60 N a millimetre, even where that is 450 N.
    """
    start, end = arm_capsules(ARM, STRETCHED)
    u = (end[2] - start[2]) / np.linalg.norm(end[2] - start[2])
    side = np.cross([0.0, 0.0, 1.0], u)
    trees, targets = [], []
    for lever in (0.1, 0.2, 0.3):
        for sign in (1.0, -1.0):
            at = start[2] + lever * u / np.linalg.norm(u[:2]) + sign * side / np.linalg.norm(side) * 0.057
            at[2] = 0.0
            trees.append(post(at, length=1.0, radius=0.02, stiffness=1e5, damping=1e3, mass=5.0))
            targets.append([-0.6 * sign, 0, 0, 0, 0, 0])
    sim = simulator(trees, q=STRETCHED)
    depth = deepest(sim, 2.0, lambda t: targets)
    force = sim.arm_force.norm(dim=2).max(dim=1).values.numpy()
    np.testing.assert_allclose(np.abs(sim.torque[:, 0].numpy()), 40.0)
    assert (np.abs(sim.qd[:, 0].numpy()) < 1e-2).all()
    assert (np.abs(sim.q[:, 0].numpy()) < 0.2).all()
    assert (force > 100.0).all()
    np.testing.assert_allclose(sim.depth.numpy(), force / 6e4, rtol=0.15)  # less by what friction carries
    assert (depth < 1.4 * force / 6e4).all()


def test_arms_at_full_speed_pass_neither_line_nor_ground_nor_themselves():
    """Drive arms down to the ground, through the line and into themselves: nothing gets deeper than 12 mm.

    They press on with all their torque: 40 N m at 0.1 m are 400 N, 7 mm deep.
    """
    rng, worlds = np.random.default_rng(2), 48
    q = STRETCHED + np.array([1.0, 0.2, 0.3, 1.0, 1.0, 1.0]) * rng.uniform(-1, 1, (worlds, 6))
    sim = simulator([FAR] * worlds, q=q, width=simd_width(), contacts={"ground": 0.05, "arm_arm": True})
    for w in range(worlds):
        point, across = beside(rng, q[w], 3, 0.01, 0.08)
        sim.line_start[w] = torch.as_tensor(point - across)
        sim.line_end[w] = torch.as_tensor(point + across)
    sim.reset()
    sim.step()
    clear = sim.depth.numpy() == 0.0
    assert clear.sum() > 30
    sim.reset()
    signs = rng.choice([-1.0, 1.0], (8, worlds, 6))
    depth = deepest(sim, 6.0, lambda t: signs[int(t / 0.75)] * ARM.velocity_limit)
    assert (sim.arm_peak.norm(dim=1) > 1.0).sum() > 30
    assert depth[clear].max() < 0.012


@pytest.mark.parametrize("through", [False, True])
def test_a_falling_branch_rests_on_the_line_where_the_mask_says_so(through):
    """Let a loose hinged branch fall: it rests on the line at the angle of geometry, and passes with the mask off."""
    tree = post((5.0, 0.0, 0.5), direction=(1.0, 0.0, 0.5), stiffness=0.0, damping=0.01, joint=Joint.REVOLUTE)
    sim = simulator([tree])
    sim.line_start.copy_(torch.tensor([5.25, -1.0, 0.5]))
    sim.line_end.copy_(torch.tensor([5.25, 1.0, 0.5]))
    sim.line_mask.fill_(0 if through else 1)
    depth = deepest(sim, 2.0, lambda t: np.zeros(6))
    sim.look()
    tip = sim.capsules.end.numpy()[0, sim.capsules.num_arm]
    if through:
        assert tip[2] < 0.3
    else:
        # two radii of 10 mm over a lever of 0.25 m
        np.testing.assert_allclose((tip[2] - 0.5) / 0.4, 0.02 / 0.25, atol=1e-3)
        assert depth.max() < 2e-3


def test_a_falling_branch_rests_on_the_ground():
    """Let a loose hinged branch fall on the ground: its tip rests one radius above it."""
    tree = post((5.0, 0.0, 0.3), direction=(1.0, 0.0, 0.5), stiffness=0.0, damping=0.01, joint=Joint.REVOLUTE)
    sim = simulator([tree], contacts={"ground": 0.1})
    depth = deepest(sim, 2.0, lambda t: np.zeros(6))
    sim.look()
    np.testing.assert_allclose(sim.capsules.end.numpy()[0, sim.capsules.num_arm, 2], 0.11, atol=1e-3)
    assert depth.max() < 3e-3


# ---- many worlds ---------------------------------------------------------------------------------------------------


def test_lanes_change_no_bit():
    """Step 40 different worlds one a thread and sixteen a thread: all the same bits after 240 busy steps."""
    one, lanes = busy(40), busy(40, width=simd_width())
    for sim in (one, lanes):
        act(sim, 240)
    assert float(one.arm_peak.max()) > 5.0
    same(bits(one), bits(lanes))


def test_steps_together_are_steps_one_by_one():
    """Take 8 steps in one launch, 8 launches and 8 replays of a captured graph: the same bits."""
    first = busy(8)
    act(first, 96)
    second = busy(8)
    act(second, 96, chunk=8)
    same(bits(first), bits(second))
    graph = busy(8)
    replay, rng = graph.capture(1), np.random.default_rng(1)
    graph.reset()
    for _ in range(4):
        graph.target.copy_(torch.as_tensor(rng.uniform(-1, 1, (8, 6)) * ARM.velocity_limit))
        for _ in range(24):
            replay()
    same(bits(first), bits(graph))


def test_a_reset_starts_again_with_the_same_bits():
    """Run, reset some worlds and run again: those repeat their bits; a reset of some leaves the others as they are."""
    sim = busy(6)
    act(sim, 96)
    before = bits(sim)
    mask = torch.tensor([True, False, True, False, True, False])
    sim.reset(mask)
    kept = ~mask.numpy()
    for a, b in zip(before[:3], bits(sim)[:3], strict=True):
        np.testing.assert_array_equal(a[kept], b[kept])
        assert not np.array_equal(a[~kept], b[~kept])
    sim.reset()
    act(sim, 96)
    same(before, bits(sim))


def test_a_full_buffer_is_counted():
    """Give worlds room for one contact: where more are found `overflow` counts them, and only there."""
    sim = busy(12)
    quiet = simulator([FAR], contacts={"capacity": 1})
    most = np.zeros(12, int)
    for n in act(sim, 96, look=lambda s: s._touch.count.numpy().copy()):
        most = np.maximum(most, n)
    small = busy(12)
    small._touch.kernel[0].record = small._touch.record[:, :1]
    small._steps.clear()
    act(small, 96)
    act(quiet, 96)
    crowded = small.overflow.numpy() > 0
    assert crowded.sum() >= 3 and not crowded[most == 0].any()
    assert int(quiet.overflow.sum()) == quiet.without_room == 0
    first = int(small.overflow.sum())
    small.reset()
    assert int(small.overflow.sum()) == 0 and small.without_room == first
    act(small, 96)
    assert small.without_room == first + int(small.overflow.sum()) > first


def test_room_grows_with_the_scene():
    """Give small trees room for 32 contacts, larger ones for one in two capsules, two in one, or what is asked."""
    small, large = (ternary(np.random.default_rng(0), order=order) for order in (1, 3))
    thrice = {name: np.concatenate([getattr(large, name)] * 3) for name in ("shape_link", "shape_start", "shape_end")}
    large = large.with_(**thrice, shape_radius=np.concatenate([large.shape_radius] * 3))
    assert len(large.shape_link) == 120 and len(RADIUS) == 10
    for given, trees, room in ((None, [small], 32), (None, [small, large], 65), (7, [large], 7)):
        assert simulator(trees, contacts={"capacity": given})._touch.record.shape == (len(trees), room)
    assert simulator([large], contacts={"branch_branch": True})._touch.record.shape == (1, 260)


def test_random_scenes_lose_no_world():
    """Step 64 random scenes of trees, line and ground 300 times under random actions: none lost, none silently wrong.

    Scenes that start without overlap never get deeper than 15 mm (a joint's 80 N m pressed on the ground), 99 % of
    their steps stay above 3 mm; no force is beyond what torques and blows can give; no contact is left out; every
    force pushes and is in Coulomb's cone to round-off, and in 99 % of the worlds' steps all forces agree to 0.5 %.
    ``benchmarks/contact.py --random`` runs 4096 x 1000.
    """
    sim = busy(64, seed=3, width=simd_width())
    sim.step()
    clear = sim.depth.numpy() == 0.0
    assert clear.sum() > 25
    sim.reset()
    cone, pull, depths, unsettled = [], [], [], []

    def look(sim):
        depths.append(sim.depth.numpy().copy())
        unsettled.append(sim.unsettled.numpy().copy())
        for w in range(0, 64, 4):
            for c in contacts_of(sim, w):
                push = float(c["normal"] @ c["force"])
                if np.linalg.norm(c["force"]) < 0.1:
                    continue
                pull.append(push)
                drag = np.linalg.norm(c["force"] - push * c["normal"])
                cone.append(drag / max(push, 1e-9))

    act(sim, 300, look=look)
    depth = np.array(depths)
    assert sim.faults() == []
    assert int(sim.overflow.sum()) == 0
    assert torch.isfinite(sim.q).all() and torch.isfinite(sim.branch_force).all()
    assert depth[:, clear].max() < 0.015
    assert np.quantile(depth[:, clear], 0.99) < 0.003
    assert float(sim.arm_peak[torch.as_tensor(clear)].max()) < 2000.0
    assert len(cone) > 1000 and max(cone) < 0.5 * (1.0 + 1e-4)
    assert min(pull) > 0.0
    assert np.mean(unsettled) < 0.01


def test_bad_contacts_are_refused():
    """Refuse numbers that no contact can have, in one line that names the field."""
    wrong = {"stiffness": -1.0, "friction": float("nan"), "creep": 0.0, "capacity": 0, "repeats": 0}
    for name, value in wrong.items():
        with pytest.raises(InputError, match=name):
            replace(Contacts(), **{name: value})


# ---- branches against branches ---------------------------------------------------------------------------------------


def posts_in_a_row(stiffness: list[float], torque: float = 0.0, damping: float = 5.0) -> Tree:
    """Make upright posts 30 mm apart, 10 mm between them; a constant torque leans the first on the second."""
    row = [post((-0.5 + 0.03 * k, 0.0, 0.0), stiffness=v, damping=damping) for k, v in enumerate(stiffness)]
    names = "parent joint position rotation mass com inertia stiffness damping axis shape_start shape_end shape_radius"
    both = {name: np.concatenate([getattr(p, name) for p in row]) for name in names.split()}
    push = np.zeros((len(row), 3))
    push[0, 1] = torque
    return Tree(name="posts", link_name=[f"post{k}" for k in range(len(row))], shape_link=np.arange(len(row)),
                preload=push, **both)  # fmt: skip


@pytest.mark.parametrize("touch", [True, False])
def test_a_post_leans_on_another(touch):
    """Let one sprung post lean on another for 4 s: moments balance at both to 1 %; or pass it where they may not touch.

    The second is bent by the contact alone: K theta = |r x f|; the first by its torque less that of the contact. What
    is left of the motion after 4 s is far below 1 %.
    """
    sim = simulator([posts_in_a_row([100.0, 60.0], 8.0)], gravity=(0.0, 0.0, 0.0), contacts={"branch_branch": touch})
    sim.step(960)
    q = np.array(sim.state.qpos()[0]).reshape(2, 4)
    theta = 2.0 * np.arctan2(q[:, 2], q[:, 0])
    if not touch:
        np.testing.assert_allclose(theta, [0.08, 0.0], atol=1e-5)
        assert float(sim.branch_force.abs().sum()) == 0.0
        return
    (c,) = contacts_of(sim)
    f, base = c["force"].astype(float), np.array([[-0.5, 0.0, 0.0], [-0.47, 0.0, 0.0]])
    moment = np.cross(c["point"] - base, [f, -f] if c["capsule"] == 0 else [-f, f])[:, 1]
    assert abs(f[0]) > 3.0 and theta[1] > 0.005
    np.testing.assert_allclose(100.0 * theta[0], 8.0 + moment[0], rtol=0.01)
    np.testing.assert_allclose(60.0 * theta[1], moment[1], rtol=0.01)
    np.testing.assert_allclose(sim.branch_force[0].sum(dim=0).numpy(), 0.0, atol=1e-5)


def test_branches_that_clash_gain_no_energy():
    """Throw four posts in a row at each other in 8 worlds: they meet, no energy comes of it, lanes keep their bits.

    Kinetic and spring energy stays below 1.01 of the most that the same posts have where they pass each other: the
    step's own ripple. Frictionless blows of a stiff contact that damps: what meets loses.
    """
    rng = np.random.default_rng(5)
    trees = [posts_in_a_row([8.0, 10.0, 6.0, 9.0], damping=0.002)] * 8
    throw = [np.tile([0.2, 4.0, 0.0], 4) * rng.normal(0.0, 1.0, 12) for _ in trees]
    sims = [
        simulator(trees, width=width, gravity=(0.0, 0.0, 0.0), contacts={"branch_branch": touch, "arm_branch": False})
        for width, touch in ((1, True), (simd_width(), True), (1, False))
    ]
    for sim in sims:
        sim.state.set_qvel(throw)
    energy, met = [], np.zeros(8, int)
    for _ in range(96):
        for sim in sims:
            sim.step(2)
        energy.append([sim.energy()[0].sum(axis=1) for sim in (sims[0], sims[2])])
        met += (sims[0].branch_force.abs().sum(dim=(1, 2)) > 0).numpy()
    meeting, passing = np.array(energy).transpose(1, 0, 2)
    assert (met >= 4).all()
    assert (meeting < 1.01 * passing.max(axis=0)).all()
    assert (meeting[-1] < 0.95 * passing[-1]).all()
    for a, b in zip(sims[0].state.qpos(), sims[1].state.qpos(), strict=True):
        np.testing.assert_array_equal(a, b)
