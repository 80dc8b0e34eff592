"""Chapter 5's tasks as parts: equation 5.9, table 5.1, the columns of table 5.2."""

from __future__ import annotations

from typing import Any

from .measures import CLEARING_COLUMNS
from .parts import Group, Parts, Reward
from .settings import FEATURES, TaskSettings, sizes_of


def clearing_parts(name: str, settings: TaskSettings, dofs: int) -> Parts:
    """Return a clearing task as its parts, for an arm with so many joints."""
    import warp as wp

    from ...kernels.tasks import clearing as c
    from ...kernels.tasks.senses import episode_return

    numbers = {name: getattr(settings, name) for name in ("success_steps", "touch_force", "touch_noise")}
    measures = {
        "return": episode_return, "success": c.success, "occlusion_drop": c.covered_no_more,
        "breach": c.breach_share, "steps_clear": c.steps_clear,
    }  # fmt: skip
    return Parts(
        name, 2, c.Clearing, (Reward(c.cleared), Reward(c.effort), Reward(c.no_breach)),
        clearing_groups(settings, dofs), measures, numbers | {"noise_range": wp.vec2(*settings.max_noise)},
        notes=(c.remember,), resets=(c.draw_noise, c.forget), columns=CLEARING_COLUMNS,
    )  # fmt: skip


def clearing_groups(settings: TaskSettings, dofs: int) -> tuple[Group, ...]:
    """Return the observation groups left in, in the order of table 5.1."""
    from ...kernels.tasks.senses import proprioceptive, touch

    sizes = sizes_of(settings, dofs)
    written: dict[str, Any] = {"proprioceptive": proprioceptive, "touch": touch}
    return tuple(
        Group(group, tuple((f, sizes[f]) for f in features), written.get(group))
        for group, features in FEATURES.items() if group in settings.groups
    )  # fmt: skip
