"""What is left of torques, against a free function of angle and rate."""

from types import SimpleNamespace

import numpy as np
import pytest
import torch
from bough.learn.cases.case import JointCase
from bough.learn.gap import decide
from bough.learn.gap.models import memoryless
from bough.learn.gap.models.fitted import FittedModels, Model
from bough.learn.gap.models.memoryless import (
    beyond_angle,
    left_without_memory,
    memoryless_share,
    of_the_angle,
    without_memory,
)
from bough.sim.effects import effect_of

RUNS, SAMPLES = 3, 200


def torque_case(fit="torque"):
    """Return a case of one joint that is fitted by its torques, or replayed."""
    case = object.__new__(JointCase)
    for name, value in {"fit": fit, "joints": (SimpleNamespace(name="axis"),),
                        "inputs": (SimpleNamespace(joint="axis"),)}.items():  # fmt: skip
        object.__setattr__(case, name, value)
    return case


def left_by(law, size, noise=1.0, names=("dry_friction",), base=1e6):
    """Return models of a joint that swings, the one of which leaves noise and ``size`` times a law (angle, rate, t)."""
    rng = np.random.default_rng(5)
    t = np.linspace(0.0, 20.0, SAMPLES)
    runs, left = [], []
    for k in range(RUNS):
        phase = rng.uniform(0.0, 6.0, 2)
        q = np.sin(1.3 * t + phase[0]) + 0.6 * np.sin(0.37 * t + phase[1])
        w = np.gradient(q, t)
        runs.append(SimpleNamespace(t=t, input=np.stack([q, w, np.gradient(w, t)], axis=1)))
        left.append(size * law(q, w, t + 20.0 * k) + noise * rng.standard_normal(SAMPLES))
    residual = torch.as_tensor(np.array(left))[None, :, :, None]
    candidates = [SimpleNamespace(name=n, columns=(0,), law=effect_of(n).joint) for n in names]
    contest = SimpleNamespace(case=torque_case(), recordings=runs, num_samples=RUNS * SAMPLES, candidates=candidates,
                              residual=lambda _: residual)  # fmt: skip

    def model(members, chi2):
        one = torch.tensor([float(chi2)])
        return Model(members, SimpleNamespace(batch=None, chi2=one, cost=one))

    own = model(tuple(range(len(names))), (residual**2).sum())
    return FittedModels(contest, model((), base), [own])


def spot(q, w, _t):
    return -np.sign(w) * np.exp(-(((q - 0.2) / 0.4) ** 2))


def remembered(q, _w, _t):
    """Return what a state that forgets within ten samples makes of where the joint has been."""
    out = np.zeros_like(q)
    for k in range(1, len(q)):
        out[k] = 0.9 * out[k - 1] + 0.4 * np.sin(3.0 * np.cumsum(q)[k])
    return out


def test_friction_in_one_place_is_seen_and_a_law_of_the_past_is_not():
    """Predict most of what a rubbing spot leaves and little of what a memory or the clock does."""
    seen = left_by(spot, 30.0)
    assert 0.6 < memoryless_share(seen, seen.models[0]) <= 1.0
    for law in (remembered, lambda q, w, t: np.sin(7.3 * t)):
        other = left_by(law, 30.0)
        assert memoryless_share(other, other.models[0]) < 0.25


def test_noise_is_no_function_of_the_motion():
    """Predict nothing of white noise: its squares are N within 3 sqrt(2 N), and no spline may gain by chance."""
    fitted = left_by(spot, 0.0, noise=1.1)  # 0.21 N beyond the noise that is known
    assert memoryless_share(fitted, fitted.models[0]) < 0.05
    quiet = left_by(spot, 0.0, noise=0.8)
    assert memoryless_share(quiet, quiet.models[0]) == 0.0


def teeth(q, _w, _t):
    """Return bumps of a twelfth of the swing that push back and then forth, one every 0.9 rad."""
    x = ((q / 0.9 + 0.2) % 1.0 - 0.5) / 0.06
    return -2.3 * x * np.exp(-(x**2))


@pytest.mark.parametrize("beside", [None, teeth])
def test_friction_is_no_function_of_the_angle(beside):
    """Explain by friction what no function of the angle does, alone and beside teeth; nothing where there are teeth.

    A model that takes 0.3 of what the teeth do off, as friction in their place did, explains nothing beyond them.
    """
    rubs = left_by(lambda q, w, t: 30.0 * np.sign(w) + 20.0 * (0.0 if beside is None else beside(q, w, t)), 1.0)
    worn = left_by(teeth, 30.0)
    for fitted, share in ((rubs, 0.95), (worn, 0.3)):
        whole, at = fitted.contest.residual(None), fitted.contest.recordings
        signs = torch.as_tensor(np.array([np.sign(r.input[:, 1]) for r in at]))[None, :, :, None]
        own = (whole * signs).mean() * signs  # friction by least squares
        less = whole - own if fitted is rubs else whole * (1.0 - share) ** 0.5
        fitted.base.fit.batch, fitted.models[0].fit.batch = "base", "own"
        fitted.contest.residual = {"base": whole, "own": less}.__getitem__
    assert beyond_angle(rubs, rubs.models[0]) > 0.9
    assert beyond_angle(worn, worn.models[0]) < 0.4


@pytest.mark.parametrize(
    ("law", "size", "seen"),
    [
        (teeth, 2.0, True),
        (lambda q, w, t: np.sin(1.3 * q), 0.7, True),  # a pull off centre
        (teeth, 0.0, False),
        (lambda q, w, t: np.sin(7.3 * t), 0.9, False),
    ],
)
def test_cogging_within_the_noise_is_something(law, size, seen):
    """Say unknown, not none, where a function of the angle predicts torques left out that pass for noise in all.

    A replay is not asked, nor is a change of the motion below the tolerance.
    """
    fitted = left_by(law, size)
    left = fitted.models[0]
    assert left.chi2 < 1.5 * fitted.contest.num_samples and (of_the_angle(fitted, left) > 0.0) is seen
    fitted = FittedModels(fitted.contest, left, [left])
    base, searched = SimpleNamespace(unusable=None, motion=50.0), SimpleNamespace(fitted=fitted, p_value=1.0)
    assert decide._verdict(base, searched, left, 0.0055)[0] == ("unknown" if seen else "none")
    assert decide._verdict(base, searched, left, 0.1)[0] == "none"
    if seen:
        (text,) = without_memory(left_without_memory(fitted, left))
        assert "function of the joint's angle and rate" in text
    fitted.contest.case = torque_case("replay")
    assert of_the_angle(fitted, left) == 0.0


@pytest.mark.parametrize(
    "names, share, beyond, left, claimed",
    [
        (("dry_friction",), 0.5, 0.5, 0.04, True),  # a real arm's gears
        (("dry_friction",), 0.5, 0.9, 0.6, False),  # a seal that rubs in one place
        (("dry_friction",), 0.5, 0.2, 0.04, False),  # worn teeth
        (("dry_friction",), 0.3, 0.9, 0.04, False),
        (("dry_friction",), 0.9, 0.0, 0.6, True),  # friction of another form
        (("plastic_set",), 0.78, 0.9, 0.0, False),  # a diode
        (("dry_friction", "plastic_set"), 0.78, 0.9, 0.0, False),
        (("plastic_set",), 0.9, 0.0, 0.0, True),
    ],
)
def test_only_friction_is_named_beside_a_large_rest(monkeypatch, names, share, beyond, left, claimed):
    """Name friction for less than other laws, unless what it leaves is a function of angle and rate.

    Or unless a function of the angle does as well.
    """
    monkeypatch.setattr(decide, "memoryless_share", lambda fitted, model: left)
    monkeypatch.setattr(decide, "beyond_angle", lambda fitted, model: beyond)
    fitted = left_by(spot, 30.0, names=names)
    own = fitted.models[0]
    excess = (own.chi2 - fitted.contest.num_samples) / (1.0 - share)
    fitted.base.fit.chi2[0] = fitted.contest.num_samples + excess
    assert decide.known(fitted, own) is claimed


@pytest.mark.parametrize(
    "names, share, claimed",
    [
        (("dry_friction",), 0.78, True),  # a real servo's
        (("dry_friction",), 0.70, False),
        (("plastic_set",), 0.78, False),
        (("plastic_set",), 0.93, False),  # a diode
        (("plastic_set",), 0.96, True),
        (("dry_friction", "plastic_set"), 0.78, False),
        (("dry_friction", "dry_friction"), 0.78, True),
        (("force_scale",), 0.97, False),  # a belt that swings
        (("force_scale",), 0.998, True),
        (("plastic_set", "force_scale"), 0.96, True),  # the loop has another form
    ],
)
def test_friction_of_a_replay_is_named_for_less_than_other_laws(names, share, claimed):
    """Name friction at joints for three quarters of the excess, others for 0.95, a sensor alone for nearly all."""
    fitted = left_by(spot, 60.0, names=names)
    own, fitted.contest.case = fitted.models[0], torque_case("replay")
    samples = fitted.contest.num_samples
    assert own.chi2 > 300.0 * samples  # beyond where less is asked of any law
    fitted.base.fit.chi2[0] = samples + (own.chi2 - samples) / (1.0 - share)
    assert decide.known(fitted, own) is claimed


def test_what_passes_for_noise_of_torques():
    """Name at seven tenths where a chi-squared of 1.5 is left, as joints without an effect do; not at 1.6."""
    for noise, claimed in ((1.2, True), (1.3, False)):
        fitted = left_by(spot, 0.0, noise=noise, names=("plastic_set",))
        own, samples = fitted.models[0], fitted.contest.num_samples
        fitted.base.fit.chi2[0] = samples + (own.chi2 - samples) / 0.25  # explains 0.75
        assert (own.chi2 / samples > 1.5) is not claimed and decide.known(fitted, own) is claimed


def test_the_page_says_that_the_rest_has_no_memory(monkeypatch):
    """Tell a user of a function of angle and rate with its share; say nothing of noise, of a memory, of a replay."""
    seen, other = left_by(spot, 30.0), left_by(remembered, 30.0)
    (text,) = without_memory(left_without_memory(seen, seen.models[0]))
    assert text.startswith(f"{memoryless_share(seen, seen.models[0]):.0%} of the torques left")
    assert without_memory(left_without_memory(other, other.models[0])) == ()
    quiet = left_by(spot, 0.5)
    assert (
        quiet.models[0].chi2 < 1.5 * quiet.contest.num_samples
        and without_memory(left_without_memory(quiet, quiet.models[0])) == ()
    )
    monkeypatch.setattr(memoryless, "fits_torque", lambda case: False)
    assert without_memory(left_without_memory(seen, seen.models[0])) == ()
