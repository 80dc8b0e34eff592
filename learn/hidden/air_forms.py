"""Other published forms of air: drag on slender cylinders and leaves, wind that grows with height, gusts.

The air's force is found link by link from its own velocity and the air's there, not by MuJoCo's fluid.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .branch import TRUNK_PIVOT, Array, unit
from .joint_laws import Random
from .parts import AIR, Draft, Law, Now, Part, Scale

#: Drag of a cylinder across a stream, and the share of it that acts along its axis.
ACROSS, ALONG = 1.1, 0.02

#: Velocity of the air [m/s] at times on the clock [s], shape [N], and places [m], [N, B, 3]; shape [N, B, 3].
Wind = Callable[[Array, Array], Array]
Numbers = NDArray[np.intp]


@dataclass
class Drag(Law):
    """Drag of every link: -rho/2 C d L |u| u across its axis, u its velocity less the air's.

    Attributes:
        density: rho, leaves and twigs counted in [kg/m^3].
        wind: Velocity of the air; still if None.
        power: Of |u|: two is the square; less where leaves fold (Vogel). Equal at 1 m/s.
        linear: Speed below which a linear drag is larger than the square [m/s].
        leaves: Drag of leaves of each link beside its own, over that; shape [links], if there are any.
    """

    density: float
    wind: Wind | None = None
    power: float = 2.0
    linear: float = 0.0
    leaves: Array | None = None

    def act(self, now: Now) -> None:
        """Drag every link."""
        links, bodies, area = self._links(now)
        place = np.array([d.geom_xpos[links] for d in now.datas])
        axis = np.array([d.geom_xmat[links].reshape(-1, 3, 3)[:, :, 2] for d in now.datas])
        u = velocities(now, bodies, place)
        if self.wind is not None:
            u = u - self.wind(now.time, place)
        along = (u * axis).sum(axis=-1, keepdims=True) * axis
        force = ACROSS * (self._push(u - along) + ALONG * self._push(along))
        if self.leaves is not None:
            force = force + self.leaves[:, None] * self._push(u)
        now.wash[:, bodies] -= 0.5 * self.density * area[:, None] * force

    def _push(self, u: Array) -> Array:
        speed = np.sqrt((u * u).sum(axis=-1, keepdims=True))
        return np.asarray((np.maximum(speed, 1e-9) ** (self.power - 1) + self.linear) * u)

    def _links(self, now: Now) -> tuple[Numbers, Numbers, Array]:
        """Return the cylinders of the branch, their bodies and areas [m^2]; a trunk's are left out."""
        model = now.rig.model
        shapes = np.flatnonzero(model.geom_size[:, 1] > 0)[int(now.rig.joints[0]) :]
        return shapes, model.geom_bodyid[shapes], 4 * model.geom_size[shapes, 0] * model.geom_size[shapes, 1]


def velocities(now: Now, bodies: Numbers, place: Array) -> Array:
    """Velocities [m/s] of points [N, B, 3] of bodies [B]."""
    roots = now.rig.model.body_rootid[bodies]
    spatial = np.array([d.cvel[bodies] for d in now.datas])
    centre = np.array([d.subtree_com[roots] for d in now.datas])
    return np.asarray(spatial[..., 3:] + np.cross(spatial[..., :3], place - centre))


# ---- quadratic_drag ------------------------------------------------------------------------------------------------


def _drag(power: float = 2.0, linear: float = 0.0) -> Draft:
    def make(strength: float) -> Part:
        """Return the drag in a fluid at rest whose density is the strength [kg/m^3]."""
        params = {"density_kgpm3": strength, "power": power, "linear_mps": linear}
        return Part(params, law=lambda: Drag(strength, power=power, linear=linear))

    return Draft(make, 0.5, 20.0, 4000.0)


def cylinders(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw drag across the links' axes (Morison); the strength is the density."""
    return _drag()


def with_linear(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a square and a linear drag, equal at a small share of the largest speed."""
    return _drag(linear=float(rng.uniform(0.03, 0.12)) * scale.speed)


def folding(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw leaves that fold in the stream: the drag goes with a lower power of the speed (Vogel)."""
    return _drag(power=float(rng.uniform(1.6, 1.85)))


def leafy(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw leaves, mostly on the outer links, each cluster with a drag of its own, alike in all directions."""
    seed = int(rng.integers(2**31))

    def make(strength: float) -> Part:
        """Return the drag of links and leaf clusters in a fluid whose density is the strength [kg/m^3]."""
        return Part({"density_kgpm3": strength, "seed": seed}, law=lambda: Leafy(strength, seed=seed))

    return Draft(make, 0.2, 5.0, 2000.0)


@dataclass
class Leafy(Drag):
    """Drag with leaves whose clusters are drawn: none on the inner half, one to six times the link's own beyond.

    Attributes:
        seed: Of the clusters.
    """

    seed: int = 0

    def begin(self, now: Now) -> None:
        """Put the leaves on."""
        count = len(self._links(now)[0])
        more = np.random.default_rng(self.seed).uniform(1, 6, count)
        self.leaves = np.where(np.arange(count) >= count // 2, more, 0.0)


# ---- steady_wind ---------------------------------------------------------------------------------------------------


def _least(scale: Scale) -> float:
    """Return the dynamic pressure [Pa] of a wind as fast as the branch: what is slower is little but a drag."""
    return 0.5 * AIR * scale.speed**2


def _wind(
    scale: Scale, direction: Array, profile: Callable[[Array], Array], veer: float = 0.0, **params: float
) -> Draft:
    """Draw a steady wind that is level; the strength is its dynamic pressure at the branch's base [Pa].

    The density of the air stands for leaves and twigs too: ten times that of air.
    """
    start = float(np.arctan2(direction[1], direction[0]))

    def make(strength: float) -> Part:
        """Return the drag in a steady wind of this dynamic pressure at the branch's base [Pa]."""
        speed = float(np.sqrt(2 * strength / AIR))

        def wind(time: Array, place: Array) -> Array:
            """Return the wind at places [m], [N, B, 3]: level, with a speed [m/s] and direction of the height alone."""
            height = np.maximum(0.05, place[..., 2] + TRUNK_PIVOT)
            turn = start + veer * (height - TRUNK_PIVOT)
            size = speed * profile(height)
            return np.stack([size * np.cos(turn), size * np.sin(turn), 0 * size], axis=-1)

        said = {"speed_mps": speed, "pressure_Pa": strength, "direction_rad": start, "veer_radpm": veer, **params}
        return Part(said, law=lambda: Drag(10 * AIR, wind), settled=True)

    return Draft(make, _least(scale), max(5.0, _least(scale)), 1000.0)


def _level(rng: Random) -> Array:
    return unit(rng.normal(size=3) * [1.0, 1.0, 0.0])


def power_law(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a speed that goes with a power of the height above the ground, a metre below the base."""
    alpha = float(rng.uniform(0.14, 0.4))
    return _wind(scale, _level(rng), lambda z: (z / TRUNK_PIVOT) ** alpha, exponent=alpha)


def log_law(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a speed that goes with the logarithm of the height over a roughness."""
    rough = float(rng.uniform(0.01, 0.1))

    def profile(height: Array) -> Array:
        """Return ln(z / z0) / ln(z1 / z0): speed at heights z [m] over that at the base, z0 the roughness."""
        return np.asarray(np.log(np.maximum(height, 1.01 * rough) / rough) / np.log(TRUNK_PIVOT / rough))

    return _wind(scale, _level(rng), profile, roughness_m=rough)


def veering(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw a wind whose direction turns with height (Ekman), and that is a little stronger above."""
    return _wind(
        scale, _level(rng), lambda z: (z / TRUNK_PIVOT) ** 0.2, veer=float(rng.choice([-1, 1]) * rng.uniform(0.1, 0.5))
    )


# ---- wind_gust -----------------------------------------------------------------------------------------------------


@dataclass
class Gusty(Drag):
    """Drag in air that swings; it sets in with the recording."""

    fading = True


def _gust(rng: Random, scale: Scale, swing: Callable[[Array], Array], **params: float) -> Draft:
    """Draw a level gust ``swing`` of the time, about one at most; the strength is its largest dynamic pressure [Pa]."""
    direction = _level(rng)

    def make(strength: float) -> Part:
        """Return the drag in a gust whose dynamic pressure [Pa] at the swing of one is the strength."""
        speed = float(np.sqrt(2 * strength / AIR))

        def wind(time: Array, place: Array) -> Array:
            """Return the speed [m/s] times the swing at each time along the one direction, alike at all places."""
            return np.asarray(speed * swing(np.asarray(time))[:, None, None] * direction + 0 * place)

        said = {"speed_mps": speed, "pressure_Pa": strength, "direction": direction.tolist(), **params}
        return Part(said, law=lambda: Gusty(10 * AIR, wind))

    return Draft(make, _least(scale), max(5.0, _least(scale)), 1500.0)


def waves(amplitude: Array, frequency: Array, phase: Array) -> Callable[[Array], Array]:
    """Return a sum of sines of the time [s] as a function; amplitudes, frequencies [Hz] and phases [rad], all [M]."""

    def swing(time: Array) -> Array:
        """Return sum_m A_m sin(2 pi f_m t + p_m) at times t [s] of any shape."""
        turns = 2 * np.pi * np.asarray(time)[..., None] * frequency + phase
        return np.asarray((amplitude * np.sin(turns)).sum(axis=-1))

    return swing


def sines(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw three to five sines between 0.2 and 2 Hz."""
    count = int(rng.integers(3, 6))
    amplitude = rng.uniform(0.4, 1.0, count)
    swing = waves(amplitude / amplitude.sum(), rng.uniform(0.2, 2.0, count), rng.uniform(0, 2 * np.pi, count))
    return _gust(rng, scale, swing, waves=count)


def one_minus_cosine(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw discrete gusts (1 - cos) / 2 one after the other, with calm between them (as in airworthiness rules)."""
    period, length, late = float(rng.uniform(2, 4)), float(rng.uniform(0.7, 1.8)), float(rng.uniform(0, 4))

    def swing(time: Array) -> Array:
        """Return (1 - cos(2 pi s / length)) / 2 at s [s] since a gust began, 0 in the calm."""
        since = np.mod(time - late, period)
        return np.asarray(np.where(since < length, (1 - np.cos(2 * np.pi * since / length)) / 2, 0.0))

    return _gust(rng, scale, swing, period_s=period, length_s=length)


def dryden_spectrum(frequency: Array, corner: float) -> Array:
    """Return Dryden's spectrum of the speed along the wind, of variance one over all frequencies [1/Hz]."""
    return np.asarray(4 / (2 * np.pi * corner) / (1 + (frequency / corner) ** 2))


def dryden(rng: Random, scale: Scale, joint: int) -> Draft:
    """Draw turbulence of Dryden's spectrum: sixty waves of random phases between 0.03 and 8 Hz."""
    corner = float(rng.uniform(0.15, 0.6))
    edges = np.geomspace(0.03, 8.0, 61)
    frequency = np.sqrt(edges[1:] * edges[:-1])
    amplitude = np.sqrt(2 * dryden_spectrum(frequency, corner) * np.diff(edges))
    return _gust(rng, scale, waves(amplitude / 2.5, frequency, rng.uniform(0, 2 * np.pi, 60)), corner_Hz=corner)


FORMS = {
    "quadratic_drag": {"cylinders": cylinders, "with_linear": with_linear, "folding": folding, "leafy": leafy},
    "steady_wind": {"power_law": power_law, "log_law": log_law, "veering": veering},
    "wind_gust": {"sines": sines, "one_minus_cosine": one_minus_cosine, "dryden": dryden},
}
