"""The ternary species: their counts, Leonardo's rule, the book's own geometry, and what noise does."""

import numpy as np
import pytest
from bough.sim.base.errors import InputError
from bough.sim.base.rotation import quat_rotate
from bough.sim.trees.lsystem import LSystem
from bough.sim.trees.pose import rest_pose
from bough.sim.trees.species import SPECIES, grow, grow_forest, grow_system, species_system
from bough.sim.trees.tree import Joint, Tree
from bough.sim.trees.turtle import interpret


def tips(tree: Tree) -> np.ndarray:
    position, rotation = rest_pose(tree)
    return position + quat_rotate(rotation, tree.shape_end)


def same(a: Tree, b: Tree) -> bool:
    return all(np.array_equal(getattr(a, k), getattr(b, k)) for k in vars(a) if k != "name")


@pytest.mark.parametrize("species", SPECIES)
@pytest.mark.parametrize(("order", "links"), [(0, 1), (1, 5), (2, 17), (3, 53), (4, 161)])
def test_counts_links(species: str, order: int, links: int) -> None:
    """Check 1 + 4 (1 + 3 + ... + 3^(n-1)) links and a tree that validates, with and without noise."""
    assert links == 1 + 4 * sum(3**k for k in range(order))
    for noise in (0.0, 0.1):
        assert grow(species, order, noise=noise).validate().num_links == links


@pytest.mark.parametrize("species", SPECIES)
def test_forks_preserve_the_cross_section(species: str) -> None:
    """Check Leonardo's rule at every fork; v_r = 1.732 for sqrt 3 leaves 1e-4 relative a fork."""
    tree = grow(species, 3, noise=0.0)
    area = tree.shape_radius[:, 0] ** 2
    forks = [(i, c) for i, c in enumerate(tree.children()) if c]
    assert {len(c) for _, c in forks} == {1, 3}
    for i, c in forks:
        assert area[c].sum() == pytest.approx(area[i], rel=2e-4)


@pytest.mark.parametrize("species", SPECIES)
def test_geometry_is_the_books(species: str) -> None:
    """Check lengths, angles and bending against the book's literal productions, and the widths of its internodes."""
    own = species_system(species)
    book = LSystem(
        "!(1)F(200)/(45)A",
        ["A -> !(vr)F(50)[&(a)F(50)A]/(d1)[&(a)F(50)A]/(d2)[&(a)F(50)A]", "F(l) -> F(l*lr)", "!(w) -> !(w*vr)"],
        own.constants,
    )
    ours, theirs = (interpret(s.derive(3), tropism=own.tropism, bending=own.bending) for s in (own, book))
    assert np.array_equal(ours.start, theirs.start) and np.array_equal(ours.end, theirs.end)
    children = np.bincount(theirs.parent[1:], minlength=len(theirs.parent))
    internode = children == 3
    assert ours.width[internode] == pytest.approx(theirs.width[internode], rel=1e-12)


def test_grows_the_published_sizes() -> None:
    """Check lengths 200 lr^n and 50 lr^k and the fork angle of tree Ta by hand, at 4 mm a unit."""
    tree = grow("Ta", 2, noise=0.0)
    lengths = tree.shape_end[:, 2] / 0.004
    assert lengths[:3] == pytest.approx([200 * 1.109**2, 50 * 1.109, 50 * 1.109])
    assert sorted(set(np.round(lengths[3:], 9))) == pytest.approx([50, 50 * 1.109])
    _, rotation = rest_pose(tree)
    heading = quat_rotate(rotation, np.array([0.0, 0.0, 1.0]))
    assert np.degrees(np.arccos(heading[2] @ heading[1])) == pytest.approx(18.95, abs=1e-9)
    assert (2 * tree.shape_radius).max() == pytest.approx(0.01 * 1.732**2)
    assert (2 * tree.shape_radius).min() == pytest.approx(0.01)


@pytest.mark.parametrize("species", SPECIES)
def test_order_two_is_a_sapling(species: str) -> None:
    """Check the default scale: 1.7 to 1.8 m tall."""
    assert 1.7 < tips(grow(species, 2, noise=0.0))[:, 2].max() < 1.82


def test_tropism_has_z_up() -> None:
    """Check that Td, whose tropism is (-0.61, 0.77, -0.19) with y up, leans toward -x, and Ta's twigs hang more."""
    assert tips(grow("Td", 3, noise=0.0))[:, 0].mean() < -0.1
    limp = tips(grow("Ta", 3, noise=0.0))[:, 2].mean()
    system = species_system("Ta")
    stiff = interpret(system.derive(3)).end[:, 2].mean() * 0.004
    assert limp < stiff


def test_the_seed_decides_the_tree() -> None:
    """Check equal trees for equal seeds, others for others, and that a species' name has no case."""
    assert same(grow("Tb", 2, seed=5), grow("tB", 2, seed=5))
    assert same(grow("Tb", 2, seed=5), grow("Tb", 2, seed=np.random.default_rng(5)))
    assert not same(grow("Tb", 2, seed=5), grow("Tb", 2, seed=6))
    assert grow("tb", 2).name == "Tb_2"


def test_a_tree_of_a_forest_does_not_depend_on_its_size() -> None:
    """Check that forests of 3 and 8 begin with the same trees, all different, with unique names."""
    few, many = grow_forest("Tc", 3, 1, seed=9), grow_forest("Tc", 8, 1, seed=9)
    assert all(same(a, b) for a, b in zip(few, many, strict=False))
    assert len({t.shape_end.tobytes() for t in many}) == 8
    assert [t.name for t in many][:2] == ["Tc_0000", "Tc_0001"] and len({t.name for t in many}) == 8


def test_noise_spreads_the_crown() -> None:
    """Check that the spread of the tips over a forest grows with the noise and vanishes without."""
    spread = []
    for noise in (0.0, 0.01, 0.1, 0.25):
        crowns = np.array([tips(t) for t in grow_forest("Ta", 40, 2, noise=noise, seed=1)])
        spread.append(np.linalg.norm(crowns.std(axis=0), axis=1).mean())
    assert spread[0] < 1e-12
    # The answer to small noise is linear: ten times the noise spreads ten times, within the sampling error of 40 trees.
    assert spread[2] / spread[1] == pytest.approx(10.0, rel=0.3) and spread[3] > 2 * spread[2]


def test_large_noise_keeps_trees_valid() -> None:
    """Check that the floor under the factors keeps every length and width positive at sigma = 1."""
    for tree in grow_forest("Ta", 20, 2, noise=1.0, seed=2):
        tree.validate()
        assert tree.shape_radius.min() > 0 and tree.shape_end[:, 2].min() > 0


def test_options_reach_the_tree() -> None:
    """Check scale, width, density, joints, base and stiffness model against the default tree."""
    plain, other = grow("Ta", 1, seed=1), grow("Ta", 1, seed=1, scale=0.008, width_scale=0.02, density=350.0)
    assert other.position == pytest.approx(2 * plain.position) and other.mass == pytest.approx(4 * plain.mass)
    bent = grow("Ta", 1, seed=1, joint=Joint.REVOLUTE, fixed_base=True, stiffness="beam")
    assert list(bent.joint) == [Joint.FIXED] + [Joint.REVOLUTE] * 4
    radius, length = bent.shape_radius[1, 0], bent.shape_end[1, 2]
    assert bent.stiffness[0] == 0 and bent.stiffness[1] == pytest.approx(3e9 * np.pi * radius**4 / (2 * length))


def test_grows_any_system() -> None:
    """Check that a system's own iterations, scales, angle and bending are used."""
    system = LSystem(
        "F[+F]", ["F -> FF"], iterations=2, angle_deg=30.0, scale_m_per_unit=0.1, width_m_per_unit=0.03,
        tropism=(0, 0, -1), bending=0.3,
    )  # fmt: skip
    tree = grow_system(system, name="weed").validate()
    assert tree.num_links == 8 and tree.shape_end[:, 2] == pytest.approx(0.1 * np.ones(8))
    assert tree.shape_radius == pytest.approx(0.015 * np.ones((8, 2)))
    tilt = np.arccos(np.diff(np.append(rest_pose(tree)[0][4:, 2], tips(tree)[-1, 2])) / 0.1)
    assert tilt[0] == pytest.approx(np.radians(30)) and tilt[1] == pytest.approx(tilt[0] + 0.3 * np.sin(tilt[0]))


@pytest.mark.parametrize(
    ("call", "found"),
    [
        (lambda: grow("Te", 1), "--species: found 'Te'; allowed: Ta, Tb, Tc, Td"),
        (lambda: grow("Ta", -1), "--order: found -1"),
        (lambda: grow("Ta", 1, noise=-0.1), "noise: found -0.1"),
        (lambda: grow("Ta", 1, noise=float("nan")), "noise: found nan"),
        (lambda: grow("Ta", 1, scale=0.0), "scale: found 0"),
        (lambda: grow("Ta", 1, stiffness="steel"), "stiffness: found 'steel'; allowed: rudimentary, beam"),
        (lambda: grow_forest("Ta", 0, 1), "--count: found 0"),
    ],
)
def test_refuses_bad_arguments(call, found: str) -> None:
    """Check that each is named with what is allowed."""
    with pytest.raises(InputError) as info:
        call()
    assert found in str(info.value)
