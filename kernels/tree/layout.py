"""The arrays that kernels work on, as Warp structs, one set per lane width and precision.

Every array is indexed [group, link]: a group is one world, or the 8 or 16 worlds in the lanes of a thread. Link 0 is
the world's slot, links are 1..count. World ``w`` sits in slot ``w`` = group * lanes + lane.
"""

from functools import cache
from types import SimpleNamespace
from typing import Any

import warp as wp

from ..lanes.algebra import types_of

__all__ = ["layout_of"]


def _model_struct(t: SimpleNamespace) -> Any:
    """What does not change while worlds move."""
    Real, Vec, Quat = t.Real, t.Vec, t.Quat

    @wp.struct
    class Model:
        """What does not change while worlds move."""

        count: wp.array(dtype=int)
        parent: wp.array2d(dtype=int)
        kind: wp.array2d(dtype=int)
        free: wp.array(dtype=int)
        inner: wp.array2d(dtype=int)
        first: wp.array2d(dtype=int)
        offset: wp.array2d(dtype=Vec)
        turn: wp.array2d(dtype=Quat)
        axis: wp.array2d(dtype=Vec)
        mass: wp.array2d(dtype=Real)
        com: wp.array2d(dtype=Vec)
        inertia: wp.array2d(dtype=Vec)
        stiffness: wp.array2d(dtype=Real)
        damping: wp.array2d(dtype=Real)
        armature: wp.array2d(dtype=Real)
        preload: wp.array2d(dtype=Vec)
        limit: wp.array2d(dtype=Real)
        lift: wp.array(dtype=wp.float64)

    return Model


def _state_structs(t: SimpleNamespace) -> dict[str, Any]:
    """What moves, and what acts."""
    Real, Vec, Quat = t.Real, t.Vec, t.Quat

    @wp.struct
    class State:
        """Joint coordinates, velocities and whether a world is alive."""

        coordinate: wp.array2d(dtype=Quat)
        velocity: wp.array2d(dtype=Vec)
        alive: wp.array(dtype=Real)
        tick: wp.array(dtype=int)
        fault_link: wp.array(dtype=int)
        fault_tick: wp.array(dtype=int)
        lanes: int

    @wp.struct
    class Load:
        """Forces at points of links, torques on links, efforts at joints."""

        force: wp.array2d(dtype=Vec)
        point: wp.array2d(dtype=Vec)
        torque: wp.array2d(dtype=Vec)
        effort: wp.array2d(dtype=Vec)

    return {"State": State, "Load": Load}


def _scratch_struct(t: SimpleNamespace) -> Any:
    """What a step works in."""
    Real, Vec, Quat, Sym, Mat = t.Real, t.Vec, t.Quat, t.Sym, t.Mat

    @wp.struct
    class Scratch:
        """The step's working memory."""

        pose: wp.array2d(dtype=Quat)
        r: wp.array2d(dtype=Vec)
        relative: wp.array2d(dtype=Vec)
        spin: wp.array2d(dtype=Vec)
        A: wp.array2d(dtype=Sym)
        B: wp.array2d(dtype=Mat)
        M: wp.array2d(dtype=Sym)
        n: wp.array2d(dtype=Vec)
        f: wp.array2d(dtype=Vec)
        D: wp.array2d(dtype=Sym)
        U: wp.array2d(dtype=Mat)
        u: wp.array2d(dtype=Vec)
        alpha0: wp.array2d(dtype=Vec)
        accel0: wp.array2d(dtype=Vec)
        alpha: wp.array2d(dtype=Vec)
        accel: wp.array2d(dtype=Vec)
        calm: wp.array2d(dtype=Real)

    return Scratch


@cache
def layout_of(width: int = 1, precision: int = 32) -> SimpleNamespace:
    """Return the structs Model, State, Load and Scratch over the reals of one width and precision.

    Raises:
        ValueError: No such real exists.
    """
    t = types_of(width, precision)
    return SimpleNamespace(**vars(t), Model=_model_struct(t), **_state_structs(t), Scratch=_scratch_struct(t),
                           width=width, precision=precision)  # fmt: skip
