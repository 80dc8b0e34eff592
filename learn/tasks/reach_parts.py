"""Chapter 4's policies as parts: table B.1 and equation 4.3."""

from __future__ import annotations

from typing import Any

from .measures import REACH_COLUMNS
from .parts import Group, Parts, Reward
from .reach_settings import REWARDED_FOR_CONTACT, RUPTURE_FORCE, UNDER_BUDGET, ReachSettings, sizes_of


def reach_parts(settings: ReachSettings, dofs: int, *, test: bool = False) -> Parts:
    """Return ``reach`` as its parts, for an arm with so many joints; in tests an episode ends at the step limit alone.

    In training it also ends, as at the step limit, within half the distance that is success.
    """
    from ...kernels.tasks import reach as r
    from ...kernels.tasks.senses import episode_return

    budget = settings.policy in UNDER_BUDGET
    contact = (Reward(r.gentle, factor=True), Reward(r.rupturing))
    measures = {
        "return": episode_return, "success": r.success, "force": r.mean_force, "rupture": r.ruptures,
        "duration": r.duration, "distance": r.distance, "rolling": r.rolling, "retracting": r.retracting,
        "slowing": r.slowing, **({"broken": r.broken_joints} if settings.scene.strength else {}),
    }  # fmt: skip
    return Parts(
        "reach", 1, r.Reach,
        (Reward(r.near), Reward(r.smooth), *(contact if settings.policy in REWARDED_FOR_CONTACT else ())),
        reach_groups(settings, dofs), measures, reach_numbers(settings), samples=(r.sample, r.behave),
        cost=r.step_force if budget else None, cost_limit=settings.reward_scale, notes=(r.remember,) if budget else (),
        resets=(r.forget,), cuts=() if test else (r.nearly_there,),
        columns=tuple(column for column in REACH_COLUMNS if column.measure in measures),
    )  # fmt: skip


def reach_groups(settings: ReachSettings, dofs: int) -> tuple[Group, ...]:
    """Return the observation groups that the policy sees, in the order of table B.1."""
    from ...kernels.tasks.reach import FLAGS, offset, skin
    from ...kernels.tasks.senses import proprioceptive, torques

    written = {"proprioceptive": proprioceptive, "offset": offset, "touch": FLAGS[settings.flag], "torque": torques,
               "skin": skin}  # fmt: skip
    return tuple(Group(name, sizes_of(dofs)[name], written[name]) for name in settings.seen)


def reach_numbers(settings: ReachSettings) -> dict[str, Any]:
    """Return the values of the numbers in `kernels.tasks.reach.Reach`."""
    same = ("force_budget", "within", "touch_force", "touch_noise", "distance_gain", "smooth_gain", "contact_gain")
    return {name: getattr(settings, name) for name in same} | {
        "rupture_force": RUPTURE_FORCE,
        "cost_scale": settings.reward_scale,
        "step_periods": settings.control_periods,
        "periods": settings.episode_steps * settings.control_periods,
    }
