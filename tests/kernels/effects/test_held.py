"""A branch that friction or a play holds off its rest begins there: by hand, and as a long experiment cut in two."""

from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml
from bough.learn.cases.case import load_case
from bough.learn.cases.noise import estimate_noise
from bough.learn.replay.recording import recordings, standing
from bough.learn.replay.rollout import Rollout
from bough.learn.systems.acting import Acting
from bough.learn.systems.branch import Unknowns
from bough.sim.effects import effect_of
from oracles.effect_case import simulate, stick_case

K, D, LEVER = 5.0, 0.02, 0.4
#: Dry friction bends by this much before it slips [rad].
BEND = 5e-4


def away(case, size):
    """Return a displacement of ``size`` metres across the stick, and the direction."""
    across = np.cross(case.axis[0], [0.0, 0.0, 1.0])
    across /= np.linalg.norm(across)
    return size * across, across


def begun(case, off):
    """Return the case's recordings with another place where the branch stands."""
    return [replace(r, off=np.asarray(o)) for r, o in zip(recordings(case), off, strict=True)]


@pytest.mark.parametrize(
    ("law", "most"),
    [({"dry_friction": {"torque_Nm": 0.3}}, 0.3),
     ({"hysteresis_boucwen": {"share": 0.5, "yield_rad": 0.12}}, 0.5 * K * 0.12),
     ({"backlash": {"gap_rad": 0.12}}, K * 0.12)],
    ids=["friction", "hysteresis", "play"],
)  # fmt: skip
def test_it_stands_where_it_is_found_or_as_far_as_is_held(tmp_path, law, most):
    """Untouched it stays at d where the law holds K |d| / l, and else at the turn most / K.

    Where it is not found off its rest it rests, or stands where what the law remembers holds it.
    """
    case = stick_case(tmp_path / "c", [np.zeros((40, 3))] * 3, gravity=0.0)
    place, across = away(case, 0.01)
    assert K * 0.01 / LEVER < most < K * 0.1 / LEVER
    out = simulate(case, K, D, chosen=begun(case, [place, 10 * place, 0 * place]), form="branch", **law)[..., :3]
    # a turn phi moves the point by l sin(phi), phi^2 / 6 less than l phi, and l phi^2 / 2 along the stick
    left = most / K if "hysteresis_boucwen" in law else 0.0
    for run, turn in zip(out, (0.01 / LEVER, most / K, left), strict=True):
        expected = LEVER * (np.sin(turn) * across - (1.0 - np.cos(turn)) * case.axis[0])
        np.testing.assert_allclose(run, np.tile(expected, (40, 1)), atol=1e-7)


def test_without_the_law_it_rests(tmp_path):
    """A friction of nothing holds nothing: the bits of a branch that begins at rest."""
    force = 2.0 * np.sin(np.linspace(0, 9, 40))[:, None] * np.array([1.0, 0.3, 0.0])
    case = stick_case(tmp_path / "c", [force])
    ends = [simulate(case, K, D, chosen=begun(case, [off]), form="branch", quadratic_drag={"coefficient_kgpm3": 2.0})
            for off in (np.zeros(3), away(case, 0.02)[0])]  # fmt: skip
    np.testing.assert_array_equal(*ends)


@pytest.mark.parametrize(
    "law", [{"dry_friction": {"torque_Nm": 0.4}}, {"hysteresis_boucwen": {"share": 2.0, "yield_rad": 0.04}},
            {"backlash": {"gap_rad": 0.08}}],
    ids=["friction", "hysteresis", "play"],
)  # fmt: skip
def test_an_experiment_cut_in_two_is_the_same(tmp_path, law):
    """Pull, let go, wait, pull otherwise: what comes after, begun where the branch then stands, is the same."""
    dt, cut = 0.02, 200
    t = np.arange(360) * dt
    pull = 3.0 * np.clip(np.minimum(t, 1.6 - t), 0.0, 0.6) / 0.6
    other = 2.5 * np.clip(np.minimum(t - 4.2, 5.8 - t), 0.0, 0.6) / 0.6
    force = pull[:, None] * [0.9, 0.4, 0.1] + other[:, None] * [-0.5, 0.8, -0.2]
    whole = stick_case(tmp_path / "whole", [force], gravity=0.0)
    parts = stick_case(tmp_path / "parts", [force[cut:]], gravity=0.0)
    long = simulate(whole, K, 0.2, form="branch", **law)[0]
    assert np.linalg.norm(long[cut, :3]) > 0.003 and np.abs(long[cut, 3:]).max() < 1e-4
    short, plain = (simulate(parts, K, 0.2, chosen=begun(parts, [off]), form="branch", **law)[0]
                    for off in (long[cut, :3], np.zeros(3)))  # fmt: skip
    # the smallest turn leaves out that about the stick's own axis, second order in the way (0.03 rad)
    np.testing.assert_allclose(short[:, :3], long[cut:, :3], atol=2e-3 * np.abs(long[:, :3]).max())
    assert np.abs(plain[:, :3] - long[cut:, :3]).max() > 0.03 * np.abs(long[:, :3]).max()


@pytest.mark.parametrize("told", [False, True])
def test_hysteresis_goes_on_from_one_recording_to_the_next(tmp_path, told):
    """Cut in two recordings, the second is what it was in one, told where the branch stands or not.

    Nothing is left out here, as where only the place is known (above). 2e-5 of the way are sixteen steps towards rest
    in float32.
    """
    dt, cut = 0.02, 200
    t = np.arange(2 * cut) * dt
    pull = 3.0 * np.clip(np.minimum(t, 1.6 - t), 0.0, 0.6) / 0.6
    back = -2.0 * np.clip(np.minimum(t - 1.2, 2.4 - t), 0.0, 0.4) / 0.4
    other = 2.5 * np.clip(np.minimum(t - 4.2, 5.8 - t), 0.0, 0.6) / 0.6
    force = pull[:, None] * [0.9, 0.4, 0.1] + back[:, None] * [0.2, 0.9, 0.3] + other[:, None] * [-0.5, 0.8, -0.2]
    law = {"hysteresis_boucwen": {"share": 2.0, "yield_rad": 0.04, "twist": 0.5}}
    long = simulate(stick_case(tmp_path / "whole", [force], gravity=0.0), K, 0.2, form="branch", **law)[0]
    assert np.linalg.norm(long[cut, :3]) > 0.003 and np.abs(long[cut, 3:]).max() < 1e-4
    parts = stick_case(tmp_path / "parts", [force[:cut], force[cut:]], gravity=0.0)
    off = [np.zeros(3), long[cut, :3] * told]
    out = simulate(parts, K, 0.2, chosen=begun(parts, off), form="branch", **law)
    for run, part in zip(out, (long[:cut], long[cut:]), strict=True):
        np.testing.assert_allclose(run[:, :3], part[:, :3], atol=2e-5 * np.abs(long[:, :3]).max())


def test_hysteresis_may_forget_the_recording_before(tmp_path):
    """Alone, of two recordings, the second is the same where the slider keeps nothing; it keeps half or all else.

    Where a branch was left to creep back, or was taken to its rest, its slider is not where the first one left it.
    """
    t = np.arange(200) * 0.02
    pull = 3.0 * np.clip(np.minimum(t, 1.6 - t), 0.0, 0.6) / 0.6
    first, second = pull[:, None] * [0.9, 0.4, 0.1], pull[:, None] * [-0.5, 0.6, -0.2]
    pair = stick_case(tmp_path / "pair", [first, second], gravity=0.0)
    law = {"share": 2.0, "yield_rad": 0.04}
    alone = stick_case(tmp_path / "alone", [second], gravity=0.0)
    own = simulate(alone, K, 0.2, form="branch", hysteresis_boucwen=law)[0]
    none, half, every = (simulate(pair, K, 0.2, form="branch", hysteresis_boucwen=law | {"kept": share})[1]
                         for share in (0.0, 0.5, 1.0))  # fmt: skip
    # it begins where steps towards rest end, which in float32 is 2e-5 of the way off
    np.testing.assert_allclose(none[:, :3], own[:, :3], rtol=0.0, atol=4e-5 * np.abs(own[:, :3]).max())
    stands = [np.linalg.norm(run[0, :3]) for run in (none, half, every)]
    assert stands[0] < 1e-6 and 0.2 * stands[2] < stands[1] < 0.8 * stands[2] and stands[2] > 0.003


@pytest.mark.parametrize("holding", [(0,), (1,), (0, 1)])
def test_joints_that_hold_take_it_there(tmp_path, holding):
    """Of two joints those with friction turn, by the least that takes the point there; the others are at rest."""
    case = stick_case(tmp_path / "c", [np.zeros((20, 3))], gravity=0.0)
    meta = yaml.safe_load((case.folder / "meta.yaml").read_text())
    meta["segments"].append({**meta["segments"][0], "name": "upper", "elevation_deg": 70.0})
    meta["grasp"]["segment"] = "upper"
    (case.folder / "meta.yaml").write_text(yaml.safe_dump(meta))
    case = load_case(case.folder)
    point = case.lower_end[1] + 0.4 * case.axis[1]
    arms = [point - case.lower_end[i] for i in (0, 1)]
    off = np.cross([0.01, -0.02, 0.01], arms[holding[0]])
    square = sum(arms[i] @ arms[i] for i in holding)
    turns = [np.cross(arms[i], off) / square for i in holding]
    first = sum(np.cross(turn, arms[i]) for turn, i in zip(turns, holding, strict=True))
    friction = {p.name: p.neutral for p in effect_of("dry_friction").branch.parameters}
    acting = tuple(Acting("dry_friction", i, friction | {"torque_Nm": 3.0, "bend_rad": BEND}) for i in holding)
    rollout = Rollout(case, begun(case, [off]), 1, unknowns=Unknowns(effects=acting))
    rollout._output.torch.fill_(torch.nan)
    out = rollout(torch.tensor([[20.0, 20.0, 0.1, 0.1]], dtype=torch.float64))[0, 0, :, :3].numpy()
    assert np.linalg.norm(first - off) < (1e-6 if len(holding) == 1 else 0.3) * np.linalg.norm(off)
    # second order in turns of 0.03 rad and less
    np.testing.assert_allclose(out, np.tile(first, (20, 1)), atol=0.03 * np.linalg.norm(first))


def test_where_it_stands_is_read_off_the_samples_before_the_pull(tmp_path):
    """Means of still samples without force count, beyond four deviations; a motion, a force or noise alone do not."""
    t, rng = np.arange(120) * 0.02, np.random.default_rng(0)
    force = 4.0 * np.clip(np.minimum(t - 0.3, 1.9 - t), 0.0, 1.0)[:, None] * np.array([1.0, 0.0, 0.0])
    case = stick_case(tmp_path / "c", [force] * 4)
    place = np.array([0.02, -0.01, 0.005])
    given = []
    for k, trajectory in enumerate(case.trajectories):
        way = 0.05 * force + (place if k in (0, 2, 3) else 0.0) + 1e-3 * rng.normal(size=(120, 3))
        speed = np.gradient(0.05 * force, 0.02, axis=0) + (0.3 if k == 2 else 0.0) + 0.02 * rng.normal(size=(120, 3))
        sensed = force + 0.05 * rng.normal(size=(120, 3)) + (1.0 if k == 3 else 0.0)
        given.append(replace(trajectory, displacement=way, velocity=speed, force=sensed))
    noise = estimate_noise(replace(case, trajectories=tuple(given)))
    found = [standing(trajectory, noise) for trajectory in given]
    for trajectory, sways in zip(given, (True, False, True, True), strict=True):
        one = replace(case, trajectories=(trajectory, given[1]))
        assert [r.sways for r in recordings(one)] == [sways] * 2
    np.testing.assert_allclose(found[0], place, atol=4 * 1e-3 / np.sqrt(10))
    for nothing in found[1:]:
        np.testing.assert_array_equal(nothing, 0.0)
