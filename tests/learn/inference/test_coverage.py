"""Intervals of joints whose sensor wanders and whose law is not quite the model's: how often they hold the truth."""

import numpy as np
from bough.learn.cases.case import load_case
from bough.learn.inference.identify import Identification, Settings
from bough.learn.runs.threads import one_thread
from oracles.oscillator import write_case
from scipy.signal import lfilter

SPRING, DAMPER, COUNT = 80.0, 1.5, 24


def wandering(folder, seed):
    """Write and load a case of three decays with an angle sensor that wanders: x_t = 0.95 x_{t-1} + e_t, 4 mrad."""
    rng = np.random.default_rng(seed)
    runs = np.column_stack([rng.uniform(0.2, 0.5, 3), rng.uniform(-2, 2, 3)])
    case = load_case(write_case(folder, runs, noise=5e-4, seed=seed, dt=0.01, stiffness=SPRING, damping=DAMPER))
    for t in case.trajectories:
        e = rng.standard_normal(len(t.t) + 200) * 4e-3 * np.sqrt(1 - 0.95**2)
        t.output[:, 0] += lfilter([1.0], [1.0, -0.95], e)[200:]
    return case


def test_replayed_joints_cover_the_truth(tmp_path):
    """Hold spring and damper in 95 % of 48 intervals, within three deviations of a binomial; unwidened ones do not."""
    inside, narrow = [], []
    with one_thread():
        for seed in range(COUNT):
            case = wandering(tmp_path / f"case_{seed}", seed)
            found = Identification(case, Settings(particles=24, iterations=12)).learn([0, 1, 2], "posterior")
            middle, low, high = found.interval()
            truth = np.array([SPRING, DAMPER])
            inside.append((low < truth) & (truth < high))
            near = np.abs(np.log(truth / middle)) < np.log(high / middle) / found.widened
            narrow.append(near)
            assert found.widened > 1.2
    share, bare = np.mean(inside), np.mean(narrow)
    assert share > 0.95 - 3 * np.sqrt(0.95 * 0.05 / (2 * COUNT)), share
    assert bare < share - 0.1, (share, bare)
