"""Effects that change the structure against MuJoCo models built for it; every effect recovered where it is true."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch
from bough.learn.cases.case import load_case
from bough.learn.hidden.branch import Branch
from bough.learn.hidden.drive import drive
from bough.learn.hidden.elastic_forms import Damage
from bough.learn.hidden.grip_forms import Slide
from bough.learn.hidden.parts import Part
from bough.learn.hidden.world_laws import Slip
from bough.learn.inference.fit import find_modes
from bough.learn.inference.target import Target
from bough.learn.replay.equation_error import EquationError, torque_recordings
from bough.learn.replay.recording import recordings
from bough.learn.replay.rollout import Rollout
from bough.learn.systems.acting import Acting, unit_at
from bough.learn.systems.branch import Unknowns
from bough.learn.systems.system import free_of
from bough.sim.base.errors import InputError
from bough.sim.effects import effects
from bough.sim.trees.measured import measured_tree
from bough.sim.trees.stiffness import hold_rest_pose
from bough.sim.trees.tree import Joint, Tree
from oracles.arm_case import write_arm
from oracles.effect_case import FORCE, held, simulate, stick_case, swing_case
from oracles.mujoco_tree import compiled, held_torque
from scipy.optimize import root
from scipy.spatial.transform import Rotation

KS, DS = 20.0, 0.4
N, DT = 120, 0.02
#: The stick of `stick_case` for the hidden simulator.
ROD = Branch([0.5], [0.012], [0.010], [35.0], [20.0], [KS], [DS], 800.0, 0.4, 9.81, ["stick"])


def push(scale=1.0, n=N):
    """Return a force that rises, wobbles, and is let go, [T, 3]."""
    t = np.arange(n) * DT
    size = np.where(t < 1.0, np.interp(t, [0.1, 0.5], [0, 1]) * (1 + 0.3 * np.sin(9 * t)), 0.0)
    return scale * size[:, None] * np.array([2.0, -3.0, 1.5])


def by_mujoco(tree: Tree, link: int, force, substeps=80):
    """Return the displacement [T, 3] of the point 0.4 m along a link under a force that is linear between samples."""
    model, data = compiled(tree, DT / substeps)
    held = data.qfrc_applied.copy()
    mujoco.mj_forward(model, data)

    def point():
        return data.xpos[link + 1] + data.xmat[link + 1].reshape(3, 3) @ [0.0, 0.0, 0.4]

    start, out = point().copy(), np.zeros((len(force), 3))
    for k in range(len(force) - 1):
        for step in range(substeps):
            share = (step + 0.5) / substeps
            data.qfrc_applied[:] = held
            mujoco.mj_applyFT(model, data, force[k] * (1 - share) + force[k + 1] * share, np.zeros(3), point(),
                              link + 1, data.qfrc_applied)  # fmt: skip
            mujoco.mj_step(model, data)
        out[k + 1] = point() - start
    return out


def close(ours, wanted):
    """Agree to what a first-order step of 2.5 ms leaves of a swing of about 10 rad/s: 1.5 % of the largest value."""
    assert np.abs(wanted).max() > 0.02
    np.testing.assert_allclose(ours, wanted, atol=0.015 * np.abs(wanted).max())


@pytest.mark.parametrize("spread", [0.0, 0.8])
def test_tip_mass_equals_a_heavier_model(tmp_path, spread):
    """Move as MuJoCo does with the mass in the link's own mass, centre and inertia, at the end or along the stick."""
    case, extra = stick_case(tmp_path / "c", [push()]), 0.25
    tree = measured_tree(case, [KS], [DS])
    mass, com, tip = tree.mass[0], tree.com[0], np.array([0.0, 0.0, 0.5 * (1 - spread / 2)])
    centre = (mass * com + extra * tip) / (mass + extra)
    about = tree.inertia[0].copy()
    for m, p in ((mass, com), (extra, tip)):
        d = p - centre
        about += m * (d @ d * np.eye(3) - np.outer(d, d))
    about += extra * (spread * 0.5) ** 2 / 12 * np.diag([1.0, 1.0, 0.0])  # a thin rod's own
    heavy = hold_rest_pose(tree.with_(mass=[mass + extra], com=centre[None], inertia=about[None]))
    hung = {"mass_kg": extra, "spread": spread}
    ours = simulate(case, KS, DS, form="branch", without=("base_compliance",), tip_mass=hung)[0, :, :3]
    wanted = by_mujoco(heavy, 0, push())
    close(ours, wanted)
    assert np.abs(by_mujoco(tree, 0, push()) - wanted).max() > 0.1 * np.abs(wanted).max()


@pytest.mark.parametrize("twist", [1.0, 0.05])
def test_base_compliance_equals_a_chain_of_two(tmp_path, twist):
    """Move as MuJoCo does with a ball joint 0.6 m below the base that carries a ball of wood, or a slender trunk."""
    case, compliance, inertia, relaxation = stick_case(tmp_path / "c", [push()]), 0.02, 0.08, 0.03
    branch = measured_tree(case, [KS], [DS])
    two = Tree(
        name="two", link_name=["trunk", "stick"], parent=[-1, 0], joint=[Joint.SPHERICAL] * 2,
        position=[[0, 0, 0.4], [0, 0, 0.6]], rotation=[[1, 0, 0, 0], branch.rotation[0]],
        mass=[1e-6, branch.mass[0]], com=[[0, 0, 0], branch.com[0]],
        inertia=[inertia * np.diag([1.0, 1.0, twist]), branch.inertia[0]],
        stiffness=[1 / compliance, KS], damping=[relaxation / compliance, DS],
    )  # fmt: skip
    unknowns = Unknowns(effects=(Acting("base_compliance"),))
    rollout = Rollout(case, recordings(case), 1, unknowns=unknowns)
    rollout._output.torch.fill_(torch.nan)
    ours = (
        rollout(torch.tensor([[KS, DS, compliance, inertia, relaxation, twist, 0.0, 0.0, 0.0, 0.02]]))[0, 0, :, :3]
        .double()
        .numpy()
    )
    close(ours, by_mujoco(hold_rest_pose(two), 1, push()))
    off = torch.tensor([[KS, DS, 0.0, inertia, 0.02, twist, 0.0, 0.0, 0.0, 0.02]])
    locked = rollout(off)[0, 0, :, :3].double().numpy()
    plain = Rollout(case, recordings(case), 1)(torch.tensor([[KS, DS]]))[0, 0, :, :3].double().numpy()
    np.testing.assert_allclose(locked, plain, atol=1e-6)  # float32 of a metre
    assert np.abs(ours - plain).max() > 0.1 * np.abs(plain).max()


def jerks(force, axis):
    """Return 1 N where the force is larger than that."""
    return np.asarray(np.linalg.norm(force, axis=1) > 1.0, dtype=np.float64)


def test_a_trunk_that_slides_is_a_chain_on_three_slides(tmp_path):
    """Move as MuJoCo does where a stick's base slides along x, y and z as well, and hangs by its weight no lower."""
    case, slide, lasts = stick_case(tmp_path / "c", [push()]), 4e-3, 0.05
    compliance, inertia = 2e-4, 0.08  # a trunk that turns next to nothing beside the stick's own 1 / KS
    branch = measured_tree(case, [KS], [DS])
    names = ["x", "y", "z", "trunk", "stick"]
    slides = Tree(
        name="slides", link_name=names, parent=[-1, 0, 1, 2, 3], joint=[Joint.PRISMATIC] * 3 + [Joint.SPHERICAL] * 2,
        axis=[*np.eye(3), [0, 0, 1.0], [0, 0, 1.0]], position=[[0, 0, 0.4], *[[0, 0, 0.0]] * 3, [0, 0, 0.6]],
        rotation=[*[[1, 0, 0, 0]] * 4, branch.rotation[0]], mass=[*[1e-6] * 4, branch.mass[0]],
        com=[*[[0, 0, 0]] * 4, branch.com[0]],
        inertia=[*[1e-9 * np.eye(3)] * 3, inertia * np.eye(3), branch.inertia[0]],
        stiffness=[*[1 / slide] * 3, 1 / compliance, KS],
        damping=[*[lasts / slide] * 3, 0.03 / compliance, DS],
    )  # fmt: skip
    rollout = Rollout(case, recordings(case), 1, unknowns=Unknowns(effects=(Acting("base_compliance"),)))
    rollout._output.torch.fill_(torch.nan)
    values = [KS, DS, compliance, inertia, 0.03, 1.0, 0.0, 0.0]
    ours, held = (rollout(torch.tensor([[*values, *own]]))[0, 0, :, :3].double().numpy()
                  for own in ((slide, lasts), (0.0, 0.02)))  # fmt: skip
    close(ours, by_mujoco(hold_rest_pose(slides), 4, push()))
    assert np.abs(ours - held).max() > 0.1 * np.abs(held).max()


@pytest.mark.parametrize("share", [0.5, 2.0])
def test_a_trunk_that_gives_way_holds_a_branch_of_any_density(tmp_path, share):
    """Rest in the given pose, whatever a branch weighs: slides and pivot carry what it does."""
    case = stick_case(tmp_path / "c", [0.0 * push()])
    unknowns = Unknowns(infer=("stiffness", "damping", "density"), effects=(Acting("base_compliance"),))
    rollout = Rollout(case, recordings(case), 1, unknowns=unknowns)
    rollout._output.torch.fill_(torch.nan)
    values = [KS, DS, share * case.density, 0.05, 0.08, 0.03, 1.0, 0.0, 0.0, 0.02, 0.05]
    assert len(values) == len(rollout.system.parameters)
    found = rollout(torch.tensor([values]))[0, 0, :, :3].double().numpy()
    np.testing.assert_allclose(found, 0.0, atol=1e-5)  # float32; the weight alone would sink it by 0.02 m/N x 1.5 N


def along(force, axis):
    """Return the excess over 0.2 N of the force along a segment, with its sign."""
    pull = (force * axis).sum(axis=1)
    return np.sign(pull) * np.maximum(0.0, np.abs(pull) - 0.2)


def test_a_dragged_grip_is_the_hidden_simulators(tmp_path):
    """Slide where the force along the segment points as MuJoCo does with such a grip, in both directions."""
    mobility, swing = 0.03, np.sin(np.arange(100) / 6.0)[:, None]
    force = push(2.5, 100) * swing
    case = stick_case(tmp_path / "c", [force])
    law = Part({}, law=lambda: Slide(mobility, 0.0, 0.0, (0.4, 0.1), along))
    wanted, held = (drive(ROD, force[None], 1 / DT, parts=parts, wood=0.0, dt=5e-4) for parts in ([law], []))
    slips = {"mobility_mpNs": mobility, "least_N": 0.2, "least_share": 0.0, "viscous": 1.0, "axial": 1.0}
    ours, plain = (simulate(case, KS, DS, form="branch", without=("base_compliance",), **on)[0]
                   for on in ({"grasp_slip": slips}, {}))  # fmt: skip
    way = (wanted.moved - held.moved)[0]
    assert way[:, 2].min() < -2e-3 and way[:, 2].max() > 2e-3
    close((ours - plain)[:, :3], way)
    close((ours - plain)[:, 3:], (wanted.velocity - held.velocity)[0])


def test_a_jerking_grip_is_the_hidden_simulators(tmp_path):
    """Slide by 4 cm within 20 ms of the force's reaching 1 N, and be held there, as MuJoCo does with such a grip."""
    force = push(2.0)
    case = stick_case(tmp_path / "c", [force])
    law = Part({}, law=lambda: Slide(-2.0, 0.0, 0.0, (0.04, 0.04), jerks))
    wanted, held = (drive(ROD, force[None], 1 / DT, parts=parts, wood=0.0, dt=5e-4) for parts in ([law], []))
    slips = {"mobility_mpNs": -2.0, "least_N": 1.0, "least_share": 0.0, "viscous": 0.0, "most_m": 0.04}
    ours, plain = (simulate(case, KS, DS, form="branch", without=("base_compliance",), **on)[0]
                   for on in ({"grasp_slip": slips}, {}))  # fmt: skip
    way = (wanted.moved - held.moved)[0]
    assert np.linalg.norm(way, axis=1).max() > 0.03
    close((ours - plain)[:, :3], way)


def test_a_rupture_with_its_preload_is_the_hidden_simulators(tmp_path):
    """Break at the first touch and sag as MuJoCo does with such a spring; the rise of 0.05 s is over by then."""
    share, force = 0.4, push(1.5)
    case = stick_case(tmp_path / "c", [force])
    law = Part({}, 0, lambda: Damage(0, KS, 1e-9, lambda _: share, sags=True))
    wanted = drive(ROD, force[None], 1 / DT, parts=[law], wood=0.0, dt=5e-4).moved[0]
    broken = {"share": share, "moment_s": float(case.trajectories[0].t[0]) - 0.05, "preload": 1.0}
    ours = simulate(case, KS, DS, form="branch", without=("base_compliance",), partial_rupture=broken)[0]
    assert np.linalg.norm(wanted[-1]) > 2e-3
    np.testing.assert_allclose(ours[-1, :3], wanted[-1], atol=1e-4)


@pytest.mark.parametrize("mobility", [0.012, -0.05])
def test_grasp_slip_is_the_hidden_simulators(tmp_path, mobility):
    """Change displacement and velocity of the point that is held as MuJoCo does with a grip that slides."""
    case, force, least = stick_case(tmp_path / "c", [push(1.5)]), push(1.5), 1.0
    law = Part({}, law=lambda: Slip(mobility, least, 1e-6, (0.4, 0.1)))
    wanted, held = (drive(ROD, force[None], 1 / DT, parts=parts, wood=0.0, dt=5e-4) for parts in ([law], []))
    slips = {"mobility_mpNs": mobility, "least_N": least}
    ours, plain = (simulate(case, KS, DS, form="branch", without=("base_compliance",), **on)[0]
                   for on in ({"grasp_slip": slips}, {}))  # fmt: skip
    close((ours - plain)[:, :3], (wanted.moved - held.moved)[0])
    close((ours - plain)[:, 3:], (wanted.velocity - held.velocity)[0])
    np.testing.assert_allclose(ours[-1, :3], wanted.moved[0, -1], atol=1e-5)  # at rest: the slide alone


def test_a_trunk_stiffer_in_one_plane_is_a_joint_that_is(tmp_path):
    """Rest where a root of the moments puts a stick on a trunk 0.6 m below with a matrix spring, its own joint stiff.

    What the stick's own spring of 2e4 N m/rad gives way by is force, lever and lever over it: 0.2 mm.
    """
    stiff, compliance, relative, angle = 2e4, 0.02, 1.5, 0.6
    case = stick_case(tmp_path / "c", [held()])
    axis = np.array([np.cos(angle), np.sin(angle), 0.0])
    matrix = (np.eye(3) + relative * np.outer(axis, axis)) / compliance
    ends = {}
    for name, more in (("plain", 0.0), ("stiffer", relative)):
        rollout = Rollout(case, recordings(case), 1, unknowns=Unknowns(effects=(Acting("base_compliance"),)))
        rollout._output.torch.fill_(torch.nan)
        values = [stiff, 40.0, compliance, 0.1, 0.05, 1.0, more, angle, 0.0, 0.02]
        ends[name] = rollout(torch.tensor([values], dtype=torch.float64))[0, 0, -1, :3].double().numpy()
    wanted = on_trunk(case, matrix, FORCE)
    assert np.linalg.norm(ends["stiffer"] - ends["plain"]) > 0.1 * np.linalg.norm(ends["plain"])
    np.testing.assert_allclose(ends["stiffer"], wanted, atol=3e-4)


def on_trunk(case, matrix, force, below=0.6, held_at=0.4):
    """Return where a stick that is stiff at its base ends under a force, on a spring [3, 3] ``below`` the base [m]."""
    axis = case.axis[0]
    a, b = case.radius[0]
    com = axis * case.length[0] * (a * a + 2 * a * b + 3 * b * b) / (4 * (a * a + a * b + b * b))
    up = np.array([0.0, 0.0, below])
    weight = np.array([0.0, 0.0, -case.gravity * case.mass[0]])
    preload = -np.cross(up + com, weight)

    def moment(phi):
        turn = Rotation.from_rotvec(phi)
        own = turn.apply(held_torque(preload, phi) - matrix @ phi)
        return own + np.cross(turn.apply(up + com), weight) + np.cross(turn.apply(up + held_at * axis), force)

    turn = Rotation.from_rotvec(root(moment, np.zeros(3), tol=1e-13).x)
    point = up + held_at * axis
    return turn.apply(point) - point


@pytest.mark.parametrize("form", ["branch", "joint"])
def test_a_replay_does_not_remember_the_one_before(tmp_path, form):
    """Replay with memories, rates, poses and guards left as a world that blew up leaves them: the same bits."""
    case = stick_case(tmp_path / "c", [push()]) if form == "branch" else swing_case(tmp_path / "c", [(0.3, 0.0)])
    rollout = Rollout(case, recordings(case), 1, unknowns=Unknowns(effects=(Acting("hysteresis_boucwen", 0),)))
    values = torch.tensor(
        [[KS, DS, 0.6, 0.06, 1.4, 0.7, 0.6, 1.0, 0.5, 0.4, 0.02][: len(rollout.system.parameters)]], dtype=torch.float64
    )
    first = rollout(values).clone()
    for name in ("memory", "effort", "hold", "before", "gain", "ahead"):
        rollout.effects.arrays[name].torch.fill_(torch.nan)
    for array in (rollout.simulator.state.coordinate, rollout.simulator.state.velocity):
        array.torch.fill_(torch.nan)
    rollout.simulator.state.alive.torch.zero_()
    assert first.abs().max() > 1e-3
    assert torch.equal(rollout(values), first)


# ---- recovery ------------------------------------------------------------------------------------------------------

BRANCH_TRUTH = {
    "cubic_stiffness": (6.0, 0.5, 0.3),
    "dry_friction": (0.25, 0.004, 0.4, 0.5, 0.8, 0.5, 0.1),
    "hysteresis_boucwen": (0.6, 0.06, 1.4, 0.7, 0.6, 1.0, 0.5, 0.4, 0.02),
    "quadratic_drag": (25.0, 0.4, 0.3, 0.6, 0.2),
    "viscoelastic_sls": (0.5, 0.3, 0.4, 0.04, 0.5),
    "tip_mass": (0.2, 0.05, -0.03, 0.4),
    "base_compliance": (0.02, 0.1, 0.02, 0.3, 1.2, 0.7, 4e-3, 0.03),
    "backlash": (0.03, 0.5, 0.1, 0.3, 1.0, 0.7, 0.4, 0.2),
    "plastic_set": (0.4, 0.1, 0.6, 0.5, 0.1),
    "partial_rupture": (0.4, 0.3, 0.5, 0.2, 0.03, 0.05),
    "grasp_slip": (-0.05, 0.5, 0.2, 1.0, 0.3, 0.7, 100.0, 0.6, -1e9, 0.0),
    "force_bias": (0.2, -0.3, 0.25, 0.5, 0.4, 0.5),
    "force_scale": (1.3, 1.2, 0.9, 0.4, 9.0, 0.05),
    "time_delay": (0.03, 0.04),
    "steady_wind": (30.0, -40.0, 20.0, 0.4, 0.1, 0.3, 0.6, 20.7, 0.4),
    "wind_gust": (20.0, -15.0, 10.0, 12.0, 0.9, 0.4, 0.7, 0.1, 0.3, 0.0),
    "gravity_comp_error": (0.15, 0.6, 0.1, -0.1, 0.2),
    "anisotropic_stiffness": (0.8, 0.7, 0.3),
    "bilinear_stiffness": (-0.5, 1.2, 0.02, 0.03, 0.4),
    "bending_torsion_coupling": (0.4, 0.9, 1.0),
}
FIXED_AT_TRUTH = {
    "force_bias": ("opened", "moment_s"),  # nothing is read of an open gripper; a jump, see test_effects
    "plastic_set": ("separate",),
    "hysteresis_boucwen": ("twist",),  # a stick that is pulled in its axis does not twist
    "backlash": ("twist",),
    "grasp_slip": ("viscous", "most_m", "moment_s", "zeroed"),  # jumps, for which see test_grasp_slip
    "quadratic_drag": ("across", "crown"),  # a stick on a ball joint moves across itself alone, as its tip does
    "gravity_comp_error": ("tared", "ahead_N", "across_N"),  # without directions nothing turns
    "wind_gust": ("frequency_Hz", "across", "crown", "rms_Pa"),  # no course was read off
    "steady_wind": ("across", "crown", "moment_s", "takes_s"),  # a kink in time, for which see test_drag
    "partial_rupture": ("moment_s",),
    "viscoelastic_sls": ("kept",),  # nothing of it is left after 20 s
}


def switched_off(name):
    """Return every other effect, known to be off: one kernel does for all tests but the trunk's."""
    others = () if name == "base_compliance" else [e for e in effects() if e.name in {*BRANCH_TRUTH} - {name}]
    return [Acting(e.name, 0 if e.branch.per_joint else None, {p.name: p.neutral for p in e.branch.parameters})
            for e in others if e.name != "base_compliance"]  # fmt: skip


def test_every_effect_is_recovered_below():
    """Leave no effect of the format's list without a truth to recover."""
    assert {e.name for e in effects() if e.branch is not None} >= set(BRANCH_TRUTH)
    assert len(BRANCH_TRUTH) == 20


@pytest.fixture(scope="module")
def stick(tmp_path_factory):
    """Probe a stick twice, in opposite directions, with open rows at both ends."""
    open_ends = [(0.0, 0.08), (1.04, (N - 1) * DT)]
    case = stick_case(tmp_path_factory.mktemp("stick"), [push(2.0), push(-1.5)[:, [1, 0, 2]]], opened=open_ends)
    moved = tuple(replace(t, displacement=t.displacement + 0.2 * np.eye(3)[0], velocity=t.velocity + 1.0)
                  for t in case.trajectories)  # fmt: skip
    return replace(case, trajectories=moved)  # priors are scaled by what was measured: 0.2 m, 1.7 m/s


@pytest.mark.parametrize("name", sorted(BRANCH_TRUTH))
def test_truth_is_recovered(stick, name):
    """Find spring, damper and effect by Levenberg-Marquardt from a third off, from exact motion."""
    truth = dict(zip([p.name for p in next(e for e in effects() if e.name == name).branch.parameters],
                     BRANCH_TRUTH[name], strict=True))  # fmt: skip
    row = next(e for e in effects() if e.name == name)
    known = {p: truth[p] for p in FIXED_AT_TRUTH.get(name, ())}
    unknowns = Unknowns(effects=(*switched_off(name), Acting(name, 0 if row.branch.per_joint else None, known)))
    values = torch.tensor([[KS, DS, *(v for p, v in truth.items() if p not in known)]], dtype=torch.float64)
    motion = Rollout(stick, recordings(stick), 1, unknowns=unknowns)(values)[0].double().numpy()
    chosen = [replace(r, output=m) for r, m in zip(recordings(stick), motion, strict=True)]
    target = Target(stick, chosen, torch.tensor([1e-4] * 3 + [1e-3] * 3), unknowns=unknowns)
    parameters = target.system.parameters
    free = free_of(parameters, values)
    log = torch.tensor([p.scale == "log" for p in parameters])
    size = torch.where(log, 0.3, 0.12 * torch.tensor([p.high - p.low for p in parameters]).clamp(max=4 * values.abs()))
    signs = torch.tensor([[1.0, -1, 1, -1, 1, 1, 1, 1, 1, -1], [-1.0, -1, -1, 1, 1, -1, 1, -1, 1, 1]])
    starts = torch.cat([free + size * signs[:, : len(parameters)], target.log_noise0.expand(2, -1)], 1)
    modes = find_modes(target, starts)
    best = modes.theta[modes.log_posterior.argmax(), : len(parameters)]
    if name == "steady_wind":  # along the only segment it acts as a thousandth of the spring, below single precision
        axis = torch.as_tensor(stick.axis[0])
        best[2:5] += axis * (axis @ (free[0, 2:5] - best[2:5]))
    # exact data: what is left is the noise assumed, four standard deviations of it
    spread = torch.linalg.inv(modes.precision[modes.log_posterior.argmax()]).diagonal().sqrt()[: len(parameters)]
    assert ((best - free[0]).abs() < 4 * spread + 0.02 * torch.where(log, 1.0, free[0].abs())).all(), list(
        zip([p.name for p in parameters], best.tolist(), free[0].tolist(), spread.tolist(), strict=True)
    )
    assert spread[2] < torch.where(log[2], 0.3, 0.3 * free[0, 2].abs())  # the data does tell


def test_faulty_effects_are_one_line(stick, tmp_path):
    """Refuse what cannot act, naming it and what is allowed."""
    for acting, words in (
        ([Acting("friction", 0)], "'friction'; allowed: one of cubic_stiffness"),
        ([Acting("dry_friction")], "joint None; allowed: a joint, 0 to 0"),
        ([Acting("dry_friction", 1)], "joint 1; allowed: a joint, 0 to 0"),
        ([Acting("tip_mass", 0)], "joint 0; allowed: no joint"),
        ([Acting("dry_friction", 0)] * 2, "a second time"),
        ([Acting("dry_friction", 0, {"torque": 1.0})], "'torque'; allowed: one of torque_Nm"),
        ([Acting("dry_friction", 0, {"torque_Nm": np.nan})], "a finite number"),
    ):
        with pytest.raises(InputError) as e:
            Rollout(stick, recordings(stick), 1, unknowns=Unknowns(effects=tuple(acting)))
        assert words in str(e.value) and "\n" not in str(e.value)
    hinge = swing_case(tmp_path / "swing", [(0.1, 0.0)])
    with pytest.raises(InputError, match="an effect that a joint case cannot have"):
        Rollout(hinge, recordings(hinge), 1, unknowns=Unknowns(effects=(Acting("tip_mass"),)))


@pytest.mark.parametrize(("stribeck", "load"), [(0.0, 0.0), (0.8, 0.0), (-0.6, 0.0), (0.0, 0.2)])
def test_torque_fit_takes_effects(tmp_path, stribeck, load):
    """Need T more at one joint, less as it turns back, and c v |v| at the other; refuse what is not at a joint.

    T grows with what the joint needs besides.
    Near rest T is larger by the share exp(-(w / v)^2) or smaller by exp(-|w| / v), within 0.012 of these.
    """
    case = load_case(write_arm(tmp_path / "arm", unknown=["damping"], seeds=(0,)))
    chosen = torque_recordings(case)
    own = {"bend_rad": 5e-4, "gradual": 0.0, "stribeck": stribeck, "stribeck_radps": 0.4, "load": load}
    acting = (Acting("dry_friction", 1, own), Acting("quadratic_drag", 0))
    values = torch.tensor([[0.1, 0.2, 0.7, 0.3]])
    plain = EquationError(case, chosen, 1)(values[:, :2])[0, 0].double().numpy().copy()
    rollout = EquationError(case, chosen, 1, unknowns=Unknowns(effects=acting))
    assert [p.name for p in rollout.system.parameters[2:]] == ["dry_friction@1 torque_Nm",
                                                             "quadratic_drag@0 coefficient_Nms2"]  # fmt: skip
    rollout._output.torch.fill_(torch.nan)
    extra = rollout(values)[0, 0].double().numpy() - plain
    rate = chosen[0].input[:, [1, 4]]
    np.testing.assert_allclose(extra[:, 0], 0.3 * rate[:, 0] * np.abs(rate[:, 0]), atol=2e-5)
    bent, friction = 0.0, []
    near = np.exp(-((np.abs(rate[:, 1]) / 0.4) ** (2.0 if stribeck > 0.0 else 1.0)))
    creeping = min(stribeck, 0.0) * (1 - near)  # what is missing at rest is a damper, which does not bend
    turns = rate[:, 1] * float(chosen[0].t[1] - chosen[0].t[0])
    size = 0.7 + load * np.abs(plain[:, 1])
    for turn, here, more in zip(turns, near, creeping, strict=True):
        bent = np.clip(bent + turn, -5e-4, 5e-4)  # [rad]: it bends before it slips
        sticks = (1 + max(stribeck, 0.0) * here + min(stribeck, 0.0)) * np.clip(bent + turn, -5e-4, 5e-4) / 5e-4
        friction.append(sticks - more * np.sign(turn))  # at the end of the step
    bound = 2e-5 + 0.013 * 0.7 * abs(stribeck)
    np.testing.assert_allclose(extra[:, 1], size * friction, atol=bound)
    fast = np.abs(turns) > 5e-4  # even where it turns back it slips by the end of the next sample
    level = size[fast] * np.sign(turns[fast]) * (1 + stribeck * near[fast])
    np.testing.assert_allclose(extra[fast, 1], level, atol=bound)
    assert fast.mean() > 0.5
    assert np.abs(extra).max(axis=0).min() > 0.1
    with pytest.raises(InputError, match="force_scale in a torque fit"):
        EquationError(case, chosen, 1, unknowns=Unknowns(effects=(Acting("force_scale", 0),)))


def test_units_of_a_slide_are_its_own():
    """Give a slide's effects metres and newtons where a hinge has radians and newton metres."""
    turns, slides = False, True
    known = {"N m": "N", "rad": "m", "1/rad^2": "1/m^2", "N m s^2/rad^2": "N s^2/m^2", "s": "s", "1": "1"}
    for unit, slid in known.items():
        assert (unit_at(unit, turns), unit_at(unit, slides)) == (unit, slid)
    assert (unit_at("N m or N", turns), unit_at("N m or N", slides)) == ("N m", "N")
    known = {p.unit for e in effects() if e.joint for p in e.joint.parameters}
    assert not [u for u in known if "rad" in unit_at(u, slides) or "N m" in unit_at(u, slides)]
