"""``bough info``: what is installed, what the machine offers, and a self-check."""

from __future__ import annotations

import platform
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib.metadata import EntryPoint, PackageNotFoundError, version
from importlib.util import find_spec
from typing import Any

from ..sim.base.console import bar, start_warp, tell
from ..sim.base.plugins import distribution_of, fault_of, points
from .base.exit_codes import ExitCode

_PACKAGES = ("warp-lang", "numpy", "torch", "newton", "mujoco")
#: A module of each extra that users have.
_EXTRAS = {"train": "rsl_rl", "gym": "gymnasium", "mpc": "pytorch_mppi", "wandb": "wandb", "touch": "rosbags",
           "robot": "fastapi", "taichi": "taichi", "view": "viser", "vision": "transformers",
           "usd": "pxr"}  # fmt: skip


@dataclass(frozen=True)
class Info:
    """Print versions, devices, vector lanes, cores, the kernel cache and extras, and let one small tree sway.

    Parts of installed packages are listed, and what is wrong with them. Exit code 0: done; 1: the tree did not stay
    finite.

    Attributes:
        json: Print all of it as JSON instead of lines.
    """

    json: bool = False

    def run(self) -> int:
        """Print one line per fact; return 0, or 1 where the tree did not stay finite."""
        start_warp()
        told, installed = dict(facts()), parts()
        lines = [*told.items(), *((p["kind"], _line(p)) for p in installed)]
        if not self.json:
            tell("\n".join(f"{name:<14}{value}" for name, value in lines), {}, False)
        with bar("self-check (the first run compiles kernels)", None):
            well, report = self_check()
        tell(f"{'self-check':<14}{report}", {**told, "parts": installed, "self-check": report}, self.json)
        return ExitCode.DONE if well else ExitCode.FAILED


def facts() -> Iterator[tuple[str, str]]:
    """Yield (name, value) of everything worth knowing in a report of a fault."""
    import warp as wp

    from ..sim.base.host import describe
    from ..version import __version__

    host = describe()
    yield "bough", f"{__version__} on Python {platform.python_version()}"
    yield "packages", ", ".join(f"{name} {_version(name)}" for name in _PACKAGES)
    yield "system", host["system"]
    yield "processor", f"{host['cpu']}, {host['cores']} cores for this process"
    yield "lanes", f"{host['lanes']} worlds per CPU thread (float32); 1 in float64"
    yield "devices", ", ".join(f"{d.alias} ({d.name})" if d.is_cuda else d.alias for d in wp.get_devices())
    yield "kernel cache", str(wp.config.kernel_cache_dir)
    have = [name for name, module in _EXTRAS.items() if find_spec(module) is not None]
    lack = [name for name in _EXTRAS if name not in have]
    yield "extras", (", ".join(have) or "none") + (f" (not installed: {', '.join(lack)})" if lack else "")


def parts() -> list[dict[str, str]]:
    """Return the parts of installed packages: kind, name, package, and what is wrong with it, if anything."""
    from ..learn.replay.probes import PROBES
    from ..learn.samplers.registry import SAMPLERS
    from ..learn.tasks.registry import TASKS
    from ..sim.arms.registry import ARMS
    from ..sim.effects import GROUP, effects, load_package

    found = []
    for registry in (TASKS, ARMS, PROBES, SAMPLERS):
        for name, point in registry.installed.items():
            found += _parts(registry.noun, point, partial(registry.of, name))
    with warnings.catch_warnings():  # what is wrong stands in the parts' own lines
        warnings.simplefilter("ignore")
        effects()
    return [
        *found,
        *(part for point in points(GROUP) for part in _parts("effect", point, partial(load_package, point))),
    ]


def _parts(kind: str, point: EntryPoint, load: Callable[[], Any]) -> list[dict[str, str]]:
    """Return what an entry point brings: one part, or as many as ``load`` returns names of."""
    names, fault = (point.name,), ""
    try:
        loaded = load()
        names = (loaded if kind == "effect" else ()) or names
    except Exception as error:  # another's package
        fault = fault_of(error)
    who = distribution_of(point)
    return [{"kind": kind, "name": name, "package": who, "fault": fault} for name in names]


def _line(part: dict[str, str]) -> str:
    return f"{part['name']}: BROKEN: {part['fault']}" if part["fault"] else f"{part['name']} ({part['package']})"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def self_check(steps: int = 20) -> tuple[bool, str]:
    """Let a small tree sway for some steps; return whether it stayed finite, and a line that says so."""
    from ..sim.engine.model import Model
    from ..sim.engine.simulator import Simulator
    from ..sim.trees.species import grow

    simulator = Simulator(Model(grow("Ta", 1), precision=64))
    simulator.step()  # compiled by now
    begin = time.perf_counter()
    for _ in range(steps):
        simulator.step()
    took = time.perf_counter() - begin
    position, _ = simulator.observe()
    well = not simulator.state.faults() and bool(position.isfinite().all())
    verdict = f"{'passed' if well else 'FAILED'}: {position.shape[1]} links, {steps + 1} steps"
    return well, f"{verdict} on {simulator.model.device}, {1e6 * took / steps:.0f} us per step"
