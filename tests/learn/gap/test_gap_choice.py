"""Replay or torque, and verdicts that hang on how the data are treated."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
import yaml
from bough.learn.cases.case import BranchCase, load_case
from bough.learn.gap.consistent import sentence
from bough.learn.gap.decide import Decision, _turned_into, held_fast
from bough.learn.gap.diagnose import find_missing
from bough.learn.gap.diagnosis import Settings
from bough.learn.gap.models.candidates import Candidate
from bough.learn.gap.models.contest import Batch, Contest
from bough.learn.gap.models.fitted import FittedModels, Model
from bough.learn.gap.models.levels import _at_moments
from bough.learn.gap.models.refit import Fits, fit
from bough.learn.gap.prepare import prepare
from bough.learn.gap.run import Run
from bough.learn.gap.search import Searched
from bough.learn.gap.steady import _contest, at_half_rate, steadied, variants
from bough.learn.inference.identify import pooled_sigma
from bough.learn.replay.choice import choose, life_of_errors, moved_by_noise
from bough.learn.replay.equation_error import EquationError, low_pass, noise_of, recordings_of, thinned, window
from bough.learn.replay.motion_noise import motion_noise
from bough.learn.runs.checkpoint import Checkpoint
from bough.learn.runs.threads import one_thread
from bough.learn.systems.acting import Acting
from bough.learn.systems.branch import Unknowns
from bough.sim.base.errors import InputError
from bough.sim.effects import EffectParameter, effect_of
from scipy.signal import firwin

INERTIA, D = 0.05, 0.1


def drive(folder, *, rub=0.0, spring=0.0, seconds=5.0, rate=200.0, noise=2e-4, loud=0.0, runs=2, measured=("q", "u"),
          keys=(), pulled=0.0):  # fmt: skip
    """Write a case of an axis under control: INERTIA q'' = u - D q' - spring q - rub sign(q') - pulled sin(t / 2 s)."""
    folder.mkdir()
    rng, fine = np.random.default_rng(0), 10
    t = np.arange(round(seconds * rate)) / rate
    for r in range(runs):
        f, phase = rng.uniform(0.2, 1.2, 5), rng.uniform(0, 6.28, 5)
        want = 0.5 * np.sin(2 * np.pi * f * t[:, None] + phase).sum(1)
        q, v, rows, h = want[0], 0.0, [], 1.0 / rate / fine
        for k in range(len(t)):
            u = 6.0 * (want[k] - q) - 0.4 * v
            rows.append((t[k], q, u))
            for _ in range(fine):
                v += h * (u - D * v - spring * q - rub * np.tanh(v / 5e-3) - pulled * np.sin(0.5 * t[k])) / INERTIA
                q += h * v
        rows = np.array(rows)
        rows[:, 1:] += np.array([noise, loud]) * rng.standard_normal((len(t), 2))
        np.savetxt(folder / f"run_{r}.csv", rows, delimiter=",", header="time_s,q,u", comments="", fmt="%.9g")
    joint = {"name": "axis", "type": "revolute", "inertia": None, "damping": None,
             "stiffness": None if spring else 0.0}  # fmt: skip
    meta = {
        "format": "joint-gap-case/1", "name": "axis", "mechanism": {"joints": [joint]},
        "input": {"joint": "axis", "column": "u", "scale": 1.0, "hold": "zero_order"} if "u" in measured else None,
        "outputs": [{"joint": "axis", "quantity": "position" if "q" in measured else "velocity", "column": "q",
                     "scale": 1.0}],
        "trajectories": [{"file": f"run_{r}.csv", "t_start_s": 100.0 * r} for r in range(runs)], **dict(keys),
    }  # fmt: skip
    if "u" not in measured:
        joint["inertia"] = INERTIA
    (folder / "meta.yaml").write_text(yaml.safe_dump(meta))
    return folder


# ---- the choice ---------------------------------------------------------------------------------------------------


def test_an_axis_without_a_spring_is_fitted_by_its_torques(tmp_path):
    """Choose torques where an error stays for ever, a replay where a damped spring forgets it, and say why."""
    free = choose(load_case(drive(tmp_path / "free")))
    assert free.case.fit == "torque" and "lives 5 s in recordings of 5 s" in free.reason and free.other == "replay"
    held = choose(load_case(drive(tmp_path / "held", spring=20.0)))
    assert held.case.fit == "replay" and "forgets it" in held.reason and held.other == "torque"


def test_efforts_that_are_noise_are_not_replayed(tmp_path):
    """Fit torques where the noise of the efforts moves a replay further than the encoder's noise is.

    Its response has the variance sigma^2 dt / (2 D k); the first seconds and a guessed spring leave a factor of two.
    """
    case = load_case(drive(tmp_path / "loud", spring=20.0, loud=0.1))
    found = choose(case)
    assert found.case.fit == "torque" and "noise of the efforts" in found.reason and found.other == "replay"
    wanted = 0.1 * np.sqrt(0.005 / (2.0 * D * 20.0)) / 2e-4
    assert 0.5 * wanted < moved_by_noise(case) < 2.0 * wanted


def test_errors_live_as_long_as_the_damper_lets_them(tmp_path):
    """Find the time 2 I / D after which free swings are down to 1 / e, to a swing of 0.3 s."""
    case = load_case(drive(tmp_path / "held", spring=20.0, seconds=8.0))
    assert life_of_errors(case) == pytest.approx(2 * INERTIA / D, abs=2 * np.pi * np.sqrt(INERTIA / 20.0))


@pytest.mark.parametrize("options, reason", [
    ({"measured": ("q",)}, "the effort of axis was not measured"),
    ({"measured": ("u",)}, "the position of axis was not measured"),
    ({"noise": 0.05}, "the rate of axis is noise"),
    ({"keys": (("fit", "replay"),)}, "meta.yaml says so"),
    ({"seconds": 0.2}, "shorter than three periods"),
])  # fmt: skip
def test_what_was_not_measured_is_replayed(tmp_path, options, reason):
    """Replay where an effort or a position is missing, where its derivative is noise, and where the case says so."""
    found = choose(load_case(drive(tmp_path / "case", **options)))
    assert found.case.fit == "replay" and reason in found.reason


def test_the_other_way_can_be_asked_for(tmp_path):
    """Fit as wanted, against the data's choice and the file's; refuse torques that were not measured in one line."""
    case = load_case(drive(tmp_path / "case"))
    assert choose(case, "replay").case.fit == "replay" and choose(case, "replay").reason == "asked for"
    assert choose(load_case(drive(tmp_path / "said", keys=(("fit", "replay"),))), "torque").case.fit == "torque"
    with pytest.raises(InputError, match="torque without the effort of axis") as e:
        choose(load_case(drive(tmp_path / "half", measured=("q",))), "torque")
    assert "\n" not in str(e.value)


@pytest.mark.parametrize("rate, pulled, named", [(20.0, 0.1, True), (24.0, 0.2, False)])
def test_torques_are_judged_where_a_replay_of_a_fast_motion_names_nothing(tmp_path, rate, pulled, named):
    """Name friction by torques of an axis that moves faster than their filter and is pulled at by what is not measured.

    A replay adds that up and names nothing. Where torques name nothing either the replay is told. A run that was killed
    after both searches goes on to the same verdict.
    """
    case = load_case(drive(tmp_path / "case", rub=0.25, rate=rate, seconds=20.0, pulled=pulled))
    assert choose(case).case.fit == "replay" and choose(case).torn and not choose(case, "replay").torn
    settings = Settings(("dry_friction", "quadratic_drag"), particles=0)
    keep = Checkpoint(tmp_path / "kept", "key")
    for resume in (False, True):
        keep.open(resume)
        with one_thread():
            found = find_missing(case, Run(settings, keep))
        assert {p.name for p in keep.folder.glob("*search")} == {"search", "turned-search"}
        if named:
            assert [a.name for a in found.effects] == ["dry_friction"] and found.fit["method"] == "torque"
            assert "a replay, which comes first" in found.fit["reason"] and found.fit["other"] == "replay"
            torque = found.parameters["dry_friction@0"]["torque_Nm"]
            assert torque.low < 0.25 < torque.high
        else:
            assert found.verdict == "unknown" and found.fit["method"] == "replay"


def test_a_cut_off_asks_for_torques(tmp_path):
    """Take ``filter_hz`` of joints with everything measured as a wish for torques, which it is of an MJCF file."""
    case = load_case(drive(tmp_path / "case", spring=20.0, keys=(("filter_hz", 8.0),)))
    assert case.fit == "torque" and choose(case).case.fit == "torque" and choose(case).reason == "meta.yaml says so"


# ---- torques ------------------------------------------------------------------------------------------------------


def test_friction_of_an_axis_is_measured_by_its_torques(tmp_path):
    """Name friction of 0.25 N m and find it to 4 %, as the case's torques show; say how it was fitted.

    One low pass of motion and efforts, at the cut-off, makes it 0.217 N m: jumps are rounded in the measured torques
    and not in the predicted ones.
    """
    with one_thread():
        found = find_missing(load_case(drive(tmp_path / "case", rub=0.25)), Run(Settings(particles=0)))
    file = found.verdict_file()
    assert [e["name"] for e in file["effects"]] == ["dry_friction"], found.sentence
    assert file["effects"][0]["parameters"]["torque_Nm"]["median"] == pytest.approx(0.25, rel=0.04)
    assert file["fit"]["method"] == "torque" and file["fit"]["other"] == "replay" and file["unstable"] == []
    assert json.loads(json.dumps(file)) == file


def test_predicted_efforts_are_rounded_like_measured_ones(tmp_path):
    """Predict the jumps of friction as the second filter leaves them of the sign of the rate under the first one."""
    case = replace(load_case(drive(tmp_path / "case", noise=0.0)), fit="torque")
    own = {"bend_rad": 1e-4, "gradual": 0.0, "stribeck": 0.0, "stribeck_radps": 1.0, "load": 0.0}
    acting = (Acting("dry_friction", 0, own),)
    full = recordings_of(case)
    chosen = [thinned(case, r) for r in full]
    system = EquationError(case, chosen, 1, unknowns=Unknowns(effects=acting))
    assert [p.name for p in system.system.parameters][2:] == ["offset axis", "dry_friction@0 torque_Nm"]
    with_it = system(torch.tensor([[INERTIA, D, 0.0, 1.0]]))[0].double().numpy()
    found = (with_it - EquationError(case, chosen, 1)(torch.tensor([[INERTIA, D, 0.0]]))[0].double().numpy())[0, :, 0]
    period = int(np.ceil(1.0 / (case.filter_hz * case.dt)))
    every, taps = chosen[0].every, firwin(2 * period + 1, case.filter_hz, fs=1.0 / case.dt)
    assert every == int(0.5 / (case.filter_hz * case.dt)) and len(found) == -(-len(full[0].t) // every)
    jump = np.sign(full[0].fine[:, 1])
    smooth = np.convolve(jump, taps, "same")[::every]
    inner = slice(3, -3)  # the window's ends, where the mean is over what there is
    # a jump is a sample late: one of 20 under the window, and the window's middle weighs 0.1
    assert np.abs(found - smooth)[inner].max() < 0.15 < np.abs(jump[::every] - smooth)[inner].max()
    assert np.abs(found - smooth)[inner].mean() < 0.01


def test_noise_of_counts_is_noise_of_predicted_torques(tmp_path):
    """State I times the deviation of the twice filtered second difference of white noise, beside D times the first."""
    case = replace(load_case(drive(tmp_path / "case", noise=1e-3)), fit="torque")
    found = motion_noise(case, Unknowns(), torch.tensor([INERTIA, D, 0.0], dtype=torch.float64))[0]
    rng, step = np.random.default_rng(3), case.dt
    x = low_pass(1e-3 * rng.standard_normal((200_000, 1)), step, 3.0 * case.filter_hz)[:, 0]
    w = 2j * np.pi * np.fft.rfftfreq(len(x), step)
    torque = np.fft.irfft((INERTIA * w**2 + D * w) * np.fft.rfft(x), len(x))
    want = np.convolve(torque, window(case), "same")[1000:-1000].std()
    # six copies of a hundred samples, and a deviation that is itself estimated from 2000: 4 %
    assert found == pytest.approx(want, rel=0.12)


# ---- what a verdict hangs on --------------------------------------------------------------------------------------


def test_treatments_of_recordings(tmp_path):
    """Try other cut-offs and parts of torques; half the rate, impulses kept, of a replay; halves of one recording."""
    case = load_case(drive(tmp_path / "two", spring=20.0))
    torque = [v.what for v in variants(replace(case, fit="torque"))]
    assert torque == ["a filter of 5 Hz", "a filter of 16 Hz", "recording 1 alone", "recording 2 alone"]
    assert [v.what for v in variants(case)] == ["a rate of 100 Hz", "recording 1 alone", "recording 2 alone"]
    one = load_case(drive(tmp_path / "one", spring=20.0, runs=1))
    assert [v.what for v in variants(one)] == ["a rate of 100 Hz"]
    half = [v for v in variants(replace(one, fit="torque")) if v.what == "the first half of the recording"]
    assert len(half) == 1 and len(half[0].case.trajectories[0].t) == len(one.trajectories[0].t) // 2
    half = at_half_rate(case)
    assert half.dt == 2 * case.dt and (half.trajectories[0].output == case.trajectories[0].output[::2]).all()
    whole = case.trajectories[0].effort
    np.testing.assert_allclose(half.trajectories[0].effort[:-1], 0.5 * (whole[:-2:2] + whole[1:-1:2]), atol=1e-12)


def test_half_the_rate_is_not_integrated_in_longer_steps(tmp_path):
    """Take steps no longer where every second sample is left out: a law would mend the integration."""
    case = choose(load_case(drive(tmp_path / "slow", spring=20.0, rate=50.0)), "replay").case
    recordings, sigma = recordings_of(case), pooled_sigma(case, noise_of(case))
    first = Contest(case, recordings, sigma, ("quadratic_drag",))
    half = next(v for v in variants(case) if "rate" in v.what)
    second = _contest(first, half, None)  # the fit of the base is for torques
    steps = [c.case.dt / c.simulations.whole.substeps for c in (first, second)]
    assert steps[1] <= steps[0]


def search_of(case, names, settings):
    """Return base, searched models and a decision for the model with ``names``, all fitted."""
    run = Run(settings)
    base = prepare(case, run)
    contest = base.contest
    models = []
    for index, candidate in enumerate(contest.candidates):
        batch = base.fit.batch.copy()
        batch.active[:, list(candidate.columns)] = True
        models.append(Model((index,), fit(contest, batch, 15), True))
    fitted = FittedModels(contest, Model((), base.fit), models)
    model = next(m for m in models if fitted.names(m) == names)
    named = tuple(contest.candidates[c].acting for c in model.members)
    decision = Decision("effects", fitted.base, model, model, named, {a.label: () for a in named})
    return base, Searched(fitted, 1e-9), decision, run


def test_a_name_that_another_filter_takes_back_is_not_claimed(tmp_path):
    """Keep friction, which every treatment finds; take back a drag that was claimed in its place, and say what for."""
    settings = Settings(("dry_friction", "quadratic_drag"), particles=0)
    with one_thread():
        case = choose(load_case(drive(tmp_path / "case", rub=0.25)), "torque").case
        base, searched, right, run = search_of(case, ("dry_friction",), settings)
        assert steadied(base, searched, right, run) == right
        wrong = next(m for m in searched.fitted.models if searched.fitted.names(m) == ("quadratic_drag",))
        drag = tuple(base.contest.candidates[c].acting for c in wrong.members)
        found = steadied(base, searched, replace(right, model=wrong, final=wrong, named=drag), run)
    assert found.verdict == "unknown" and found.named == ()
    assert any("a filter of 5 Hz gives dry_friction" in line for line in found.unstable)
    said = {"unusable": None, "not_understood": (), "verdict": "unknown", "implausible": (), "remarks": ()}
    text = sentence(SimpleNamespace(**said, unstable=found.unstable))
    assert "hangs on how the data are treated: a filter of 5 Hz gives dry_friction" in text


def test_an_effect_that_is_off_is_still_off_under_another_filter(tmp_path):
    """A model whose effect is off, because nothing was better with it, has no strength with an interval."""
    settings = Settings(("quadratic_drag",), particles=0)
    with one_thread():
        case = choose(load_case(drive(tmp_path / "case", rub=0.25)), "torque").case
        base, searched, claimed, run = search_of(case, ("quadratic_drag",), settings)
        off = Model(claimed.model.members, base.fit, True, rests=True)
        searched.fitted.models[:] = [off]
        nothing = replace(claimed, verdict="none", named=(), alternatives={}, model=searched.fitted.base)
        assert steadied(base, searched, nothing, run) == nothing


# ---- a law that becomes another -------------------------------------------------------------------------------------


def turning(specs, places, lefts, at):
    """Return fitted models of one law each with one parameter, whose box is 0 to 1; the base leaves 3000.

    Args:
        specs: The parameter of each law, by the law's name.
        places: Joint of each.
        lefts: Chi-squared of each, of 1000 samples.
        at: Value of every parameter.
    """
    candidates = [Candidate(Acting(name, joint), (k,), SimpleNamespace(parameters=(spec,)))
                  for k, ((name, spec), joint) in enumerate(zip(specs.items(), places, strict=True))]  # fmt: skip
    one = torch.ones(2, dtype=torch.float64)
    contest = SimpleNamespace(num_samples=1000, candidates=candidates, low=0.0 * one, high=one)

    def model(members, chi2):
        batch = Batch(at * one[None], one[None] > 0.0, torch.zeros(0), torch.zeros(0))
        return Model(members, Fits(batch, *[torch.tensor([chi2])] * 4), True)

    return FittedModels(contest, model((), 3000.0), [model((k,), left) for k, left in enumerate(lefts)])


@pytest.mark.parametrize(
    ("bend", "left", "place", "turned"),
    [(1.0, 1080.0, 0, True), (0.5, 1080.0, 0, False), (1.0, 1200.0, 0, False), (1.0, 1080.0, 1, False)],
)
@pytest.mark.parametrize("end", ["becomes", "below"])
def test_friction_that_bends_as_far_as_it_may_is_hysteresis(bend, left, place, turned, end):
    """Take hysteresis at its joint where it explains as much to 3 % of the excess, 2000 squares, and not elsewhere.

    A law may turn into another at either end of its box.
    """
    spec = EffectParameter("bend_rad", "rad", 0.0, 1.0, **{end: "hysteresis_boucwen"})
    bend = bend if end == "becomes" else 1.0 - bend
    fitted = turning({"dry_friction": spec, "hysteresis_boucwen": spec}, (0, place), (1030.0, left), bend)
    friction, other = fitted.models
    assert _turned_into(fitted, friction) is (other if turned else friction)


@pytest.mark.parametrize(("high", "held"), [((1.0, 1.0), (0,)), ((2.0, 1.0), ()), ((1.0, 2.0), ())])
def test_two_laws_that_each_end_where_they_become_the_other_are_none(high, held):
    """Claim neither friction that never slides nor a slider's spring as stiff as can be, though noise alone is left.

    A wind that differs from recording to recording was such a friction (blind case of an independent generator).
    """
    specs = {"dry_friction": EffectParameter("bend_rad", "rad", 0.0, 1.0, becomes="hysteresis_boucwen"),
             "hysteresis_boucwen": EffectParameter("share", "1", 0.0, 1.0, becomes="dry_friction")}  # fmt: skip
    fitted = turning(specs, (0, 0), (1030.0, 1040.0), 1.0)
    fitted.contest.high = torch.tensor(high, dtype=torch.float64)
    assert held_fast(fitted, fitted.models[0]) == held


@pytest.mark.parametrize(("share", "turned"), [(0.0, True), (0.05, False)])
def test_a_slider_that_yields_at_once_is_friction(share, turned):
    """Take friction that explains as much where the slider yields as soon as it may, and not where it yields later."""
    yields = effect_of("hysteresis_boucwen").branch.parameters[1]
    plain = EffectParameter("torque_Nm", "N m", 0.0, 1.0)
    fitted = turning({"hysteresis_boucwen": yields, "dry_friction": plain}, (0, 0), (1030.0, 1050.0), share)
    slider, friction = fitted.models
    assert _turned_into(fitted, slider) is (friction if turned else slider)


def test_a_break_is_tried_in_every_part_of_every_recording():
    """Try moments in the last third of each, where a break was missed; as fitted, and with what is optional off."""
    law = effect_of("partial_rupture").branch
    own = Candidate(Acting("partial_rupture", 0), tuple(range(6)), law)
    runs = tuple(SimpleNamespace(t_start=x, t=np.array([0.0, 3.0])) for x in (5.0, 30.0))
    case = BranchCase.__new__(BranchCase)
    object.__setattr__(case, "trajectories", runs)
    contest = SimpleNamespace(case=case, parameters=[SimpleNamespace(free=lambda value: value)] * 6)
    one = torch.tensor([[0.4, 33.5, 0.7, 0.2, 0.03, 0.01]], dtype=torch.float64)
    tried = _at_moments(contest, Batch(one, one > 0.0, torch.zeros(1, 0), torch.ones(1, 2)), own).free
    fitted, off = tried.chunk(2)
    for own_half in (fitted, off):
        for run in runs:
            away = own_half[:, 1] - run.t_start
            assert int(((away > 2.0) & (away < 3.0)).sum()) >= 3 and int(((away >= 0.0) & (away < 1.0)).sum()) >= 3
    assert (fitted[:, [0, 2, 3, 4, 5]] == one[:, [0, 2, 3, 4, 5]]).all()
    neutral = torch.tensor([s.neutral for s in law.parameters[2:]], dtype=torch.float64)
    assert (off[:, 0] == 0.4).all() and (off[:, 2:] == neutral).all()


@pytest.mark.parametrize(("off", "left", "turned"), [(0.5, 1050.0, True), (0.1, 1050.0, False), (0.5, 1200.0, False)])
def test_a_spring_that_softens_far_from_rest_is_a_softer_one(off, left, turned):
    """Take the other spring that explains as much as one-sided softening beyond a quarter of how far it may be."""
    plain = EffectParameter("relative", "1", 0.0, 1.0)
    specs = {"bilinear_stiffness": effect_of("bilinear_stiffness").branch.parameters[3], "anisotropic_stiffness": plain}
    fitted = turning(specs, (0, 0), (1030.0, left), 0.5 + 0.5 * off)  # it may stiffen by as much
    sided, other = fitted.models
    assert _turned_into(fitted, sided) is (other if turned else sided)


@pytest.mark.parametrize(
    ("offset", "read", "left", "turned"),
    [([0.0, 0.02, 0.04, 0.0], 0.066, 1050.0, True), ([0.0, 0.02, 0.04, 0.0], 0.066, 1200.0, False),
     ([0.0, 0.01, 0.06, 0.0], 0.066, 1050.0, False), ([0.0, 0.0, 0.01, 1.0], 0.066, 1050.0, False),
     ([0.0, 0.02, 0.04, 0.0], 0.0, 1050.0, False), ([0.0, 0.04, 0.0], 0.066, 1050.0, True)],
)  # fmt: skip
def test_an_offset_that_an_open_gripper_does_not_read_is_a_weight(offset, read, left, turned):
    """Take a tool's weight that explains as much where the offset is another than the open gripper's by a third.

    What is read of an open gripper may be most of the offset; and where nothing is, it says nothing. A planar case has
    no offset along y.
    """
    plain = EffectParameter("mass_kg", "kg", 0.0, 1.0)
    fitted = turning({"force_bias": plain, "gravity_comp_error": plain}, (None, None), (1030.0, left), 0.5)
    contest = fitted.contest
    contest.case = BranchCase.__new__(BranchCase)
    let_go, held = np.array([True, False]), np.array([True, True])  # nothing is read where it is never let go
    contest.recordings = [
        SimpleNamespace(opened=np.array([0.0, 0.0, own]), t=np.arange(2.0), t_start=start, contact=contact)
        for own, start, contact in ((read, 0.0, let_go), (0.0, 5.0, held))
    ]
    acting = Acting("force_bias", known={} if len(offset) == 4 else {"force_y_N": 0.0})
    offset = [*offset, 0.0, 0.0]  # it does not jump
    contest.candidates[0] = Candidate(acting, tuple(range(len(offset))), effect_of("force_bias").branch)
    contest.values = lambda batch: torch.tensor([offset])
    biased, other = fitted.models
    assert _turned_into(fitted, biased) is (other if turned else biased)
