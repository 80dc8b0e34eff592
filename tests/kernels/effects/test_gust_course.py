"""Gusts along a course that recordings have, beside the law's own sine."""

from dataclasses import replace

import numpy as np
from bough.learn.replay.recording import recordings
from oracles.effect_case import stick, stick_case


def test_gusts_along_a_course_do_what_their_pressure_does(tmp_path):
    """Sway along a sampled sine as along the law's own, from before the recording on; without a course stay calm.

    Between samples the course is a line, which is off by (w dt)^2 / 8 of the sine: 0.13 %; a step takes both in its
    middle. A step of 3 ms that took one of them at its start would be off by 0.75 % more.
    """
    f, begins = 0.8, [3.3, 40.0, 80.0]
    case = stick_case(tmp_path / "c", [np.zeros((200, 3))] * 3, gravity=0.0, elevation=90.0, azimuth=0.0, starts=begins)
    chosen, w = recordings(case), 2 * np.pi * f
    t = [b + (np.arange(case.lead + 200) - case.lead) * case.dt for b in begins]
    waves = [np.column_stack([np.sin(w * own), 0.75 * np.cos(w * own)]) for own in t]
    given = [replace(chosen[0], course=waves[0], sways=True), replace(chosen[1], sways=True),
             replace(chosen[2], course=waves[2], sways=True)]  # fmt: skip
    out = stick(case, chosen=given, wind_gust={"rms_Pa": 200.0})
    swayed = [replace(r, sways=True) for r in chosen]
    expected = stick(case, chosen=swayed, wind_gust={"sine_x_Pa": 200.0, "cosine_y_Pa": 150.0, "frequency_Hz": f})
    assert np.all(out[1] == 0.0) and np.abs(expected[0, :, :3]).max() > 0.005
    for k in (0, 2):
        np.testing.assert_allclose(out[k], expected[k], atol=0.003 * np.abs(expected[k]).max())
