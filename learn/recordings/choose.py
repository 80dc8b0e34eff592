"""Which columns hold what, in which unit: as said, as the names say, or asked."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from ...sim.base.errors import InputError, shortened
from ...sim.base.strict_yaml import nearest
from ..cases.table import Table
from .given import SOURCE, Given
from .guess import columns_like, meaning
from .questions import Asker, Question
from .units import UNITS, Kind, checked_unit, unit_of


@dataclass(frozen=True)
class Quantity:
    """Columns of one quantity.

    Attributes:
        kind: The quantity.
        columns: Its column, or those of two or three axes.
        unit: Their unit.
        stated: Whether a flag or the file states that unit.
        flag: The flag that would.
    """

    kind: Kind
    columns: tuple[str, ...]
    unit: str
    stated: bool
    flag: str

    @property
    def scale(self) -> float:
        """SI units per unit of the columns."""
        return UNITS[self.kind][self.unit]


@dataclass(frozen=True)
class Chosen:
    """What is read of every file.

    Attributes:
        clock: The clock, None where rows come at a stated rate.
        motion: Position or angle.
        effort: Force or torque, None where nothing acts.
        velocity: Velocity of three axes where it was measured.
    """

    clock: Quantity | None
    motion: Quantity
    effort: Quantity | None
    velocity: Quantity | None

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of all columns but the clock."""
        parts = (self.effort, self.motion, self.velocity)
        return tuple(dict.fromkeys(name for part in parts if part for name in part.columns))


def choose(table: Table, units: dict[str, str], given: Given, ask: Asker) -> Chosen:
    """Choose the columns of a table.

    Args:
        table: The first file.
        units: What a line of units below the header says of columns.
        given: What was said.
        ask: Who is asked.

    Raises:
        InputError: A column that was named is not there; nothing says which column, and nobody can be asked.
    """
    clock = _clock(table, units, given, ask)
    motion = _one_of(table, units, ask, _said(given.position, "position") + _said(given.angle, "angle"),
                     ("position", "angle"), "motion", given.position_unit)  # fmt: skip
    effort = None
    if given.free and (given.force or given.torque):
        raise InputError(SOURCE, "--free", "--force or --torque as well", "one of them")
    if not given.free:
        effort = _one_of(table, units, ask, _said(given.force, "force") + _said(given.torque, "torque"),
                         ("force", "torque"), "force", given.force_unit)  # fmt: skip
    velocity = None
    if given.velocity:
        _present(table, given.velocity, "--velocity")
        velocity = _with_unit("velocity", given.velocity, table, units, given.velocity_unit, "--velocity-unit", ask)
    _check_axes(motion, effort, velocity, given)
    return Chosen(clock, motion, effort, velocity)


def _said(columns: tuple[str, ...], kind: Kind) -> list[tuple[Kind, tuple[str, ...]]]:
    return [(kind, columns)] if columns else []


def _left(table: Table, given: Given) -> list[str]:
    """Return the columns that no flag has named as something else, such as a torque called t1."""
    named = {*given.force, *given.torque, *given.position, *given.angle, *given.velocity}
    return [name for name in table.header if name not in named]


def _clock(table: Table, units: dict[str, str], given: Given, ask: Asker) -> Quantity | None:
    if given.rate is not None and given.time is not None:
        raise InputError(SOURCE, "--rate", "--time as well", "one of them")
    if given.rate is not None:
        ask.notes.append(f"time: rows come at {given.rate:g} Hz (--rate)")
        return None
    name = given.time
    if name is None:
        found = columns_like(_left(table, given), "time")
        name = found[0][0] if len(found) == 1 else ask(
            Question("--time", f"Which column is the time? {_listed(table.header)}", _count(found, "the time"),
                     f"one of {_listed(table.header)}; or --rate HZ for rows at a steady rate"),
            lambda text: _present(table, (text,), "--time")[0],
        )  # fmt: skip
    _present(table, (name,), "--time")
    unit, stated = given.time_unit, True
    if unit is None:
        unit = _named_unit(name, "time", units)
        stated = unit is not None
    unit = checked_unit(unit or "s", "time", SOURCE, "--time-unit")
    ask.notes.append(f"time: column {name} [{unit}{'' if stated else ', no unit stated: --time-unit'}]")
    return Quantity("time", (name,), unit, stated, "--time-unit")


def _one_of(
    table: Table, units: dict[str, str], ask: Asker, said: list[tuple[Kind, tuple[str, ...]]], kinds: tuple[Kind, Kind],
    what: str, unit: str | None,
) -> Quantity:  # fmt: skip
    """Choose the columns of one quantity out of two kinds, of which a recording has one."""
    flags = [f"--{kind}" for kind in kinds]
    if len(said) > 1:
        raise InputError(SOURCE, flags[0], f"{flags[1]} as well", "one of them")
    found = said or [(kind, names) for kind in kinds for names in columns_like(table.header, kind)]
    if len(found) != 1:
        kind = found[0][0] if len({k for k, _ in found}) == 1 else kinds[0]
        flag = f"--{kind}"
        likely = [_listed(names) for _, names in found] or [_listed(table.header)]
        other = f"--{kinds[1] if kind == kinds[0] else kinds[0]}"
        more = "" if what == "motion" else ", or --free where nothing acts"
        question = Question(
            flag, f"Which column is the {' or '.join(kinds)}? One of {_listed(table.header)}",
            _count([names for _, names in found], f"the {what}"),
            f"one of {'; '.join(likely)}, or three for the axes x y z; {other} in its place{more}",
        )  # fmt: skip
        names = ask(question, lambda text: _present(table, tuple(text.replace(",", " ").split()), flag))
        found = [(_kind_of(names[0], kinds, units), names)]
    kind, names = found[0]
    _present(table, names, f"--{kind}")
    return _with_unit(kind, names, table, units, unit, "--force-unit" if what == "force" else "--position-unit", ask)


def _kind_of(name: str, kinds: tuple[Kind, Kind], units: dict[str, str]) -> Kind:
    """Return which of two kinds a column has that somebody named; the first where nothing says so."""
    own = meaning(name)
    if own is not None and own.kind in kinds:
        return own.kind
    return next((kind for kind in kinds if unit_of(units.get(name, ""), kind)), kinds[0])


def _with_unit(
    kind: Kind, names: tuple[str, ...], table: Table, units: dict[str, str], unit: str | None, flag: str, ask: Asker
) -> Quantity:
    stated = unit or _named_unit(names[0], kind, units)
    if stated is None:
        default = next(iter(UNITS[kind]))
        question = Question(flag, f"In which unit is {names[0]}? One of {', '.join(UNITS[kind])}", "", "", default)
        chosen = ask(question, lambda text: checked_unit(text, kind, SOURCE, flag))
        ask.notes.append(f"{kind}: {_listed(names)} [{chosen}]" + ("" if ask.terminal else f", no unit stated: {flag}"))
        return Quantity(kind, names, chosen, ask.terminal, flag)
    chosen = checked_unit(stated, kind, SOURCE, flag)
    ask.notes.append(f"{kind}: {_listed(names)} [{chosen}]")
    return Quantity(kind, names, chosen, True, flag)


def _named_unit(name: str, kind: Kind, units: dict[str, str]) -> str | None:
    own = meaning(name)
    if own is not None and own.kind == kind and own.unit:
        return own.unit
    return unit_of(units.get(name, ""), kind)


def _present(table: Table, names: tuple[str, ...], flag: str) -> tuple[str, ...]:
    """Return names of columns, all of which the file has."""
    if not names:
        raise InputError(SOURCE, flag, "nothing", f"one of {_listed(table.header)}")
    for name in names:
        if name not in table.header:
            raise InputError(table.path, f"line {table.header_line} (header)", f"no column {shortened(name)} of {flag}",
                             nearest(name, table.header))  # fmt: skip
    return names


def _check_axes(motion: Quantity, effort: Quantity | None, velocity: Quantity | None, given: Given) -> None:
    count = len(motion.columns)
    joints = motion.kind == "angle" and count > 1
    if joints and given.mjcf is None:
        raise InputError(
            SOURCE, "--mjcf", f"{count} angles without a mechanism", "an MJCF file of the joints; or one angle"
        )
    if joints and effort is not None and effort.kind != "torque":
        raise InputError(SOURCE, "--torque", f"a {effort.kind} beside {count} angles", "a torque for each, or --free")
    if count > 3 and not joints:
        raise InputError(SOURCE, f"--{motion.kind}", f"{count} columns", "one, or two (x z) or three (x y z)")
    if count > 1 and effort is None and not joints:
        raise InputError(
            SOURCE, "--free", "a motion in space without a force", "a force of as many axes, or one column"
        )
    for part in (effort, velocity):
        if part is not None and len(part.columns) != count:
            found = f"{len(part.columns)} columns beside {count} of the motion"
            raise InputError(SOURCE, f"--{part.kind}", found, f"{count}, for the same axes")


def _listed(names: Sequence[str]) -> str:
    return ", ".join(name or "(a column without a name)" for name in names)


def _count(found: Sequence[tuple[str, ...]], what: str) -> str:
    if not found:
        return f"no column whose name says that it is {what}"
    return f"{len(found)} columns that may be {what}: {'; '.join(_listed(names) for names in found)}"
