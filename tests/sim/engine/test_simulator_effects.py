"""Effects in the step of a forest: laws against closed forms, worlds on their own, resets, graphs, the command."""

import numpy as np
import pytest
import torch
from bough.cli.main import main
from bough.learn.replay.recording import recordings
from bough.learn.replay.simulated_case import Experiment, random_branch, write_simulated_case
from bough.sim.base.errors import InputError
from bough.sim.base.rotation import quat_rotate
from bough.sim.effects import effects
from bough.sim.engine import arrays
from bough.sim.engine.forest_effects import forest_laws
from bough.sim.engine.model import Model
from bough.sim.engine.simulator import Simulator
from bough.sim.formats.export_mjcf import to_mjcf
from bough.sim.formats.import_mjcf import load_mjcf
from bough.sim.trees.measured import measured_tree
from bough.sim.trees.stiffness import hold_rest_pose
from bough.sim.trees.tree import Joint, Tree
from oracles.effect_case import simulate
from oracles.random_tree import random_qpos, random_tree
from oracles.rods import AREA, BEND, LENGTH, D, H, J, K, W, forked, simulator, stick
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, root
from scipy.spatial.transform import Rotation

ALL = tuple(forest_laws())
BALLS = ("anisotropic_stiffness", "bending_torsion_coupling")  # bend about an axis across a segment: no hinge has one
HINGED = tuple(name for name in ALL if name not in BALLS)
MIXED = (Joint.SPHERICAL, Joint.REVOLUTE, Joint.PRISMATIC, Joint.FIXED)


def begin(sim: Simulator, qpos) -> Simulator:
    """Put all worlds at their start."""
    sim.state.set_qpos(qpos)
    sim.refresh()
    sim.mark_start()
    return sim


def watch(sim: Simulator, seconds: float, every: int = 10) -> tuple[np.ndarray, np.ndarray]:
    """Return times [T] and the first joint's coordinate [T, worlds] of hinges and slides."""
    steps = round(seconds / sim.dt / every)
    rows = [[q[0] for q in sim.state.qpos()]]
    for _ in range(steps):
        sim.step(every)
        rows.append([q[0] for q in sim.state.qpos()])
    return np.arange(steps + 1) * every * sim.dt, np.array(rows)


def peaks(t: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return times and values of the extrema of a sampled coordinate, by parabolas through three samples."""
    at = np.flatnonzero(np.diff(np.sign(np.diff(q)))) + 1
    a, b, c = q[at - 1], q[at], q[at + 1]
    shift = 0.5 * (a - c) / (a - 2 * b + c)
    return t[at] + shift * (t[1] - t[0]), b - 0.25 * (a - c) * shift


# ---- laws ----------------------------------------------------------------------------------------------------------


def test_dry_friction_stops_worlds_off_centre_each_at_its_place():
    """Stay at the first turn where K |q| < T, at 2 T / K - A after half a swing from A; a world without swings on."""
    torque, start = [14.0, 14.0, 14.0, 0.0], [0.4, -0.38, 0.06, 0.4]
    sim = begin(simulator([stick()] * 4, HINGED, dry_friction={"torque_Nm": torque}), [[q] for q in start])
    t, q = watch(sim, 2.5)
    for k, end in ((0, 2 * 14.0 / K - 0.4), (1, 0.38 - 2 * 14.0 / K), (2, 0.06)):
        late = q[t > (1.05 * np.pi / W if k < 2 else 0.0), k]
        # held, the joint unbends by 2 BEND at most; that way's work of the spring goes into a slide against T - K |q|
        within = 2 * BEND * 14.0 / (14.0 - K * abs(end)) + abs(start[k] - end) * W * H / 2
        np.testing.assert_allclose(late, end, atol=within)
    np.testing.assert_allclose(q[:, 3], 0.4 * np.cos(W * t), atol=0.4 * (W * H / 2 + D / (2 * J) * 2.5))


def test_dry_friction_takes_two_torques_over_the_spring_a_half_swing():
    """Lose 2 T / K of amplitude every half swing."""
    sim = begin(simulator([stick()], HINGED, dry_friction={"torque_Nm": 2.0}), [[0.5]])
    t, q = watch(sim, 3.0)
    _, tops = peaks(t, q[:, 0])
    drop = -np.diff(np.abs([0.5, *tops[np.abs(tops) > 0.15]]))
    assert len(drop) >= 5
    # a reversal turns through 2 BEND at no friction in the mean: 2 BEND of A + A' > 0.3, and the step's W H / 2
    np.testing.assert_allclose(drop, 2 * 2.0 / K, rtol=2 * BEND / 0.3 + W * H / 2)


def test_quadratic_drag_makes_one_over_amplitude_linear():
    """Decay as 1 / A = 1 / A0 + 4 C W t / (3 pi J) with C = c A L^3 / 4, of all that the rod sweeps.

    First order in C A / J (Krylov-Bogoliubov), 0.15 at the start: an integration in float64 differs by 4e-5.
    """
    c = np.array([24.0, 48.0])
    sim = begin(simulator([stick()] * 2, HINGED, quadratic_drag={"coefficient_kgpm3": c}), [[0.5]] * 2)
    t, q = watch(sim, 6.0)
    for k in range(2):
        time, tops = peaks(t, q[:, k])
        slope = np.polyfit(time, 1 / np.abs(tops), 1)[0]
        assert slope == pytest.approx(4 * c[k] * AREA * LENGTH**3 / 4 * W / (3 * np.pi * J), rel=0.02)


def test_steady_wind_bends_joints_of_every_kind():
    """Rest where K phi = q A L / 2 cos phi (ball, hinge) and K x = q A (slide), worlds with pressures of their own."""
    soft, q = 20.0, np.array([40.0, -60.0, 80.0, 0.0])
    kinds = [(Joint.SPHERICAL, (0, 1, 0)), (Joint.REVOLUTE, (0, 1, 0)), (Joint.PRISMATIC, (1, 0, 0))]
    trees = [stick(k, stiffness=soft, damping=10.0, axis=np.array(a, float)) for k, a in kinds] + [stick()]
    sim = simulator(trees, HINGED, steady_wind={"pressure_x_Pa": q})
    sim.refresh()
    sim.step(20000)  # 20 s: the slowest relaxation, D / K = 0.5 s, is down to 1e-15
    bent = [brentq(lambda p, q=q: soft * p - q * AREA * LENGTH / 2 * np.cos(p), -1.5, 1.5) for q in q[:2]]
    ball, hinge, slide, calm = sim.state.qpos()
    turn = Rotation.from_quat(np.roll(ball, -1)).as_rotvec()
    np.testing.assert_allclose(turn, [0.0, bent[0], 0.0], atol=1e-9)
    assert hinge[0] == pytest.approx(bent[1], abs=1e-9) and slide[0] == pytest.approx(q[2] * AREA / soft, abs=1e-9)
    assert calm[0] == 0.0


def test_wind_bends_a_fork():
    """Rest where the moments of the wind on a stem and its two branches balance the hinges' springs."""
    stem = stick(stiffness=60.0, damping=8.0)
    fork, length, radius = forked(0.5)
    q, area = 250.0, length * 1.5 * radius
    centre = length * (radius + radius) / (3 * 1.5 * radius)  # of a trapezium: L (a + 2 b) / (3 (a + b))

    def moments(p):
        push = q * area
        tops = [p[0], p[0] + p[1], p[0] + p[2]]
        arms = centre * np.cos(tops)
        own = push[1:] * arms[1:]
        stem = push[0] * arms[0] + (push[1:] * (LENGTH * np.cos(p[0]) + arms[1:])).sum()
        return fork.stiffness * p - np.array([stem, *own])

    rest = root(moments, np.zeros(3), tol=1e-13).x
    assert np.abs(rest).max() > 0.1
    sim = simulator([fork, stem], HINGED, steady_wind={"pressure_x_Pa": [q, 0.0]})
    sim.refresh()
    sim.step(20000)
    np.testing.assert_allclose(sim.state.qpos()[0], rest, atol=1e-9)


def test_gust_follows_each_world_s_own_clock():
    """Drive a slide by s sin + c cos of a frequency; a world that is reset feels the gust from its beginning again."""
    s, c, f = 30.0, -20.0, 1.3
    tree = stick(Joint.PRISMATIC, stiffness=30.0, damping=1.5, axis=np.array([1.0, 0.0, 0.0]))
    gust = {"sine_x_Pa": [s, s], "cosine_x_Pa": [c, c], "frequency_Hz": [f, f]}
    sim = begin(simulator([tree] * 2, HINGED, wind_gust=gust), [[0.0]] * 2)
    t, first = watch(sim, 1.7)

    def slope(time, y):
        force = AREA * (s * np.sin(2 * np.pi * f * time) + c * np.cos(2 * np.pi * f * time))
        return [y[1], force - 30.0 * y[0] - 1.5 * y[1]]

    wanted = solve_ivp(slope, (0, t[-1]), [0.0, 0.0], t_eval=t, rtol=1e-9, atol=1e-12).y[0]
    # symplectic Euler is off by h / 2 of the rate: 2 pi f h / 2 = 0.4 % of an amplitude
    np.testing.assert_allclose(first[:, 0], wanted, atol=2 * np.pi * f * H / 2 * np.abs(wanted).max())
    sim.reset(torch.tensor([False, True]))
    np.testing.assert_allclose(sim.effects.time.numpy(), [1.7, 0.0], atol=1e-12)
    _, second = watch(sim, 1.7)
    np.testing.assert_array_equal(second[:, 1], first[:, 1])
    assert np.abs(second[:, 0] - first[:, 0]).max() > 0.1 * np.abs(wanted).max()


def test_rupture_comes_at_its_moment_of_each_world():
    """Rest at M / K before the moment and at M / ((1 - s) K) after it."""
    sim = simulator([stick(damping=20.0)] * 2, HINGED, partial_rupture={"share": 0.4, "moment_s": [2.0, 5.0]})
    sim.refresh()
    sim.load.effort.torch[..., 1, 0] = 10.0
    sim.step(1950)
    np.testing.assert_allclose([q[0] for q in sim.state.qpos()], 10.0 / K, rtol=1e-3)  # exp(-1.95 s D / 2 J) = 6e-5
    sim.step(2950)
    np.testing.assert_allclose([q[0] for q in sim.state.qpos()], [10.0 / (0.6 * K), 10.0 / K], rtol=1e-3)


def test_bilinear_spring_of_a_hinge_is_about_its_own_axis():
    """Rest at M = K q + rel K ramp(q) on both sides, whatever axis across the segment is written."""
    effort = np.array([8.0, -8.0])
    law = {"relative": [1.5, 1.5], "axis_rad": [0.3, 2.0]}
    sim = simulator([stick(damping=30.0)] * 2, HINGED, bilinear_stiffness=law)
    sim.refresh()
    sim.load.effort.torch[:, 0, 1, 0] = torch.as_tensor(effort)
    sim.step(8000)

    def ramp(q):
        return (q + np.hypot(q, 0.005) - 0.005) / 2

    wanted = [brentq(lambda q, m=m: K * (q + 1.5 * ramp(q)) - m, -1, 1) for m in effort]
    np.testing.assert_allclose([q[0] for q in sim.state.qpos()], wanted, rtol=1e-6)


def square(d):
    """Return |d|^2 1 - d d^T of every row, shape [N, 3, 3]."""
    return (d * d).sum(1)[:, None, None] * np.eye(3) - d[:, :, None] * d[:, None, :]


def test_masses_at_the_ends_equal_a_heavier_tree():
    """Move as the plain step does with every mass in its link's own, the pre-loads holding both, in a mixed tree."""
    rng = np.random.default_rng(5)
    grown = random_tree(rng, 9, joints=MIXED[:3], stiffness=(20.0, 200.0), damping_ratio=(0.3, 1.0))
    extra = rng.uniform(0.05, 0.3, 9) * (np.arange(9) != 4)
    ours, aside = simulator([hold_rest_pose(grown)], ALL, gravity=9.81), rng.uniform(-0.1, 0.1, (9, 3)) * [1, 1, 0]
    spread = rng.uniform(0.0, 1.0, 9) * (np.arange(9) % 2)
    end = grown.shape_end[np.argsort(grown.shape_link)]
    rod = spread[:, None] * (end - grown.anchor)  # the part of the way from the joint to the end
    end = end - rod / 2 + quat_rotate(ours.model.links.frame, aside)
    mass = grown.mass + extra
    centre = (grown.mass[:, None] * grown.com + extra[:, None] * end) / mass[:, None]
    inertia = grown.inertia.copy()
    for m, p in ((grown.mass, grown.com), (extra, end)):
        d = p - centre
        inertia += m[:, None, None] * square(d)
    inertia += extra[:, None, None] / 12 * square(rod)
    heavy = hold_rest_pose(grown.with_(mass=mass, com=centre, inertia=inertia))
    start, plain = [random_qpos(rng, grown, 0.2)], simulator([heavy], (), gravity=9.81)
    for name, given in (("mass_kg", extra), ("aside_x_m", aside[:, 0]), ("aside_y_m", aside[:, 1]),
                        ("spread", spread)):  # fmt: skip
        ours.effects["tip_mass"][name].copy_(torch.as_tensor(given)[None])
    for sim in (plain, ours):
        begin(sim, start)
        assert sim.implicit_worlds() == 0
        sim.step(500)
    assert np.abs(plain.state.qpos()[0] - start[0]).max() > 0.05
    np.testing.assert_allclose(ours.state.qpos()[0], plain.state.qpos()[0], atol=1e-9)  # rounding, 500 steps


def pushed(case, stiffness, damping, on, parts) -> np.ndarray:
    """Step a measured branch with effects through its first recording, ``parts`` steps a sample; its displacement."""
    (recorded, *_), tree = recordings(case), measured_tree(case, stiffness, damping)
    sim = simulator([tree], tuple(on), dt=case.dt / parts, gravity=case.gravity)
    for name, given in on.items():
        for parameter, value in given.items():
            tensor = sim.effects[name][parameter]
            tensor[(0, -1 if name == "tip_mass" else 0) if tensor.ndim == 2 else 0] = value
    sim.refresh()
    link, point = recorded.grasp
    place = int(sim.model.link_place[link])
    sim.load.point.torch[0, 0, place] = torch.as_tensor(sim.model.links.in_link_frame(link, point))
    probe = sim.probes([[(link, point)]])
    start, out = probe.read()[0][0, 0].clone(), [np.zeros(3)]
    for a, b in zip(recorded.input, recorded.input[1:], strict=False):
        for step in range(parts):
            share = (step + 0.5) / parts
            sim.load.force.torch[0, 0, place] = torch.as_tensor(a * (1 - share) + b * share)
            sim.step()
        out.append((probe.read()[0][0, 0] - start).numpy().copy())
    return np.array(out)


def test_a_chain_moves_as_in_the_replay_of_a_case(tmp_path):
    """Push a measured branch of three segments with six effects at once: shorter steps go to the replay's displacement.

    A simulator's step is of first order: its error halves with it, so that twice the finer motion less the coarser one
    is without it. A replay steps from sample to sample, 2.5 ms: friction, which sets in between steps, leaves an error
    of first order: 0.1 % of the motion, and 0.26 % in the 5 ms that it steps where samples are further apart.
    """
    rng = np.random.default_rng(3)
    stiffness, damping = np.array([60.0, 25.0, 8.0]), np.array([0.6, 0.3, 0.1])
    truth, still = {"stiffness": stiffness, "damping": damping}, Experiment(880, 400.0, noise=0.0)
    case = write_simulated_case(tmp_path / "case", random_branch(rng, 3), truth, still, trajectories=1, seed=4)
    on = {"dry_friction": {"torque_Nm": 0.06}, "cubic_stiffness": {"cubic_radm2": 2.0},
          "viscoelastic_sls": {"share": 0.4, "relaxation_s": 0.3}, "quadratic_drag": {"coefficient_kgpm3": 4.0},
          "tip_mass": {"mass_kg": 0.05, "aside_x_m": 0.04, "aside_y_m": -0.03, "spread": 0.6},
          "anisotropic_stiffness": {"relative": 0.5, "axis_rad": 0.4}}  # fmt: skip
    without = tuple(e.name for e in effects() if e.name not in on)
    replay = simulate(case, stiffness, damping, form="branch", without=without, chosen=recordings(case), **on)
    coarse, fine = (pushed(case, stiffness, damping, on, parts) for parts in (1, 2))
    assert case.dt == pytest.approx(2.5e-3)
    size = np.abs(fine).max()
    assert size > 0.02
    seen, limit = replay[0, :, :3], 2.0 * fine - coarse
    np.testing.assert_allclose(limit, seen, atol=2e-3 * size)
    assert np.abs(coarse - seen).max() > 3.0 * np.abs(limit - seen).max()


# ---- worlds on their own -------------------------------------------------------------------------------------------


def forest(count=9, seed=3, joints=MIXED) -> tuple[list[Tree], list[np.ndarray]]:
    """Make different trees and bent starts."""
    rng = np.random.default_rng(seed)
    trees = [random_tree(rng, int(n), joints=joints, bent_rest=True, preloaded=True, damping_ratio=(0.3, 2.0))
             for n in rng.integers(2, 12, count)]  # fmt: skip
    return trees, [random_qpos(rng, t, 0.3) for t in trees]


#: A box for every parameter, wide enough to be felt, that trees of twigs bear.
BOX = {
    "cubic_radm2": (0.5, 2.0), "relative": (-0.3, 0.5), "axis_rad": (0.0, 3.0), "torque_Nm": (0.01, 0.1),
    "share": (0.1, 0.3), "yield_rad": (0.02, 0.1), "coefficient_kgpm3": (0.5, 2.0), "relaxation_s": (0.1, 1.0),
    "mass_kg": (0.001, 0.02), "gap_rad": (0.001, 0.01), "moment_s": (0.0, 0.2), "coupling": (-0.3, 0.3),
    "frequency_Hz": (0.5, 3.0), "exponent": (1.0, 2.0),
}  # fmt: skip


def randomise(sim: Simulator, worlds=slice(None), seed=0) -> None:
    """Write random values of all parameters into some worlds, as `docs/effects.md` does."""
    generator = torch.Generator().manual_seed(seed)
    for parameters in sim.effects.values():
        for name, tensor in parameters.items():
            low, high = BOX.get(name, (-5.0, 5.0) if name.endswith("_Pa") else (0.0, 1.0))
            drawn = torch.empty(tensor.shape, dtype=tensor.dtype).uniform_(low, high, generator=generator)
            tensor[worlds] = drawn[worlds]


def motion(sim: Simulator, world: int) -> np.ndarray:
    """Return the coordinates and velocities of a world, one vector."""
    return np.concatenate([sim.state.qpos()[world], sim.state.qvel()[world]])


@pytest.mark.parametrize(("width", "precision"), [(1, 64), (8, 32)])
def test_neutral_effects_keep_the_plain_step_s_bits(width, precision):
    """Step all effects at their neutral values under a load, beside a world that has all of them: the plain bits."""
    trees, starts = forest()
    plain = begin(simulator(trees, (), gravity=9.81, width=width, precision=precision, dt=1 / 240), starts)
    ours = begin(simulator(trees, ALL, gravity=9.81, width=width, precision=precision, dt=1 / 240), starts)
    randomise(ours, 4)
    for sim in (plain, ours):
        sim.load.force.torch[..., 1:, :] = torch.tensor([0.1, -0.2, 0.3]).to(sim.load.force.torch)
        sim.step(100)
    assert ours.state.faults() == []
    for w in range(len(trees)):
        assert np.array_equal(motion(ours, w), motion(plain, w)) == (w != 4), w


@pytest.mark.parametrize("width", [8, 16])
def test_worlds_with_values_of_their_own_keep_their_bits(width):
    """Step trees with random values of all effects in lanes: every world has the bits that it has alone."""
    trees, starts = forest()
    sim = begin(simulator(trees, ALL, gravity=9.81, precision=32, width=width, dt=1 / 240), starts)
    randomise(sim)
    sim.step(60)
    assert sim.state.faults() == []
    for w, tree in enumerate(trees):
        if not (tree.joint == Joint.SPHERICAL).any():
            continue
        alone = begin(simulator([tree], ALL, gravity=9.81, precision=32, width=1, dt=1 / 240), [starts[w]])
        for name, parameters in alone.effects.items():
            for parameter, tensor in parameters.items():
                given = sim.effects[name][parameter][w : w + 1]
                tensor.copy_(given[:, : tree.num_links] if tensor.ndim == 2 else given)
        alone.step(60)
        np.testing.assert_array_equal(motion(sim, w), motion(alone, 0))


@pytest.mark.parametrize("width", [1, 8])
def test_memory_order_of_a_gpu_gives_the_same_bits(monkeypatch, width):
    """Lay values and all else out link by link, as on a GPU: the motion keeps its bits through steps and a reset."""
    trees, starts = forest()

    def run() -> list[np.ndarray]:
        sim = begin(simulator(trees, ALL, gravity=9.81, precision=32, width=width, dt=1 / 240), starts)
        randomise(sim)
        sim.step(40)
        sim.reset(torch.arange(9) % 2 == 0)
        sim.step(20)
        return [motion(sim, w) for w in range(9)]

    here = run()
    monkeypatch.setattr(arrays, "link_major", lambda device: True)
    for a, b in zip(here, run(), strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_simulator_without_effects_has_none():
    """Hold no values and take the plain kernels."""
    sim = simulator([stick()], ())
    assert dict(sim.effects) == {} and sim.effects.nbytes == 0
    assert sim._load is None and sim._dynamics.damping is sim._damping.kernel


# ---- resets and graphs ---------------------------------------------------------------------------------------------


def test_reset_gives_a_fresh_world():
    """Forget memory, damage and time of the masked worlds: they do again what they did, bit for bit; others go on."""
    trees, starts = [stick(Joint.SPHERICAL, damping=0.5)] * 3, [[1.0, 0, 0, 0]] * 3
    law = {"plastic_set": {"share": 0.5, "yield_rad": 0.02}, "dry_friction": {"torque_Nm": 0.5},
           "hysteresis_boucwen": {"share": 0.3, "yield_rad": 0.05}}  # fmt: skip
    sim = begin(simulator(trees, ALL, dt=5e-3, **law), starts)

    def push() -> list[np.ndarray]:
        sim.load.force.torch[..., 1, 0] = 40.0
        sim.load.point.torch[..., 1, 2] = 1.0
        sim.step(100)
        sim.load.force.torch.zero_()
        sim.step(300)
        return [motion(sim, w) for w in range(3)]

    first = push()
    assert np.abs(first[0][1:4]).max() > 0.01  # stays bent
    sim.reset(torch.tensor([True, False, True]))
    second = push()
    for w, same in enumerate((True, False, True)):
        assert np.array_equal(second[w], first[w]) == same


def test_a_marked_start_keeps_its_memories():
    """Take the damage so far as part of the start where it is marked: the next run from there is the same twice."""
    law = {"plastic_set": {"share": 0.5, "yield_rad": 0.02}}
    sim = begin(simulator([stick(Joint.SPHERICAL, damping=0.5)], ALL, dt=5e-3, **law), [[0.8, 0.0, 0.6, 0.0]])
    sim.step(50)
    sim.mark_start()
    sim.step(50)
    once = motion(sim, 0)
    sim.reset()
    assert sim.effects.time.tolist() == pytest.approx([0.25])
    sim.step(50)
    np.testing.assert_array_equal(motion(sim, 0), once)


@pytest.mark.parametrize(("width", "precision"), [(1, 64), (8, 32)])
def test_a_captured_graph_takes_what_is_written_between(width, precision):
    """Replay steps as one graph, values written and worlds reset in between: the bits of plain calls."""
    trees, starts = forest(8)
    plain, graph = (
        begin(simulator(trees, ALL, gravity=9.81, width=width, precision=precision, dt=1 / 240), starts)
        for _ in range(2)
    )
    replay = graph.capture(3)
    for k in range(4):
        for sim in (plain, graph):
            randomise(sim, k, seed=k)
        replay()
        plain.step(3)
        if k == 2:
            for sim in (plain, graph):
                sim.reset(torch.arange(8) % 2 == 0)
    assert torch.equal(graph.state.coordinate.torch, plain.state.coordinate.torch)
    assert torch.equal(graph.state.velocity.torch, plain.state.velocity.torch)
    assert torch.equal(graph.effects.time, plain.effects.time) and plain.effects.time.unique().numel() == 2


def test_substeps_are_smaller_steps():
    """Take a step in four parts: the bits of four steps of a quarter, law by law, time included."""
    trees, starts = forest()
    coarse = Simulator(Model(trees, precision=64), dt=1 / 240, substeps=4, effects=ALL)
    fine = Simulator(Model(trees, precision=64), dt=1 / 960, effects=ALL)
    for sim, count in ((coarse, 10), (fine, 40)):
        begin(sim, starts)
        randomise(sim)
        sim.step(count)
    for w in range(len(trees)):  # the clocks add h as often or four h at once: rounding of a time
        np.testing.assert_allclose(motion(coarse, w), motion(fine, w), rtol=1e-9, atol=1e-9)


# ---- trees that nothing holds --------------------------------------------------------------------------------------

FREE = ("dry_friction", "quadratic_drag", "steady_wind")


def floating() -> Tree:
    """Make a rod with a branch on a ball joint, on three slides and a ball that nothing holds."""
    rod, slides = random_tree(np.random.default_rng(2), 2, joints=(Joint.SPHERICAL,)), np.zeros((3, 3))
    loose = np.r_[np.zeros(4), rod.stiffness[1:]]
    return Tree(
        name="free", link_name=["x", "y", "z", "rod", "twig"], parent=[-1, 0, 1, 2, 3],
        joint=[Joint.PRISMATIC] * 3 + [Joint.SPHERICAL] * 2, position=np.r_[slides, [[0, 0, 0]], rod.position[1:]],
        rotation=np.r_[[[1.0, 0, 0, 0]] * 4, rod.rotation[1:]], mass=np.r_[np.zeros(3), rod.mass],
        com=np.r_[slides, rod.com], inertia=np.r_[np.zeros((3, 3, 3)), rod.inertia], stiffness=loose,
        damping=0.1 * loose, axis=np.r_[np.eye(3), rod.axis], shape_link=rod.shape_link + 3,
        shape_start=rod.shape_start, shape_end=rod.shape_end, shape_radius=rod.shape_radius,
    ).validate()  # fmt: skip


def test_wind_gives_a_floating_tree_its_impulse():
    """Gain the momentum F t of the wind and nothing else; friction at the free root is none."""
    tree, q = floating(), np.array([30.0, -20.0, 10.0])
    area = np.zeros(5)
    size = np.linalg.norm(tree.shape_end - tree.shape_start, axis=1) * tree.shape_radius.sum(axis=1)
    np.add.at(area, tree.shape_link, size)
    wind = {f"pressure_{c}_Pa": value for c, value in zip("xyz", q, strict=True)}
    sim = simulator([tree], FREE, dt=1 / 240, steady_wind=wind)
    sim.effects["dry_friction"]["torque_Nm"][:, :4] = 10.0
    sim.refresh()
    sim.step(240)
    np.testing.assert_allclose(sim.energy()[1][0][0], q * area.sum(), atol=1e-10)


def test_wind_gives_a_tree_on_a_ball_its_angular_impulse():
    """Gain h x_c x F of angular momentum about the pivot in every step, x_c before it."""
    tree = stick(Joint.SPHERICAL, stiffness=0.0, damping=0.0)
    sim = simulator([tree], FREE, dt=1 / 240, steady_wind={"pressure_x_Pa": 50.0, "pressure_y_Pa": -20.0})
    force, wanted = AREA * np.array([50.0, -20.0, 0.0]), np.zeros(3)
    for _ in range(200):
        turn = Rotation.from_quat(np.roll(sim.state.qpos()[0], -1))
        wanted += sim.dt * np.cross(turn.apply([0.0, 0.0, LENGTH / 2]), force)
        sim.step()
    np.testing.assert_allclose(sim.energy()[1][0][1], wanted, atol=1e-10)


def test_friction_slows_a_tree_on_a_ball():
    """Lose T t of angular momentum about the pivot while it turns, and stay where it stops."""
    tree, torque, rate = stick(Joint.SPHERICAL, stiffness=0.0, damping=0.0), 0.8, 2.0
    sim = simulator([tree], FREE, dry_friction={"torque_Nm": torque})
    sim.state.set_qvel(np.array([0.0, 0.0, rate]))
    sim.step(2000)
    # the first BEND of the way, a quarter of a step here, has less friction: a step's worth at most
    assert sim.state.qvel()[0][2] == pytest.approx(rate - torque / J * 2.0, abs=torque / J * H)
    sim.step(8000)
    stopped = sim.state.qpos()[0]
    sim.step(1000)
    np.testing.assert_allclose(sim.state.qpos()[0], stopped, atol=BEND)


# ---- what is refused -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("names", "words"),
    [
        (("friction",), "simulator: effects: found 'friction'; allowed: one of cubic_stiffness, "),
        (("force_bias",), "found 'force_bias', an effect of measured cases; allowed: one of "),
        (("time_delay",), "'time_delay', an effect of measured cases"),
        (("base_compliance",), "'base_compliance', an effect of measured cases"),
        (("grasp_slip",), "'grasp_slip', an effect of measured cases"),
        (("dry_friction", "dry_friction"), "'dry_friction' a second time"),
        (("anisotropic_stiffness",), "'anisotropic_stiffness', but no ball joint"),
    ],
)
def test_effects_that_a_forest_cannot_have_are_refused(names, words):
    """Name the effect and what is allowed in one line."""
    with pytest.raises(InputError, match=words) as error:
        simulator([stick()], names)
    assert "\n" not in str(error.value)


def test_trees_that_an_effect_cannot_act_on_are_refused():
    """Refuse wind where there is nothing to blow at and masses on a tree that nothing holds."""
    bare = stick().with_(shape_link=np.zeros(0, int), shape_start=np.zeros((0, 3)), shape_end=np.zeros((0, 3)),
                         shape_radius=np.zeros((0, 2)))  # fmt: skip
    with pytest.raises(InputError, match="'steady_wind', but no link has a capsule"):
        simulator([bare], ("steady_wind",))
    with pytest.raises(InputError, match="'tip_mass' on a tree that nothing holds"):
        simulator([floating()], ("tip_mass",))


# ---- the command ---------------------------------------------------------------------------------------------------


@pytest.fixture
def tree_file(tmp_path, monkeypatch):
    """Write a random tree as MJCF, go there, and return the tree of the file."""
    tree = random_tree(np.random.default_rng(8), 4, stiffness=(20.0, 100.0), damping_ratio=(0.3, 1.0))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tree.xml").write_text(to_mjcf(tree))
    return load_mjcf(tmp_path / "tree.xml").tree


def test_command_simulates_effects(tree_file):
    """Move as the simulator does with the same values, masses at the tips alone."""
    options = ["--effect", "dry_friction:torque_Nm=0.05", "--effect", "steady_wind:pressure_x_Pa=40,pressure_y_Pa=-10",
               "--effect", "tip_mass:mass_kg=0.02"]  # fmt: skip
    assert main(["simulate", "tree.xml", "--out", "out", "--seconds", "0.5", "--worlds", "2", *options]) == 0
    names = ("dry_friction", "steady_wind", "tip_mass")
    wind = {"pressure_x_Pa": 40.0, "pressure_y_Pa": -10.0}
    sim = simulator([tree_file], names, dt=1 / 240, gravity=9.81, steady_wind=wind, dry_friction={"torque_Nm": 0.05})
    tips = np.setdiff1d(np.arange(4), tree_file.parent)
    sim.effects["tip_mass"]["mass_kg"][:, torch.as_tensor(tips)] = 0.02
    sim.refresh()
    sim.step(120)
    with np.load("out/trajectory.npz") as file:
        seen = file["body_pos"]
    np.testing.assert_allclose(seen[-1, 0], sim.observe()[0][0].numpy(), atol=1e-12)
    np.testing.assert_array_equal(seen[-1, 0], seen[-1, 1])
    assert np.abs(seen[-1] - seen[0]).max() > 1e-3


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ("dry_friction", "--effect: found 'dry_friction'; allowed: NAME:PARAMETER=VALUE"),
        ("friction:torque_Nm=1", "--effect: effects: found 'friction'; allowed: one of cubic_stiffness"),
        ("force_scale:scale=1.1", "found 'force_scale', an effect of measured cases"),
        (
            "dry_friction:torque=1",
            "--effect: dry_friction: found parameter 'torque'; allowed: torque_Nm [N m], bend_rad [rad]",
        ),
        ("dry_friction:torque_Nm=0.1Nm", "torque_Nm: found '0.1Nm'; allowed: 0 or more, in N m and without the unit"),
        ("dry_friction:torque_Nm=-1", "found '-1'; allowed: 0 or more"),
        ("dry_friction:torque_Nm=1,torque_Nm=2", "found torque_Nm a second time; allowed: each parameter once"),
        ("steady_wind:pressure_x_Pa=nan", "found 'nan'; allowed: a finite number, in Pa"),
    ],
)
def test_command_refuses_bad_effects(tree_file, capsys, option, words):
    """Say in one line what is wrong, write nothing, and return 2."""
    assert main(["simulate", "tree.xml", "--out", "out", "--effect", option]) == 2
    text = capsys.readouterr().err
    assert words in text and text.count("\n") == 1
