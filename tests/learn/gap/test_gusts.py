"""Gusts of any course: who sways untouched, what is read off recordings, and the verdict, on simulated branches."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml
from bough.learn.cases.case import load_case
from bough.learn.gap import search
from bough.learn.gap.diagnose import find_missing
from bough.learn.gap.diagnosis import Settings
from bough.learn.gap.gusts.answers import acting_along
from bough.learn.gap.gusts.course import Process, rms_of
from bough.learn.gap.gusts.read_off import blows_on, blows_open, explains, gusts_in, read_off
from bough.learn.gap.gusts.sway import differs, sways
from bough.learn.gap.models.contest import Contest
from bough.learn.gap.models.refit import fit
from bough.learn.gap.report import write_diagnosis, write_models
from bough.learn.gap.run import Run
from bough.learn.hidden.hide import hide
from bough.learn.inference.replayed import replay_model
from bough.learn.replay.recording import recordings
from bough.learn.replay.rollout import Rollout
from bough.learn.runs.checkpoint import Checkpoint
from bough.learn.systems.acting import Acting
from bough.learn.systems.branch import Unknowns
from bough.learn.systems.model_file import model_of, read_model
from bough.sim.base.errors import InputError
from bough.sim.effects import effect_of
from oracles.case_files import make_planar

#: Pressure of gusts [Pa] that sways this branch by a third of its motion; deviation of the sensors, of each channel.
PRESSURE, NOISE = 25.0, 0.02


@pytest.fixture(scope="module")
def branch(tmp_path_factory):
    """Return a branch of two segments whose pushes, some repeated, are recorded, and its springs and dampers."""
    folder = tmp_path_factory.mktemp("branch") / "case"
    answer = hide(folder, seed=21, segments=2, noise=0.03, samples=80)
    return load_case(folder), np.concatenate([answer["truth"]["K"], answer["truth"]["D"]])


def courses(case, seed, wave=0.4):
    """Return a course for every recording: a normal process that forgets over ``wave`` seconds, of rms one."""
    rng, out = np.random.default_rng(seed), []
    for t in case.trajectories:
        steps = rng.normal(size=(case.lead + len(t.t), 2))
        fade, x = np.exp(-case.dt / wave), np.zeros(2)
        rows = [x := fade * x + np.sqrt(1 - fade**2) * step for step in steps]
        out.append(np.array(rows))
    size = rms_of(out)
    return [own / size for own in out]


def measured(case, springs, blown, *, acting=None, seed=3):
    """Simulate the recordings with an effect, add noise, and return their contest and its base, fitted."""
    effect = acting or replace(acting_along(), known={**acting_along().known, "rms_Pa": PRESSURE})
    chosen = recordings(case)
    given = [replace(r, course=c, sways=c is not None) for r, c in zip(chosen, blown, strict=True)]
    rollout = Rollout(case, given, 1, unknowns=Unknowns(effects=(effect,)))
    out = rollout(torch.tensor(springs[None]))[0].double().cpu().numpy().copy()
    sigma = NOISE * np.sqrt((out**2).mean((0, 1)))
    noise = np.random.default_rng(seed).normal(size=out.shape) * sigma
    seen = [replace(r, output=(y + e)[: len(r.t)], sways=bool(blown[0] is not None))
            for r, y, e in zip(chosen, out, noise, strict=True)]  # fmt: skip
    contest = Contest(case, seen, sigma, ("wind_gust",))
    return contest, fit(contest, contest.base_batch(1), 12)


def test_gusts_are_seen_and_read_off(branch):
    """Tell that a branch in turbulence sways and never twice the same; find springs, pressures and their time.

    A third of the motion is the gusts' and the noise 2 %: what moves the branch is known well, and a pressure that
    changes within its period less so.
    """
    case, springs = branch
    blown = courses(case, 1)
    contest, base = measured(case, springs, blown)
    assert sways(contest) and differs(contest, contest.residual(base.batch)[0])
    found = Process(contest, base.batch).fit()
    truth = [PRESSURE * own[case.lead :] for own in blown]
    seen = [
        k.course(p, r)[case.lead :] for k, p, r in zip(found.knots, found.pressure, contest.recordings, strict=True)
    ]
    a, b = (np.concatenate(x).ravel() for x in (truth, seen))
    assert np.corrcoef(a, b)[0, 1] > 0.8
    assert abs(rms_of(seen) / PRESSURE - 1) < 0.2 and 0.1 < found.time < 1.2
    stiffness = np.exp(found.free.cpu().numpy())[:2] / springs[:2]
    assert np.abs(stiffness - 1).max() < 0.05
    assert found.deviance < float(base.chi2[0]) - 1000.0
    own, fits = read_off(contest, base, found)
    assert float(fits.chi2[1]) < 1.1 * contest.num_samples < 0.2 * float(fits.chi2[0])
    assert blows_on(own, fits) and blows_open(own)


def test_gusts_are_read_off_in_a_plane(tmp_path):
    """Read gusts off a branch whose case shows one plane alone: what blows across it is not seen, and is nothing.

    Of two sizes and a turn the one across the plane was any number, and the branch was blown out of its plane by it.
    """
    answer = hide(tmp_path / "solid", seed=22, segments=2, noise=0.03, samples=80)
    make_planar(tmp_path / "solid", tmp_path / "flat")
    case, springs = load_case(tmp_path / "flat"), np.concatenate([answer["truth"]["K"], answer["truth"]["D"]])
    blown = [own * [1.0, 0.0] for own in courses(case, 1)]
    contest, base = measured(case, springs, blown)
    assert differs(contest, contest.residual(base.batch)[0])
    found = gusts_in(contest, base)
    assert found is not None
    own, fits = found
    assert float(fits.chi2[1]) < 1.1 * contest.num_samples < 0.5 * float(fits.chi2[0])
    assert all(np.abs(r.course[:, 1]).max() == 0.0 for r in own.recordings)


def test_a_law_of_the_branch_is_no_gust(branch):
    """Neither sway untouched nor differ from repeat to repeat with friction instead."""
    case, springs = branch
    neutral = {p.name: p.neutral for p in effect_of("dry_friction").branch.parameters}
    friction = Acting("dry_friction", 0, {**neutral, "torque_Nm": 0.02 * springs[0], "bend_rad": 0.002})
    contest, base = measured(case, springs, [None] * len(case.trajectories), acting=friction)
    assert gusts_in(contest, base) is None
    assert float(base.chi2[0]) > 1.5 * contest.num_samples  # it is seen
    assert not sways(contest)
    assert not differs(contest, contest.residual(base.batch)[0])


def test_a_branch_that_still_swings_is_in_no_wind(branch):
    """Read a course off a branch that was let go before every recording: it ends where that begins."""
    case, springs = branch
    blown = courses(case, 2)
    for own in blown:
        own[case.lead - 5 :] = 0.0
    contest, base = measured(case, springs, blown)
    assert sways(contest)
    own, fits = read_off(contest, base, Process(contest, base.batch).fit())
    assert float(fits.chi2[1]) < 1.2 * contest.num_samples < float(fits.chi2[0])
    assert not blows_on(own, fits)


def test_what_waits_for_the_gripper_is_no_wind(branch):
    """Read a course off a branch that explains all but blows as a gripper is closed: what is wrong with springs does.

    Springs that drift over the hours, of a branch that rests elsewhere for it and sways as it is let go, were gusts.
    """
    case, springs = branch
    blown = courses(case, 3)
    for own, r in zip(blown, recordings(case), strict=True):
        own[: case.lead] *= 0.3
        own[case.lead :][~r.contact] *= 0.3
    contest, base = measured(case, springs, blown)
    own, fits = read_off(contest, base, Process(contest, base.batch).fit())
    assert explains(own, fits) and blows_on(own, fits) and not blows_open(own)
    assert gusts_in(contest, base) is None


def test_hidden_turbulence_is_named(tmp_path, monkeypatch):
    """Name gusts that C MuJoCo blew on a branch of finer links, leave little, and replay the file to the last digit.

    Beside what leaves noise alone no pair is begun again; a run that is gone on with finds the same.
    """
    hidden = {"effects": ("wind_gust",), "forms": {"wind_gust": "dryden"}, "size": 0.3}
    hide(tmp_path / "case", **hidden, seed=4, segments=2, noise=0.03)
    case = load_case(tmp_path / "case")
    monkeypatch.setattr(search, "_settle_level", lambda fitted, further, count: pytest.fail("a pair is begun again"))
    keep = Checkpoint(tmp_path / "kept", "gusty")
    keep.open(False)
    run = Run(Settings(("wind_gust", "dry_friction"), particles=0), keep)
    found, again = find_missing(case, run), find_missing(case, run)
    assert (again.effects, again.parameters, again.gap) == (found.effects, found.parameters, found.gap)
    assert [a.name for a in found.effects] == ["wind_gust"], found.sentence
    excess = [x**2 - found.gap.noise_floor**2 for x in (found.gap.repaired, found.gap.base)]
    assert excess[0] < 0.1 * excess[1]
    (tmp_path / "out").mkdir()
    write_diagnosis(tmp_path / "out", found)
    write_models(tmp_path / "out", found)
    again = replay_model(case, model_of(tmp_path / "out" / "model.yaml", case))
    assert f"{again.rms:.3g}" == f"{found.gap.repaired:.3g}"


def test_courses_that_do_not_fit_are_refused(branch, tmp_path):
    """Say in one line what is wrong with the courses of a model file."""
    case, springs = branch
    names = case.segment_name
    effect = {"name": "wind_gust", "joint": None,
              "parameters": {**acting_along().known, "rms_Pa": 10.0}}  # fmt: skip
    content = {"format": "branch-model/1", "name": "gusty", "effects": [effect],
               "segments": [{"name": n, "stiffness_Nmprad": float(k), "damping_Nmsprad": 0.1}
                            for n, k in zip(names, springs, strict=False)]}  # fmt: skip
    whole = [{"file": t.file, "x": [0.0] * (case.lead + len(t.t)), "y": [0.0] * (case.lead + len(t.t))}
             for t in case.trajectories]  # fmt: skip
    short = [{**whole[0], "x": [0.0], "y": [0.0]}, *whole[1:]]
    path = tmp_path / "model.yaml"
    for given, words in (
        ([], "without courses"),
        ([{**whole[0], "y": [0.0]}], "1 of y"),
        ([whole[0]] * 2, "a second time"),
    ):
        path.write_text(yaml.safe_dump(content | {"courses": given}))
        with pytest.raises(InputError, match=words):
            read_model(path)
    for given, words in ((short, "1 values"), (whole[:1], "0 values")):
        path.write_text(yaml.safe_dump(content | {"courses": given}))
        with pytest.raises(InputError, match=words):
            model_of(path, case)
    path.write_text(yaml.safe_dump(content | {"courses": whole}))
    assert set(model_of(path, case).courses) == {t.file for t in case.trajectories}
