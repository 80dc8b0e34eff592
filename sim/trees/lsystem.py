"""Parametric L-systems: productions read from text, checked as a whole, applied in parallel.

A production is ``predecessor : condition : probability -> successor``; condition (``*`` for none) and probability may
be left out::

    A(l, w) : l > 0.1 && w >= 1 -> !(w)F(l)[&(a)A(l*r, w*0.7)]
    B : * : 0.3 -> F(1)B

Symbols are single characters: letters and the turtle's commands (`turtle.COMMANDS`). All productions of one iteration
act at once, on every module that has a production of its symbol: the first whose condition holds. If that one has a
probability, one is drawn from those whose conditions hold and that have one; what is missing to 1 leaves the module as
it is. A module without a production that applies stays. Expressions are those of `expression`; they know the
predecessor's parameters and the system's constants. Nothing is ever passed to Python's own evaluator.

After Prusinkiewicz and Lindenmayer, The Algorithmic Beauty of Plants, section 1.10.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from ..base.errors import InputError
from ..base.files import read_text
from .expression import ExpressionError
from .production import (
    Production,
    Reader,
    Template,
    check_system,
    read_declaration,
    read_modules,
    read_production,
    resolve_constants,
)
from .turtle import Module

Seed = int | np.random.SeedSequence | np.random.Generator

MAX_MODULES = 2_000_000
SMALLEST_FACTOR = 0.1
"""Least factor that noise puts on a constant: keeps lengths and widths positive however large the noise."""


class LSystemFile(BaseModel):
    """Fields of an L-system file (YAML). Angles are in degrees, lengths in the file's own units.

    Attributes:
        axiom: Modules to begin with.
        productions: Productions, one text each.
        constants: Numbers, or expressions of numbers and other constants, by name.
        iterations: How often the productions are applied.
        symbols: Further symbols without a production, with their parameters: ``B``, ``C(x, y)``.
        tropism: Direction T toward which segments bend, z up.
        bending: Susceptibility e to it: e |H x T| rad a segment.
        angle_deg: Angle of turns written without one.
        scale_m_per_unit: Metres per unit of length.
        width_m_per_unit: Metres of diameter per unit of width.
    """

    model_config = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

    axiom: str
    productions: list[str] = []
    constants: dict[str, float | str] = {}
    iterations: Annotated[int, Field(ge=0)] = 1
    symbols: list[str] = []
    tropism: Annotated[list[float], Field(min_length=3, max_length=3)] = [0.0, 0.0, 0.0]
    bending: float = 0.0
    angle_deg: float | None = None
    scale_m_per_unit: Annotated[float, Field(gt=0)] = 1.0
    width_m_per_unit: Annotated[float, Field(gt=0)] = 1.0


class LSystem:
    """A checked L-system.

    Its arguments are the fields of `LSystemFile`, and ``source``: what errors name as the place of the fault, usually
    the file.

    Raises:
        InputError: Names the text and the column: unbalanced brackets, a symbol that is no turtle command, has no
            production and is not declared, a wrong number of parameters, an unknown name, constants that define each
            other in a circle, a production that nothing can lead to, text that cannot be read.
    """

    def __init__(
        self,
        axiom: str,
        productions: Sequence[str] = (),
        constants: Mapping[str, float | str] | None = None,
        *,
        iterations: int = 1,
        symbols: Sequence[str] = (),
        tropism: Sequence[float] = (0.0, 0.0, 0.0),
        bending: float = 0.0,
        angle_deg: float | None = None,
        scale_m_per_unit: float = 1.0,
        width_m_per_unit: float = 1.0,
        source: str | Path = "L-system",
    ) -> None:
        self.source, self.iterations = str(source), iterations
        self.tropism, self.bending, self.angle_deg = tuple(tropism), bending, angle_deg
        self.scale_m_per_unit, self.width_m_per_unit = scale_m_per_unit, width_m_per_unit
        self.constants = resolve_constants(constants or {}, self.source)
        self.productions = [read_production(text, self.constants, self.source) for text in productions]
        self._rules: dict[str, list[Production]] = {}
        for production in self.productions:
            self._rules.setdefault(production.symbol, []).append(production)
        reader = Reader("axiom", axiom, self.source)
        templates = read_modules(reader)
        declared = dict(read_declaration(text, self.source) for text in symbols)
        check_system((reader, templates), self.productions, declared, self.constants, self.source)
        try:
            self.axiom = _evaluate(templates, self.constants)
        except ExpressionError as error:
            raise _located(error, self.source, f"axiom '{axiom}'") from None

    @classmethod
    def from_file(cls, path: str | Path) -> LSystem:
        """Read a YAML file with the fields of `LSystemFile`.

        Raises:
            InputError: Names the file and the line or field; otherwise as for the class.
        """
        fields = _load_yaml(path)
        try:
            file = LSystemFile.model_validate(fields)
        except ValidationError as error:
            first = error.errors()[0]
            found = "nothing" if first["type"] == "missing" else repr(first["input"])
            field = ".".join(str(part) for part in first["loc"])
            allowed = f"one of {', '.join(LSystemFile.model_fields)}" if "extra" in first["type"] else first["msg"]
            raise InputError(path, field, found, allowed) from None
        return cls(**file.model_dump(), source=path)

    def derive(self, iterations: int | None = None, *, seed: Seed = 0, noise: float = 0.0) -> list[Module]:
        """Apply the productions and return the string of modules.

        Args:
            iterations: How often; None for the system's own number.
            seed: Seed or generator of the noise and of productions with a probability.
            noise: Standard deviation sigma of the noise relative to each constant: every time a production is applied,
                each constant c in its successor becomes c max(1 + sigma N(0, 1), 0.1), drawn once for the application
                (thesis B.9). Conditions see the constants without noise.

        Raises:
            InputError: A parameter has no value (division by zero, ...), the string grows beyond 2 million modules,
                ``iterations`` or ``noise`` is out of range.
        """
        count = self.iterations if iterations is None else iterations
        if count < 0:
            raise InputError(self.source, "iterations", str(count), "zero or more")
        if not 0.0 <= noise <= 1.0:
            raise InputError(self.source, "noise", f"{noise:g}", "0 to 1")
        rng = np.random.default_rng(seed)
        word = self.axiom
        for iteration in range(1, count + 1):
            word = self._rewrite(word, iteration, rng, noise)
        return word

    def _rewrite(self, word: list[Module], iteration: int, rng: np.random.Generator, noise: float) -> list[Module]:
        out: list[Module] = []
        for module in word:
            rule = self._choose(module, rng) if module[0] in self._rules else None
            if rule is None:
                out.append(module)
            else:
                out += self._apply(rule, module, rng, noise)
            if len(out) > MAX_MODULES:
                found = f"more than {MAX_MODULES} modules"
                raise InputError(self.source, f"iteration {iteration}", found, "fewer iterations or slower growth")
        return out

    def _choose(self, module: Module, rng: np.random.Generator) -> Production | None:
        """Production that acts on a module, or None."""
        holding = [rule for rule in self._rules[module[0]] if self._holds(rule, module)]
        if not holding or holding[0].probability is None:
            return holding[0] if holding else None
        total = sum(rule.probability or 0.0 for rule in holding)
        if total > 1.0 + 1e-9:
            place = f"productions of {_module_text(module)}"
            raise InputError(self.source, place, f"probabilities that add up to {total:g}", "at most 1")
        draw = rng.random()
        for rule in holding:
            draw -= rule.probability or 0.0
            if draw < 0.0:
                return rule
        return None

    def _holds(self, rule: Production, module: Module) -> bool:
        if rule.condition is None:
            return True
        try:
            return rule.condition.evaluate(self._environment(rule, module)) != 0.0
        except ExpressionError as error:
            raise _located(error, self.source, f"production '{rule.text}'", module) from None

    def _apply(self, rule: Production, module: Module, rng: np.random.Generator, noise: float) -> list[Module]:
        environment = self._environment(rule, module)
        if noise > 0.0 and rule.constants:
            for name, draw in zip(rule.constants, rng.standard_normal(len(rule.constants)).tolist(), strict=True):
                environment[name] *= max(1.0 + noise * draw, SMALLEST_FACTOR)
        try:
            return _evaluate(rule.successor, environment)
        except ExpressionError as error:
            raise _located(error, self.source, f"production '{rule.text}'", module) from None

    def _environment(self, rule: Production, module: Module) -> dict[str, float]:
        return {**self.constants, **dict(zip(rule.parameters, module[1], strict=True))}


def _evaluate(templates: Sequence[Template], environment: Mapping[str, float]) -> list[Module]:
    return [(t.symbol, tuple([p.evaluate(environment) for p in t.parameters])) for t in templates]


def _located(error: ExpressionError, source: str, place: str, module: Module | None = None) -> InputError:
    found = error.found + (f" for {_module_text(module)}" if module else "")
    return InputError(source, f"{place}, column {error.position + 1}", found, error.allowed)


def to_text(modules: Sequence[Module]) -> str:
    """Write modules as text, numbers with six digits: ``F(1.5)[+(30)A]``."""
    return "".join(_module_text(module) for module in modules)


def _module_text(module: Module) -> str:
    return module[0] + ("(" + ",".join(f"{p:g}" for p in module[1]) + ")" if module[1] else "")


class _StrictLoader(yaml.SafeLoader):
    """Safe YAML that refuses a key given twice instead of keeping the last."""

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        """Return a mapping; raise where a key is given twice."""
        seen: list[object] = []
        for key, _ in node.value:
            if key.value in seen:
                raise yaml.constructor.ConstructorError(None, None, f"the key {key.value} twice", key.start_mark)
            seen.append(key.value)
        return super().construct_mapping(node, deep)


def _load_yaml(path: str | Path) -> dict:
    """Read a YAML mapping; faults name the line."""
    try:
        fields = yaml.load(read_text(path), Loader=_StrictLoader)
    except RecursionError:
        raise InputError(path, "", "YAML that is nested too deeply", "fields of numbers, texts and lists") from None
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        place = f"line {mark.line + 1}, column {mark.column + 1}" if mark else ""
        found = getattr(error, "problem", None) or "text that is no YAML"
        raise InputError(path, place, found, "YAML with each key once; texts that begin with ! & [ in quotes") from None
    if not isinstance(fields, dict):
        raise InputError(path, "", f"a {type(fields).__name__}", "fields such as 'axiom: ...'")
    return fields
