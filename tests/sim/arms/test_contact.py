"""Arm and contact against closed forms and C MuJoCo: servo, stops, pushes, friction, energy, a sweep through a tree."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch
from bough.sim.arms.arm import forward_kinematics
from bough.sim.arms.arrays import arm_capsules
from bough.sim.arms.jaco2 import jaco2
from oracles import mujoco_arm
from oracles.contact_case import (
    DT,
    STRETCHED,
    contacts_of,
    drive,
    free_arm,
    point_jacobian,
    post,
    pushed_posts,
    pushes,
    roughness,
    simulator,
    slider,
    ternary,
)

#: A branch that nothing reaches.
FAR = post((50.0, 0.0, 1.0))


@pytest.fixture(scope="module", autouse=True)
def _elsewhere(tmp_path_factory):
    """Work in a scratch folder: C MuJoCo appends its warnings to MUJOCO_LOG.TXT in the current one."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("log"))
        yield


def mujoco_drive(arm, seconds: float, target, substeps: int, q=None, **options) -> np.ndarray:
    """Joint positions of the same in C MuJoCo."""
    model, data = mujoco_arm.compiled(arm, dt=DT / substeps, **options)
    data.qpos[:6] = arm.home if q is None else q
    out = []
    for k in range(round(seconds / DT)):
        data.ctrl[:] = target(k * DT)
        mujoco.mj_step(model, data, substeps)
        out.append(data.qpos.copy())
    return np.array(out)


# ---- the arm alone -------------------------------------------------------------------------------------------------


def sines(t: float) -> np.ndarray:
    """Joint speeds within all limits [rad/s], zero at first."""
    return 0.5 * np.sin(2 * np.pi * np.array([0.5, 0.7, 0.9, 1.1, 1.3, 1.5]) * t)


def test_a_free_arm_moves_as_mujocos():
    """Drive all joints along sines: q is converged MuJoCo's to 1e-3 rad at 1/240 s, and half the step halves the error.

    First order: the error halves with the step, until float32 and MuJoCo's own dry friction (a constraint with a time
    constant of 2 ms) are left, about 2e-5 rad.
    """
    arm = jaco2()
    coarse, fine = (mujoco_drive(arm, 0.5, sines, n) for n in (16, 32))
    truth = 2.0 * fine - coarse
    error = [
        np.abs(drive(simulator([FAR], arm, q=arm.home, dt=DT / n), 0.5, sines, substeps=n) - truth).max()
        for n in (1, 2, 4)
    ]
    assert error[0] < 1e-3
    assert error[1] < 0.65 * error[0] + 2e-5
    assert error[2] < 0.65 * error[1] + 2e-5


def test_a_servo_carries_the_weight_and_stays():
    """Ask for no motion for 2 s at random poses: the arm does not move, its torques are those that gravity needs."""
    q = np.random.default_rng(0).uniform(0.9, 5.0, (8, 6))
    sim = simulator([FAR] * 8, q=q)
    drive(sim, 2.0, lambda t: np.zeros((8, 6)))
    np.testing.assert_allclose(sim.q.numpy(), q, atol=2e-5)
    model, data = mujoco_arm.compiled(jaco2(), servo=False)
    for w in range(8):
        data.qpos[:] = q[w]
        mujoco.mj_forward(model, data)
        np.testing.assert_allclose(sim.torque[w].numpy(), data.qfrc_bias, atol=2e-4)


def test_a_joint_comes_to_rest_at_its_stop():
    """Drive joints 2 and 3 against both stops: they end there to 1e-3 rad, were never beyond by more, and stay."""
    arm = jaco2()
    for sign, limit in ((1.0, arm.upper), (-1.0, arm.lower)):
        speeds = np.array([0.0, sign, sign, 0.0, 0.0, 0.0])
        q = drive(simulator([FAR], arm, q=arm.home), 9.0, lambda t, v=speeds: v)[:, 1:3]
        np.testing.assert_allclose(q[-1], limit[1:3], atol=1e-3)
        assert (sign * (q - limit[1:3])).max() < 1e-3


def test_the_end_pose_is_the_kinematics_and_never_jumps():
    """Turn joints 1, 4 and 5 through more than two turns: position and rotation are the host's, the sign never flips.

    Bounds: float32 poses over six joints, 2e-6; a step turns the hand by at most 3 x 2.5 rad/s / 240 / 2 in the
    quaternion.
    """
    arm = free_arm(velocity_limit=10.0)
    sim = simulator([FAR], arm, q=arm.home)

    def read(sim):
        return np.r_[sim.q[0].numpy(), sim.end_position[0].numpy(), sim.end_rotation[0].numpy()]

    seen = drive(sim, 6.0, lambda t: [2.5, 0, 0, -2.5, 2.5, 0], read)
    assert np.abs(np.diff(seen[:, 9:], axis=0)).max() < 0.02
    for row in seen[::90]:
        _, _, end = forward_kinematics(arm, row[:6].astype(float))
        np.testing.assert_allclose(row[6:9], end[0], atol=2e-6)
        assert abs(row[9:] @ end[1]) > 1.0 - 1e-6


def test_speeds_keep_their_limits():
    """Ask for 10 rad/s: every joint turns at its speed limit, to 1 %."""
    arm = free_arm()
    sim = simulator([FAR], arm, q=arm.home)
    drive(sim, 1.0, lambda t: np.full(6, 10.0))
    np.testing.assert_allclose(sim.qd[0].numpy(), jaco2().velocity_limit, rtol=0.01)


def test_an_arm_too_weak_sags_as_mujocos():
    """Let an arm with 4 N m a joint try to rise from `STRETCHED`: it falls, as in MuJoCo, to 3 mrad in 0.4 s.

    MuJoCo clips the torque of the step before, so it is taken at 1/15360 s.
    """
    arm = replace(free_arm(torque_limit=4.0, velocity_limit=10.0), name="weak")

    def up(t):
        return np.array([0.0, 0.3, 0.0, 0.0, 0.0, 0.0])

    sim = simulator([FAR], arm, dt=DT / 4)
    ours = drive(sim, 0.4, up, substeps=4)
    theirs = mujoco_drive(arm, 0.4, up, 64, q=STRETCHED)
    assert np.abs(theirs[-1] - STRETCHED).max() > 0.1
    np.testing.assert_allclose(ours, theirs, atol=3e-3)
    assert (np.abs(sim.torque[0].numpy()) <= 4.0).all()


# ---- pushes --------------------------------------------------------------------------------------------------------


def test_a_push_settles_at_the_force_of_the_spring():
    """Push sprung posts in twelve directions with 12 N m at joint 1: moments about the post's joint balance within 2 %.

    With phi the rotation vector of the post's ball joint, K phi = r x f; and the servos hold tau = J^T f, J from the
    host's kinematics in float64. Without gravity. Every sum of forces equals what acts on the arm, with the other sign.
    """
    trees, q, arm = pushed_posts(12)
    sim = simulator(trees, arm, q=q, gravity=(0.0, 0.0, 0.0))
    drive(sim, 14.0, lambda t: [0.15, 0, 0, 0, 0, 0])
    pushed = 0
    for w, found, turn, moment in pushes(sim, trees):
        tree = trees[w]
        pushed += 1
        assert np.linalg.norm(moment) > 1.0
        assert np.linalg.norm(moment - tree.stiffness[0] * turn) < 0.02 * np.linalg.norm(moment)
        now = sim.q[w].numpy().astype(float)
        needed = sum(point_jacobian(arm, now, int(c["body"]), c["point"]).T @ c["force"] for c in found)
        # what still creeps: the servo's joints turn by some mrad/s, and 80 N m s/rad of each is in the torque
        np.testing.assert_allclose(sim.torque[w].numpy(), needed, atol=0.02 * np.abs(needed).max())
    assert pushed >= 10


def test_80_newton_indent_by_at_most_a_millimetre_and_a_half():
    """Push a stiff post at the default step and stiffness: at rest and at every moment before, 1.5 mm a 80 N.

    The arm comes at its greatest speed, so that the push includes the blow.
    """
    trees, q, arm = pushed_posts(6)
    trees = [t.with_(stiffness=[3000.0], damping=[30.0]) for t in trees]
    sim = simulator(trees, arm, q=q)

    def read(sim):
        return sim.depth.numpy().copy(), sim.branch_force[:, 0].norm(dim=1).numpy().copy()

    seen = drive(sim, 2.0, lambda t: [0.6, 0, 0, 0, 0, 0], read)
    depth, force = seen[:, 0], seen[:, 1]
    assert (force.max(axis=0) > 80.0).sum() >= 4
    assert (depth[-1] <= 1.5e-3 * force[-1] / 80.0 + 1e-6).all()
    assert depth[force < 80.0].max() < 1.5e-3


def test_forces_on_arm_and_branches_are_equal_and_opposite():
    """Sum the forces of all contacts in a busy scene: on links and on capsules they cancel to round-off of the sums."""
    tree = ternary(np.random.default_rng(3))
    sim = simulator([tree], FAST, q=SWEEP, contacts={"capacity": 64})
    most = 0

    def read(sim):
        nonlocal most
        found = contacts_of(sim)
        most = max(most, int((np.abs(found["force"]).sum(axis=1) > 0).sum()))
        for name, count in (("arm", 6), ("branch", tree.num_links)):
            sums = np.zeros((count, 3))
            for c in found:
                if name == "arm" and c["body"] >= 0:
                    sums[c["body"]] -= c["force"]
                elif name == "branch":
                    sums[c["capsule"]] += c["force"]
            have = (sim.arm_force if name == "arm" else sim.branch_force)[0].numpy()
            np.testing.assert_allclose(have, sums, atol=1e-6 * max(np.abs(sums).max(), 1.0))
        return 0

    drive(sim, 1.0, sweep, read)
    assert most >= 3


# ---- friction ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("surface", ["ground", "line", "arm"])
def test_a_body_on_an_incline_slips_at_the_angle_of_friction(surface):
    """Tilt gravity by 25 degrees: a body on two free slides stays where mu > tan 25 degrees and slips where it is less.

    One world for each mu, 2 % above and below and further away. Where it sticks it creeps at most at the speed that
    friction grows up to (2 mm/s), where it slips it gains g (sin a - mu cos a), within 2 % of g sin a.
    """
    a, g = np.radians(25.0), 9.81
    mu = np.tan(a) * np.array([0.5, 0.8, 0.98, 1.02, 1.2, 2.0])
    top = {"ground": 0.0, "line": 0.61, "arm": 0.0}[surface]
    arm, q = replace(free_arm(friction=0.0), gain=np.full(6, 1e6)), STRETCHED
    contacts = {"ground": 0.0} if surface == "ground" else {}
    at = np.array([5.0, 0.0, top + 0.0101])
    gravity = g * np.array([np.sin(a), 0.0, -np.cos(a)])
    if surface == "arm":
        q = LEVEL
        start, end = arm_capsules(arm, q)
        u = (end[2] - start[2]) / np.linalg.norm(end[2] - start[2])
        assert abs(u[2]) < 1e-3 and abs(abs(u[0]) - 1) < 1e-3  # the upper arm lies along x
        at = start[2] + (end[2] - start[2]) * 0.5 + np.array([0.0, 0.0, 0.0421])
    sim = simulator([slider(at)] * 6, arm, q=q, contacts=contacts, gravity=gravity)
    sim.friction.copy_(torch.as_tensor(mu))
    if surface == "line":
        sim.line_start.copy_(torch.tensor([3.0, 0.0, 0.6]))
        sim.line_end.copy_(torch.tensor([7.0, 0.0, 0.6]))
        sim.line_mask.fill_(1)
    seen = drive(sim, 0.4, lambda t: np.zeros(6), lambda s: np.array([v[1] for v in s.state.qvel()]))
    gained = (seen[-1] - seen[11]) / (DT * (len(seen) - 12))
    slips = mu < np.tan(a)
    expected = g * (np.sin(a) - mu * np.cos(a))
    np.testing.assert_allclose(gained[slips], expected[slips], atol=0.02 * g * np.sin(a))
    assert (np.abs(seen[-1][~slips]) <= 2.05e-3).all()
    assert (seen[-1][slips] > 0.01).all()


# ---- energy --------------------------------------------------------------------------------------------------------


def test_a_thrown_arm_never_gains_energy_from_branches():
    """Throw an arm without servo and friction into trees at rest: kinetic and spring energy never grow beyond its own.

    Without gravity, branches undamped by contact; energy of the branches is the simulator's own (tested elsewhere),
    that of the arm from MuJoCo's joint-space inertia. Velocity products are explicit in a step: what the same arms gain
    by them with nothing in the way, up to 2 %, is allowed for.
    """
    arm = free_arm(gain=0.0, friction=0.0, velocity_limit=100.0)
    rng, worlds = np.random.default_rng(4), 12
    thrown = torch.as_tensor(rng.uniform(-0.1, 0.1, (worlds, 6)) + np.array([2.0, 0, 0, 0, 0, 0]))
    model, data = mujoco_arm.compiled(arm, servo=False, gravity=0.0)
    share = []
    for trees in ([FAR] * worlds, [ternary(rng) for _ in range(worlds)]):
        sim = simulator(trees, arm, q=SWEEP, gravity=(0.0, 0.0, 0.0), substeps=4,
                        contacts={"capacity": 64, "damping": 0.0})  # fmt: skip
        sim.qd.copy_(thrown)
        energy = [total_energy(sim, model, data)]
        for _ in range(240):
            sim.step()
            energy.append(total_energy(sim, model, data))
        share.append(np.array(energy) / energy[0])
        assert sim.faults() == []
    free, hit = share
    assert free.max() < 1.02
    assert (hit <= free.max(axis=0) + 0.001).all()
    assert (sim.arm_peak.norm(dim=1) > 1.0).sum() >= 8
    assert (hit[-1] < 0.9).sum() >= 8


def total_energy(sim, model, data) -> np.ndarray:
    """Kinetic energy of arm and branches and energy of their springs [J], [worlds]."""
    energy, _ = sim.energy()
    out, M = energy[:, 0] + energy[:, 2], np.zeros((6, 6))
    for w in range(len(out)):
        data.qpos[:] = sim.q[w].numpy()
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, M)
        v = sim.qd[w].numpy().astype(float)
        out[w] += 0.5 * v @ M @ v
    return out


# ---- the sweep -----------------------------------------------------------------------------------------------------

#: Where the sweep starts: beside the tree, and what its servo is asked for [rad/s]: a tip speed of 1.5 m/s.
SWEEP = STRETCHED + np.array([-0.7, 0, 0, 0, 0, 0])
FAST = replace(jaco2(), velocity_limit=np.full(6, 3.0))
#: Upper arm level along x.
LEVEL = np.deg2rad([0.0, 270.0, 180.0, 0.0, 180.0, 180.0])


def sweep(t: float) -> np.ndarray:
    return np.array([2.4 * min(1.0, t / 0.1), 0, 0, 0, 0, 0])


def swept(seed: int) -> tuple[np.ndarray, list, float, float]:
    """Sweep through a tree of 40 links at the default step.

    Returns net force on the arm [steps, 3], the contacts that acted in every step, greatest depth [m] and tip speed.
    """
    tree = ternary(np.random.default_rng(seed))
    sim = simulator([tree], FAST, q=SWEEP, contacts={"capacity": 64})

    def read(sim):
        found = contacts_of(sim)
        found = found[np.abs(found["force"]).sum(axis=1) > 0]
        order = np.lexsort((found["gap"], found["body"], found["capsule"]))
        tip = np.linalg.norm(point_jacobian(FAST, sim.q[0].numpy().astype(float), 5, sim.end_position[0].numpy())
                             @ sim.qd[0].numpy())  # fmt: skip
        return sim.arm_force[0].sum(dim=0).numpy().copy(), found[order].copy(), float(sim.depth[0]), float(tip)

    out = []
    for k in range(240):
        sim.target[0] = torch.as_tensor(sweep(k * DT))
        sim.step()
        out.append(read(sim))
    assert sim.faults() == []
    assert int(sim.overflow.sum()) == 0
    force, found, depth, tip = zip(*out, strict=True)
    return np.array(force), list(found), max(depth), max(tip)


def mujoco_swept(seed: int, substeps: int, time_constant: float) -> np.ndarray:
    """Net force on the arm [steps, 3] in C MuJoCo, averaged over the substeps of every 1/240 s."""
    tree = ternary(np.random.default_rng(seed))
    model, data = mujoco_arm.compiled(FAST, tree, dt=DT / substeps, time_constant=time_constant)
    data.qpos[:6] = SWEEP
    out = np.zeros((240, 3))
    for k in range(240):
        data.ctrl[:] = sweep(k * DT)
        for _ in range(substeps):
            mujoco.mj_step(model, data)
            out[k] -= mujoco_arm.contact_forces(model, data)[0] / substeps
    return out


def test_a_sweep_through_a_tree_is_smooth_and_has_mujocos_force():
    """Sweep through 40-link trees, tip at 1.4 to 1.5 m/s: mean force within 10 % of converged MuJoCo, roughness 2 %.

    The mean is that of the net force's norm over the sweep, four trees together, MuJoCo at 1/1920 s with a time
    constant of its contacts of 5 ms. Roughness (`oracles.contact_case.roughness`) counts where contacts last: same
    pairs since three steps, normals turning by less than 0.03 rad a step; blows and edges are no noise.
    """
    ours, theirs, noise, level, weights = [], [], [], [], []
    for seed in range(4):
        force, found, depth, tip = swept(seed)
        assert 1.3 < tip < 1.6
        assert depth < 2.5e-3  # of blows
        size = np.linalg.norm(force, axis=1)
        ours.append(size.mean())
        theirs.append(np.linalg.norm(mujoco_swept(seed, 8, 0.005), axis=1).mean())
        rough, mean, count = roughness(size, found)
        noise.append(rough)
        level.append(mean)
        weights.append(count)
    assert min(weights) >= 20
    assert 15.0 < np.mean(ours) < 35.0
    assert abs(np.mean(ours) / np.mean(theirs) - 1.0) < 0.1
    assert np.sqrt(np.average(np.square(noise), weights=weights)) < 0.02
