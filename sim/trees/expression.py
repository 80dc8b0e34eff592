"""Arithmetic and conditions of L-system productions: text in, a function of named numbers out.

Grammar, weakest binding first::

    a || b      a && b      a < b  (also <= > >= == !=, not chained)      a + b  a - b
    a * b  a / b  a % b      -a  +a  !a      a ^ b  (power, from the right)
    numbers, names, ( ... ), sin cos tan (degrees) sqrt exp log abs floor min max

Logical values are the numbers 0 and 1; every number other than 0 is true; ``&&`` and ``||`` leave their right side
alone where the left decides. ``%`` has the sign of the divisor.
"""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

Evaluator = Callable[[Mapping[str, float]], float]

MAX_OPERATIONS = 100  # of one expression: keeps the recursive parser and evaluator far from Python's stack limit


class ExpressionError(ValueError):
    """An expression that cannot be read or has no value: ``position`` (from 0 in the text), what was found, allowed."""

    def __init__(self, position: int, found: str, allowed: str) -> None:
        self.position, self.found, self.allowed = position, found, allowed
        super().__init__(f"column {position + 1}: found {found}; allowed: {allowed}")


@dataclass(frozen=True)
class Expression:
    """A parsed expression.

    Attributes:
        text: Its text.
        names: Names it uses and the position of each name's first use in the text it was read from.
        evaluate: Its value for numbers by name; raises `ExpressionError` where it has none.
    """

    text: str
    names: dict[str, int]
    evaluate: Evaluator


def parse_expression(text: str, position: int = 0) -> tuple[Expression, int]:
    """Read the expression that begins at ``position`` and return it with the position of what follows it.

    Raises:
        ExpressionError: No expression begins there, or it is not finished.
    """
    parser = _Parser(text, position)
    evaluate = parser.parse(0)
    return Expression(text[position : parser.position].strip(), parser.names, evaluate), parser.position


def _power(base: float, exponent: float) -> float:
    if base == 0.0 and exponent < 0.0:
        raise ZeroDivisionError
    return math.pow(base, exponent)


_BINARY: dict[str, tuple[int, Callable[[float, float], float]]] = {
    "||": (1, operator.or_), "&&": (2, operator.and_), "<": (3, operator.lt), "<=": (3, operator.le),
    ">": (3, operator.gt), ">=": (3, operator.ge), "==": (3, operator.eq), "!=": (3, operator.ne),
    "+": (4, operator.add), "-": (4, operator.sub), "*": (5, operator.mul), "/": (5, operator.truediv),
    "%": (5, operator.mod), "^": (7, _power),
}  # fmt: skip
_COMPARISON, _UNARY, _POWER = 3, 6, 7
_LOGICAL = ("||", "&&")
_SIGNS: dict[str, Callable[..., float]] = {"-": operator.neg, "+": operator.pos, "!": operator.not_}
_FUNCTIONS: dict[str, tuple[int, Callable[..., float]]] = {
    "sin": (1, lambda x: math.sin(math.radians(x))), "cos": (1, lambda x: math.cos(math.radians(x))),
    "tan": (1, lambda x: math.tan(math.radians(x))), "sqrt": (1, math.sqrt), "exp": (1, math.exp),
    "log": (1, math.log), "abs": (1, abs), "floor": (1, math.floor), "min": (2, min), "max": (2, max),
}  # fmt: skip
_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<end>->)|(?P<operator>\|\||&&|<=|>=|==|!=|[-+*/%^<>!()]))",
    re.ASCII,
)
_OPERAND = "a number, a name, a function or '('"


class _Parser:
    """Precedence climbing over the tokens of one text."""

    def __init__(self, text: str, position: int) -> None:
        self.text, self.position, self.operations = text, position, 0
        self.names: dict[str, int] = {}

    def parse(self, weakest: int) -> Evaluator:
        """Read operands joined by operators that bind at least as strongly as ``weakest``."""
        left = self._operand()
        while True:
            kind, symbol, start, end = self._look()
            strength, function = _BINARY.get(symbol, (-1, operator.add)) if kind == "operator" else (-1, operator.add)
            if strength < max(weakest, 0):
                return left
            self._count(start)
            self.position = end
            right = self.parse(strength if strength == _POWER else strength + 1)
            left = _logical(symbol, left, right) if symbol in _LOGICAL else _apply(function, [left, right], start)
            if strength == _COMPARISON and _BINARY.get(self._look()[1], (0,))[0] == _COMPARISON:
                raise ExpressionError(self._look()[2], "a chain of comparisons", "two comparisons joined by &&")

    def _look(self) -> tuple[str, str, int, int]:
        """Kind, text, start and end of the next token; kind "" where none begins."""
        match = _TOKEN.match(self.text, self.position)
        if not match:
            start = len(self.text) - len(self.text[self.position :].lstrip())
            return "", self.text[start : start + 1], start, start
        kind = str(match.lastgroup)
        return kind, match[kind], match.start(kind), match.end()

    def _count(self, position: int) -> None:
        self.operations += 1
        if self.operations > MAX_OPERATIONS:
            raise ExpressionError(position, f"more than {MAX_OPERATIONS} operations", "a shorter expression")

    def _operand(self) -> Evaluator:
        kind, symbol, start, end = self._look()
        if kind not in ("number", "name") and symbol not in ("(", "-", "+", "!"):
            raise ExpressionError(start, f"'{symbol}'" if symbol else "the end", _OPERAND)
        self.position = end
        if kind == "number":
            return _constant(float(symbol), start)
        if kind == "name" and self._look()[1] == "(":
            return self._function(symbol, start)
        if kind == "name":
            self.names.setdefault(symbol, start)
            return operator.itemgetter(symbol)
        self._count(start)
        if symbol == "(":
            inner = self.parse(0)
            self._expect(")", "an operator or ')'")
            return inner
        return _apply(_SIGNS[symbol], [self.parse(_UNARY)], start)

    def _function(self, name: str, start: int) -> Evaluator:
        if name not in _FUNCTIONS:
            raise ExpressionError(start, f"the function {name}", "the functions " + ", ".join(_FUNCTIONS))
        self._count(start)
        count, function = _FUNCTIONS[name]
        self._expect("(", "'('")
        arguments = [self.parse(0)]
        for _ in range(count - 1):
            self._expect(",", f"{count} arguments of {name} separated by ','")
            arguments.append(self.parse(0))
        self._expect(")", f"an operator, or ')' after {count} argument{'s' if count > 1 else ''} of {name}")
        return _apply(function, arguments, start)

    def _expect(self, symbol: str, allowed: str) -> None:
        _, found, start, _ = self._look()
        if found != symbol:
            raise ExpressionError(start, f"'{found}'" if found else "the end", allowed)
        self.position = start + len(symbol)


def _constant(value: float, position: int) -> Evaluator:
    if not math.isfinite(value):
        raise ExpressionError(position, "a number too large", "a number below 1.8e308")
    return lambda _: value


def _logical(symbol: str, left: Evaluator, right: Evaluator) -> Evaluator:
    if symbol == "&&":
        return lambda environment: float(left(environment) != 0 and right(environment) != 0)
    return lambda environment: float(left(environment) != 0 or right(environment) != 0)


def _apply(function: Callable[..., float], operands: list[Evaluator], position: int) -> Evaluator:
    """Return the evaluator of ``function`` of the operands; its failures carry the position of the operator."""

    def evaluate(environment: Mapping[str, float]) -> float:
        """Return the function's value of the operands; raise `ExpressionError` where it is not a finite number."""
        try:
            value = float(function(*[operand(environment) for operand in operands]))
        except ZeroDivisionError:
            raise ExpressionError(position, "a division by zero", "a divisor other than 0") from None
        except OverflowError:
            value = math.inf
        except ExpressionError:
            raise
        except ValueError:
            raise ExpressionError(position, "an argument outside the domain", "arguments with a real value") from None
        if not math.isfinite(value):
            raise ExpressionError(position, "a result that is not finite", "finite numbers")
        return value

    return evaluate
