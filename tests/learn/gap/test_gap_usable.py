"""What a case cannot say is said: too few samples, other plants, one direction only; laws of springs need a spring."""

from dataclasses import replace

import numpy as np
import pytest
import yaml
from bough.learn.cases.case import load_case
from bough.learn.gap.diagnose import find_missing
from bough.learn.gap.diagnosis import Settings
from bough.learn.gap.models.candidates import everywhere, names_for, needs_spring, springs
from bough.learn.gap.models.contest import Contest, activated
from bough.learn.gap.models.scan import all_probes
from bough.learn.gap.run import Run
from bough.learn.gap.usable import one_way, plant_numbers, rests_elsewhere, too_few
from bough.learn.gap.where import locate, replicate_scatter, swing_of
from bough.learn.replay.recording import recordings
from bough.learn.runs.threads import one_thread
from bough.sim.base.errors import InputError
from bough.sim.effects import effects
from oracles.branch_case import make_branch_case
from oracles.case_files import make_planar
from oracles.effect_case import simulate, stick_case, swing_case

HANGING = {"type": "revolute", "inertia": 1.0, "stiffness": 0.0, "damping": None,
           "gravity_torque": {"amplitude": None, "zero_angle": 0.0}}  # fmt: skip


def write(folder, signals, joint, *, rate=50.0, effort=None, quantity="position"):
    """Write and load a case of one joint, an array [T] of what was measured for every recording."""
    folder.mkdir()
    for k, x in enumerate(signals):
        u = np.zeros_like(x) if effort is None else effort
        np.savetxt(folder / f"run_{k + 1}.csv", np.column_stack([np.arange(len(x)) / rate, u, x]), fmt="%.9g",
                   delimiter=",", header="time_s,effort,measured", comments="")  # fmt: skip
    driven = {"joint": "axis", "column": "effort", "scale": 1.0, "hold": "linear"}
    meta = {"format": "joint-gap-case/1", "name": folder.name, "mechanism": {"joints": [{"name": "axis"} | joint]},
            "input": None if effort is None else driven,
            "outputs": [{"joint": "axis", "quantity": quantity, "column": "measured", "scale": 1.0}],
            "trajectories": [{"file": f"run_{k + 1}.csv", "t_start_s": 100.0 * k, "replicate_of": None}
                             for k in range(len(signals))], "noise_nominal": None}  # fmt: skip
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta))
    return load_case(folder)


def swings(count, square, *, rate=50.0, decay=0.05, noise=1e-3, size=0.02):
    """Return the decaying swing [count] of a pendulum of a squared frequency, small enough to be linear."""
    t = np.arange(count) / rate
    clean = size * np.exp(-decay * t) * np.cos(np.sqrt(square - decay**2) * t)
    return clean + noise * size * np.random.default_rng(int(square)).standard_normal(count)


def test_a_planar_case_has_nothing_aside(tmp_path):
    """Leave what is along y, and laws that bend or twist out of the plane, out of a planar case; the rest is seen.

    A force across the plane was charged to an offset, and bent its branch to second order; of laws of the force and of
    the wind each parameter that stays changes the motion in the plane.
    """
    make_branch_case(tmp_path / "solid", 4, segments=1, samples=40, dt=1e-3)
    make_planar(tmp_path / "solid", tmp_path / "flat")
    solid, case = load_case(tmp_path / "solid"), load_case(tmp_path / "flat")
    with pytest.raises(InputError, match="an effect that this case cannot show"):
        names_for(case, ("anisotropic_stiffness",))
    assert set(names_for(solid)) - set(names_for(case)) == {"anisotropic_stiffness", "bending_torsion_coupling"}
    names = ("force_bias", "steady_wind", "gravity_comp_error", "force_scale", "grasp_slip")
    contest = Contest(case, recordings(case)[:2], np.full(6, 0.003), names)
    whole = {p.name for p in Contest(solid, recordings(solid)[:2], np.full(6, 0.003), names).parameters}
    gone = {"force_bias force_y_N", "steady_wind pressure_y_Pa", "force_scale relative_y"}
    gone.add("gravity_comp_error across_N")
    assert whole - {p.name for p in contest.parameters} == gone
    assert all(len(p.values) == len(contest.candidates[p.candidate].columns) for p in all_probes(contest))
    batch = activated(contest, contest.base_batch(3), [[c] for c in range(3)])
    batch.free[:, contest.num_base :] += 0.1 * contest.reach[contest.num_base :]
    _, derivative, columns = contest.linearise(batch)
    seen = (derivative[..., [0, 2, 3, 5]] ** 2).sum((2, 3, 4)) > 0.0
    needed = [k for c in contest.candidates for k, own in zip(c.columns, c.specs, strict=True) if not own.optional]
    assert all(bool(seen[columns == k].all()) for k in needed)


def test_few_samples_cannot_support_a_verdict(tmp_path):
    """Refuse 27 samples for a damper, a gravity torque, a start state and a law, and say how many are needed."""
    few = too_few(write(tmp_path / "few", [swings(27, 14.0)], HANGING))
    assert few is not None and "27 samples" in few and "7 unknowns" in few and "record 70" in few
    assert too_few(write(tmp_path / "enough", [swings(70, 14.0)], HANGING)) is None
    force = np.zeros((60, 3))
    assert too_few(stick_case(tmp_path / "stick", [force])) is not None
    assert too_few(stick_case(tmp_path / "sticks", [force, force])) is None


def test_other_plants_are_not_one_case(tmp_path):
    """Abstain where four pendulums of other lengths are recorded as one; say which two differ, and by how much."""
    case = write(tmp_path / "plants", [swings(300, a) for a in (14.0, 20.0, 30.0, 56.0)], HANGING)
    with one_thread():
        found = find_missing(case, Run(Settings(effects=("dry_friction",), particles=0, max_effects=1)))
    assert found.verdict == "unknown" and found.nearest is None and found.effects == ()
    words = ("one and the same plant", "recording 4 (run_4.csv)", "recording 1 (run_1.csv)", "squared frequency")
    assert all(word in found.sentence for word in words), found.sentence
    ratio = float(found.sentence.split(" has ")[1].split(" times")[0])
    assert ratio == pytest.approx(56.0 / 14.0, rel=0.01)  # a phase error of 0.1 rad in 40 rad is 0.5 % of the square
    assert "a case of each plant" in found.next_experiment


def test_one_plant_is_one_case(tmp_path):
    """Leave a pendulum alone that friction stops, from three heights."""
    t = np.arange(300) / 50.0
    runs = [np.maximum(size - 0.001 * t, 0.2 * size) * np.cos(np.sqrt(14.0) * t) for size in (0.01, 0.02, 0.015)]
    runs = [x + 1e-5 * np.random.default_rng(k).standard_normal(len(t)) for k, x in enumerate(runs)]
    with one_thread():
        settings = Settings(effects=("dry_friction",), particles=0, max_effects=1)
        found = find_missing(write(tmp_path / "one", runs, HANGING), Run(settings))
    assert "plant" not in found.sentence, found.sentence


def test_numbers_of_a_plant(tmp_path):
    """Give way as a lever does: 0.4 m from a joint of 30 N m/rad; a pendulum's square is torque over inertia."""
    stick = stick_case(tmp_path / "stick", [np.zeros((60, 3))] * 2)
    assert plant_numbers(stick, [{"stiffness stick": 30.0}]) == {
        "compliance at the grasp point": [pytest.approx(0.16 / 30.0)]
    }
    case = write(tmp_path / "hanging", [swings(100, 14.0)] * 2, HANGING | {"inertia": 2.0})
    assert plant_numbers(case, [{"gravity torque axis": 28.0}]) == {"squared frequency of axis": [14.0]}


@pytest.mark.parametrize(("kind", "unit"), [("revolute", "N m"), ("prismatic", "N")])
def test_motion_one_way_leaves_friction_open(tmp_path, kind, unit):
    """Remark that an offset may be friction where a joint never turns back, in the joint's unit, and what to record."""
    t = np.arange(200) / 50.0
    joint = {"type": kind, "inertia": None, "stiffness": 0.0, "damping": None}
    values, effort = {"offset axis": -0.4, "damping axis": 1.0}, 1.0 + np.sin(t)
    forward = write(tmp_path / "forward", [1.0 + 0.5 * np.sin(t)], joint, effort=effort, quantity="velocity")
    said = one_way(forward, recordings(forward), values)
    assert len(said) == 1 and f"offset axis of -0.4 {unit} may be friction" in said[0] and "both ways" in said[0]
    assert one_way(forward, recordings(forward), {"damping axis": 1.0}) == ()  # no offset is free
    both = write(tmp_path / "both", [np.sin(t)], joint, effort=effort, quantity="velocity")
    assert one_way(both, recordings(both), values) == ()


def test_a_joint_that_rests_beside_its_model_is_told(tmp_path):
    """Say by how much, in the joint's unit, where all recordings end there: 30 mrad to one side, 1 mrad apart.

    Not where they end on both sides, where one moves on or is pushed, or where efforts are fitted.
    """
    swing = [size * np.exp(-1.5 * np.arange(300) / 50.0) * np.cos(0.2 * np.arange(300)) for size in (0.4, 0.7, 0.9)]
    model = np.stack(swing)[..., None]

    def told(name, away, **more):
        case = write(tmp_path / name, [x + a for x, a in zip(swing, away, strict=True)], HANGING, **more)
        return rests_elsewhere(case, recordings(case), model)

    (said,) = told("beside", (-0.029, -0.03, -0.031))
    assert "axis comes to rest about -0.03 rad from where the model does, in 3 recordings alike" in said
    assert told("both", (-0.03, 0.03, -0.03)) == ()
    assert told("pushed", (-0.029, -0.03, -0.031), effort=np.full(300, 0.1)) == ()
    assert told("moving", (*2 * [-0.03 + 0.05 * np.sin(np.arange(300))], -0.03)) == ()
    case = write(tmp_path / "torque", [x - 0.03 for x in swing], HANGING, effort=np.zeros(300))
    assert len(rests_elsewhere(case, recordings(case), model)) == 1
    assert rests_elsewhere(case, recordings(case), np.full_like(model, np.nan)) == ()  # a model that diverged
    assert rests_elsewhere(replace(case, fit="torque"), recordings(case), model) == ()


def test_laws_of_springs_are_nothing_without_one(tmp_path):
    """Find by simulation which laws change the motion of a joint without a spring: those that are tried there."""
    case = swing_case(tmp_path / "case", [(0.4, 1.0)])
    size = {"dry_friction": {"torque_Nm": 0.3, "bend_rad": 1e-3}, "quadratic_drag": {"coefficient_Nms2": 0.5},
            "cubic_stiffness": {"cubic_radm2": 5.0}, "bilinear_stiffness": {"relative": 1.0},
            "backlash": {"gap_rad": 0.1},
            "hysteresis_boucwen": {"share": 0.5, "yield_rad": 0.1}, "plastic_set": {"share": 0.5, "yield_rad": 0.1},
            "viscoelastic_sls": {"share": 0.5, "relaxation_s": 0.3}}  # fmt: skip
    laws = {e.name: e.joint for e in effects() if e.joint is not None and e.joint.kind == "joint"}
    assert laws.keys() == size.keys()
    free = simulate(case, 0.0, 0.2, start=[0.4, 1.0])
    for name, law in laws.items():
        moved = np.abs(simulate(case, 0.0, 0.2, start=[0.4, 1.0], **{name: size[name]}) - free).max()
        assert needs_spring(law) == (moved == 0.0), name


def test_springless_joints_are_not_tried_with_springs(tmp_path):
    """Try friction and drag at a pendulum without a spring; all laws where a spring is unknown."""
    hanging = write(tmp_path / "hanging", [swings(100, 14.0)] * 2, HANGING)
    assert springs(hanging) == [False] and set(names_for(hanging)) == {"dry_friction", "quadratic_drag"}
    sprung = write(tmp_path / "sprung", [swings(100, 14.0)] * 2, HANGING | {"stiffness": None})
    assert springs(sprung) == [True] and {"cubic_stiffness", "backlash"} < set(names_for(sprung))
    assert {a.name for a in everywhere(hanging, ["cubic_stiffness", "dry_friction"])} == {"dry_friction"}


def test_scatter_of_repeats_is_what_they_differ_by(tmp_path):
    """Find the scatter that was put on repeats: a deviation of 2 mrad from their mean, noise of 1e-9 or not."""
    clean, rng = swings(400, 14.0, noise=0.0, size=0.3), np.random.default_rng(5)
    runs = [clean + 2e-3 * rng.standard_normal(400) for _ in range(2)]
    case = write(tmp_path / "twice", [*runs, clean], HANGING)
    once = recordings(case)
    assert replicate_scatter(case, once) is None
    first, second, third = case.trajectories
    case = replace(case, trajectories=(first, replace(second, replicate_of=0), third))
    assert replicate_scatter(case, once) == pytest.approx(2e-3, rel=0.15)  # 400 differences: 5 % is one deviation
    assert swing_of(case, once, [2]) == pytest.approx(np.std(clean))


def test_residuals_are_shares_of_the_motion_whatever_the_zero_and_the_noise(tmp_path):
    """Give a residual of 2 % of the motion as 2 %, for an encoder of any zero and of a noise of a millionth."""
    clean = swings(400, 14.0, noise=0.0, size=0.3)
    for zero in (0.0, np.pi):
        case = write(tmp_path / f"zero_{zero:.0f}", [clean + zero], HANGING)
        recorded = recordings(case)
        missed = (clean + zero + 0.02 * clean.std())[None, :, None]
        where = locate(case, recorded, np.array([1e-6 * clean.std()]), missed)
        np.testing.assert_allclose(where.of_motion, 0.02, rtol=1e-4)  # nine digits in the file
        np.testing.assert_allclose(where.heat, 0.02e6, rtol=1e-3)  # not clipped
        lost = np.where(np.arange(400)[:, None] < 200, missed[0], np.nan)[None]
        assert np.nanmax(locate(case, recorded, np.array([1e-6]), lost).of_motion) == 10.0
