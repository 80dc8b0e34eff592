"""Parts that installed packages add through entry points, beside bough's own of the same kind.

Names are read from the packages' metadata alone; a package is imported when its part is asked for, so a broken one
breaks only the commands that use it.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Generic, TypeVar

from .errors import InputError

Part = TypeVar("Part")


def points(group: str) -> list[EntryPoint]:
    """Return a group's entry points, in an order that does not depend on where packages lie."""
    return sorted(entry_points(group=group), key=lambda p: (p.name, distribution_of(p), p.value))


@cache
def _accepted(group: str, taken: frozenset[str]) -> dict[str, EntryPoint]:
    """Return a group's entry points by name; none, with a warning, where the name is taken or of several packages."""
    found: dict[str, list[EntryPoint]] = {}
    for point in points(group):
        found.setdefault(point.name, []).append(point)
    for name, same in found.items():
        who = ", ".join(distribution_of(p) for p in same)
        why = "bough has one of that name" if name in taken else "of several packages" if len(same) > 1 else ""
        if why:
            warnings.warn(f"{who}: {name} of {group} is refused: {why}", stacklevel=2)
    return {name: same[0] for name, same in found.items() if name not in taken and len(same) == 1}


def distribution_of(point: EntryPoint) -> str:
    """Return the package that an entry point is of, with its version."""
    return f"{point.dist.name} {point.dist.version}" if point.dist else point.value


def fault_of(error: BaseException) -> str:
    """Return an error of another's package in one line."""
    return str(error) if isinstance(error, InputError) else " ".join(f"{type(error).__name__}: {error}".split())


class Registry(Generic[Part]):
    """Parts of one kind by name: bough's own and those of installed packages.

    Args:
        group: Entry points' group.
        noun: What a part is called in errors, such as ``task``.
        kind: Class of a part. An entry point names one, or a function without arguments that returns one.
        own: bough's own, or functions that make them when they are asked for.
        reserved: Names that packages may not take, beside those of ``own``.
        check: Called with a package's part and its name; raises `InputError` where they do not fit.
    """

    def __init__(
        self, group: str, noun: str, kind: type[Part], own: Mapping[str, Part | Callable[[], Part]], *,
        reserved: Iterable[str] = (), check: Callable[[Part, str], None] = lambda part, name: None,
    ) -> None:  # fmt: skip
        self.group, self.noun, self.kind, self.own, self.check = group, noun, kind, own, check
        self._taken = frozenset(own) | frozenset(reserved)

    @property
    def installed(self) -> dict[str, EntryPoint]:
        """Entry points of installed packages by name; none is imported."""
        return _accepted(self.group, self._taken)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parts, bough's own first; no package is imported."""
        return (*self.own, *self.installed)

    def of(self, name: str, source: object = "bough", place: str = "") -> Part:
        """Return the part of a name.

        Raises:
            InputError: There is none (the error names ``source`` and ``place``), or its package is broken (the error
                names the package).
        """
        if name in self.own:
            return self._made(self.own[name])
        if name not in self.installed:
            raise InputError(str(source), place, name, ", ".join(self.names))
        return self._load(self.installed[name])

    def everything(self) -> dict[str, Part]:
        """Return all parts by name; a package that is broken is left out with a line of warning."""
        found = {name: self._made(part) for name, part in self.own.items()}
        for name, point in self.installed.items():
            try:
                found[name] = self._load(point)
            except InputError as error:
                warnings.warn(f"{error}; it is left out", stacklevel=2)
        return found

    @contextmanager
    def running(self, name: str) -> Iterator[None]:
        """Make one line that names the package of what its part raises while it runs; errors of bough's own stay.

        Raises:
            InputError: A package's part raised an error.
        """
        try:
            yield
        except Exception as error:
            if isinstance(error, InputError) or name not in self.installed:
                raise
            who = distribution_of(self.installed[name])
            raise InputError(who, f"{self.noun} {name}", fault_of(error), "a part that raises nothing") from error

    def hint(self, default: str = "") -> str:
        """Return what the help of a command's option says of the names, and of the default that tyro tells."""
        names = [*self.own, *(f"{name} of {distribution_of(point)}" for name, point in self.installed.items())]
        given = f"; default: {default}" if default else ""
        return f"({self.noun}: {', '.join(names)}{given})"

    def _made(self, part: Part | Callable[[], Part]) -> Part:
        """Return a part, or what a function returns, checked to be one."""
        found = part if isinstance(part, self.kind) else part()  # type: ignore[operator]
        if not isinstance(found, self.kind):
            raise TypeError(f"a {type(found).__name__}")
        return found

    def _load(self, point: EntryPoint) -> Part:
        """Import a package's part; whatever goes wrong in it becomes one line that names it."""
        try:
            found = self._made(point.load())
            self.check(found, point.name)
        except InputError as error:
            place = ": ".join(filter(None, [f"{self.noun} {point.name}", error.source, error.place]))
            raise InputError(distribution_of(point), place, error.found, error.allowed) from error
        except (Exception, SystemExit) as error:
            wanted = f"{self.kind.__name__}, or a function that returns one"
            raise InputError(distribution_of(point), f"{self.noun} {point.name}", fault_of(error), wanted) from error
        return found
