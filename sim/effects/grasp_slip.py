"""A gripper that slides along the segment."""

from collections.abc import Sequence
from itertools import product

from .registry import Effect, EffectParameter, Law, Setting, kept_share, moment_parameter, register

#: Farthest slide of a grip that nothing but the segment's ends stops [m].
ENDLESS = 100.0
#: The moment from which on a grip slides that may always do so [s], and how long before the recordings one may lie.
ALWAYS, BEFORE = -1e9, 1.0


def _ways(s: Setting) -> list[float]:
    """Mobilities that a search looks at [m/(N s)]."""
    return [m * s.length / (s.force * s.duration) for m in (-20.0, -2.0, -0.2, 0.2, 2.0, 20.0)]


def _further(s: Setting) -> Sequence[tuple[float, ...]]:
    """Grips that slide where the force along the segment points, that the tracker does not see slide, or that jerk."""
    towards_tip, least = _ways(s)[3:], [b * s.force for b in (0.05, 0.12, 0.3)]
    along = product(towards_tip, least, [0.0], [1.0], [1.0], [1.0, 0.0])
    unseen = product(_ways(s), least, [0.0], [1.0], [0.0], [0.0])
    fast, ends = (_ways(s)[0], _ways(s)[-1]), [m * s.length for m in (0.02, 0.05, 0.15)]
    jerks = product(fast, [b * s.force for b in (0.1, 0.3, 0.6)], [0.0], [1.0], [0.0], [1.0], ends)
    fresh = [*((*slide, s.length) for slide in (*along, *unseen)), *jerks]
    return [*((*slide, 0.0, s.start - BEFORE, 0.0) for slide in fresh), *_kept(s)]


def _kept(s: Setting) -> list[tuple[float, ...]]:
    """Grips that are not taken anew, zeroed or not: they slide by force, jerk, or slide evenly from a moment on."""
    ways, fast = _ways(s), (_ways(s)[0], _ways(s)[-1])
    slides = [(way, b * s.force, 0.0, 1.0, 0.0, 1.0, s.length, 1.0, s.start - BEFORE)
              for way in ways for b in (0.05, 0.3)]  # fmt: skip
    jerks = [(way, b * s.force, 0.0, 1.0, 0.0, 1.0, 0.1 * s.length, 1.0, s.start - BEFORE)
             for way in fast for b in (0.4, 0.7)]  # fmt: skip
    once = [(3.0 * way, 0.05 * s.force, 0.0, 0.0, 0.0, 1.0, 0.1 * s.length, 1.0, moment)
            for way in fast for moment in s.moments[::3]]  # fmt: skip
    return [(*slide, zeroed) for slide in (*slides, *jerks, *once) for zeroed in (0.0, 1.0)]


EFFECT = register(
    Effect(
        name="grasp_slip",
        plain="a grip that slides",
        summary="beyond a least force, part of which may be a share of the recording's largest one, the grip slides"
        " along the segment, towards its tip at a rate of mobility times the excess (towards the base where negative),"
        " or, as far as it is not viscous, at the rate of 1 N of excess; as far as it is axial, only the force along"
        " the segment counts, and it slides where that points; inside the segment's ends and no farther than most_m;"
        " the tracker sees the share seen of the slide, all where it follows the gripper, none where it follows a mark"
        " on the wood; in the next recording it holds the marked point again, or, in the share kept, where it slid to,"
        " which displacement may be counted from (zeroed); and it may slide from a moment on the absolute clock on",
        source="Bingham 1922 (yield, then viscous flow); Coulomb 1785 (force that does not grow with the rate);"
        " displacement is that of the point that is held, or of the mark",
        signature="displacement drifts along the segment while the force is held, and stays away after the release",
        mistaken_for=("viscoelastic_sls", "plastic_set"),
        probe="a long hold of a large force beside one of a small force",
        branch=Law(
            "grasp_slip",
            (
                EffectParameter(
                    "mobility_mpNs",
                    "m/(N s)",
                    lambda s: -100.0 * s.length / (s.force * s.duration),
                    lambda s: 100.0 * s.length / (s.force * s.duration),
                    tries=_ways,
                    reach=lambda s: 5.0 * s.length / (s.force * s.duration),
                ),
                EffectParameter("least_N", "N", lambda s: 0.02 * s.force, lambda s: s.force, scale="log", tries=4),
                EffectParameter("least_share", "1", 0.0, 0.9, tries=lambda s: [0.0, 0.4], optional=True),
                EffectParameter("viscous", "1", 0.0, 1.0, neutral=1.0, tries=lambda s: [1.0, 0.0], optional=True),
                EffectParameter("axial", "1", 0.0, 1.0, tries=lambda s: [0.0], optional=True),
                EffectParameter("seen", "1", 0.0, 1.0, neutral=1.0, tries=lambda s: [1.0], optional=True),
                EffectParameter(
                    "most_m",
                    "m",
                    lambda s: 0.003 * s.length,
                    lambda s: s.length,
                    neutral=ENDLESS,
                    scale="log",
                    tries=lambda s: [s.length],
                    optional=True,
                ),
                kept_share(0.0),
                moment_parameter(BEFORE, neutral=ALWAYS),
                EffectParameter("zeroed", "1", 0.0, 1.0, tries=lambda s: [0.0], optional=True),
            ),
            further=_further,
            per_joint=False,
            memory=1,
            persistent=True,
            keeps="kept",
            moment="moment_s",
        ),
    )
)
