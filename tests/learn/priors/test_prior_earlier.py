"""The posterior of an earlier case as a prior: against SciPy's kernel density, and files that are none."""

import zipfile

import numpy as np
import pytest
import torch
from bough.learn.priors.earlier import EarlierPosterior, read_earlier
from bough.learn.systems.system import Parameter
from bough.sim.base.errors import InputError
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

STIFFNESS, DAMPING = (
    Parameter(f"{k} child", u, 1.0, 100.0) for k, u in (("stiffness", "N m/rad"), ("damping", "N m s/rad"))
)
ANGLE = Parameter("rest angle child", "rad", -1.0, 1.0, scale="linear")
NAMES = ["rest angle child", "stiffness child", "inertia"]
UNITS = ["rad", "N m/rad", "kg m^2"]


def particles(count=40, seed=0):
    rng = np.random.default_rng(seed)
    angle = rng.normal(-0.2, 0.1, count)
    return np.stack([angle, np.exp(3.0 + angle + rng.normal(0, 0.2, count)), np.exp(rng.normal(0, 1, count))], 1)


def write(path="posterior.npz", **changes):
    arrays = {"names": np.array(NAMES), "units": np.array(UNITS), "particles": particles(), **changes}
    np.savez(path, **{k: v for k, v in arrays.items() if v is not None})
    return path


def shrunken_kde(points):
    """SciPy's kernel density on points drawn towards their mean, with a bandwidth that undoes the shrinking."""
    count, m = points.shape
    h = count ** (-1.0 / (m + 4))
    shrink = np.sqrt(1.0 - h * h)
    centre = points.mean(0)
    return stats.gaussian_kde((centre + shrink * (points - centre)).T, bw_method=h / shrink)


@settings(max_examples=25, deadline=None)
@given(m=st.integers(1, 5), count=st.integers(8, 60), seed=st.integers(0, 999))
def test_density_is_scipys(m, count, seed):
    """Equal SciPy's Gaussian kernel density on shrunken points, near the particles and far off."""
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((count, m)) @ (rng.standard_normal((m, m)) + 2.0 * np.eye(m))
    theta = 2.0 * rng.standard_normal((6, m)) @ np.diag(points.std(0))
    ours = EarlierPosterior(torch.arange(m), torch.from_numpy(points))(torch.from_numpy(theta))
    assert np.allclose(ours, shrunken_kde(points).logpdf(theta.T), rtol=1e-6, atol=1e-6)


def test_density_has_the_moments_of_the_particles():
    """Integrate to the particles' own mean and variance, whatever their number."""
    points = torch.from_numpy(particles())[:, :1]
    prior = EarlierPosterior(torch.tensor([0]), points)
    x = torch.linspace(-3, 3, 6001, dtype=torch.float64)
    weight = prior(x[:, None]).exp() * 1e-3
    mean = float((weight * x).sum())
    spread = points.var(0) * (len(points) - 1) / len(points)
    assert mean == pytest.approx(float(points.mean()), abs=1e-6)
    # kernels take the covariance over P - 1, their places that over P
    assert float((weight * (x - mean) ** 2).sum()) == pytest.approx(float(spread), rel=0.02)


def test_density_integrates_to_one():
    """Sum to one over a fine grid in one dimension."""
    prior = EarlierPosterior(torch.tensor([0]), torch.from_numpy(particles())[:, :1])
    x = torch.linspace(-2, 2, 4001, dtype=torch.float64)
    assert float(prior(x[:, None]).exp().sum() * 1e-3) == pytest.approx(1.0, abs=1e-6)


def test_reads_common_names_in_the_order_of_the_next_case():
    """Match columns by name, take logarithms of positive parameters alone, and leave the others without density."""
    prior = read_earlier(write(), [STIFFNESS, DAMPING, ANGLE])
    free = particles()[:, [1, 0]]
    free[:, 0] = np.log(free[:, 0])
    theta = np.array([[3.0, 7.0, -0.1], [2.7, 9.0, 0.1]])
    expected = shrunken_kde(free).logpdf(theta[:, [0, 2]].T)
    assert prior.index.tolist() == [0, 2]
    assert np.allclose(prior(torch.from_numpy(theta)), expected)
    assert torch.allclose(prior(torch.from_numpy(theta).reshape(2, 1, 3)), torch.from_numpy(expected)[:, None])


def test_gradient_against_finite_differences():
    """Agree with finite differences, and have no slope along a parameter that the earlier case did not know."""
    prior = read_earlier(write(), [STIFFNESS, DAMPING, ANGLE])
    theta = torch.tensor([[3.0, 7.0, -0.1], [8.0, 9.0, 2.0]], dtype=torch.float64, requires_grad=True)
    assert torch.autograd.gradcheck(prior, theta)
    assert not torch.autograd.grad(prior(theta).sum(), theta)[0][:, 1].any()


def changed(row, column, value):
    out = particles()
    out[row, column] = value
    return out


# the angle in proportion to the logarithm of the stiffness
LINE = np.stack([np.linspace(0, 1, 40), np.exp(np.linspace(0, 2, 40)), np.ones(40)], axis=1)
BAD = {
    "particles lacks": ({"particles": None}, "particles", "only names, units"),
    "nothing common": ({"names": np.array(["a", "b", "c"])}, "names", "only a, b, c"),
    "unit": ({"units": np.array(["deg", "N m/rad", "kg m^2"])}, "units, rest angle child", "'deg'; allowed: 'rad'"),
    "nan": ({"particles": changed(3, 0, np.nan)}, "particles, row 3, rest angle child", "nan"),
    "infinite": ({"particles": changed(5, 1, np.inf)}, "particles, row 5, stiffness child", "inf"),
    "negative": ({"particles": changed(2, 1, -4.0)}, "particles, row 2, stiffness child", "-4"),
    "few": ({"particles": particles(2)}, "particles", "2 particles of 2 parameters"),
    "alike": ({"particles": np.ones((40, 3))}, "particles", "in a plane"),
    "in a line": ({"particles": LINE}, "particles", "in a plane"),
    "objects": ({"names": np.array(["a", None, 3], dtype=object)}, "", "no whole .npz archive"),
    "text": ({"particles": np.array([["1", "2", "3"]])}, "particles", "type <U1"),
    "flat": ({"particles": np.ones(3)}, "particles", "shape [3]"),
    "counts": ({"units": np.array(["rad"])}, "", "3 names, 1 units, 3 columns"),
    "twice": ({"names": np.array([NAMES[0], NAMES[0], "c"])}, "names", "rest angle child twice"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_archives_are_one_line(case):
    """Name file, place and what was found on one line."""
    changes, place, found = BAD[case]
    with pytest.raises(InputError) as error:
        read_earlier(write(**changes), [ANGLE, STIFFNESS])
    assert error.value.place == place and found in str(error.value)
    assert str(error.value).startswith("posterior.npz: ") and "\n" not in str(error.value)


def test_other_files_are_one_line(tmp_path):
    """Refuse what is missing, a folder, text, one array, an empty file and half an archive."""
    write()
    whole = (tmp_path / "posterior.npz").read_bytes()
    (tmp_path / "text.npz").write_text("names: [a]\n")
    (tmp_path / "empty.npz").write_bytes(b"")
    (tmp_path / "half.npz").write_bytes(whole[: len(whole) // 2])
    damaged = bytearray(whole)
    damaged[whole.index(b"particles.npy") + 200] ^= 0xFF
    (tmp_path / "damaged.npz").write_bytes(damaged)
    np.save(tmp_path / "array.npy", particles())
    with zipfile.ZipFile(tmp_path / "other.npz", "w") as archive:
        archive.writestr("names.npy", b"no array")
    (tmp_path / "folder").mkdir()
    for name, found in (
        ("missing.npz", "no such file"), ("folder", "a folder"), ("array.npy", "a single array"),
        ("text.npz", "no whole"), ("empty.npz", "no whole"), ("half.npz", "no whole"), ("damaged.npz", "no whole"),
        ("other.npz", "only names"),
    ):  # fmt: skip
        with pytest.raises(InputError) as error:
            read_earlier(tmp_path / name, [ANGLE])
        assert found in str(error.value) and "\n" not in str(error.value)
