"""bough: thousands of articulated trees in parallel, their springs, and the physics a model of them lacks.

The names below are the public interface, imported when they are first used. Everything else lives in rooms
(``bough.sim``, ``bough.learn``, ...: the table in README.md) and may move between them.

Units are SI (m, kg, s, rad, N), quaternions are ``w, x, y, z``, z is up.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from .version import __version__

if TYPE_CHECKING:
    from .learn.cases.case import load_case
    from .learn.gap.diagnose import diagnose
    from .learn.gym.make import make_gym
    from .learn.hidden.hide import hide
    from .learn.inference.identify import identify
    from .learn.tasks.clearing import make_task
    from .perception.embedding import embed, occlusion
    from .sim.arms.jaco2 import jaco2
    from .sim.arms.simulator import ArmSimulator
    from .sim.base.errors import InputError
    from .sim.engine.model import Model
    from .sim.engine.simulator import Simulator
    from .sim.formats.import_mujoco import from_mujoco
    from .sim.formats.load import load_mechanism
    from .sim.trees.species import grow_forest
    from .sim.trees.tree import Tree

__all__ = [
    "ArmSimulator",
    "InputError",
    "Model",
    "Simulator",
    "Tree",
    "__version__",
    "diagnose",
    "embed",
    "from_mujoco",
    "grow_forest",
    "hide",
    "identify",
    "jaco2",
    "load_case",
    "load_mechanism",
    "make_gym",
    "make_task",
    "occlusion",
]

#: Where each public name lives.
_HOMES = {
    "ArmSimulator": "sim.arms.simulator",
    "InputError": "sim.base.errors",
    "Model": "sim.engine.model",
    "Simulator": "sim.engine.simulator",
    "Tree": "sim.trees.tree",
    "diagnose": "learn.gap.diagnose",
    "embed": "perception.embedding",
    "from_mujoco": "sim.formats.import_mujoco",
    "grow_forest": "sim.trees.species",
    "hide": "learn.hidden.hide",
    "identify": "learn.inference.identify",
    "jaco2": "sim.arms.jaco2",
    "load_case": "learn.cases.case",
    "load_mechanism": "sim.formats.load",
    "make_gym": "learn.gym.make",
    "make_task": "learn.tasks.clearing",
    "occlusion": "perception.embedding",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that ``import bough`` loads neither Warp nor torch."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(import_module(f".{_HOMES[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names."""
    return __all__
