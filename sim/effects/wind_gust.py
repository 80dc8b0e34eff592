"""Wind that comes and goes."""

from typing import Any

import warp as wp

from ...kernels.lanes.algebra import add, div, mul, norm, size, sub
from ...kernels.lanes.real import cos_root, fma, fnma, real, round_, sin_ratio, sqrt_, where_neg
from .flow import ACROSS, CROWN, SLOWNESS, STORM
from .registry import Effect, EffectParameter, Law, register
from .steady_wind import pressed

PI = wp.constant(wp.float64(3.141592653589793))


@wp.func
def amplitudes(p: Any, like: Any):
    """Largest pressures along x and y; the sign of that along y says whether both swing together or against another."""
    y = sqrt_(fma(p.c, p.c, p.d * p.d))
    o = real(0.0, y)
    return type(like)(sqrt_(fma(p.a, p.a, p.b * p.b)), where_neg(fma(p.a, p.c, p.b * p.d), o - y, y), o)


@wp.func
def wind_gust(b: Any, p: Any):
    """F of the pressure s sin 2 pi f t + c cos 2 pi f t + g M + r y, horizontal, t on the clock, by half angles.

    M are the largest of the pressures that swing, and 1 + |g| times M the largest of all; y is a course that was read
    off the recording, of rms one, and r the rms of its pressure.
    """
    cycles = p.e * b.time
    half = (cycles - round_(cycles)) * real(PI, cycles)
    u = half * half
    sine = sin_ratio(u) * half
    cosine = cos_root(u)
    double_sine = sine * cosine * real(2.0, u)
    double_cosine = fnma(sine + sine, sine, real(1.0, u))
    x = fma(p.b, double_cosine, p.a * double_sine)
    y = fma(p.d, double_cosine, p.c * double_sine)
    most = amplitudes(p, b.velocity)
    q = type(b.velocity)(x, y, real(0.0, u)) + most * p.g + b.course * p.j
    largest = fma(size(p.j), norm(b.course), norm(most) * (real(1.0, u) + size(p.g)))
    return pressed(q, largest, b, p.f, p.h, p.i)


def _pressure(name: str) -> EffectParameter:
    ends = [lambda s: -2.0 * s.force / s.area, lambda s: 2.0 * s.force / s.area]
    return EffectParameter(name, "Pa", *ends, plausible=(-STORM, STORM), aside="_y_" in name)


EFFECT = register(
    Effect(
        name="wind_gust",
        plain="gusts of wind",
        summary="a horizontal force on every segment that oscillates at one frequency on the absolute clock,"
        " about mean times its largest value, or of rms r along a course that was read off each recording; of the share"
        " m of the air only what flows across the segment counts, a segment that moves feels another wind as far as the"
        " air is slow, and the share crown of the area may hang at the tip",
        source="Davenport 1961, Q. J. R. Meteorol. Soc. 87:194 (one component of the gust spectrum); a course as a"
        " normal process: Rasmussen & Williams, Gaussian Processes for Machine Learning (2006), section 2.2",
        signature="the open gripper sees the branch sway; replicates differ by their phase on the clock",
        mistaken_for=("steady_wind",),
        probe="a long recording with the gripper open",
        branch=Law(
            "link",
            (
                _pressure("sine_x_Pa"),
                _pressure("cosine_x_Pa"),
                _pressure("sine_y_Pa"),
                _pressure("cosine_y_Pa"),
                EffectParameter(
                    "frequency_Hz",
                    "Hz",
                    lambda s: 0.5 / s.duration,
                    lambda s: 0.2 / s.dt,
                    reach=lambda s: 0.25 / (s.end - s.start),
                ),
                ACROSS,
                EffectParameter("mean", "1", -1.5, 1.5, optional=True),
                SLOWNESS,
                CROWN,
                EffectParameter(
                    "rms_Pa",
                    "Pa",
                    0.0,
                    lambda s: 3.0 * s.force / s.area,
                    tries=lambda s: [0.0],
                    optional=True,
                    plausible=(0.0, STORM),
                    read_off=True,
                ),
            ),
            wind_gust,
            per_joint=False,
            precedes=True,
            active=True,
            strengths=tuple(f"{wave}_{axis}_Pa" for axis in "xy" for wave in ("sine", "cosine")),
        ),
    )
)
