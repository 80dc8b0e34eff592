"""Noise estimates against signals whose noise is known."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from bough.learn.cases.case import load_case
from bough.learn.cases.columns import resolution
from bough.learn.cases.noise import difference_sigma, estimate_noise, pool, quiet_sigma, replicate_sigma
from bough.learn.replay.equation_error import low_pass, torque_noise
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.branch_case import make_branch_case

DATA = Path(__file__).resolve().parents[4] / "shared" / "data"
T = np.arange(110)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), period=st.floats(7, 60), sigma=st.floats(1e-4, 0.1))
def test_differences_see_through_a_smooth_signal(seed: int, period: float, sigma: float) -> None:
    """Oscillations of seven samples a period and more, 30 times the noise, leave it within 4 standard errors + 15 %."""
    rng = np.random.default_rng(seed)
    signals = [30 * sigma * np.sin(2 * np.pi * T / period + rng.uniform(0, 6)) * np.exp(-T / 60) for _ in range(8)]
    estimate, error = difference_sigma([s + sigma * rng.normal(size=110) for s in signals])
    assert abs(estimate - sigma) < 4 * error + 0.15 * sigma


def test_differences_of_white_noise_are_unbiased() -> None:
    """Over 200 draws of white noise the mean is right within 3 % and the stated standard error is the scatter's."""
    rng = np.random.default_rng(0)
    draws = np.array([difference_sigma([rng.normal(size=110) for _ in range(8)]) for _ in range(200)])
    assert abs(draws[:, 0].mean() - 1) < 0.03
    assert 0.7 < draws[:, 1].mean() / draws[:, 0].std() < 1.5


@pytest.mark.parametrize("ratio", [0.2, 0.3, 0.5, 0.8, 1.5])
def test_rounding_hides_no_noise(ratio: float) -> None:
    """The noise of an encoder, its rounding included, is found within 6 % in the mean; plain medians gave 71 to 95 %.

    Twenty estimates scatter by 5 % at most, their mean by 1 %; a deviation of a fifth of a count is hardly white.
    """
    rng, t = np.random.default_rng(0), np.arange(2000) * 1e-3
    shares = []
    for k in range(20):
        smooth = 200.0 * np.sin(4.0 * np.pi * t + k) + (30.0 + k) * np.sin(15.0 * t)
        read = np.round(smooth + ratio * rng.standard_normal(2000))
        shares.append(difference_sigma([read * 1.53e-3])[0] / ((read - smooth).std() * 1.53e-3))
    assert abs(np.mean(shares) - 1.0) < 0.06


def test_a_signal_that_stands_still_has_no_noise() -> None:
    """Equal samples, and equal ones but for the round-off of their last digits, give none."""
    assert difference_sigma([np.full(100, 0.3)])[0] == 0.0
    assert difference_sigma([0.3 + 1e-15 * (np.arange(100) % 2)])[0] < 1e-14


def test_jumps_do_not_count() -> None:
    """A step of a thousand sigma in every signal moves the estimate by less than a fifth."""
    rng = np.random.default_rng(1)
    signals = [rng.normal(size=110) + 1000.0 * (T > 50) for _ in range(8)]
    assert abs(difference_sigma(signals)[0] - 1) < 0.2


def test_quiet_and_replicates_by_hand() -> None:
    """Small examples worked out by hand: scatter about run means, half the mean square of differences."""
    x = np.array([1.0, 3.0, 1.0, 3.0, 50.0, 7.0, 9.0, 7.0, 9.0])
    mask = np.array([1, 1, 1, 1, 0, 1, 1, 1, 1], dtype=bool)
    # Each run of four scatters by 1 about its mean: 8 squares, 2 x 3 degrees of freedom.
    assert quiet_sigma([x], [mask])[0] == pytest.approx(np.sqrt(8 / 6))
    # Differences 1, -1, 2: half the mean square is (1 + 1 + 4) / 6.
    assert replicate_sigma([(np.array([2.0, 0, 5]), np.array([1.0, 1, 3]))])[0] == pytest.approx(1.0)
    assert np.isnan(quiet_sigma([x], [np.zeros(9, dtype=bool)])[0]) and np.isnan(replicate_sigma([])[0])


def test_pool_drops_what_only_adds_variance() -> None:
    """Agreeing estimates are averaged, one far above is left out, whatever its stated error."""
    assert pool([(1.0, 0.05), (1.04, 0.05), (9.0, 0.1)]) == pytest.approx(1.02, abs=1e-3)
    assert pool([(np.nan, np.nan), (2.0, 0.1)]) == 2.0
    assert np.isnan(pool([(np.nan, np.nan)]))


def test_noise_of_oracle_cases(tmp_path: Path) -> None:
    """On simulated branches at 1, 3, 5 % and 20 to 40 Hz all kinds of channel are right within 12 %, 5 % on average.

    Per channel the standard error is 4 to 5 %; the mean of three axes is looked at.
    """
    ratios = []
    for seed, (noise, rate) in enumerate([(0.01, 40.0), (0.03, 20.0), (0.05, 25.0), (0.01, 20.0), (0.03, 25.0)]):
        answer = make_branch_case(tmp_path / str(seed), seed, noise=noise, rate=rate, dt=1e-3)
        found = estimate_noise(load_case(tmp_path / str(seed)))
        truth = [answer[f"sigma_{k}"] for k in ("force_N", "displacement_m", "velocity_mps")]
        kinds = (found.force, found.displacement, found.velocity)
        ratios.append([k.mean() / t for k, t in zip(kinds, truth, strict=True)])
    assert np.abs(np.array(ratios) - 1).max() < 0.12, ratios
    assert np.abs(np.mean(ratios, axis=0) - 1).max() < 0.05, ratios


@pytest.mark.skipif(not DATA.is_dir(), reason="measured data folder shared/data is not there")
def test_rounded_angles_keep_their_rounding() -> None:
    """The pendulum's angles come in steps of 0.09 degrees (an encoder of 4000 counts); no estimate is below that."""
    found = estimate_noise(load_case(DATA / "pendulum"))
    assert found.channel == ("angle_deg",) and found.sigma[0] >= np.radians(0.09) / np.sqrt(12) * 0.99
    assert np.isnan(found.by_method["replicates"]).all()


def test_levels_show_where_samples_stay() -> None:
    """Find an encoder's count after its samples were put on another grid by lines; keep what other samples have.

    Recordings have zeros of their own. A force that was held at two values shows no levels, a ramp of even steps its
    steps, noise its finest step.
    """
    rng, count = np.random.default_rng(0), 1.5e-3
    t = np.cumsum(rng.uniform(0.004, 0.006, 1500))
    angle = 0.4 * np.exp(-t) * np.cos(8.0 * t)
    counted = [np.round((angle + zero) / count) * count - zero for zero in (0.0, 0.3 * count)]
    regular = np.arange(0.005, 7.0, 0.005)
    assert resolution(counted) == pytest.approx(count, rel=1e-6)
    assert resolution([np.interp(regular, t, x) for x in counted]) == pytest.approx(count, rel=1e-6)
    held = np.interp(np.arange(500), [0, 150, 190, 350, 390, 500], [0, 0, 3, 3, 0, 0]) + 0.0
    assert resolution([held]) == pytest.approx(3 / 40, rel=1e-6)
    smooth = np.where(np.arange(500) < 200, 0.0, np.sin(0.05 * np.arange(500)))
    assert resolution([smooth]) < 1e-4
    white = rng.standard_normal(500)
    assert resolution([white]) == np.diff(np.sort(white))[np.diff(np.sort(white)) > 1e-6].min()


def resampled(folder, columns, outputs, keys=""):
    """Return the case of an axis under a torque, put on another grid; ``outputs`` are (quantity, column, scale)."""
    np.savetxt(folder / "run.csv", np.column_stack([*columns.values()]), fmt="%.6f", delimiter=",", comments="",
               header=",".join(columns))  # fmt: skip
    listed = ", ".join(f"{{joint: a, quantity: {q}, column: {c}, scale: {k}}}" for q, c, k in outputs)
    (folder / "meta.yaml").write_text(
        f"format: joint-gap-case/1\nresample_hz: 100\n{keys}"
        "mechanism: {joints: [{name: a, type: revolute, inertia: null, stiffness: null, damping: null}]}\n"
        "input: {joint: a, column: torque, scale: 1.0, hold: linear}\n"
        f"outputs: [{listed}]\n"
        "trajectories: [{file: run.csv, t_start_s: 0.0}]\n"
    )
    return load_case(folder)


def test_counts_on_another_grid_are_still_rounded(tmp_path):
    """A coarse encoder whose clock has jitter, mostly at rest: between counts the grid knows no more than the encoder.

    Of resampled counts the smallest step is a thousandth of one and most differences are none at all.
    """
    count, rng = 1e-3, np.random.default_rng(1)
    t = np.cumsum(rng.uniform(0.009, 0.011, 600))
    angle = np.round(0.05 * np.sin(2.0 * t) * (t > 4.0) / count) * count
    columns = {"time_s": t, "angle": angle, "torque": np.cos(t)}
    (sigma,) = estimate_noise(resampled(tmp_path, columns, [("position", "angle", 2.0)])).sigma
    assert sigma >= 0.99 * 2.0 * count / np.sqrt(12.0)


def test_efforts_have_the_noise_and_rounding_of_their_own(tmp_path):
    """One effort beside a position and a velocity, on another grid: one number, of the effort's rounding at least.

    Of white noise the filter leaves as much as of 200000 samples, to the 1 % that they tell.
    """
    count, t = 0.5, np.cumsum(np.random.default_rng(2).uniform(0.009, 0.011, 600))
    columns = {"time_s": t, "angle": np.cos(t), "rate": -np.sin(t), "torque": np.round(2 * np.sin(t) / count) * count}
    outputs = [("position", "angle", 1.0), ("velocity", "rate", 1.0)]
    case = resampled(tmp_path, columns, outputs, "fit: torque\n")
    assert case.trajectories[0].effort_step == [count]
    found = torque_noise(case)
    assert found.channel == ("torque",) and found.sigma.shape == (1,)
    left = low_pass(np.random.default_rng(3).standard_normal((200_000, 1)), case.dt, case.filter_hz).std()
    assert found.sigma[0] >= 0.98 * left * count / np.sqrt(12.0)
