"""A Newton solver with bough's kernels: against bough's own simulator, C MuJoCo and conservation of energy."""

from __future__ import annotations

import mujoco
import newton
import numpy as np
import pytest
import warp as wp
from bough.sim.base.errors import InputError
from bough.sim.engine.model import Model
from bough.sim.engine.simulator import Simulator
from bough.sim.newton.bridge import from_newton, to_newton
from bough.sim.newton.layout import (
    coordinates_from_newton,
    coordinates_to_newton,
    read_layout,
    velocities_from_newton,
    velocities_to_newton,
)
from bough.sim.newton.solver import BoughSolver
from bough.sim.trees.tree import Joint
from oracles.random_tree import random_qpos, random_tree
from scipy.spatial.transform import Rotation

ALL = (Joint.SPHERICAL, Joint.REVOLUTE, Joint.PRISMATIC, Joint.FIXED)
DT = 1.0 / 240.0
LENGTH, RADIUS, MASS = 0.3, 0.02, 0.4
INERTIA = (0.0032, 0.0035, 0.0004)


def _forest(seed, count):
    rng = np.random.default_rng(seed)
    sizes = rng.integers(1, 9, count)
    return [random_tree(rng, n, joints=ALL, armature=0.1, bent_rest=True, preloaded=True) for n in sizes]


def _start(model, joint_q, joint_qd):
    state = model.state()
    state.joint_q.assign(joint_q.astype(np.float32))
    state.joint_qd.assign(joint_qd.astype(np.float32))
    newton.eval_fk(model, state.joint_q, state.joint_qd, state)
    return state


def _steps(solver, state, count, control=None):
    other = solver.model.state()
    for _ in range(count):
        other.body_f.assign(state.body_f)
        solver.step(state, other, control, None, DT)
        state, other = other, state
    return state


# ---- against bough's own simulator -------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [3, 6], ids=["one world a thread", "lanes"])
def test_steps_are_the_simulators(count):
    """Step a forest of all joint kinds for a quarter of a second: the simulator's own motion, to float32."""
    model = to_newton(_forest(count, count), device="cpu")
    trees, layout = from_newton(model), read_layout(model)
    rng = np.random.default_rng(1)
    qpos = [random_qpos(rng, t, 0.3) for t in trees]
    qvel = [rng.normal(size=t.num_dofs) for t in trees]
    joint_q, joint_qd = coordinates_to_newton(layout, qpos), velocities_to_newton(layout, qpos, qvel)
    simulator = Simulator(Model(trees, device="cpu"), dt=DT)
    simulator.state.set_qpos(qpos)
    simulator.state.set_qvel(qvel)
    simulator.refresh()
    model.joint_q.assign(joint_q.astype(np.float32))
    solver = BoughSolver(model, dt=DT)
    assert solver.simulator.model.width == (1 if count < 4 else 8)
    state = _steps(solver, _start(model, joint_q, joint_qd), 60)
    simulator.step(60)
    # each step rounds coordinates twice more than the simulator does; stiff joints (300 N m/rad on 0.001 kg m^2)
    # make that some 1e-5 rad/s
    got = coordinates_from_newton(layout, state.joint_q.numpy())
    for a, b in zip(got, simulator.state.qpos(), strict=True):
        np.testing.assert_allclose(a, b, atol=2e-5)
    rates = velocities_from_newton(layout, state.joint_q.numpy(), state.joint_qd.numpy())
    for a, b in zip(rates, simulator.state.qvel(), strict=True):
        np.testing.assert_allclose(a, b, atol=2e-3)
    position, _ = simulator.observe()
    for world, seen in zip(layout, position.numpy(), strict=True):
        np.testing.assert_allclose(state.body_q.numpy()[world.body, :3], seen[: len(world.body)], atol=2e-5)


# ---- a Newton user's own model, against C MuJoCo -----------------------------------------------------------------


PARENT_TURN = Rotation.from_euler("xyz", [0.5, -0.3, 0.2])
CHILD_TURN = Rotation.from_euler("xyz", [-0.4, 0.1, 0.7])
CHILD_ORIGIN = np.array([0.01, -0.02, 0.015])


def _newton_chain(links, *, stiffness, damping, worlds=1):
    """Build a chain of links along x: ball joints and, every third, a hinge, with joint frames turned on both sides."""
    chain = newton.ModelBuilder(up_axis=newton.Axis.Z)
    joints, parent = [], -1
    for i in range(links):
        body = chain.add_link(mass=MASS, com=wp.vec3(LENGTH / 2, 0.0, 0.0), inertia=wp.mat33(np.diag(INERTIA)))
        place = {
            "parent": parent,
            "child": body,
            "parent_xform": wp.transform(
                wp.vec3(LENGTH * (i > 0), 0.0, 1.0 * (i == 0)), wp.quat(*PARENT_TURN.as_quat())
            ),
            "child_xform": wp.transform(wp.vec3(*CHILD_ORIGIN), wp.quat(*CHILD_TURN.as_quat())),
            "stiffness": stiffness,
            "damping": damping,
        }
        hinge = i % 3 == 2
        joints.append(
            chain.add_joint_revolute(axis=wp.vec3(0.0, 0.6, 0.8), **place) if hinge else chain.add_joint_ball(**place)
        )
        chain.add_shape_capsule(
            body, radius=RADIUS, half_height=LENGTH / 2, cfg=newton.ModelBuilder.ShapeConfig(density=0)
        )
        parent = body
    chain.add_articulation(joints)
    scene = newton.ModelBuilder(up_axis=newton.Axis.Z)
    scene.replicate(chain, worlds)
    return scene.finalize(device="cpu")


def _mujoco_chain(links, *, stiffness, damping):
    """Build the same chain for MuJoCo: a body's frame at rest is X_p X_c^-1, its joint sits at the origin of X_c."""
    turn = PARENT_TURN * CHILD_TURN.inv()
    axis = CHILD_TURN.apply([0.0, 0.6, 0.8])
    xml, end = "", ""
    for i in range(links):
        pos = np.array([LENGTH * (i > 0), 0.0, 1.0 * (i == 0)]) - turn.apply(CHILD_ORIGIN)
        kind = f'type="hinge" axis="{_text(axis)}"' if i % 3 == 2 else 'type="ball"'
        xml += f'<body pos="{_text(pos)}" quat="{_text(np.roll(turn.as_quat(), 1))}">'
        xml += f'<inertial pos="{LENGTH / 2} 0 0" mass="{MASS}" diaginertia="{_text(INERTIA)}"/>'
        xml += f'<joint {kind} pos="{_text(CHILD_ORIGIN)}" stiffness="{stiffness}" damping="{damping}"/>'
        end += "</body>"
    option = f'<option timestep="{DT}" integrator="implicitfast"/>'
    return mujoco.MjModel.from_xml_string(f"<mujoco>{option}<worldbody>{xml}{end}</worldbody></mujoco>")


def _text(values):
    return " ".join(f"{x:.12g}" for x in values)


def _push(model, data, wrench, joint_f):
    """Apply Newton's wrenches [bodies, 6] and joint forces to MuJoCo's bodies and joints, at the present pose.

    Newton's ball torques are along the axes of X_p, MuJoCo's along the child's own.
    """
    data.xfrc_applied[1:] = wrench
    start = 0
    for i in range(model.nbody - 1):
        own = joint_f[start : start + (1 if i % 3 == 2 else 3)]
        if len(own) == 3:
            above, below = (Rotation.from_quat(np.roll(data.xquat[b], -1)) for b in (i, i + 1))
            own = below.inv().apply((above * PARENT_TURN).apply(own))
        data.qfrc_applied[start : start + len(own)] = own
        start += len(own)


@pytest.mark.parametrize("pushed", [False, True], ids=["free", "under wrenches and joint forces"])
def test_a_users_chain_moves_as_in_mujoco(pushed):
    """Step a chain made with ModelBuilder beside C MuJoCo's: poses and velocities of all bodies after a second."""
    links = 5
    model = _newton_chain(links, stiffness=4.0, damping=0.02)
    reference = _mujoco_chain(links, stiffness=4.0, damping=0.02)
    rng = np.random.default_rng(2)
    wrench = (rng.normal(size=(links, 6)) * [2, 2, 2, 0.2, 0.2, 0.2]).astype(np.float32) * pushed
    joint_f = rng.normal(size=model.joint_dof_count).astype(np.float32) * 0.1 * pushed
    state, control = model.state(), model.control()
    state.body_f.assign(wrench)
    control.joint_f.assign(joint_f)
    state = _steps(BoughSolver(model), state, 240, control)
    data = mujoco.MjData(reference)
    for _ in range(240):
        mujoco.mj_forward(reference, data)
        _push(reference, data, wrench, joint_f)
        mujoco.mj_step(reference, data)
    mujoco.mj_forward(reference, data)
    # the same scheme in float32 and float64: rounding grows to 1e-4 over a second of swinging
    np.testing.assert_allclose(state.body_q.numpy()[:, :3], data.xpos[1:], atol=2e-4)
    for body, got in enumerate(state.body_qd.numpy()):
        spatial = np.zeros(6)
        mujoco.mj_objectVelocity(reference, data, mujoco.mjtObj.mjOBJ_BODY, body + 1, spatial, 0)
        np.testing.assert_allclose(got, np.r_[spatial[3:], spatial[:3]], atol=4e-3)


def _energy(model, state):
    """Kinetic and gravitational energy [J] of Newton's bodies, from their own poses and velocities."""
    q, qd = state.body_q.numpy().astype(float), state.body_qd.numpy().astype(float)
    turn = Rotation.from_quat(q[:, 3:])
    centre = q[:, :3] + turn.apply(model.body_com.numpy())
    spin = turn.inv().apply(qd[:, 3:])
    kinetic = 0.5 * MASS * (qd[:, :3] ** 2).sum() + 0.5 * (spin**2 * INERTIA).sum()
    return kinetic + 9.81 * MASS * centre[:, 2].sum()


def test_undamped_chain_holds_its_energy_to_first_order():
    """Let an undamped, unsprung chain fall for half a second: energy drifts in proportion to the step."""
    model, drift = _newton_chain(3, stiffness=0.0, damping=0.0), []
    for count in (120, 240, 480):
        solver, state = BoughSolver(model, dt=0.5 / count), model.state()
        newton.eval_fk(model, state.joint_q, state.joint_qd, state)
        before = _energy(model, state)
        for _ in range(count):
            solver.step(state, state, None, None, 0.5 / count)
        drift.append(abs(_energy(model, state) - before))
    # the chain turns about 3 J over; a first-order step halves its error with the step
    assert drift[0] < 0.3
    assert 1.6 < drift[0] / drift[1] < 2.5
    assert 1.6 < drift[1] / drift[2] < 2.5


def test_substeps_are_shorter_steps():
    """Take one step in four parts: as four steps of a quarter, to float32."""
    model = _newton_chain(4, stiffness=4.0, damping=0.02)
    once, often = BoughSolver(model, dt=DT, substeps=4), BoughSolver(model, dt=DT / 4)
    a, b = model.state(), model.state()
    for _ in range(20):
        once.step(a, a, None, None, DT)
        for _ in range(4):
            often.step(b, b, None, None, DT / 4)
    np.testing.assert_allclose(a.joint_q.numpy(), b.joint_q.numpy(), atol=2e-6)
    np.testing.assert_allclose(a.joint_qd.numpy(), b.joint_qd.numpy(), atol=1e-4)


# ---- the rest of Newton's interface ------------------------------------------------------------------------------


def test_another_dt_is_taken_as_it_is():
    """Step with a dt the solver was not made for: the bits of a solver that was."""
    model = _newton_chain(3, stiffness=4.0, damping=0.02)
    states = []
    for made_for in (0.01, DT):
        solver, state = BoughSolver(model, dt=made_for), model.state()
        solver.step(state, state, None, None, DT)
        states.append(state.joint_qd.numpy())
    np.testing.assert_array_equal(*states)


def test_changes_count_once_notified():
    """Stiffen the springs: nothing until the solver is notified, then the bits of a new solver."""
    model = _newton_chain(3, stiffness=4.0, damping=0.02)
    solver = BoughSolver(model)

    def after(chosen):
        state = model.state()
        state.joint_q.assign(coordinates_to_newton(read_layout(model), [_bent(model)]).astype(np.float32))
        chosen.step(state, state, None, None, DT)
        return state.joint_qd.numpy()

    soft = after(solver)
    model.joint_stiffness.assign(4.0 * model.joint_stiffness.numpy())
    np.testing.assert_array_equal(after(solver), soft)
    solver.notify_model_changed(newton.ModelFlags.SHAPE_PROPERTIES)
    np.testing.assert_array_equal(after(solver), soft)
    solver.notify_model_changed(newton.ModelFlags.JOINT_DOF_FORCE_PROPERTIES)
    stiff = after(solver)
    np.testing.assert_array_equal(stiff, after(BoughSolver(model)))
    assert np.abs(stiff - soft).max() > 1e-2


def _bent(model):
    return random_qpos(np.random.default_rng(5), from_newton(model)[0], 0.3)


def test_a_bad_world_is_frozen_alone_and_let_go_by_reset():
    """Put NaN into one of six worlds: the others keep their bits; after a reset it steps as they do."""
    model = _newton_chain(3, stiffness=4.0, damping=0.02, worlds=6)
    solver, healthy, state = BoughSolver(model), BoughSolver(model), model.state()
    good = _steps(healthy, model.state(), 10).joint_q.numpy().reshape(6, -1)
    bad = state.joint_q.numpy().reshape(6, -1)
    bad[4, 0] = np.nan
    state.joint_q.assign(bad.ravel())
    state = _steps(solver, state, 10)
    assert [world for world, _, _ in solver.simulator.state.faults()] == [4]
    others = [0, 1, 2, 3, 5]
    np.testing.assert_array_equal(state.joint_q.numpy().reshape(6, -1)[others], good[others])
    mask = wp.array(np.arange(7) == 4, dtype=wp.bool, device="cpu")
    solver.reset(state, mask)
    assert solver.simulator.state.faults() == []
    np.testing.assert_array_equal(_steps(solver, model.state(), 10).joint_q.numpy().reshape(6, -1), good)


def test_a_graph_replays_the_steps():
    """Capture two steps as a graph on the CPU: replays give the bits of the same steps."""
    model = _newton_chain(4, stiffness=4.0, damping=0.02, worlds=6)
    solver, plain = BoughSolver(model, threads=2), _steps(BoughSolver(model, threads=2), model.state(), 20)
    a, b = model.state(), model.state()
    with wp.ScopedCapture(device="cpu") as scope:
        solver.step(a, b, None, None, DT)
        solver.step(b, a, None, None, DT)
    for _ in range(10):
        wp.capture_launch(scope.graph)
    for name in ("joint_q", "joint_qd", "body_q", "body_qd"):
        np.testing.assert_array_equal(getattr(a, name).numpy(), getattr(plain, name).numpy(), err_msg=name)


def test_what_the_solver_lacks_is_refused():
    """Refuse drives and worlds with different gravity in one line that names the joint and the value."""
    model = _newton_chain(3, stiffness=4.0, damping=0.02)
    drive = model.joint_target_ke.numpy()
    drive[6] = 50.0
    model.joint_target_ke.assign(drive)
    with pytest.raises(InputError, match=r"joint \S+: found a drive, joint_target_ke 50; allowed: 0"):
        BoughSolver(model)
    model = _newton_chain(2, stiffness=4.0, damping=0.02, worlds=2)
    gravity = model.gravity.numpy()
    gravity[1] = 0.0
    model.gravity.assign(gravity)
    with pytest.raises(InputError, match="worlds with different gravity"):
        BoughSolver(model)


# ---- viewers -----------------------------------------------------------------------------------------------------


def _show(viewer, model):
    """Step a chain for a tenth of a second and show every other step."""
    solver, state = BoughSolver(model), model.state()
    viewer.set_model(model)
    for frame in range(12):
        state = _steps(solver, state, 2)
        viewer.begin_frame(frame / 120)
        viewer.log_state(state)
        viewer.end_frame()


def test_states_are_shown_by_newtons_viewers():
    """Log twelve frames to the viewer that shows nothing: it counts them."""
    viewer = newton.viewer.ViewerNull(num_frames=12)
    _show(viewer, _newton_chain(5, stiffness=4.0, damping=0.02, worlds=2))
    assert viewer.frame_count == 12
    assert not viewer.is_running()


def test_a_picture_is_rendered_without_a_screen():
    """Render frames with OpenGL and no display: the chain's capsules stand out from the background."""
    pyglet = pytest.importorskip("pyglet", reason="ViewerGL needs pyglet (pip install pyglet)")
    pyglet.options["headless"] = True
    try:
        viewer = newton.viewer.ViewerGL(width=320, height=240, headless=True)
    except Exception as error:
        pytest.skip(f"no OpenGL here: {error}")
    try:
        _show(viewer, _newton_chain(5, stiffness=4.0, damping=0.02))
        image = viewer.get_frame().numpy()
    finally:
        viewer.close()
    assert image.shape == (240, 320, 3)
    assert len(np.unique(image.reshape(-1, 3), axis=0)) > 50
