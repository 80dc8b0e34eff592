"""Embedding and occlusion of loose clouds against float64 and the thesis's own definition."""

import bough.perception.embedding as module
import numpy as np
import pytest
import torch
import warp as wp
from bough.perception import embed, occlusion
from bough.perception.frequencies import draw_frequencies
from bough.sim.base.errors import InputError
from hypothesis import given, settings
from hypothesis import strategies as st
from oracles.point_scene import embedding, squared_distances, top_pairs_score

WIDTHS = [1, 8, 16]


@pytest.fixture(params=WIDTHS)
def width(request, monkeypatch):
    """Run at each lane width, whatever the processor prefers."""
    monkeypatch.setattr(module, "simd_width", lambda: request.param)
    return request.param


def clouds(*shape, seed=0, spread=1.0):
    """Return normal points [..., 3]."""
    return torch.randn(*shape, 3, generator=torch.Generator().manual_seed(seed)) * spread


# Float32 coordinates of 1 m give phases of a few rad with an error of 2e-7 each; the mean of N such errors is smaller.
# 2e-6 is the bound, and holds at 4 m (phases to 40 rad) too.
@pytest.mark.parametrize("count", [1, 7, 16, 100, 517])
def test_embedding_equals_float64(width, count):
    """Compare with eq. 5.3 in float64, at cloud sizes that fill lanes and that do not."""
    points, w = clouds(4, 3, count, spread=2.0), draw_frequencies(8)
    got = embed(points)
    assert got.shape == (4, 3, 16)
    np.testing.assert_allclose(got, embedding(points.numpy(), w), rtol=0, atol=2e-6)


@pytest.mark.parametrize("features", [1, 8, 33])
def test_given_frequencies(width, features):
    """Take any number of frequencies."""
    points, w = clouds(5, 64), draw_frequencies(features, bandwidth=0.5, seed=3)
    got = embed(points, torch.from_numpy(w))
    np.testing.assert_allclose(got, embedding(points.numpy(), w), rtol=0, atol=2e-6)
    assert torch.equal(got, embed(points, features=features, bandwidth=0.5, seed=3))


def test_phases_far_from_zero(width):
    """Reduce phases of hundreds of turns: float32 points 100 m away still agree to the rounding of the phase itself.

    Phases of 300 rad are multiples of 3e-5 in float32, rounded three times: errors below 1e-4 each, random in sign, so
    that the mean of 512 stays below 2e-5.
    """
    points = clouds(3, 512) + 100.0
    np.testing.assert_allclose(embed(points), embedding(points.numpy(), draw_frequencies(8)), rtol=0, atol=2e-5)


def test_order_of_points_does_not_matter(width):
    """Permute 517 points: sums in another order differ by rounding only."""
    points = clouds(6, 517)
    order = torch.randperm(517, generator=torch.Generator().manual_seed(1))
    assert (embed(points) - embed(points[:, order])).abs().max() < 1e-6


def test_masked_points_do_not_count(width):
    """Leave masked points out, be they infinite in value; an empty cloud embeds as zeros."""
    points = clouds(3, 4, 77)
    mask = torch.rand(3, 4, 77, generator=torch.Generator().manual_seed(2)) < 0.4
    mask[1, 2] = False
    got = embed(points, mask=mask)
    np.testing.assert_allclose(got, embedding(points.numpy(), draw_frequencies(8), mask.numpy()), rtol=0, atol=2e-6)
    assert torch.equal(got[1, 2], torch.zeros(16))
    moved = torch.where(mask[..., None], points, torch.tensor(1e6))
    assert torch.equal(got, embed(moved, mask=mask))


def test_points_are_read_where_they_lie(width, monkeypatch):
    """Hand Warp the tensor's own memory, transposed and sliced too, and get the same bits."""
    seen = []
    real_from_torch = wp.from_torch
    monkeypatch.setattr(wp, "from_torch", lambda t, *a, **k: seen.append(t.data_ptr()) or real_from_torch(t, *a, **k))
    points = clouds(5, 96)
    transposed = points.mT.contiguous().mT
    sliced = torch.cat([points, points], dim=-1)[..., :3]
    results = []
    for tensor in (points, transposed, sliced):
        seen.clear()
        results.append(embed(tensor))
        assert tensor.data_ptr() in seen
    assert torch.equal(results[0], results[1]) and torch.equal(results[0], results[2])


def test_same_bits_twice(width):
    """Embed a thousand clouds twice, over however many threads."""
    points = clouds(1000, 48)
    assert torch.equal(embed(points), embed(points))
    assert torch.equal(embed(points)[123], embed(points[123]))


def test_no_clouds_and_no_points(width):
    """Return shapes that fit for an empty batch and for clouds without points."""
    assert embed(torch.zeros(0, 5, 3)).shape == (0, 16)
    assert torch.equal(embed(torch.zeros(2, 0, 3)), torch.zeros(2, 16))


def test_inner_products_approach_the_kernel():
    """Halve the error of <phi(x), phi(y)> against exp(-|x-y|^2/2) with four times the frequencies.

    The error of one draw is Gaussian with deviation at most 1/sqrt(2 R); rms over 400 pairs and 20 draws is known to
    a few percent, so that the ratio of R = 16 to R = 256 is 4 within 15 %.
    """
    x, y = clouds(400, 1, seed=5), clouds(400, 1, seed=6)
    exact = torch.exp(-((x - y) ** 2).sum((-1, -2)) / 2)
    rms = {}
    for features in (16, 256):
        errors = [(embed(x, features=features, seed=s) * embed(y, features=features, seed=s)).sum(-1) - exact
                  for s in range(20)]  # fmt: skip
        rms[features] = float(torch.stack(errors).square().mean().sqrt())
    assert rms[16] / rms[256] == pytest.approx(4.0, rel=0.15)
    assert rms[16] < 1 / np.sqrt(2 * 16)


# ---- occlusion ---------------------------------------------------------------------------------------------------


def expected(a, b, pairs, threshold):
    """Score of clouds [batch, N, 3] and [batch, M, 3] by sorting all distances."""
    d2 = squared_distances(a.numpy(), b.numpy())
    return np.array([top_pairs_score(d, pairs, threshold) for d in d2], np.float32)


@pytest.mark.parametrize(("n", "m"), [(1, 1), (40, 300), (300, 40), (33, 17)])
@pytest.mark.parametrize("pairs", [1, 20, 200])
def test_occlusion_equals_the_thesis(width, n, m, pairs):
    """Count exactly what sorting all pair distances finds, from no pair to all k."""
    a, b = clouds(12, n, spread=0.4), clouds(12, m, seed=1, spread=0.4)
    a += torch.linspace(0, 2.0, 12)[:, None, None]
    for threshold in (0.05, 0.3):
        got = occlusion(a, b, pairs=pairs, threshold=threshold)
        np.testing.assert_array_equal(got, expected(a, b, pairs, threshold))


@settings(max_examples=60, deadline=None)
@given(
    st.integers(0, 2**31 - 1), st.integers(1, 40), st.integers(1, 40), st.integers(1, 60), st.sampled_from([1, 2, 3, 5])
)
def test_ties_and_the_threshold_itself(seed, n, m, pairs, steps):
    """Points on a grid of 1/8 m: many equal distances, many exactly at the threshold, which do not count."""
    rng = np.random.default_rng(seed)
    a, b = (torch.tensor(rng.integers(-4, 5, (1, k, 3)) / 8.0, dtype=torch.float32) for k in (n, m))
    got = occlusion(a, b, pairs=pairs, threshold=steps / 8.0)
    np.testing.assert_array_equal(got, expected(a, b, pairs, steps / 8.0))


def test_occlusion_of_masked_clouds(width):
    """Count pairs of unmasked points only."""
    a, b = clouds(4, 60, spread=0.2), clouds(4, 50, seed=1, spread=0.2)
    generator = torch.Generator().manual_seed(3)
    am, bm = torch.rand(4, 60, generator=generator) < 0.5, torch.rand(4, 50, generator=generator) < 0.5
    got = occlusion(a, b, threshold=0.1, first_mask=am, second_mask=bm)
    for i in range(4):
        assert got[i] == expected(a[i : i + 1, am[i]], b[i : i + 1, bm[i]], 200, 0.1)[0]


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: embed(torch.zeros(4, 2)), "points: found shape [4, 2]; allowed: [..., N, 3]"),
        (lambda: embed(torch.zeros(4, 5, 3), mask=torch.ones(4, 6)), "mask: found shape [4, 6]; allowed: [4, 5]"),
        (lambda: embed(torch.zeros(4, 5, 3), torch.ones(8)), "frequencies: found shape [8]; allowed: [R, 3]"),
        (lambda: occlusion(torch.zeros(2, 5, 3), torch.zeros(3, 5, 3)), "found [2, 5, 3] and [3, 5, 3]"),
        (lambda: occlusion(torch.zeros(2, 5, 3), torch.zeros(2, 5, 3), pairs=0), "found 0, 0.1"),
    ],
)
def test_bad_input(call, message):
    """Name what was given and what is allowed in one line."""
    with pytest.raises(InputError) as error:
        call()
    assert message in str(error.value) and "\n" not in str(error.value)
