"""The turtle against geometry by hand, closed forms and SciPy's rotations; segments as links against MuJoCo."""

import mujoco
import numpy as np
import pytest
from bough.sim.base.errors import InputError
from bough.sim.base.rotation import quat_matrix, quat_rotate
from bough.sim.trees.lsystem import LSystem, to_text
from bough.sim.trees.pose import pose, rest_pose
from bough.sim.trees.tree import Joint
from bough.sim.trees.turtle import Segments, interpret, segments_to_tree
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation


def draw(text: str, **options) -> Segments:
    return interpret(LSystem(text).axiom, **options)


def heading(segments: Segments) -> np.ndarray:
    along = segments.end - segments.start
    return along / np.linalg.norm(along, axis=1, keepdims=True)


@pytest.mark.parametrize(
    ("turn", "direction"),
    [
        ("+(90)", [-1, 0, 0]),  # left: L = -x
        ("-(90)", [1, 0, 0]),
        ("&(90)", [0, 1, 0]),  # down: -U = +y
        ("^(90)", [0, -1, 0]),
        ("|", [0, 0, -1]),
        ("/(90)&(90)", [-1, 0, 0]),  # rolled right by 90 degrees, the belly faces left
        ("\\(90)&(90)", [1, 0, 0]),
        ("+(90)+(90)+(90)", [1, 0, 0]),
        ("&(30)", [0, 0.5, np.sqrt(0.75)]),
        ("f(2)", [0, 0, 1]),
    ],
)
def test_turns_by_hand(turn: str, direction: list[float]) -> None:
    """Check the heading after single turns from H = z, L = -x, U = -y."""
    assert heading(draw(f"{turn}F(2)"))[0] == pytest.approx(direction, abs=1e-15)


def test_draws_a_square() -> None:
    """Check positions, the default angle and length, parents and a closed path."""
    segments = draw("F+F+F+F", angle_deg=90.0)
    corners = [[0, 0, 0], [0, 0, 1], [-1, 0, 1], [-1, 0, 0], [0, 0, 0]]
    assert segments.start == pytest.approx(np.array(corners[:4]), abs=1e-15)
    assert segments.end == pytest.approx(np.array(corners[1:]), abs=1e-15)
    assert list(segments.parent) == [-1, 0, 1, 2]


def test_keeps_state_in_brackets() -> None:
    """Check width, level, parent and the gap of `f` by hand."""
    segments = draw("!(3)F(2)[!(1)&(90)f(1)F(1)[F(1)]]F(1)")
    assert list(segments.parent) == [-1, 0, 1, 0]
    assert list(segments.level) == [0, 1, 2, 0]
    assert list(segments.width) == [3, 1, 1, 3]
    assert segments.start[1] == pytest.approx([0, 1, 2], abs=1e-15)
    assert segments.start[3] == pytest.approx([0, 0, 2], abs=1e-15)


@settings(max_examples=50, deadline=None)
@given(st.lists(st.tuples(st.sampled_from("+-&^/\\"), st.floats(-180, 180)), max_size=40))
def test_turns_compose_as_rotations(turns: list[tuple[str, float]]) -> None:
    """Check any sequence of turns against SciPy: right-handed about U for +, L for &, H for /."""
    axes = {"+": (0, -1, 0), "&": (-1, 0, 0), "/": (0, 0, 1), "-": (0, 1, 0), "^": (1, 0, 0), "\\": (0, 0, -1)}
    total = Rotation.identity()
    for symbol, angle in turns:
        total = total * Rotation.from_rotvec(np.radians(angle) * np.array(axes[symbol], dtype=float))
    segments = interpret([*((s, (a,)) for s, a in turns), ("F", (1.0,))])
    assert quat_matrix(segments.rotation)[0] == pytest.approx(total.as_matrix(), abs=1e-13)
    assert segments.end[0] == pytest.approx(total.apply([0, 0, 1]), abs=1e-13)


@settings(max_examples=30, deadline=None)
@given(st.floats(-180, 180), st.floats(1, 179), st.floats(-180, 180))
def test_dollar_levels_the_turtle(roll: float, pitch: float, spin: float) -> None:
    """Check that $ keeps the heading and makes L = z x H / |z x H|."""
    word = [("/", (roll,)), ("&", (pitch,)), ("/", (spin,)), ("$", ()), ("F", (1.0,))]
    segments = interpret(word)
    ahead, left = heading(segments)[0], -quat_matrix(segments.rotation)[0][:, 0]
    assert ahead == pytest.approx(heading(interpret([*word[:3], ("F", (1.0,))]))[0], abs=1e-12)
    wanted = np.cross([0, 0, 1], ahead)
    assert left == pytest.approx(wanted / np.linalg.norm(wanted), abs=1e-9)


def test_tropism_turns_by_its_closed_form() -> None:
    """Check theta_(k+1) = theta_k - e |T| sin theta_k, theta the angle between heading and tropism."""
    tropism, e = np.array([0.3, -0.2, -1.1]), 0.2
    segments = draw("&(50)/(20)" + "F(1)" * 12, tropism=tropism, bending=e)
    direction = tropism / np.linalg.norm(tropism)
    angle = np.arccos(heading(segments) @ direction)
    step = e * np.linalg.norm(tropism) * np.sin(angle[:-1])
    assert angle[1:] == pytest.approx(angle[:-1] - step, abs=1e-14)
    normal = np.cross(heading(segments)[0], direction)
    assert heading(segments) @ normal == pytest.approx(np.zeros(12), abs=1e-14)  # it stays in one plane


def test_tropism_along_the_heading_does_nothing() -> None:
    """Check that a vertical stem under a vertical tropism stays straight."""
    assert heading(draw("F(1)F(1)", tropism=(0, 0, -1), bending=0.4)).tolist() == [[0, 0, 1], [0, 0, 1]]


STRINGS = st.recursive(
    st.lists(st.sampled_from(["F(1.5)", "F(0.25)", "+(40)", "&(25)", "/(70)", "!(2)", "!(0.5)"]), max_size=5).map(
        "".join
    ),
    lambda inner: st.lists(st.one_of(inner, inner.map(lambda t: f"[{t}]")), max_size=4).map("".join),
    max_leaves=12,
).map(lambda text: "F(1)" + text)


@settings(max_examples=80, deadline=None)
@given(STRINGS)
def test_random_strings_branch_as_a_stack_says(text: str) -> None:
    """Check parents, levels and widths of random bracketed strings against a plain reading of the text."""
    system = LSystem(text)
    assert to_text(system.derive(3)) == text
    segments = interpret(system.axiom)
    parents, levels, widths = [], [], []
    stack, last, width, count = [], -1, 1.0, 0
    for token in text.replace("(", " ").replace("[", ") [)").replace("]", ") ])").split(")"):
        symbol, value = token.strip()[:1], token.strip()[1:]
        if symbol == "[":
            stack.append((last, width))
        elif symbol == "]":
            last, width = stack.pop()
        elif symbol == "!":
            width = float(value)
        elif symbol == "F":
            parents.append(last), levels.append(len(stack)), widths.append(width)
            last, count = count, count + 1
    assert (list(segments.parent), list(segments.level), list(segments.width)) == (parents, levels, widths)
    above = segments.parent[1:]
    assert segments.start[1:] == pytest.approx(segments.end[above], abs=1e-15)


@settings(max_examples=40, deadline=None)
@given(STRINGS, st.data())
def test_a_missing_bracket_is_an_error(text: str, data) -> None:
    """Check that dropping any one bracket is refused."""
    places = [i for i, c in enumerate(text) if c in "[]"]
    if places:
        i = data.draw(st.sampled_from(places))
        with pytest.raises(InputError, match="without"):
            LSystem(text[:i] + text[i + 1 :])


@pytest.mark.parametrize(
    ("text", "place", "found"),
    [
        ("F(1)F(0)", "segment_1 (module 1 F(0))", "length 0"),
        ("F(1)[&(3)F(-2)]", "segment_1 (module 3 F(-2))", "length -2"),
        ("F(10^308)F(10^308)F(10^308)", "segment_1", "length 1e+308"),
        ("!(0)F(1)", "module 0 !(0)", "width 0"),
        ("F(1)+F(1)", "module 1 +", "without an angle"),
        ("+(3)", "", "nothing drawn"),
    ],
)
def test_refuses_bad_strings(text: str, place: str, found: str) -> None:
    """Check that segment or module is named."""
    with pytest.raises(InputError) as info:
        draw(text)
    assert place in str(info.value) and found in str(info.value)


@pytest.mark.parametrize("word", [[("F", (1.0,)), ("]", ())], [("[", ()), ("F", (1.0,))]])
def test_refuses_unbalanced_modules(word: list) -> None:
    """Check modules that no parser has seen."""
    with pytest.raises(InputError, match="balanced brackets"):
        interpret(word)


WORD = "!(3)F(2)[&(40)!(1)F(1)/(50)&(20)F(0.7)]/(100)[&(70)f(0.1)!(2)F(0.8)]"


def test_links_are_where_the_segments_are() -> None:
    """Check the tree's pose at joint zero against the turtle's own drawing, scaled."""
    segments = draw(WORD)
    tree = segments_to_tree(segments, name="t", scale=0.3, width_scale=0.01).validate()
    position, rotation = rest_pose(tree)
    assert position == pytest.approx(0.3 * segments.start, abs=1e-15)
    assert position + quat_rotate(rotation, tree.shape_end) == pytest.approx(0.3 * segments.end, abs=1e-15)
    assert tree.shape_radius[:, 0] == pytest.approx(0.005 * segments.width)
    assert list(tree.level) == [0, 1, 1, 1] and set(tree.joint) == {Joint.SPHERICAL}


def test_mass_and_inertia_are_mujocos() -> None:
    """Check mass, centre and principal inertias of the links against capsules that MuJoCo weighs itself."""
    tree = segments_to_tree(draw(WORD), name="t", scale=0.3, width_scale=0.01, density=650.0)
    bodies = "".join(
        f'<body><freejoint/><geom type="capsule" density="650" size="{r}" fromto="0 0 0 0 0 {z}"/></body>'
        for r, z in zip(tree.shape_radius[:, 0], tree.shape_end[:, 2], strict=True)
    )
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody>{bodies}</worldbody></mujoco>")
    assert tree.mass == pytest.approx(model.body_mass[1:], rel=1e-12)
    assert tree.com == pytest.approx(model.body_ipos[1:], abs=1e-15)
    ours = np.sort(np.linalg.eigvalsh(tree.inertia), axis=1)
    assert ours == pytest.approx(np.sort(model.body_inertia[1:], axis=1), rel=1e-12)
    assert tree.inertia[:, 2, 2] == pytest.approx(ours[:, 0])  # the least one is about the axis


def test_revolute_links_droop_in_their_vertical_plane() -> None:
    """Check that a small positive angle lowers a tilted link's tip and leaves its vertical plane alone."""
    tree = segments_to_tree(draw(WORD), name="t", joint=Joint.REVOLUTE, fixed_base=True).validate()
    assert list(tree.joint) == [Joint.FIXED] + [Joint.REVOLUTE] * 3
    along = quat_rotate(rest_pose(tree)[1], tree.shape_end)
    for dof in range(3):
        link, qpos = dof + 1, np.zeros(3)
        qpos[dof] = 1e-6
        moved = (quat_rotate(pose(tree, qpos)[1], tree.shape_end) - along)[link] / 1e-6
        level = np.hypot(*along[link][:2])
        assert moved[2] == pytest.approx(-level, rel=1e-5)  # dz/dangle of a vector is minus its horizontal length
        assert np.cross(moved, along[link])[2] == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("option", ["scale", "width_scale", "density"])
def test_refuses_scales_that_are_not_positive(option: str) -> None:
    """Check that the option is named."""
    with pytest.raises(InputError, match=f"{option}: found 0"):
        segments_to_tree(draw("F(1)"), name="t", **{option: 0.0})
