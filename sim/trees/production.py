"""Text of an L-system into structures, and the checks that make it whole: every fault names its text and column."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NoReturn

from ..base.errors import InputError
from .expression import Expression, ExpressionError, parse_expression
from .turtle import COMMANDS

_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)


@dataclass(frozen=True)
class Template:
    """One module of an axiom or a successor before its parameters have values; ``position`` in its text, from 0."""

    symbol: str
    parameters: tuple[Expression, ...]
    position: int


@dataclass(frozen=True)
class Production:
    """One rule: what it replaces, when, how often and by what.

    Attributes:
        text: Its text.
        symbol, parameters: Its predecessor.
        condition: When it applies; None for always.
        probability: How often, 0 to 1; None for always.
        successor: What it puts in place.
        constants: Constants that the successor uses, in the order of their names.
    """

    text: str
    symbol: str
    parameters: tuple[str, ...]
    condition: Expression | None
    probability: float | None
    successor: tuple[Template, ...]
    constants: tuple[str, ...]


class Reader:
    """A text and a place in it; ``fail`` raises the `InputError` that names both."""

    def __init__(self, kind: str, text: str, source: str) -> None:
        self.kind, self.text, self.source, self.position = kind, text, source, 0

    def fail(self, position: int, found: str, allowed: str) -> NoReturn:
        """Raise `InputError` for what stands at ``position``."""
        raise InputError(self.source, f"{self.kind} '{self.text}', column {position + 1}", found, allowed)

    def peek(self) -> str:
        """Next character that is no space, "" at the end."""
        rest = self.text[self.position :]
        self.position += len(rest) - len(rest.lstrip())
        return self.text[self.position : self.position + 1]

    def take(self, symbol: str, allowed: str) -> None:
        """Step over ``symbol``, which must come next."""
        if not self.peek() or not self.text.startswith(symbol, self.position):
            self.fail(self.position, _quoted(self.peek()), allowed)
        self.position += len(symbol)

    def name(self) -> str:
        """Read the name of a parameter."""
        self.peek()
        match = _NAME.match(self.text, self.position)
        if not match:
            self.fail(self.position, _quoted(self.peek()), "the name of a parameter")
        self.position = match.end()
        return match[0]

    def expression(self) -> Expression:
        """Read an expression."""
        try:
            expression, self.position = parse_expression(self.text, self.position)
        except ExpressionError as error:
            self.fail(error.position, error.found, error.allowed)
        return expression


def _quoted(symbol: str) -> str:
    return f"'{symbol}'" if symbol else "the end"


def read_modules(reader: Reader) -> tuple[Template, ...]:
    """Read modules to the end of the text: an axiom or a successor, brackets balanced."""
    out: list[Template] = []
    opened: list[int] = []
    while symbol := reader.peek():
        position = reader.position
        if not (symbol.isascii() and symbol.isalpha()) and symbol not in COMMANDS and symbol not in "[]":
            allowed = f"letters, brackets and the turtle commands {' '.join(COMMANDS)}"
            reader.fail(position, f"the symbol '{symbol}'", allowed)
        reader.position += 1
        if symbol == "[":
            opened.append(position)
        elif symbol == "]" and not opened:
            reader.fail(position, "']' without '['", "balanced brackets")
        elif symbol == "]":
            opened.pop()
        parameters = _read_list(reader, reader.expression) if symbol not in "[]" and reader.peek() == "(" else []
        out.append(Template(symbol, tuple(parameters), position))
    if opened:
        reader.fail(opened[-1], "'[' without ']'", "balanced brackets")
    return tuple(out)


def _read_list(reader: Reader, item: Callable) -> list:
    """Read ``(item, item, ...)``."""
    reader.take("(", "'('")
    out = [item()]
    while reader.peek() == ",":
        reader.position += 1
        out.append(item())
    reader.take(")", "an operator, ',' or ')'")
    return out


def read_predecessor(reader: Reader) -> tuple[str, tuple[str, ...]]:
    """Read a symbol with the names of its parameters."""
    symbol, start = reader.peek(), reader.position
    if not (symbol.isascii() and symbol.isalpha()) and symbol not in COMMANDS:
        reader.fail(start, _quoted(symbol), f"one letter or turtle command ({' '.join(COMMANDS)})")
    reader.position += 1
    parameters = _read_list(reader, reader.name) if reader.peek() == "(" else []
    for name in parameters:
        if parameters.count(name) > 1:
            reader.fail(start, f"the parameter {name} twice", "different names")
    if symbol in COMMANDS and len(parameters) not in COMMANDS[symbol]:
        reader.fail(start, f"{symbol} with {_parameters(len(parameters))}", _counts(COMMANDS[symbol]))
    return symbol, tuple(parameters)


def read_production(text: str, constants: Mapping[str, float], source: str) -> Production:
    """Read ``A(l) : condition : probability -> successor``.

    Raises:
        InputError: The text cannot be read, uses an unknown name, or a parameter has a constant's name.
    """
    reader = Reader("production", text, source)
    symbol, parameters = read_predecessor(reader)
    for name in parameters:
        if name in constants:
            reader.fail(0, f"the parameter {name}, which is a constant too", "a name that is no constant")
    condition, probability = _read_clauses(reader)
    reader.take("->", "':' or '->'" if condition is None else "an operator, ':' or '->'")
    successor = read_modules(reader)
    expressions = [p for t in successor for p in t.parameters]
    for expression in expressions + ([condition] if condition else []):
        check_names(reader, expression, [*parameters, *constants])
    used = {name for e in expressions for name in e.names if name in constants}
    value = _probability(reader, probability, constants) if probability else None
    return Production(text, symbol, parameters, condition, value, successor, tuple(sorted(used)))


def _read_clauses(reader: Reader) -> tuple[Expression | None, Expression | None]:
    """Read what may stand before the arrow: a condition and a probability."""
    clauses: list[Expression | None] = []
    while reader.peek() == ":" and len(clauses) < 2:
        reader.position += 1
        if reader.peek() == "*" and not clauses:
            reader.position += 1
            clauses.append(None)
        else:
            clauses.append(reader.expression())
    return clauses[0] if clauses else None, clauses[1] if len(clauses) > 1 else None


def _probability(reader: Reader, expression: Expression, constants: Mapping[str, float]) -> float:
    check_names(reader, expression, list(constants))
    try:
        value = expression.evaluate(constants)
    except ExpressionError as error:
        reader.fail(error.position, error.found, error.allowed)
    if not 0.0 < value <= 1.0:
        reader.fail(reader.text.index(":"), f"the probability {value:g}", "more than 0, at most 1")
    return value


def check_names(reader: Reader, expression: Expression, known: Sequence[str]) -> None:
    """Raise `InputError` for a name in ``expression`` that is not known."""
    for name, position in expression.names.items():
        if name not in known:
            allowed = f"one of {', '.join(known)}" if known else "numbers: no parameter or constant is defined"
            reader.fail(position, f"the unknown name {name}", allowed)


def read_declaration(text: str, source: str) -> tuple[str, tuple[str, ...]]:
    """Read a declared symbol with its parameters: ``B`` or ``C(x, y)``."""
    reader = Reader("symbol", text, source)
    declaration = read_predecessor(reader)
    if reader.peek():
        reader.fail(reader.position, _quoted(reader.peek()), "one symbol with its parameters")
    return declaration


def resolve_constants(definitions: Mapping[str, float | str], source: str) -> dict[str, float]:
    """Values of constants that are numbers or expressions of other constants.

    Raises:
        InputError: Names the constant: a name that is none, an unknown name, a circle, an expression without a value.
    """
    expressions: dict[str, tuple[Reader, Expression]] = {}
    values: dict[str, float] = {}
    for name, definition in definitions.items():
        reader = Reader(f"constant {name} =", str(definition), source)
        if not _NAME.fullmatch(name):
            reader.fail(0, f"the name '{name}'", "letters, digits and _, not beginning with a digit")
        if isinstance(definition, str):
            expressions[name] = reader, _whole_expression(reader, list(definitions))
        elif not math.isfinite(definition):
            reader.fail(0, f"{definition}", "a finite number or an expression")
        else:
            values[name] = float(definition)
    for name in definitions:
        _resolve(name, [], expressions, values)
    return {name: values[name] for name in definitions}


def _whole_expression(reader: Reader, known: Sequence[str]) -> Expression:
    expression = reader.expression()
    if reader.peek():
        reader.fail(reader.position, _quoted(reader.peek()), "an operator or the end")
    check_names(reader, expression, known)
    return expression


def _resolve(
    name: str, above: list[str], expressions: dict[str, tuple[Reader, Expression]], values: dict[str, float]
) -> None:
    """Put the value of ``name`` into ``values``, those it needs first; ``above`` are those that wait for it."""
    if name in values:
        return
    reader, expression = expressions[name]
    if name in above:
        circle = " -> ".join([*above[above.index(name) :], name])
        reader.fail(0, f"a circle of constants {circle}", "constants that do not lead back to themselves")
    for other in expression.names:
        _resolve(other, [*above, name], expressions, values)
    try:
        values[name] = expression.evaluate(values)
    except ExpressionError as error:
        reader.fail(error.position, error.found, error.allowed)


def check_system(
    axiom: tuple[Reader, tuple[Template, ...]],
    productions: Sequence[Production],
    declared: Mapping[str, tuple[str, ...]],
    constants: Mapping[str, float],
    source: str,
) -> None:
    """Check what no production shows alone: symbols, numbers of parameters, productions that can never act.

    Raises:
        InputError: Names the text and the column.
    """
    reader, modules = axiom
    if not modules:
        reader.fail(0, "nothing", "at least one module")
    for template in modules:
        for expression in template.parameters:
            check_names(reader, expression, list(constants))
    counts = _parameter_counts(productions, declared, source)
    _check_symbols(reader, modules, counts)
    for production in productions:
        _check_symbols(Reader("production", production.text, source), production.successor, counts)
    _check_reached(modules, productions, source)


def _parameter_counts(
    productions: Sequence[Production], declared: Mapping[str, tuple[str, ...]], source: str
) -> dict[str, tuple[int, ...]]:
    """Numbers of parameters each symbol may have; one that stands before an arrow has just one number."""
    counts: dict[str, tuple[int, ...]] = {symbol: (len(names),) for symbol, names in declared.items()}
    for production in productions:
        number = (len(production.parameters),)
        if counts.setdefault(production.symbol, number) != number:
            found = f"{production.symbol} with {_parameters(number[0])}"
            Reader("production", production.text, source).fail(0, found, _counts(counts[production.symbol]))
    return {**COMMANDS, "[": (0,), "]": (0,), **counts}


def _check_symbols(reader: Reader, modules: Sequence[Template], counts: Mapping[str, tuple[int, ...]]) -> None:
    for template in modules:
        allowed = counts.get(template.symbol)
        if allowed is None:
            found = f"the unknown symbol {template.symbol}"
            reader.fail(template.position, found, "a turtle command, a symbol with a production or a declared symbol")
        elif len(template.parameters) not in allowed:
            found = f"{template.symbol} with {_parameters(len(template.parameters))}"
            reader.fail(template.position, found, _counts(allowed))


def _check_reached(modules: Sequence[Template], productions: Sequence[Production], source: str) -> None:
    """Refuse productions whose symbol the axiom never leads to, and those behind one that always applies."""
    reached, todo = set[str](), [t.symbol for t in modules]
    while todo:
        symbol = todo.pop()
        if symbol not in reached:
            reached.add(symbol)
            todo += [t.symbol for p in productions if p.symbol == symbol for t in p.successor]
    always: dict[str, str] = {}
    for production in productions:
        reader, symbol = Reader("production", production.text, source), production.symbol
        if symbol not in reached:
            found = f"a production of {symbol}, which nothing produces"
            reader.fail(0, found, f"productions of symbols that the axiom leads to: {' '.join(sorted(reached))}")
        if symbol in always:
            found = f"a production that never applies, behind '{always[symbol]}'"
            reader.fail(0, found, "productions with conditions before the one without")
        if production.condition is None and production.probability is None:
            always[symbol] = production.text


def _parameters(count: int) -> str:
    return f"{count} parameter{'' if count == 1 else 's'}"


def _counts(allowed: Sequence[int]) -> str:
    return " or ".join(str(count) for count in allowed) + f" parameter{'' if tuple(allowed) == (1,) else 's'}"
