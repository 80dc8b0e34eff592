"""Grammar, expressions and rewriting against derivations by hand and Python's own arithmetic."""

import numpy as np
import pytest
from bough.sim.base.errors import InputError
from bough.sim.trees import lsystem
from bough.sim.trees.expression import ExpressionError, parse_expression
from bough.sim.trees.lsystem import LSystem, to_text
from hypothesis import given, settings
from hypothesis import strategies as st

PARAMETRIC = [
    "A(x, y) : y <= 3 -> A(x*2, x + y)",
    "A(x, y) : y > 3 -> B(x)A(x/y, 0)",
    "B(x) : x < 1 -> C",
    "B(x) : x >= 1 -> B(x - 1)",
]


def test_derives_the_parametric_example_by_hand() -> None:
    """Check the parametric example of Prusinkiewicz and Lindenmayer, section 1.10, derived by hand."""
    system = LSystem("B(2)A(4,4)", PARAMETRIC, symbols=["C"])
    words = [to_text(system.derive(n)) for n in range(5)]
    assert words == [
        "B(2)A(4,4)",
        "B(1)B(4)A(1,0)",
        "B(0)B(3)A(2,1)",
        "CB(2)A(4,3)",
        "CB(1)A(8,7)",
    ]
    assert to_text(system.derive(5)) == "CB(0)B(8)A(1.14286,0)"


def test_derives_a_growing_filament_by_hand() -> None:
    """Check the cells of Anabaena catenula: sequences by hand, then Fibonacci's numbers."""
    # a, b: long and short cell that divides to the left; c, d: to the right; the parameter counts the generation.
    rules = ["a(n) -> c(n+1)b(n+1)", "c(n) -> d(n+1)a(n+1)", "b(n) -> a(n+1)", "d(n) -> c(n+1)"]
    system = LSystem("a(0)", rules)
    words = ["".join(symbol for symbol, _ in system.derive(n)) for n in range(6)]
    assert words == ["a", "cb", "daa", "ccbcb", "dadaadaa", "ccbccbcbccbcb"]
    fibonacci = [1, 2]
    while len(fibonacci) < 15:
        fibonacci.append(fibonacci[-1] + fibonacci[-2])
    assert len(system.derive(14)) == fibonacci[14]
    assert {p for _, p in system.derive(14)} == {(14.0,)}


def test_resolves_constants_of_constants() -> None:
    """Check the row of trees, whose constants are expressions of each other in any order."""
    definitions = {"h": "(p*q)^0.5", "q": "c - p", "p": 0.3, "c": 1}
    system = LSystem("F(1)", ["F(x) -> F(x*p)+F(x*h)--F(x*h)+F(x*q)"], definitions, angle_deg=86.0)
    h = np.sqrt(0.3 * 0.7)
    lengths = [p[0] for s, p in system.derive(2) if s == "F"]
    assert lengths == pytest.approx([a * b for a in (0.3, h, h, 0.7) for b in (0.3, h, h, 0.7)], rel=1e-15)


def test_takes_the_first_production_that_holds() -> None:
    """Check the order of productions, and that a module no production holds for stays."""
    system = LSystem("A(1)A(5)A(9)", ["A(x) : x > 8 -> F(8)", "A(x) : x > 4 && !(x == 7) -> F(4)"])
    assert to_text(system.derive(1)) == "A(1)F(4)F(8)"


def test_reads_the_grammar_of_the_module_docstring() -> None:
    """Check turtle symbols as predecessors, `^` as pitch outside and power inside parentheses, `-` before `->`."""
    system = LSystem("!(2)^(10)A(3)-", ["!(w) -> !(w^2)", "^(a) -> ^(-a)", "A(l):l-1>1->F(l)-"], angle_deg=90)
    assert to_text(system.derive(1)) == "!(4)^(-10)F(3)--"


def test_draws_productions_by_their_probability() -> None:
    """Check frequencies 0.2, 0.5 and, for what is missing to 1, no change, within five standard errors."""
    system = LSystem("A" * 20_000, ["A : * : 0.2 -> B", "A : * : 0.5 -> C"], symbols=["B", "C"])
    word = "".join(s for s, _ in system.derive(1, seed=3))
    for symbol, share in (("B", 0.2), ("C", 0.5), ("A", 0.3)):
        assert abs(word.count(symbol) / 20_000 - share) < 5 * np.sqrt(share * (1 - share) / 20_000)


def test_noise_has_the_mean_and_spread_asked_for() -> None:
    """Check that every application draws each constant once: mean, sigma 0.1 and equality inside an application."""
    system = LSystem("A" * 10_000, ["A -> F(l)+(a)F(l)"], {"l": 3.0, "a": 40.0})
    word = system.derive(1, seed=1, noise=0.1)
    values = np.array([p[0] for _, p in word]).reshape(-1, 3)
    assert np.array_equal(values[:, 0], values[:, 2])
    for column, constant in ((0, 3.0), (1, 40.0)):
        relative = values[:, column] / constant
        assert abs(relative.mean() - 1.0) < 5 * 0.1 / 100  # five standard errors of the mean
        assert abs(relative.std() / 0.1 - 1.0) < 5 / np.sqrt(2 * 10_000)  # and of the standard deviation
    assert abs(np.corrcoef(values[:, 0], values[:, 1])[0, 1]) < 0.05
    assert {p for s, p in system.derive(1, seed=1) if s == "F"} == {(3.0,)}


def test_refuses_a_string_that_grows_without_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    """Check the limit of the length, named with the iteration that passes it."""
    monkeypatch.setattr(lsystem, "MAX_MODULES", 1000)
    with pytest.raises(InputError, match=r"iteration 10: found more than 1000 modules"):
        LSystem("A", ["A -> AA"]).derive(40)
    assert len(LSystem("A", ["A -> AA"]).derive(9)) == 512


BAD = [
    ("A[&(3)F", ["A -> F"], {}, "axiom 'A[&(3)F', column 2", "'[' without ']'"),
    ("A", ["A -> F]F"], {}, "production 'A -> F]F', column 7", "']' without '['"),
    ("A", ["A -> B"], {}, "production 'A -> B', column 6", "unknown symbol B"),
    ("F", ["A -> F"], {}, "production 'A -> F', column 1", "a production of A, which nothing produces"),
    ("A", ["A -> F", "A -> FF"], {}, "production 'A -> FF', column 1", "never applies, behind 'A -> F'"),
    ("A(1)", ["A(x) -> F(y)"], {}, "production 'A(x) -> F(y)', column 11", "unknown name y"),
    ("A(1)", ["A(x) : z > 1 -> F"], {}, "column 8", "unknown name z"),
    ("A(k)", ["A(x) -> F"], {}, "axiom 'A(k)', column 3", "unknown name k"),
    ("A(1,2)", ["A(x) -> F"], {}, "axiom 'A(1,2)', column 1", "A with 2 parameters; allowed: 1 parameter"),
    ("A(1)", ["A(x) -> F(x,x)"], {}, "column 9", "F with 2 parameters; allowed: 0 or 1"),
    ("A(1)", ["A(x) : x>5 -> F", "A(x, y) -> F"], {}, "'A(x, y) -> F', column 1", "A with 2 parameters"),
    ("A", ["!(w, v) -> F"], {}, "column 1", "! with 2 parameters; allowed: 1 parameter"),
    ("A(1)", ["A(x, x) -> F"], {}, "column 1", "parameter x twice"),
    ("A(1)", ["A(x) -> F(x)"], {"x": 1}, "column 1", "parameter x, which is a constant"),
    ("A", ["A -> F(1/0)"], {}, "production 'A -> F(1/0)', column 9", "division by zero"),
    ("A(2)", ["A(x) -> F(1/(x-2))"], {}, "column 12", "division by zero for A(2)"),
    ("A(2)", ["A(x) : 1 % (x-2) > 0 -> F"], {}, "column 10", "division by zero for A(2)"),
    ("F(1/0)", [], {}, "axiom 'F(1/0)', column 4", "division by zero"),
    ("A", ["A -> F(sqrt(0-1))"], {}, "column 8", "outside the domain"),
    ("A", ["A -> F(10^400)"], {}, "column 10", "not finite"),
    ("A", ["A -> F(2"], {}, "column 9", "the end; allowed: an operator, ',' or ')'"),
    ("A", ["A -> F()"], {}, "column 8", "')'; allowed: a number"),
    ("A", ["A -> F(2 3)"], {}, "column 10", "'3'"),
    ("A", ["A F"], {}, "column 3", "'F'; allowed: ':' or '->'"),
    ("A", ["-> F"], {}, "column 2", "'>'"),
    ("A", ["A : 1 < 2 < 3 -> F"], {}, "column 11", "a chain of comparisons"),
    ("A", ["A -> F#"], {}, "column 7", "the symbol '#'"),
    ("A", ["A -> tree(1)"], {}, "column 6", "unknown symbol t"),
    ("A", ["A -> F(wave(1))"], {}, "column 8", "the function wave"),
    ("A", ["A : * : 1.5 -> F"], {}, "column 3", "probability 1.5"),
    ("A", ["A : * : 0.7 -> F", "A : * : 0.7 -> FF"], {}, "productions of A", "add up to 1.4"),
    ("A", ["A -> F(" + "1+" * 200 + "1)"], {}, "column", "more than 100 operations"),
    ("", [], {}, "axiom ''", "nothing"),
    ("F(a)", [], {"a": "b + 1", "b": "2*c", "c": "a"}, "constant a =", "a circle of constants a -> b -> c -> a"),
    ("F(a)", [], {"a": "a"}, "constant a =", "a circle of constants a -> a"),
    ("F(a)", [], {"a": "q"}, "constant a = 'q', column 1", "unknown name q"),
    ("F(a)", [], {"a": "1 1"}, "constant a = '1 1', column 3", "'1'"),
    ("F(a)", [], {"a": "1/0"}, "constant a = '1/0', column 2", "division by zero"),
    ("F(a)", [], {"a": float("nan")}, "constant a =", "nan"),
    ("F", [], {"2a": 1}, "constant 2a", "the name '2a'"),
]


@pytest.mark.parametrize(("axiom", "productions", "constants", "place", "found"), BAD)
def test_refuses_bad_text(axiom: str, productions: list[str], constants: dict, place: str, found: str) -> None:
    """Check that each fault is one line with the text, the column and what was found."""
    with pytest.raises(InputError) as info:
        LSystem(axiom, productions, constants, source="system.yaml").derive(1)
    message = str(info.value)
    assert message.startswith("system.yaml: ") and "\n" not in message
    assert place in message and found in message


@pytest.mark.parametrize(("options", "found"), [({"noise": -0.1}, "noise"), ({"iterations": -1}, "iterations")])
def test_refuses_bad_options(options: dict, found: str) -> None:
    """Check that options out of range are named."""
    with pytest.raises(InputError, match=found):
        LSystem("F").derive(**options)


def test_reads_a_file(tmp_path) -> None:
    """Check that a file gives the system its text describes."""
    path = tmp_path / "system.yaml"
    path.write_text(
        'axiom: "!(1)F(a)A"\nconstants: {a: 2, b: a/4}\nproductions: ["A -> [+(30)F(b)]A"]\niterations: 2\n'
        "tropism: [0, 0, -1]\nbending: 0.2\nscale_m_per_unit: 0.5\nwidth_m_per_unit: 0.01\n"
    )
    system = LSystem.from_file(path)
    assert to_text(system.derive()) == "!(1)F(2)[+(30)F(0.5)][+(30)F(0.5)]A"
    assert (system.tropism, system.bending) == ((0, 0, -1), 0.2)
    assert (system.scale_m_per_unit, system.width_m_per_unit) == (0.5, 0.01)


@pytest.mark.parametrize(
    ("text", "place", "found"),
    [
        ("axiom: F\nangle: 3\n", "angle", "3; allowed: one of axiom, productions"),
        ("productions: []\n", "axiom", "nothing"),
        ("axiom: F\niterations: 2.5\n", "iterations", "2.5"),
        ("axiom: F\niterations: -1\n", "iterations", "-1"),
        ("axiom: F\nbending: steep\n", "bending", "'steep'"),
        ("axiom: F\nbending: .nan\n", "bending", "nan"),
        ("axiom: F\ntropism: [0, 1]\n", "tropism", "[0, 1]"),
        ("axiom: F\nscale_m_per_unit: 0\n", "scale_m_per_unit", "0"),
        ("axiom: F\naxiom: FF\n", "line 2", "the key axiom twice"),
        ("axiom: [F\n", "line 2", "allowed: YAML"),
        ("axiom: !(1)F\n", "line 1", "in quotes"),
        ("- F\n", "", "a list"),
        ("", "", "a NoneType"),
        ("axiom: F[\n", "axiom 'F[', column 2", "without"),
    ],
)
def test_refuses_a_bad_file(tmp_path, text: str, place: str, found: str) -> None:
    """Check that file and field or line are named."""
    path = tmp_path / "system.yaml"
    path.write_text(text)
    with pytest.raises(InputError) as info:
        LSystem.from_file(path)
    assert str(info.value).startswith(f"{path}: {place}") and found in str(info.value)


def test_refuses_a_missing_file(tmp_path) -> None:
    """Check that a file that is not there is named."""
    with pytest.raises(InputError, match="no such file"):
        LSystem.from_file(tmp_path / "none.yaml")


# Expressions: text in Python's notation, where ours differs only in ^, &&, ||, ! and in values being numbers.
_NUMBERS = st.sampled_from(["0.0", "1.0", "2.5", "3.0", "0.25", "a", "b"])
_NAMES = {"a": 1.5, "b": -2.0}


def _arithmetic(inner: st.SearchStrategy[str]) -> st.SearchStrategy[str]:
    joined = st.lists(st.tuples(st.sampled_from([" + ", "-", "*", " / ", "%"]), inner), min_size=1, max_size=3)
    return st.one_of(
        st.tuples(inner, joined).map(lambda t: t[0] + "".join(a + b for a, b in t[1])),
        inner.map(lambda t: f"({t})"),
        inner.map(lambda t: f"-{t}"),
        st.tuples(inner, st.sampled_from(["2.0", "3.0", "-1.0", "2.0**2.0"])).map(lambda t: f"({t[0]})**{t[1]}"),
        st.tuples(inner, inner).map(lambda t: f"max({t[0]}, {t[1]})"),
    )


ARITHMETIC = st.recursive(_NUMBERS, _arithmetic, max_leaves=8)
COMPARISON = st.tuples(ARITHMETIC, st.sampled_from(["<", "<=", ">", ">=", "==", "!="]), ARITHMETIC).map("".join)
LOGIC = st.recursive(
    COMPARISON,
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from([" and ", " or "]), inner).map("".join),
        inner.map(lambda t: f"not ({t})"),
    ),
    max_leaves=5,
)


def _ours(text: str) -> float | None:
    for python, own in (("**", "^"), (" and ", " && "), (" or ", " || "), ("not ", "!")):
        text = text.replace(python, own)
    expression, end = parse_expression(text)
    assert end == len(text)
    try:
        return expression.evaluate(_NAMES)
    except ExpressionError as error:
        assert "division by zero" in error.found
        return None


def _pythons(text: str) -> float | None:
    try:
        return float(eval(compile(text, "expression", "eval"), {"max": max}, _NAMES))
    except ZeroDivisionError:
        return None


@settings(max_examples=200, deadline=None)
@given(st.one_of(ARITHMETIC, LOGIC))
def test_expressions_mean_what_python_means(text: str) -> None:
    """Check value or division by zero against Python's own evaluation, to the last bit."""
    assert _ours(text) == _pythons(text)


def test_logic_leaves_the_undecided_side_alone() -> None:
    """Check that && and || guard a division, and the functions in degrees."""
    values = {"l": 0.0}
    assert parse_expression("l > 0 && 1/l > 2")[0].evaluate(values) == 0.0
    assert parse_expression("l == 0 || 1/l > 2")[0].evaluate(values) == 1.0
    assert parse_expression("sin(30) + cos(60) + tan(45)")[0].evaluate({}) == pytest.approx(2.0, rel=1e-15)
    assert parse_expression("-2^2")[0].evaluate({}) == -4.0
    assert parse_expression("2^3^2")[0].evaluate({}) == 512.0
