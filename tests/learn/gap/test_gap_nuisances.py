"""Geometry, mountings and noise with a memory: told as what they are, against dense algebra and made-up recordings."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from bough.learn.cases.case import load_case
from bough.learn.exam.grades import grades
from bough.learn.gap import TOLERANCE
from bough.learn.gap.decide import predicts
from bough.learn.gap.diagnosis import Settings
from bough.learn.gap.evidence import bootstrap_test, retested
from bough.learn.gap.geometry import TRACKER, add_nuisances, alone, explained_by, in_doubt, instead
from bough.learn.gap.models.at_rest import Noise, noise_of_neighbours, noise_of_repeats
from bough.learn.gap.models.contest import Contest, activated
from bough.learn.gap.models.fitted import FittedModels, Model
from bough.learn.gap.models.nuisance import FARTHEST, Nuisances
from bough.learn.gap.models.refit import evaluated, fit, normal_equations
from bough.learn.gap.prepare import Base, colour
from bough.learn.gap.run import Run
from bough.learn.inference.correlated import correlation, drawn_as
from bough.learn.replay.recording import recordings
from bough.learn.replay.rollout import Rollout
from oracles.branch_case import make_branch_case
from scipy.optimize import lsq_linear
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

FEW = ("force_scale", "tip_mass")
NOISE = np.repeat([2e-4, 2e-3], 3)  # m, m/s


def wandering(rng, rho, shape):
    """Return x_t = rho x_{t-1} + e_t of deviation one along the axis before the last."""
    e = rng.standard_normal((*shape[:-2], shape[-2] + 200, shape[-1])) * np.sqrt(1.0 - rho**2)
    return lfilter([1.0], [1.0, -rho], e, axis=-2)[..., 200:, :]


@pytest.fixture(scope="module")
def case(tmp_path_factory):
    """Return a branch of two segments, 60 samples a recording."""
    folder = tmp_path_factory.mktemp("nuisances") / "case"
    make_branch_case(folder, 4, segments=2, samples=60, dt=2e-3)
    return load_case(folder)


@pytest.fixture
def contest(case):
    """Return a contest whose recordings are those of its own base model at typical values, without noise."""
    contest = Contest(case, recordings(case), NOISE, FEW)
    batch = contest.base_batch(1)
    contest.measured = contest.simulate(contest.values(batch), batch.start)[0].double()
    return contest


def noisy(contest, rho=0.0, seed=0):
    """Add noise of a memory to what a contest has measured."""
    noise = NOISE * wandering(np.random.default_rng(seed), rho, tuple(contest.measured.shape))
    contest.measured = contest.measured + torch.as_tensor(noise)
    contest.motion = contest.measured


# ---- algebra --------------------------------------------------------------------------------------------------------


def test_nuisances_are_a_part_of_the_covariance(contest):
    """Charge (r - N'm)' (1 + N'N)^-1 (r - N'm), and have the slope and curvature of that by dense algebra."""
    noisy(contest)
    rng = torch.Generator().manual_seed(1)
    shape = (3, len(contest.recordings), contest.measured[0].numel())
    columns = 0.3 * torch.randn(shape, generator=rng, dtype=torch.float64)
    mean = torch.tensor([0.5, -1.0, 0.0], dtype=torch.float64)
    contest.nuisance = Nuisances(columns, mean, ("a", "b", "c"), mean - 99.0, mean + 99.0)
    batch = contest.base_batch(1)
    batch.free[:, :2] += 0.1
    residual, derivative, found = contest.linearise(batch)
    n, r, j = contest.nuisance.flat, residual.flatten(), derivative[0].flatten(1)
    inverse = torch.linalg.inv(torch.eye(len(r), dtype=torch.float64) + n.T @ n)
    away = r - contest.nuisance.mean @ n
    assert float(evaluated(contest, batch).chi2[0]) == pytest.approx(float(away @ inverse @ away), rel=1e-9)
    normal, pull = normal_equations(contest, batch, residual, derivative, found)
    prior = contest.spread[found[0]] ** -2
    lean = (contest.centre[found[0]] - batch.free[0, found[0]]) * prior
    torch.testing.assert_close(normal[0], j @ inverse @ j.T + torch.diag(prior), rtol=1e-7, atol=1e-6)
    torch.testing.assert_close(pull[0], j @ inverse @ away + lean, rtol=1e-7, atol=1e-6)


def test_nuisances_are_no_further_off_than_four_deviations(contest):
    """Leave what SciPy's bounded least squares leave; the slope is theirs, the curvature that beside what is free."""
    noisy(contest)
    rng = torch.Generator().manual_seed(1)
    columns = 0.3 * torch.randn(5, len(contest.recordings), contest.measured[0].numel(), generator=rng).double()
    mean = torch.tensor([0.5, -1.0, 0.0, 0.0, 2.0], dtype=torch.float64)
    contest.nuisance = Nuisances(columns, mean, tuple("abcde"), mean - FARTHEST, mean + FARTHEST)
    n = contest.nuisance.flat
    wanted = torch.tensor([9.0, -1.5, -20.0, 0.1, 2.0], dtype=torch.float64)  # a and c are far beyond the limit
    contest.measured = contest.measured + torch.as_tensor(NOISE) * (wanted @ n).view_as(contest.measured)
    batch = contest.base_batch(1)
    residual, derivative, found = contest.linearise(batch)
    r, j = residual.flatten(), derivative[0].flatten(1)
    rows, right = np.vstack([n.T, np.eye(5)]), np.append(r, mean)
    least = lsq_linear(rows, right, (mean - FARTHEST, mean + FARTHEST), tol=1e-14)
    fits = evaluated(contest, batch)
    assert float(fits.chi2[0]) == pytest.approx(2.0 * least.cost, rel=1e-9)
    np.testing.assert_allclose(fits.nuisance[0], least.x, rtol=1e-6)
    assert contest.nuisance.held(fits.nuisance)[0].tolist() == [True, False, True, False, False]
    normal, pull = normal_equations(contest, batch, residual, derivative, found)
    free = n[[1, 3, 4]]
    inverse = torch.linalg.inv(torch.eye(len(r), dtype=torch.float64) + free.T @ free)
    prior = contest.spread[found[0]] ** -2
    lean = (contest.centre[found[0]] - batch.free[0, found[0]]) * prior
    torch.testing.assert_close(normal[0], j @ inverse @ j.T + torch.diag(prior), rtol=1e-7, atol=1e-6)
    torch.testing.assert_close(pull[0], j @ (r - torch.as_tensor(least.x) @ n) + lean, rtol=1e-5, atol=1e-4)
    assert float(evaluated(contest.unlimited(), batch).chi2[0]) < 0.5 * float(fits.chi2[0])


def test_recordings_left_out_leave_their_nuisances_out(contest):
    """Give a model that leaves half of the recordings out the chi-squared of a contest that never had them."""
    noisy(contest)
    add_nuisances(contest, contest.base_batch(1), doubted=True)
    half = len(contest.recordings) // 2
    batch = contest.base_batch(1)
    batch.weight[:, half:] = 0.0
    few = Contest(contest.case, contest.recordings[:half], NOISE, FEW)
    few.measured = contest.measured[:half]
    few.nuisance = replace(contest.nuisance, columns=contest.nuisance.columns[:, :half])
    wanted = evaluated(few, few.base_batch(1))
    assert float(evaluated(contest, batch).chi2[0]) == pytest.approx(float(wanted.chi2[0]), rel=1e-5)


@pytest.mark.parametrize("off, possible", [("wood child", True), ("length child", False)])
def test_only_what_was_measured_can_be_too_far_off(contest, off, possible):
    """Take wood that bends by eight deviations more for wood; a length eight deviations off for impossible."""
    noisy(contest)
    add_nuisances(contest, contest.base_batch(1), doubted=True)
    k = contest.nuisance.names.index(off)
    free = evaluated(contest, contest.base_batch(1))
    free.nuisance[0] = contest.nuisance.mean
    free.nuisance[0, k] += 8.0
    found = explained_by(contest, free, 100.0)
    assert (found.chance > 0.01) is possible and (off in found.furthest) is not possible


# ---- geometry and mountings -----------------------------------------------------------------------------------------


def wrongly_told(contest, rng):
    """Measure a branch whose file is wrong by what callipers and mountings are worth, simulated anew and turned."""
    case, chosen = contest.case, contest.recordings
    count = case.num_segments
    other = replace(
        case,
        length=case.length * (1 + 0.01 * rng.normal(size=count)),
        mass=case.mass * (1 + 0.05 * rng.normal(size=count)),
        elevation=case.elevation + np.radians(rng.normal(size=count)),
    )
    turn = Rotation.from_rotvec(np.radians([0.6, -0.6, 0.6])).as_matrix()
    felt = [replace(r, input=r.input @ turn, grasp=(r.grasp[0], r.grasp[1] + [0.006, -0.006, 0.0])) for r in chosen]
    values = contest.values(contest.base_batch(1))[:, : contest.num_base]
    moved = Rollout(other, felt, 1)(values)[0].double().cpu().numpy()
    tracker = Rotation.from_rotvec(np.radians([1.5, 1.0, -1.5])).as_matrix()
    seen = moved.reshape(*moved.shape[:2], 2, 3) @ tracker
    contest.measured = torch.as_tensor(seen.reshape(moved.shape))


def test_wrong_geometry_leaves_noise(contest):
    """Leave noise where a file is a little wrong, by numbers that are no further off than four deviations."""
    wrongly_told(contest, np.random.default_rng(5))
    noisy(contest)
    base = fit(contest.rigid(), contest.base_batch(1), 10)
    assert float(base.chi2[0]) > 1.5 * contest.num_samples  # without nuisances something would be missing
    add_nuisances(contest, base.batch, doubted=True)
    told = fit(contest, base.batch, 10)
    assert abs(float(told.chi2[0]) / contest.num_samples - 1.0) < 5.0 * np.sqrt(2.0 / contest.num_samples)
    found = dict(zip(contest.nuisance.names, (told.nuisance[0] - contest.nuisance.mean).tolist(), strict=True))
    turned = [np.degrees(TRACKER) * found[f"tracker about {a}"] for a in "xy"]  # about z the branch may be turned too
    assert turned == pytest.approx([1.5, 1.0], abs=0.5)
    assert max(abs(x) for x in found.values()) < 4.0


@pytest.mark.parametrize("wrong", [False, True])
def test_geometry_is_doubted_where_it_is_wrong(contest, wrong):
    """Doubt geometry and mountings that are off by what callipers are worth, and none that are right."""
    if wrong:
        wrongly_told(contest, np.random.default_rng(5))
    noisy(contest)
    add_nuisances(contest, contest.base_batch(1), doubted=False)
    assert in_doubt(contest, fit(contest, contest.base_batch(1), 10).batch, 0.0) == wrong


def weighted(contest, share):
    """Measure a branch with a share of its last segment's mass at its tip; return the effect's index and the truth."""
    member = next(k for k, c in enumerate(contest.candidates) if c.name == "tip_mass")
    truth = activated(contest, contest.base_batch(1), [[member]])
    column = contest.candidates[member].columns[0]
    truth.free[0, column] = contest.parameters[column].free(share * float(contest.case.mass[-1]))
    contest.measured = contest.simulate(contest.values(truth), truth.start)[0].double()
    noisy(contest)
    return member, truth


def test_a_few_grams_at_the_tip_are_no_wrong_geometry(contest):
    """Doubt no geometry beside the right model of an eighth of the last segment's mass at its tip."""
    _, truth = weighted(contest, 0.12)
    add_nuisances(contest, contest.base_batch(1), doubted=False)
    assert not in_doubt(contest, fit(contest, truth, 10).batch, 0.0)


def test_nuisances_do_not_swallow_a_mass_at_the_tip(contest):
    """Leave far more than noise where three tenths of the last segment's mass are at its tip, and noise with it."""
    member, truth = weighted(contest, 0.3)
    base = fit(contest, contest.base_batch(1), 10)
    add_nuisances(contest, base.batch, doubted=True)
    mass = activated(contest, base.batch, [[member]])
    mass.free[0] = truth.free[0]
    fits = [fit(contest, b, 10) for b in (base.batch, mass)]
    without, beside = (float(f.chi2[0]) / contest.num_samples for f in fits)
    assert without > 1.3 and beside < 1.0 + 5.0 * np.sqrt(2.0 / contest.num_samples)


def test_geometry_off_by_any_amount_says_how_far(contest):
    """Say that a force sensor is turned further than it can be; segments and tracker share its 12 degrees."""
    turn = Rotation.from_rotvec(np.radians([12.0, 0.0, 0.0])).as_matrix()
    felt = [replace(r, input=r.input @ turn) for r in contest.recordings]
    values = contest.values(contest.base_batch(1))[:, : contest.num_base]
    contest.measured = Rollout(contest.case, felt, 1)(values)[0].double()
    noisy(contest)
    add_nuisances(contest, contest.base_batch(1), doubted=True)
    base = fit(contest, contest.base_batch(1), 10)
    free = alone(contest, base)
    assert float(free.chi2[0]) < 0.5 * float(base.chi2[0])
    what = instead(contest, free, base)
    assert what.startswith("force sensor about x ") and FARTHEST < int(what.split()[4]) <= 12
    assert not instead(contest, free, free)


# ---- noise with a memory --------------------------------------------------------------------------------------------


def test_noise_is_drawn_as_it_was_seen():
    """Draw noise of mean square one whose correlations are 0.8^k, as those of the residuals it is drawn after."""
    rng = np.random.default_rng(3)
    z = torch.as_tensor(np.array([3.0, 1.0]) * wandering(rng, 0.8, (12, 800, 2)))
    drawn = drawn_as(correlation(z, [800] * 12), torch.as_tensor(rng.standard_normal((40, 12, 800, 2))))
    assert float((drawn**2).mean()) == pytest.approx(1.0, rel=0.02)
    assert float((drawn[..., 0] ** 2).mean() / (drawn[..., 1] ** 2).mean()) == pytest.approx(9.0, rel=0.1)
    for lag in (1, 3, 6):  # 15 %: of the 9,600 values that the residuals have, one in nine is independent
        found = float((drawn[..., lag:, 0] * drawn[..., :-lag, 0]).mean() / (drawn[..., 0] ** 2).mean())
        assert found == pytest.approx(0.8**lag, abs=0.15)


def test_repeats_and_rest_show_noise_that_differences_miss(contest):
    """Find the deviation of noise with a memory to a tenth, where half of it was known; keep white noise as it is."""
    rigid = contest.base_batch(1)
    contest.recordings = [replace(r, contact=r.t > 0.3 * r.t[-1]) for r in contest.recordings]
    clean = contest.measured
    noisy(contest, 0.6)
    found = noise_of_repeats(contest, rigid, Noise(0.5 * NOISE))
    np.testing.assert_allclose(found.sigma, NOISE, rtol=0.1)
    contest.measured = clean
    noisy(contest)
    known = Noise(NOISE)
    assert noise_of_repeats(contest, rigid, known) is known


def test_a_branch_that_has_changed_between_repeats_is_no_noise(contest):
    """Keep the noise of a branch whose springs are a tenth stiffer in the second of two recordings of one experiment.

    They differ by several deviations then, and by a hundredth of that once other springs may have made the difference.
    """
    rigid, known = contest.base_batch(1), Noise(NOISE)
    stiffer = rigid.copy()
    stiffer.free[:, [k for k, p in enumerate(contest.parameters) if p.name.startswith("stiffness")]] += 0.1
    later = contest.simulate(contest.values(stiffer), stiffer.start)[0].double()
    again = [i for i, t in enumerate(contest.case.trajectories) if t.replicate_of is not None]
    assert float(((later - contest.measured)[again] / torch.as_tensor(NOISE)).pow(2).mean()) > 4.0
    contest.measured[again] = later[again]
    noisy(contest)
    assert noise_of_repeats(contest, rigid, known) is known


def test_neighbours_show_noise_that_was_taken_for_less(contest):
    """Find white noise to 5 % where 0.9 of it was known, beside a slow misfit and a jump that no model follows.

    Differences of neighbours, some 500 or more, know it to 4 %; a misfit whose neighbours differ little adds 1 %. Where
    more was known, or what is left is far from noise, the noise stays.
    """
    rigid = contest.base_batch(1)
    noisy(contest)
    for r, x in zip(contest.recordings, contest.measured, strict=True):
        n = len(r.t)
        x[:n] += torch.as_tensor(0.3 * NOISE * np.sin(2.0 * np.pi * np.arange(n) / n)[:, None])
    contest.measured[0, 20] += torch.as_tensor(8.0 * NOISE)
    contest.set_noise(0.9 * NOISE)
    found = noise_of_neighbours(contest, rigid, Noise(0.9 * NOISE))
    np.testing.assert_allclose(found.sigma, NOISE, rtol=0.05)
    contest.set_noise(1.2 * NOISE)
    more = Noise(1.2 * NOISE)
    assert noise_of_neighbours(contest, rigid, more) is more
    contest.set_noise(0.5 * NOISE)
    far = Noise(0.5 * NOISE)
    assert noise_of_neighbours(contest, rigid, far) is far


def test_noise_of_the_force_is_not_taken_twice(contest):
    """Keep the noise of the channels where noise of the force, which whitening knows of, makes repeats differ."""
    rng, sigma = np.random.default_rng(2), np.full(3, 0.2)
    touched = [
        replace(r, contact=np.ones(len(r.t), dtype=bool)) for r in contest.recordings
    ]  # nothing shows it at rest
    felt = [replace(r, input=r.input + sigma * rng.standard_normal(r.input.shape)) for r in touched]
    other = Contest(contest.case, felt, NOISE, FEW)
    other.measured = contest.measured
    noisy(other)
    known, rigid = Noise(NOISE), other.base_batch(1)
    assert noise_of_repeats(other, rigid, known) is not known
    colour(other, rigid, sigma)
    assert noise_of_repeats(other, rigid, known) is known


def test_a_sum_of_correlated_noise_is_not_rare(contest):
    """Call noise of 0.9 from sample to sample no effect, at one in a hundred, which it is beside white noise."""
    noisy(contest, 0.9)
    base = Base(contest, fit(contest, contest.base_batch(1), 8), Noise(NOISE), None)
    run = Run(Settings())
    white = bootstrap_test(base, run)
    again = retested(base, Model((), base.fit), white, run)
    assert white.p_value < 1e-3 < 0.01 < again.p_value


# ---- grades ---------------------------------------------------------------------------------------------------------


def test_an_alarm_is_a_name_where_measurement_alone_leaves_more():
    """Count `unknown` as a false alarm of a null whose file is right, and only a name where its errors show."""

    def null(gap, verdict, *names):
        told = {"verdict": verdict, "alternatives": {}, "effects": [{"name": n, "joint": 0} for n in names]}
        truth = {"null": True, "effects": [], "equivalents": {}, "measurement_gap": gap}
        return {"kind": "null", "noise": 0.03, "truth": truth, "verdict": told}

    small, large = 0.5 * TOLERANCE, 2.0 * TOLERANCE
    for case, share in (
        (null(small, "unknown"), 1.0), (null(large, "unknown"), 0.0), (null(large, "effects", "tip_mass"), 1.0),
        (null(large, "none"), 0.0),
    ):  # fmt: skip
        assert grades([case])["false alarm on null"] == (share, 1)


def test_a_held_out_error_of_wrong_geometry_takes_no_name_back(contest):
    """Predict recordings left out better with the mass that is there, and not with a gain that is not."""
    wrongly_told(contest, np.random.default_rng(5))
    members = {c.name: k for k, c in enumerate(contest.candidates)}
    clean = contest.measured
    noisy(contest)
    base = fit(contest, contest.base_batch(1), 8)
    add_nuisances(contest, base.batch, doubted=True)
    base = Model((), fit(contest, base.batch, 8))

    def ahead(name):
        model = Model((members[name],), fit(contest, activated(contest, base.fit.batch, [[members[name]]]), 10))
        return predicts(FittedModels(contest, base, [model]), model)

    assert not ahead("force_scale")
    mass = activated(contest, contest.base_batch(1), [[members["tip_mass"]]])
    column = contest.candidates[members["tip_mass"]].columns[0]
    mass.free[0, column] = contest.parameters[column].free(0.5 * float(contest.case.mass[-1]))
    plain = contest.base_batch(1)
    change = [contest.simulate(contest.values(b), b.start)[0].double() for b in (mass, plain)]
    contest.measured = clean + change[0] - change[1]
    noisy(contest)
    base = Model((), fit(contest, base.fit.batch, 8))
    assert ahead("tip_mass")
