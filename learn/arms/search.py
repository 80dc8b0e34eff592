"""What one channel of an arm lacks: effects are taken up one after the other, by what they save of blocks left out."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ...sim.base.types import Array
from ..cases.arm import ArmCase
from .channels import LEAST_BLOCKS, Kind, Rows
from .effects import GRIDS, LATEST, NAMES, PARAMETERS, Curve, anything, column, speeds
from .held_out import HeldOut, centred, chance, held_out, spread_of

#: Probability of naming anything where nothing is, over all channels and effects.
CHANCE = 0.01
#: Share of the channel's squared error that an effect must save, and that what has no name must save to be noted.
LEAST_SAVED, LEAST_UNNAMED = 0.02, 0.05
#: Share that named effects must have of what columns without a name save beside them.
CLAIM = 0.75
#: Change of a joint's weight below which nothing is said about who carries it [N m].
LIGHT = 0.1


@dataclass(frozen=True)
class Named:
    """An effect of a channel: its parameter with a 95 % interval, and what speaks for it.

    Attributes:
        name: Its name (`effects`).
        value, low, high: Its parameter.
        unit: Of the parameter.
        p: Probability of so clear a gain by chance, over all that was tried.
        alternatives: Names that do nearly as well in its place.
    """

    name: str
    value: float
    low: float
    high: float
    unit: str
    p: float
    alternatives: tuple[str, ...] = ()


@dataclass
class Channel:
    """One joint's torque or speed, and what came out.

    Attributes:
        kind, joint: What it is, and the joint's index.
        rows: How many rows it has.
        signal: Rms of what is measured, less the means of torques over recordings.
        base, repaired, floor: Rms left of blocks not seen by the base model and by the repaired one; white noise.
        unnamed: Share of the base model's squared error that columns without a name save beside the named effects, zero
            where that is no more than chance.
        memory: Time within which the repaired model's errors forget half of their past [s].
        named: Effects in the order in which they were taken up.
        claimed: Whether they are claimed.
        damping: Of the torque channel [N m s/rad], with its interval.
        nearest: Best name that was not taken up, where something without a name is left; None else.
        p: Least family-wise p-value of all that was tried first.
        measured, base_left, left: Rows measured, and what base and repaired model leave, [N] each.
    """

    kind: Kind
    joint: int
    rows: int = 0
    signal: float = 0.0
    base: float = 0.0
    repaired: float = 0.0
    floor: float = 0.0
    unnamed: float = 0.0
    memory: float = 0.0
    named: list[Named] = field(default_factory=list)
    claimed: bool = True
    damping: tuple[float, float, float] = (0.0, 0.0, 0.0)
    nearest: str | None = None
    p: float = 1.0
    measured: Array = field(default_factory=lambda: np.zeros(0))
    base_left: Array = field(default_factory=lambda: np.zeros(0))
    left: Array = field(default_factory=lambda: np.zeros(0))


@dataclass(frozen=True)
class _Model:
    """Effects of a channel and the fit with them."""

    names: tuple[str, ...]
    way: Curve
    fit: HeldOut
    ways: Curve


class Search:
    """Searches one channel.

    Args:
        case: The recordings.
        rows: Their rows.
        kind, joint: The channel.
        tried: How many effects are tried in all channels together.
        tolerance: Share of the channel's rms below which an effect is of no interest.
        allowed: Names that may be taken up.
        most: How many are taken up at most.
    """

    def __init__(
        self, case: ArmCase, rows: Rows, kind: Kind, joint: int, tried: int, tolerance: float,
        allowed: tuple[str, ...], most: int,
    ) -> None:  # fmt: skip
        self.case, self.rows, self.kind, self.joint = case, rows, kind, joint
        self.tried, self.tolerance, self.most, self.whole = tried, tolerance, most, 0.0
        self.gain = float(case.arm.gain[joint])
        heavy = float(centred(rows.weight[:, joint], rows.recording).std()) >= LIGHT
        self.names = tuple(n for n in NAMES[kind] if n in allowed and (heavy or n != "gravity_comp_error"))
        self.use = np.ones(len(rows.start), dtype=bool) if kind == "torque" else rows.start >= LATEST
        self.recording, inside = rows.recording[self.use], rows.block[self.use]
        self.block = np.unique(inside, return_inverse=True)[1]

    def run(self) -> Channel:
        """Return what the channel lacks."""
        out = Channel(self.kind, self.joint, int(self.use.sum()))
        base = best = self._fit((), Curve.none())
        self.whole = float(base.fit.error.sum())
        out.measured = self._target(Curve.none())[0] if self.kind == "torque" else self._speed
        out.signal = float(np.sqrt((out.measured**2).mean()))
        while len(best.names) < self.most:
            found = self._next(best, out)
            if found is None:
                break
            best = found
        self._judge(out, base, self._needed(self._refined(best), out))
        return out

    @property
    def _speed(self) -> Array:
        return self.rows.speed[self.use, self.joint]

    def _next(self, best: _Model, out: Channel) -> _Model | None:
        """Return the best model with one effect more if it is far better than chance, and note its name.

        A late command hides what friction and play do to a joint that turns back, and they hide it: where no single
        effect shows, pairs with a delay are tried.
        """
        singles = [m for n in self.names if n not in best.names and (m := self._tried(best, n)) is not None]
        found = self._best(best, singles, out)
        if found is None and self.kind == "speed" and not best.names and self.most > 1:
            late = [n for n in ("dry_friction", "backlash") if {n, "time_delay"} <= set(self.names)]
            pairs = [self._refined(self._fit((n, "time_delay"), Curve.together(n, "time_delay"))) for n in late]
            pairs = sorted(pairs, key=lambda m: float(m.fit.error.sum()))[:1]
            found = self._best(best, [m for m in pairs if self._both(m)], out)
        return found

    def _best(self, before: _Model, trials: list[_Model], out: Channel) -> _Model | None:
        """Return the best of some models if it is far better than chance and of any size, and note its new names.

        Of models that do equally well the first in the order of `NAMES` is taken; the others are its alternatives.
        """
        if not trials:
            return None
        best = min(trials, key=lambda m: float(m.fit.error.sum()))
        equal = [m for m in trials if m is best or chance(m.fit.error, best.fit.error, self.block) > 0.05]
        passing = [m for m in equal if self._clear(before, m, out)]
        new = best.names[len(before.names) :]
        if not passing:
            out.nearest = new[0] if best.fit.error.sum() < before.fit.error.sum() else None
            return None
        first = min(passing, key=lambda m: NAMES[self.kind].index(m.names[-1]))
        new = first.names[len(before.names) :]
        p = min(1.0, self.tried * chance(before.fit.error, first.fit.error, self.block))
        rivals = tuple(m.names[-1] for m in equal if m is not first) if len(new) == 1 else ()
        out.named += [Named(n, 0.0, 0.0, 0.0, PARAMETERS[n][1], p, rivals) for n in new]
        out.nearest = None
        return first

    def _clear(self, before: _Model, after: _Model, out: Channel) -> bool:
        """Return whether a model is far better than another, by more than chance and by a size that matters."""
        p = min(1.0, self.tried * chance(before.fit.error, after.fit.error, self.block))
        out.p = min(out.p, p)
        saved = float((before.fit.error - after.fit.error).sum()) / self.whole
        return p <= CHANCE and saved >= LEAST_SAVED and self._size(before, after) >= self.tolerance * out.signal

    def _needed(self, model: _Model, out: Channel) -> _Model:
        """Return a model without the effects that others beside them can do without."""
        for name in model.names:
            rest = tuple(n for n in model.names if n != name)
            way = Curve(*(np.zeros(1) if key == name else getattr(model.way, key) for key in GRIDS))
            less = self._refined(self._fit(rest, way))
            if not self._clear(less, model, out):
                out.named = [n for n in out.named if n.name != name]
                return self._needed(less, out)
        return model

    def _both(self, pair: _Model) -> bool:
        """Return whether a pair of effects is far better than either alone."""
        alone = [self._fit((n,), Curve.none().beside(n)) for n in pair.names]
        return all(self.tried * chance(m.fit.error, pair.fit.error, self.block) < CHANCE for m in alone)

    def _tried(self, best: _Model, name: str) -> _Model | None:
        """Return the model with an effect more; None where its parameter is not one that it can have."""
        linear = self._linear(name)
        way = best.way if linear else best.way.beside(name)
        model = self._fit((*best.names, name), way)
        if linear and name == "dry_friction" and model.fit.beta[-1] <= 0.0:
            return None
        if name == "servo_gain" and self._yielding(model)[1] <= 0.0:
            return None  # its speed does not yield to torques at all
        return model

    def _refined(self, model: _Model) -> _Model:
        """Return a model with each curve scanned again beside the others."""
        for name in [n for n in model.names if not self._linear(n)]:
            model = self._fit(model.names, model.way.beside(name))
        return model

    def _linear(self, name: str) -> bool:
        return self.kind == "torque" or name in ("servo_gain", "gravity_comp_error", "speed_scale")

    def _fit(self, names: tuple[str, ...], way: Curve) -> _Model:
        fit = held_out(self._target(way), self._columns(names, way), self.block)
        return _Model(names, way.at(fit.at) if len(way.time_delay) > 1 else way, fit, way)

    def _target(self, way: Curve) -> Array:
        """Return what columns are to explain, [G, N]."""
        if self.kind == "torque":
            assert self.rows.torque is not None
            return centred(self.rows.torque[:, self.joint], self.recording)[None]
        made = speeds(self.case, self.rows, self.joint, way)[:, self.use]
        return self._speed - made + self.rows.needed[self.use, self.joint] / self.gain

    def _columns(self, names: tuple[str, ...], way: Curve) -> Array:
        commanded = speeds(self.case, self.rows, self.joint, way.at(0))[0] if "speed_scale" in names else np.zeros(0)
        own = [self.rows.speed[:, self.joint]] if self.kind == "torque" else []
        own += [column(self.kind, n, self.rows, self.joint, self.gain, commanded) for n in names if self._linear(n)]
        if not own:
            return np.zeros((int(self.use.sum()), 0))
        z = np.stack(own, axis=1)[self.use]
        return centred(z, self.recording) if self.kind == "torque" else z

    def _size(self, before: _Model, after: _Model) -> float:
        """Return the rms by which a further effect changes what is predicted."""
        return float(np.sqrt(((before.fit.left - after.fit.left) ** 2).mean()))

    def _interval(self, model: _Model, name: str) -> tuple[float, float, float]:
        """Return a parameter and its 95 % interval."""
        if name == "servo_gain":  # 1 / K' = 1 / K + beta: the ends change places
            soft, least, most = self._yielding(model)
            return 1.0 / soft, 1.0 / most, 1.0 / least if least > 0.0 else float("inf")
        if name == "speed_scale":
            share, half = self._estimate(model, name)
            return 1.0 + share, 1.0 + share - half, 1.0 + share + half
        linear = self._linear(name)
        if linear:
            value, half = self._estimate(model, name)
        else:
            grid = getattr(model.ways, name)
            value, half = (
                float(grid[model.fit.at]),
                self._half(
                    grid[model.fit.chosen],
                    float(np.interp(float(grid[model.fit.at]), GRIDS[name], np.gradient(GRIDS[name]))),
                ),
            )
        scale = self._gain(model) if name == "dry_friction" and not linear else 1.0
        low = value - half if name == "gravity_comp_error" else max(0.0, value - half)
        return scale * value, scale * low, scale * (value + half)

    def _half(self, estimates: Array, step: float = 0.0) -> float:
        """Return half a 95 % interval by the fits without each block; no less than a grid's step can tell."""
        from scipy.stats import t

        return float(t.ppf(0.975, len(estimates) - 1)) * max(float(spread_of(estimates)), 0.29 * step)

    def _estimate(self, model: _Model, name: str) -> tuple[float, float]:
        """Return the coefficient of a linear effect and half its interval."""
        which = [n for n in model.names if self._linear(n)].index(name) + (1 if self.kind == "torque" else 0)
        return float(model.fit.beta[which]), self._half(model.fit.betas[:, which])

    def _yielding(self, model: _Model) -> tuple[float, float, float]:
        """Return 1 / K' and its interval [rad/s / (N m)]."""
        beta, half = self._estimate(model, "servo_gain")
        soft = 1.0 / self.gain + beta
        return soft, soft - half, soft + half

    def _gain(self, model: _Model) -> float:
        """Return the gain that a speed lost to friction is counted with [N m s/rad]."""
        return 1.0 / self._yielding(model)[0] if "servo_gain" in model.names else self.gain

    def _judge(self, out: Channel, base: _Model, best: _Model) -> None:
        """Note what is left, and whether it has a system that no name explains."""
        out.base, out.repaired = (float(np.sqrt(m.fit.error.sum() / out.rows)) for m in (base, best))
        out.base_left, out.left = base.fit.left, best.fit.left
        out.floor = float(self.rows.noise[self.kind][self.joint])
        out.memory = self._memory(best.fit.left)
        if self.kind == "torque":
            value, half = float(best.fit.beta[0]), 1.96 * float(spread_of(best.fit.betas[:, 0]))
            out.damping = (value, value - half, value + half)
        self._look_further(out, base, best)
        if out.named:
            named = 1.0 - float(best.fit.error.sum() / base.fit.error.sum())
            out.claimed = named >= CLAIM * (named + out.unnamed)
            # parameters are those of the last fit, beside all other effects
            out.named = [self._again(n, best) for n in out.named]

    def _again(self, named: Named, best: _Model) -> Named:
        value, low, high = self._interval(best, named.name)
        others = tuple(n for n in named.alternatives if n not in best.names)
        return Named(named.name, value, low, high, named.unit, named.p, others)

    def _look_further(self, out: Channel, base: _Model, best: _Model) -> None:
        """Fit columns without a name to what the best model leaves.

        So many columns would learn a drift from the seconds before and after: whole recordings are left out, where
        there are enough of them.
        """
        commanded = speeds(self.case, self.rows, self.joint, best.way)[0] if self.kind == "speed" else np.zeros(0)
        z = anything(self.kind, self.rows, commanded, self.joint)[self.use]
        z = centred(z, self.recording) if self.kind == "torque" else z
        z = z[:, z.std(axis=0) > 1e-9]
        whole = np.unique(self.recording, return_inverse=True)[1]
        block = whole if whole.max() + 1 >= LEAST_BLOCKS else self.block
        target, own = self._target(best.way), self._columns(best.names, best.way)
        plain = held_out(self._target(base.way), self._columns((), base.way), block).error
        named = held_out(target, own, block).error
        further = held_out(target, np.column_stack([own, z]), block).error
        saved = float((named - further).sum() / plain.sum())
        channels = self.tried / max(1, len(self.names))
        if saved >= LEAST_UNNAMED and channels * chance(named, further, block) <= CHANCE:
            out.unnamed = saved

    def _memory(self, left: Array) -> float:
        """Return how long errors stay correlated by more than one half [s]."""
        step = float(np.median(self.rows.end - self.rows.start))
        r = centred(left, self.recording)
        for lag in range(1, 51):
            same = self.recording[lag:] == self.recording[:-lag]
            if float((r[lag:] * r[:-lag])[same].mean()) < 0.5 * float((r**2).mean()):
                return (lag - 1) * step
        return 50 * step
