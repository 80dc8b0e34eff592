"""The repaired model: what is written, replayed by ``bough simulate``, has the gap that the diagnosis claims."""

import re
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from bough.cli.main import main
from bough.learn.cases.case import BranchCase, load_case
from bough.learn.cases.noise import estimate_noise
from bough.learn.gap import prepare as preparing
from bough.learn.gap.consistent import stand_in
from bough.learn.gap.decide import Decision, stretched
from bough.learn.gap.diagnosis import Interval, Settings
from bough.learn.gap.models.at_rest import Noise
from bough.learn.gap.models.contest import Contest, activated
from bough.learn.gap.models.fitted import Model
from bough.learn.gap.models.refit import fit
from bough.learn.gap.posterior import at_bound, only
from bough.learn.gap.prepare import Base
from bough.learn.gap.repaired import implausible, noise_floor, off_in, repair
from bough.learn.gap.run import Run
from bough.learn.inference.replayed import Replayed, held_out, replay_model
from bough.learn.inference.target import Target
from bough.learn.replay.recording import recordings
from bough.learn.replay.rollout import Rollout
from bough.learn.replay.simulated_case import Experiment, random_branch, write_simulated_case
from bough.learn.runs.threads import one_thread
from bough.learn.systems.acting import Acting
from bough.learn.systems.branch import Unknowns
from bough.learn.systems.model_file import model_of, write_model
from bough.learn.systems.system import Parameter
from bough.sim.effects import effect_of
from oracles.branch_case import make_branch_case
from oracles.oscillator import write_case

FEW = ("dry_friction", "force_scale", "force_bias", "anisotropic_stiffness")


def decided(case, sigma, names, chosen, verdict, near=None):
    """Return base and decision of a case as a search would leave them, with the effects ``chosen`` in the model.

    Their fit begins at the values ``near`` by name, else in the middle of their boxes.
    """
    contest = Contest(case, recordings(case), sigma, names)
    typical = isinstance(case, BranchCase)  # a precise swing has false minima, such as a damper that lets nothing swing
    base = fit(contest, contest.base_batch(1) if typical else preparing._modes(contest, 0), 24)
    base = base.one(int(base.cost.argmin()))
    members = tuple(next(k for k, c in enumerate(contest.candidates) if c.name == name) for name in chosen)
    begun = activated(contest, base.batch, [members])
    for c in members:
        for spec, column in zip(contest.candidates[c].specs, contest.candidates[c].columns, strict=True):
            middle = 0.5 * (contest.low[column] + contest.high[column])
            begun.free[0, column] = contest.parameters[column].free(near[spec.name]) if near else middle
    with_effects = Model(members, fit(contest, begun, 24), True) if members else Model((), base)
    plain = Model((), base)
    named = tuple(contest.candidates[c].acting for c in members) if verdict == "effects" else ()
    return Base(contest, base, Noise(sigma), None), Decision(verdict, plain, with_effects, with_effects, named)


def branch(folder):
    """Return a branch of one segment with four recordings, and the noise of its channels."""
    make_branch_case(folder, 4, segments=1, samples=50, dt=1e-3)
    case = load_case(folder)
    noise = estimate_noise(case)
    return case, np.concatenate([noise.displacement, noise.velocity])


def swings(folder):
    """Return a hinge that swings freely in four recordings, and the noise of its angle."""
    case = load_case(write_case(folder, [(0.5, 0.0), (-0.3, 1.0), (0.2, -2.0), (0.4, 1.0)], noise=0.004))
    return case, estimate_noise(case).sigma


@pytest.mark.parametrize(
    ("make", "chosen", "verdict", "particles"),
    [
        (branch, ("dry_friction",), "effects", 16),
        (branch, ("force_scale", "dry_friction"), "effects", 0),
        (branch, (), "none", 0),
        (branch, ("dry_friction",), "unknown", 0),
        (swings, ("dry_friction",), "effects", 16),
        (swings, (), "none", 0),
    ],
)
def test_the_written_model_has_the_gap_that_is_claimed(tmp_path, capsys, make, chosen, verdict, particles):
    """Print by ``simulate --model`` the very RMSE of the diagnosis; values, medians and particles are its numbers."""
    case, sigma = make(tmp_path / "case")
    names = FEW if make is branch else ("dry_friction",)
    with one_thread():
        base, decision = decided(case, sigma, names, chosen, verdict)
        found = repair(base, decision, Run(Settings(particles=particles)))
    path = tmp_path / "model.yaml"
    write_model(path, found.model)
    assert main(["simulate", str(tmp_path / "case"), "--model", str(path), "--out", str(tmp_path / "out")]) == 0
    told = capsys.readouterr()
    printed = re.search(r"held-out RMSE (\S+) (\S+) \(", told.out)
    assert printed is not None and printed[1] == f"{found.gap.repaired:.3g}" and printed[2] == found.gap.unit
    assert ("does not claim" in told.err) == (verdict == "unknown")
    again = model_of(path, case)
    assert [a.name for a in again.effects] == sorted(chosen, key=lambda n: [a.name for a in again.effects].index(n))
    alone, beside = replay_model(case, again), replay_model(case, again, off_in(base.contest, again))
    np.testing.assert_array_equal(alone.output, beside.output)  # a kernel with more laws gives the same bits
    assert alone.rms == found.gap.repaired
    for a in again.effects:
        for name, value in a.known.items():
            assert value == found.values[f"{a.label} {name}"]
            if verdict == "effects":
                own = found.parameters[a.label][name]
                assert own.median == value and own.low <= value <= own.high and own.low < own.high
    if found.posterior is not None:
        assert dict(zip(found.posterior.names, found.posterior.interval()[0].tolist(), strict=True)) == found.values


def test_what_is_held_out_is_not_fitted_to(tmp_path):
    """Leave the repaired model alone where only a held-out recording changes, and claim another gap."""
    gaps, values = [], []
    for k in range(2):
        case, sigma = swings(tmp_path / f"case_{k}")
        if k:
            held = case.trajectories[-1].output
            held[:] = held[::-1].copy()  # swings that grow
        with one_thread():
            base, decision = decided(case, sigma, ("dry_friction",), (), "none")
            found = repair(base, decision, Run(Settings(particles=0)))
        gaps.append(found.gap.repaired)
        values.append(list(found.values.values()))
    np.testing.assert_allclose(values[0], values[1], rtol=1e-3)  # fits end where a step gains less than 1e-4
    assert gaps[1] > 2.0 * gaps[0]


def test_a_parameter_at_its_bound_is_called_so():
    """Say low or high of a share whose fit is at an end and whose interval is near it; nothing of one not known."""
    share = Parameter("share", "1", 0.0, 1.0, None, "linear")
    assert at_bound(share, 0.5, (0.5, 0.4, 0.6)) is None
    assert at_bound(share, 1.0, (0.93, 0.8, 0.99)) == "high"
    assert at_bound(share, 0.0, (0.3, 0.01, 0.9)) is None
    assert at_bound(share, 0.3, (0.005, 0.001, 0.3)) == "low"
    torque = Parameter("torque", "N m", 1e-3, 1.0)
    assert at_bound(torque, np.log(0.9), (0.99, 0.9, 1.1)) == "high"


@pytest.mark.parametrize(("low", "high", "told"), [(700.0, 800.0, True), (0.4, 0.9, False), (5.0, 800.0, False)])
def test_a_value_that_nature_does_not_have_is_told(low, high, told):
    """Tell drag a thousand times that of air, not air's, and not where the interval leaves room for air's."""
    acting = SimpleNamespace(name="quadratic_drag", label="quadratic_drag", known={})
    own = {s.name: Interval(0.5, 0.0, 1.0, s.unit) for s in effect_of("quadratic_drag").law("branch").parameters}
    own["coefficient_kgpm3"] = Interval(0.5 * (low + high), low, high, "kg/m^3")
    contest = SimpleNamespace(case=object.__new__(BranchCase))
    found = implausible(contest, SimpleNamespace(named=(acting,)), {"quadratic_drag": own})
    assert bool(found) is told
    assert ("stand-in" in " ".join(stand_in(found))) is told


def test_deviations_follow_the_noise(tmp_path):
    """Give the hinge's cubic spring an interval that grows with the noise, by curvature alone."""
    widths = []
    for noise in (0.002, 0.02):
        folder = write_case(tmp_path / str(noise), [(0.5, 0.0), (-0.3, 1.0), (0.2, -2.0)], noise=noise)
        case = load_case(folder)
        with one_thread():
            base, decision = decided(
                case, estimate_noise(case).sigma, ("cubic_stiffness",), ("cubic_stiffness",), "effects"
            )
            found = repair(base, decision, Run(Settings(particles=0)))
        own = found.parameters["cubic_stiffness@0"]["cubic_radm2"]
        widths.append(own.high - own.low)
    assert widths[1] > 2.0 * widths[0] and torch.isfinite(torch.tensor(widths)).all()


def test_a_break_in_the_recording_held_out_is_fitted_and_another_is_held_out(tmp_path, capsys):
    """Where a joint breaks in the last recording, which is held out by itself, the others say nothing of it.

    The one before is held out instead, and the model's file says so, so that ``simulate`` prints the same RMSE.
    """
    rng = np.random.default_rng(5)
    truth = {"stiffness": np.array([30.0]), "damping": np.array([0.6])}
    values = {
        "share": 0.3,
        "moment_s": 3 * (110 / 50 + 5.0) + 0.4,
        "preload": 1.0,
        "takes_s": 0.05,
        "limit_rad": 0.0,
        "grows_rad": 0.0,
    }
    broken = Acting("partial_rupture", 0, values)
    case = write_simulated_case(tmp_path / "case", random_branch(rng, 1), truth, Experiment(), trajectories=4, seed=2,
                                unknowns=Unknowns(effects=(broken,)))  # fmt: skip
    noise = estimate_noise(case)
    with one_thread():
        sigma = np.concatenate([noise.displacement, noise.velocity])
        base, decision = decided(case, sigma, ("partial_rupture",), ("partial_rupture",), "effects", values)
        plain = decided(case, sigma, ("partial_rupture",), (), "none")
        found, without = (repair(*d, Run(Settings(particles=0))) for d in ((base, decision), plain))
    assert without.model.held_out is None and without.gap.test == (3,)
    assert found.model.held_out == ("traj_03.csv",) and found.gap.test == (2,)
    assert found.gap.repaired < 1.2 * found.gap.noise_floor < 0.5 * found.gap.base
    assert found.values["partial_rupture@0 share"] == pytest.approx(0.3, abs=0.05)
    write_model(tmp_path / "model.yaml", found.model)
    arguments = ["simulate", str(tmp_path / "case"), "--model", str(tmp_path / "model.yaml"), "--out", "out"]
    assert main(arguments) == 0
    assert f"held-out RMSE {found.gap.repaired:.3g} m (traj_03.csv, not used" in capsys.readouterr().out


@pytest.mark.parametrize(("share", "chi2", "left"), [(1.0, 2.0, True), (0.995, 2.0, True), (0.9, 2.0, False),
                                                     (1.0, 1.1, False), (0.0, 2.0, False)])  # fmt: skip
def test_an_effect_as_strong_as_its_box_allows_is_not_claimed_beside_a_misfit(share, chi2, left):
    """A law in another's place grows until it is stopped; one that leaves noise, or is off at the low end, does not."""
    strength, form = effect_of("hysteresis_boucwen").law("branch").parameters[:2]
    parameters = [SimpleNamespace(low=s.low, high=s.high) for s in (strength, form)]
    contest = SimpleNamespace(
        candidates=[SimpleNamespace(columns=(0, 1), specs=(strength, form))], low=torch.zeros(2), high=torch.ones(2),
        parameters=parameters,
    )  # fmt: skip
    fitted = SimpleNamespace(contest=contest, reduced_chi2=lambda model: chi2)
    batch = SimpleNamespace(free=torch.tensor([[share, 1.0]]))
    assert bool(stretched(fitted, Model((0,), SimpleNamespace(batch=batch)))) is left


@pytest.mark.parametrize(("share", "left"), [(0.0, True), (1.0, True), (0.5, False)])
def test_a_strength_of_either_sign_may_be_stopped_at_either_end(share, left):
    """A spring that is a tenth as stiff about one axis is as stretched as one that is ten times as stiff."""
    specs = effect_of("anisotropic_stiffness").law("branch").parameters
    parameters = [SimpleNamespace(low=-0.9, high=9.0)]
    contest = SimpleNamespace(candidates=[SimpleNamespace(columns=(0,), specs=specs)], low=torch.zeros(1),
                              high=torch.ones(1), parameters=parameters)  # fmt: skip
    fitted = SimpleNamespace(contest=contest, reduced_chi2=lambda model: 2.0)
    batch = SimpleNamespace(free=torch.tensor([[share]]))
    assert bool(stretched(fitted, Model((0,), SimpleNamespace(batch=batch)))) is left


def test_the_noise_floor_holds_what_a_noisy_force_does(tmp_path):
    """Say what a perfect model leaves where the force's noise shakes it more than the sensor's: its residual, to 10 %.

    A stiff branch swings once in five samples. The residual of two held-out recordings has a hundred independent
    values and more, so its rms is known to 7 %. The sensor's noise alone is an eighth of it.
    """
    rng = np.random.default_rng(7)
    meta = random_branch(rng, 1)
    inertia = meta["segments"][0]["mass_kg"] * meta["segments"][0]["length_m"] ** 2 / 3
    truth = {"stiffness": np.array([60.0**2 * inertia]), "damping": np.array([0.2 * 60.0 * inertia])}
    experiment = Experiment(samples=110, force_noise=0.02, noise=0.005, deflection=0.03)
    case = write_simulated_case(tmp_path / "case", meta, truth, experiment, trajectories=6, seed=3)
    with one_thread():
        base = preparing.prepare(case, Run(Settings(("tip_mass",), particles=0)))
        values = torch.tensor([[truth["stiffness"][0], truth["damping"][0]]])
        output = Rollout(case, recordings(case), 1)(values)[0].double().numpy()
    train, test = held_out(case)
    seen = Replayed(recordings(case), output, tuple(train), tuple(test), (0, 1, 2))
    assert noise_floor(base, seen) == pytest.approx(seen.rms, rel=0.1)
    assert np.sqrt(np.mean(base.noise.sigma[:3] ** 2)) < 0.3 * seen.rms


@pytest.mark.parametrize("name", ["dry_friction", "base_compliance"])
def test_a_posterior_simulates_the_trunk_where_it_gives_way_alone(tmp_path, name):
    """Predict what the search's simulation does to the bit, with the links of the trunk only where it is in the model.

    Seven links, of which four are the trunk's, take twice as long as three.
    """
    make_branch_case(tmp_path / "case", 4, samples=30, dt=2e-3)
    case = load_case(tmp_path / "case")
    contest = Contest(case, recordings(case)[:2], np.full(6, 1e-3), ("dry_friction", "base_compliance"))
    member = next(k for k, c in enumerate(contest.candidates) if c.name == name)
    batch = activated(contest, contest.base_batch(1), [(member,)])
    batch.free = contest.typical.expand_as(batch.free).clone()
    target = Target(case, contest.recordings, torch.full((6,), 1e-3), unknowns=only(contest, batch))
    links = target.system.tree.num_links
    assert links == case.num_segments + (4 if name == "base_compliance" else 0)
    theta = torch.cat([batch.free[batch.active][None], target.log_noise0[None]], 1)
    told = contest.simulate(contest.values(batch), batch.start)
    assert bool(told.abs().max() > 1e-3)
    torch.testing.assert_close(target.predict(theta), told.double(), rtol=0.0, atol=0.0)
