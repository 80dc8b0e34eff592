"""Sliders for springs, wind and laws, and what they mean in a simulator's own numbers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
import torch

from ..effects.registry import EffectParameter, Setting, in_setting
from ..engine.forest_effects import forest_laws, forest_terms

if TYPE_CHECKING:
    from ..engine.simulator import Simulator
    from .page import Page

WIND = ("steady_wind", "wind_gust")
LAWS = ("quadratic_drag", "dry_friction", "cubic_stiffness")
"""Laws that have sliders unless others are asked for."""

_AIR = 1.2
"""Density of air [kg/m^3] at 20 degrees Celsius and sea level."""


@dataclass
class Sliders:
    """Controls of a live forest. They are looked at once a frame; what has changed is written to the simulator.

    Attributes:
        names: Effects that the simulator must be built with.
    """

    names: tuple[str, ...]
    _value: dict[str, Callable[[], float]] = field(default_factory=dict)
    _written: dict[str, tuple[float, ...]] = field(default_factory=dict)
    _laws: list[tuple[str, str]] = field(default_factory=list)
    _base: dict[str, torch.Tensor] = field(default_factory=dict)

    def write(self, simulator: Simulator) -> None:
        """Give a simulator what the sliders say, where that has changed since the last call."""
        if self._changed("springs", "dampers"):
            self._scale(simulator)
        if self._changed("wind", "direction"):
            self._blow(simulator)
        if self._changed("gust", "frequency", "direction "):
            self._gust(simulator)
        for name, parameter in self._laws:
            if self._changed(f"{name} {parameter}"):
                simulator.effects.fill(name, parameter, self._now(f"{name} {parameter}"))

    def _now(self, key: str) -> float:
        return float(self._value[key.strip()]())

    def _changed(self, *keys: str) -> bool:
        now, group = tuple(self._now(k) for k in keys), " ".join(keys)
        changed = self._written.get(group) != now
        self._written[group] = now
        return changed

    def _scale(self, simulator: Simulator) -> None:
        for key, name in (("springs", "stiffness"), ("dampers", "damping")):
            own = simulator.model.arrays[name].torch
            base = self._base.setdefault(name, own.clone())
            own.copy_(base * self._now(key))
        simulator.refresh()

    def _blow(self, simulator: Simulator) -> None:
        pressure = _pressure(self._now("wind")) * _heading(self._now("direction"))
        for axis, value in zip("xyz", pressure, strict=True):
            simulator.effects.fill("steady_wind", f"pressure_{axis}_Pa", float(value))
        simulator.effects.fill("steady_wind", "across", 1.0)

    def _gust(self, simulator: Simulator) -> None:
        pressure = _pressure(self._now("gust")) * _heading(self._now("direction"))
        for axis, value in zip("xy", pressure[:2], strict=True):
            simulator.effects.fill("wind_gust", f"sine_{axis}_Pa", float(value))
        simulator.effects.fill("wind_gust", "frequency_Hz", self._now("frequency"))
        simulator.effects.fill("wind_gust", "across", 1.0)


def _pressure(speed: float) -> float:
    """Return the dynamic pressure of air [Pa] at a speed [m/s]: rho v^2 / 2."""
    return 0.5 * _AIR * speed**2


def _heading(degrees: float) -> Any:
    angle = np.radians(degrees)
    return np.array([np.cos(angle), np.sin(angle), 0.0])


def add_sliders(page: Page, setting: Setting, laws: Sequence[str] = LAWS) -> Sliders:
    """Put sliders for springs, wind and laws on the page, every one where it changes nothing.

    Args:
        page: Where to.
        setting: What the trees are like, for the ranges of laws.
        laws: Laws that get sliders.

    Raises:
        InputError: A law that a forest cannot have.
    """
    laws = [law for law in dict.fromkeys(laws) if law not in WIND]
    forest_terms(laws, "--law")
    out, gui = Sliders((*WIND, *laws)), page.server.gui

    def slider(key: str, label: str, low: float, high: float, step: float, start: float) -> None:
        """Add a slider from ``low`` to ``high`` and make its value that of ``key``."""
        handle = gui.add_slider(label, low, high, step, start)
        out._value[key] = lambda: handle.value

    with gui.add_folder("Springs"):
        slider("springs", "springs ×", 0.1, 5.0, 0.05, 1.0)
        slider("dampers", "dampers ×", 0.1, 5.0, 0.05, 1.0)
    with gui.add_folder("Wind"):
        slider("wind", "wind [m/s]", 0.0, 25.0, 0.5, 0.0)
        slider("gust", "gusts [m/s]", 0.0, 25.0, 0.5, 0.0)
        slider("frequency", "gusts [Hz]", 0.05, 3.0, 0.05, 0.3)
        slider("direction", "towards [°]", 0.0, 360.0, 5.0, 0.0)
    for law in laws:
        with gui.add_folder(law.replace("_", " "), expand_by_default=law in LAWS):
            for spec in (p for p in forest_laws()[law].parameters if not p.optional):
                low, high = (float(f"{end:.2g}") for end in _range(spec, setting))
                slider(f"{law} {spec.name}", _label(spec), low, high, (high - low) / 200.0, spec.neutral)
                out._laws.append((law, spec.name))
    return out


def _label(spec: EffectParameter) -> str:
    name = spec.name.rsplit("_", 1)[0] if spec.unit != "1" else spec.name
    return f"{name.replace('_', ' ')} [{spec.unit}]" if spec.unit != "1" else name.replace("_", " ")


def _range(spec: EffectParameter, setting: Setting) -> tuple[float, float]:
    """Return the ends of a slider: the prior's box with the neutral value in it, inside what nature has."""
    low, high = (in_setting(end, setting) for end in (spec.low, spec.high))
    if spec.plausible is not None:
        low, high = max(low, spec.plausible[0]), min(high, spec.plausible[1])
    return min(low, spec.neutral), max(high, spec.neutral)
