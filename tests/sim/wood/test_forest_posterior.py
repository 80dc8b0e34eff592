"""Forests whose springs are drawn from the posterior of a measured branch, or are those of a model of it."""

import json
import math
import pickle
import subprocess
import sys

import mujoco
import numpy as np
import pytest
import yaml
from bough.cli.forest import Forest, write_forest
from bough.sim.base.errors import InputError
from bough.sim.trees.measured import MeasuredBranch, measured_tree
from bough.sim.trees.species import grow
from bough.sim.wood.posterior import SpringPosterior
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import ks_2samp

NAMES = ("grandparent", "parent", "child")
LENGTH = np.array([0.6, 0.45, 0.35])
RADIUS = np.array([[0.018, 0.016], [0.013, 0.012], [0.009, 0.008]])


def arrays(particles: int = 200, seed: int = 0) -> dict:
    """Return the arrays of a posterior with strong correlations: K of neighbours anticorrelated, D follows K."""
    rng = np.random.default_rng(seed)
    z = rng.normal(size=(particles, 6))
    stiffness = np.array([90.0, 40.0, 15.0]) * np.exp(0.2 * (z[:, :3] - 0.9 * z[:, [1, 2, 0]]))
    damping = stiffness / 70.0 * np.exp(0.1 * z[:, 3:])
    return {
        "names": np.array([f"{kind} {n}" for kind in ("stiffness", "damping") for n in NAMES]),
        "units": np.array(["N m/rad"] * 3 + ["N m s/rad"] * 3),
        "particles": np.hstack([stiffness, damping]),
        "segment_name": np.array(NAMES),
        "segment_length_m": LENGTH,
        "segment_radius_m": RADIUS,
        "noise": np.full((particles, 6), 1e-3),
        "log_posterior": z[:, 0],
    }


@pytest.fixture
def saved(tmp_path):
    """Return the function that writes a posterior.npz, with some arrays replaced or, given None, left out."""

    def save(**changes):
        content = arrays() | changes
        np.savez(tmp_path / "posterior.npz", **{k: v for k, v in content.items() if v is not None})
        return tmp_path / "posterior.npz"

    return save


def branch_tree(length=LENGTH, radius=RADIUS):
    """Return the tree of a branch with these segments, with springs of no account."""
    count = len(length)
    branch = MeasuredBranch(
        name="branch", segment_name=tuple(f"s{i}" for i in range(count)), length=np.asarray(length, float),
        radius=np.asarray(radius, float), elevation=np.full(count, 0.5), azimuth=np.zeros(count), mass=np.ones(count),
        base_position=np.zeros(3), gravity=9.81, grasp_segment=count - 1, grasp_distance=0.1,
    )  # fmt: skip
    return measured_tree(branch, np.ones(count), np.ones(count))


def test_the_branch_itself_gets_back_every_particle(saved):
    """Give a tree of the case's own segments the particle's K and D, to rounding (1e-12)."""
    posterior, particles = SpringPosterior.from_file(saved()), arrays()["particles"]
    for k in range(0, 200, 23):
        tree = posterior.apply(branch_tree(), k)
        np.testing.assert_allclose(tree.stiffness, particles[k, :3], rtol=1e-12)
        np.testing.assert_allclose(tree.damping, particles[k, 3:], rtol=1e-12)


def test_shared_parameters_hold_for_every_joint(saved):
    """Give every joint of the branch the one K and D that all share."""
    particles = np.array([[30.0, 0.5], [50.0, 0.6]])
    path = saved(
        names=np.array(["stiffness", "damping"]), units=np.array(["N m/rad", "N m s/rad"]), particles=particles
    )
    tree = SpringPosterior.from_file(path).apply(branch_tree(), 1)
    np.testing.assert_allclose(tree.stiffness, 50.0, rtol=1e-12)
    np.testing.assert_allclose(tree.damping, 0.6, rtol=1e-12)


def test_between_and_beyond_the_segments_by_hand(saved):
    """Take E and tau half way between two segments at the geometric mean of their radii, and the last ones outside."""
    k, d = np.array([90.0, 40.0, 15.0]), np.array([1.2, 0.5, 0.3])
    posterior = SpringPosterior.from_file(saved(particles=np.concatenate([k, d])[None]))
    r = RADIUS.mean(1)
    young = [2 * k[i] * LENGTH[i] / (math.pi * r[i] ** 4) for i in range(3)]
    middle = math.sqrt(r[1] * r[2])
    tree = posterior.apply(branch_tree([0.5, 0.3, 0.2], [[0.04] * 2, [middle] * 2, [0.003] * 2]), 0)
    expected = [(young[0], d[0] / k[0]), ((young[1] + young[2]) / 2, (d[1] / k[1] + d[2] / k[2]) / 2),
                (young[2], d[2] / k[2])]  # fmt: skip
    for i, (radius, length) in enumerate([(0.04, 0.5), (middle, 0.3), (0.003, 0.2)]):
        stiffness = expected[i][0] * math.pi * radius**4 / (2 * length)
        assert tree.stiffness[i] == pytest.approx(stiffness, rel=1e-12)
        assert tree.damping[i] == pytest.approx(expected[i][1] * stiffness, rel=1e-12)


def test_segments_of_one_radius_share_the_mean(saved):
    """Take the mean of E where two segments are equally thick."""
    path = saved(segment_radius_m=np.array([[0.018, 0.016], [0.009, 0.008], [0.009, 0.008]]))
    k = arrays()["particles"][7]
    young = [2 * k[i] * LENGTH[i] / (math.pi * 0.0085**4) for i in (1, 2)]
    tree = SpringPosterior.from_file(path).apply(branch_tree([0.3], [[0.0085] * 2]), 7)
    assert tree.stiffness[0] == pytest.approx(sum(young) / 2 * math.pi * 0.0085**4 / 0.6, rel=1e-12)


def test_columns_of_effects_are_named_and_left_out(saved):
    """Read the same springs with columns of effects between them; name each effect once, and nothing else."""
    content, plain = arrays(), SpringPosterior.from_file(saved())
    more = {"backlash@1 gap_rad": "rad", "hysteresis_boucwen@0 share": "1", "hysteresis_boucwen@0 yield_rad": "rad",
            "tip_mass mass_kg": "kg", "density": "kg/m^3"}  # fmt: skip
    path = saved(
        names=np.array([*more, *content["names"]]),
        units=np.array([*more.values(), *content["units"]]),
        particles=np.hstack([-np.ones((200, 5)), content["particles"]]),
    )
    found = SpringPosterior.from_file(path)
    assert found.left_out == ("backlash@1", "hysteresis_boucwen@0", "tip_mass") and plain.left_out == ()
    np.testing.assert_array_equal(found.young, plain.young)
    np.testing.assert_array_equal(found.relaxation, plain.relaxation)


def test_a_model_is_a_posterior_of_one_particle(saved, tmp_path):
    """Give trees the springs that a posterior of the model's numbers alone gives."""
    one = arrays()["particles"][:1]
    keys = ("name", "stiffness_Nmprad", "damping_Nmsprad", "length_m", "radius_base_m", "radius_tip_m")
    rows = zip(NAMES, *one.reshape(2, 3).tolist(), LENGTH.tolist(), *RADIUS.T.tolist(), strict=True)
    content = {"format": "branch-model/1", "name": "any", "segments": [dict(zip(keys, r, strict=True)) for r in rows],
               "effects": [{"name": "force_scale", "joint": None, "parameters": {"scale": 1.1}}]}  # fmt: skip
    (tmp_path / "model.yaml").write_text(yaml.safe_dump(content))
    model, posterior = SpringPosterior.from_model("model.yaml"), SpringPosterior.from_file(saved(particles=one))
    assert model.left_out == ("force_scale",)
    for name in ("radius", "young", "relaxation"):
        np.testing.assert_array_equal(getattr(model, name), getattr(posterior, name))


@settings(max_examples=40, deadline=None)
@given(st.floats(0.002, 0.05), st.floats(0.002, 0.05), st.floats(0.05, 1.0), st.integers(0, 199))
def test_interpolation_stays_between_the_segments(tmp_path_factory, a, b, length, particle):
    """Keep E and tau of any link inside the range of the particle's segments."""
    path = tmp_path_factory.mktemp("p") / "posterior.npz"
    np.savez(path, **arrays())
    tree = SpringPosterior.from_file(path).apply(branch_tree([length], [[a, b]]), particle)
    k, d = np.split(arrays()["particles"][particle], 2)
    young, own = 2 * k * LENGTH / (np.pi * RADIUS.mean(1) ** 4), 2 * tree.stiffness[0] * length
    own /= np.pi * ((a + b) / 2) ** 4
    assert young.min() * (1 - 1e-9) <= own <= young.max() * (1 + 1e-9)
    tau = tree.damping[0] / tree.stiffness[0]
    assert (d / k).min() * (1 - 1e-9) <= tau <= (d / k).max() * (1 + 1e-9)


def test_a_forest_has_the_posterior_distribution(saved, tmp_path):
    """Spread the springs of 600 saplings as the particles do, correlations included.

    A trunk link that no noise reshapes makes K proportional to one particle's E. Two-sample Kolmogorov-Smirnov at
    p > 0.01; quartiles within four standard errors of a quantile of 600 draws (0.5 sd x 4 / sqrt 600, rounded up).
    """
    options = Forest(tmp_path / "out", species="Ta", count=600, order=1, noise=0.0, posterior=saved(), seed=3,
                     picture_width=0)  # fmt: skip
    trees = write_forest(options)
    drawn = [tree["particle"] for tree in json.loads((tmp_path / "out/forest.json").read_text())["trees"]]
    posterior = SpringPosterior.from_file(options.posterior)
    every = np.array([posterior.apply(trees[0], k).stiffness for k in range(200)])
    ours = np.array([tree.stiffness for tree in trees])
    np.testing.assert_array_equal(ours, every[drawn])
    for column in range(ours.shape[1]):
        assert ks_2samp(ours[:, column], every[:, column]).pvalue > 0.01
        spread = 0.11 * every[:, column].std()
        np.testing.assert_allclose(np.quantile(ours[:, column], [0.25, 0.5, 0.75]),
                                   np.quantile(every[:, column], [0.25, 0.5, 0.75]), atol=spread)  # fmt: skip
    # Fisher's z of a correlation over 600 draws has a standard error of 0.041.
    z_ours, z_all = (np.arctanh(np.corrcoef(np.log(k[:, 0]), np.log(k[:, -1]))[0, 1]) for k in (ours, every))
    assert abs(z_ours - z_all) < 4 * 0.041


def test_a_tree_depends_on_seed_and_number_alone(saved, tmp_path):
    """Grow the same tree whatever the count, with the shape it has without a posterior; another from another seed."""
    common = {"picture_width": 0, "posterior": saved(), "order": 1}
    few = write_forest(Forest(tmp_path / "few", count=2, seed=4, **common))
    many = write_forest(Forest(tmp_path / "many", count=5, seed=4, **common))
    other = write_forest(Forest(tmp_path / "other", count=5, seed=5, **common))
    plain = write_forest(Forest(tmp_path / "plain", count=2, seed=4, order=1, picture_width=0))
    for a, b, shape in zip(few, many, plain, strict=False):
        np.testing.assert_array_equal(a.stiffness, b.stiffness)
        np.testing.assert_array_equal(a.damping, b.damping)
        np.testing.assert_array_equal(a.position, shape.position)
        assert (a.stiffness != shape.stiffness).any()
    drawn = [json.loads((tmp_path / n / "forest.json").read_text())["trees"] for n in ("many", "other")]
    assert [t["particle"] for t in drawn[0]] != [t["particle"] for t in drawn[1]]
    assert (other[0].stiffness != many[0].stiffness).all()


def run(*arguments):
    """Run bough as a user does."""
    command = [sys.executable, "-m", "bough", *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)


def test_the_command_as_a_user_types_it(saved, tmp_path):
    """Write MJCF that C MuJoCo loads with the drawn particle's springs, and record file and particle."""
    saved()
    done = run("forest", "--posterior", "posterior.npz", "--species", "Tb", "--count", 3, "--seed", 7,
               "--picture-width", 0, "--out", "out")  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    listed = json.loads((tmp_path / "out/forest.json").read_text())
    assert listed["options"]["posterior"] == "posterior.npz" and listed["options"]["stiffness"] is None
    posterior = SpringPosterior.from_file("posterior.npz")
    for i, tree in enumerate(listed["trees"]):
        grown = grow("Tb", 2, noise=0.1, seed=np.random.SeedSequence(7, spawn_key=(i,)))
        expected = posterior.apply(grown, tree["particle"])
        model = mujoco.MjModel.from_xml_path(f"out/{tree['files'][0]}")
        np.testing.assert_allclose(model.jnt_stiffness, expected.stiffness, rtol=1e-12)
        np.testing.assert_allclose(model.dof_damping[::3], expected.damping, rtol=1e-12)


def test_a_model_and_a_posterior_contradict_each_other(saved):
    """Refuse --stiffness beside --posterior in one line, before anything is written."""
    saved()
    done = run("forest", "--posterior", "posterior.npz", "--stiffness", "beam", "--out", "out")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr == ("bough: --posterior: found posterior.npz and --stiffness beam; allowed: one of the two\n")


BAD = {
    "no geometry": ({"segment_length_m": None}, "segment_length_m: found no such array", "branch-gap-case/1"),
    "no names": ({"names": None}, "names: found only units", "an array names"),
    "names of another length": ({"names": np.array(["stiffness"])}, "units: found shape [6]", "shape [1]"),
    "particles of another width": ({"particles": np.ones((9, 5))}, "particles: found shape [9, 5]", "[1 or more, 6]"),
    "no particle": ({"particles": np.ones((0, 6))}, "particles: found shape [0, 6]", "[1 or more, 6]"),
    "text for particles": ({"particles": np.full((3, 6), "x")}, "entries of type <U1", "numbers"),
    "numbers for names": ({"names": np.arange(6)}, "names: found entries of type int64", "text"),
    "radii in one column": ({"segment_radius_m": np.ones(3)}, "segment_radius_m: found shape [3]", "shape [3, 2]"),
    "a length too many": ({"segment_length_m": np.ones(4)}, "segment_length_m: found shape [4]", "shape [3]"),
    "no radius": ({"segment_radius_m": RADIUS * [[1, 1], [1, 1], [1, 0]]}, "segment_radius_m, child: found 0",
                  "finite numbers above 0"),
    "a segment without damping": ({"names": np.array([*arrays()["names"][:5], "mass"])},
                                  "damping of segment child: found no such parameter", "'damping child'"),
    "a stiffness twice": ({"names": np.array([*arrays()["names"][:5], "stiffness"])},
                          "found stiffness grandparent and stiffness", "one 'stiffness grandparent'"),
    "another unit": ({"units": np.array(["N mm/rad", *arrays()["units"][1:]])}, "found 'N mm/rad'", "N m/rad"),
}  # fmt: skip


@pytest.mark.parametrize("name", BAD)
def test_a_posterior_that_does_not_fit_is_refused(saved, name):
    """Name file and array, what was found and what is allowed."""
    changes, found, allowed = BAD[name]
    with pytest.raises(InputError) as error:
        SpringPosterior.from_file(saved(**changes))
    message = str(error.value)
    assert "posterior.npz: " in message and found in message and allowed in message.split("allowed: ")[1]


@pytest.mark.parametrize("value", [np.nan, np.inf, -1.0, 0.0])
def test_particles_that_cannot_be_are_refused(saved, value):
    """Name the particle and the parameter that is not a finite number above 0."""
    particles = arrays()["particles"]
    particles[11, 4] = value
    with pytest.raises(InputError, match=rf"particle 11, damping parent: found {value:g}; allowed: finite numbers"):
        SpringPosterior.from_file(saved(particles=particles))


def test_files_that_are_no_archive_are_refused(saved, tmp_path):
    """Say in one line what is wrong with a file that is missing, a folder, text, a lone array, cut short or pickled."""
    whole = saved().read_bytes()
    (tmp_path / "text.npz").write_text("no archive")
    (tmp_path / "empty.npz").write_bytes(b"")
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "hit.npz").write_bytes(whole[:200] + b"\xff" * 40 + whole[240:])
    (tmp_path / "pickle.npz").write_bytes(pickle.dumps({"names": 1}))
    np.savez(tmp_path / "objects.npz", **(arrays() | {"names": np.array([None] * 6)}))
    np.save(tmp_path / "lone.npy", np.ones(3))
    found = {"none.npz": "no such file", "": "a folder", "lone.npy": "a single array"}
    broken = ("text.npz", "empty.npz", "cut.npz", "hit.npz", "pickle.npz", "objects.npz")
    for name, words in (found | dict.fromkeys(broken, "no whole .npz archive")).items():
        with pytest.raises(InputError) as error:
            SpringPosterior.from_file(tmp_path / name)
        assert words in str(error.value) and "\n" not in str(error.value), name


def test_a_faulty_posterior_leaves_nothing_behind(tmp_path):
    """Exit with 2 and one line, and write no folder."""
    done = run("forest", "--posterior", "nothing.npz", "--out", "out")
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("bough: nothing.npz: found no such file; allowed: ") and done.stderr.count("\n") == 1
    assert list(tmp_path.iterdir()) == []
