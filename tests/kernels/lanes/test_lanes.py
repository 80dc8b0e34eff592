"""Operations across lanes, against NumPy in float64."""

import numpy as np
import pytest
import warp as wp
from bough.kernels.lanes.across import (
    cosine_pi,
    first_bit,
    lane_sum,
    log_,
    negatives,
    row_greatest,
    row_least,
    sine_pi,
)
from bough.kernels.lanes.real import REAL_OF_WIDTH

WIDTHS = [1, 8, 16]


def lanes_of(values, width):
    """Return a Warp array of reals that sees float32 values of NumPy."""
    flat = np.ascontiguousarray(values, np.float32)
    if width == 1:
        return wp.array(flat, dtype=wp.float32)
    view = wp.array(ptr=flat.ctypes.data, shape=(len(flat) // width,), dtype=REAL_OF_WIDTH[width], device="cpu")
    view._values = flat
    return view


def apply(function, values, width):
    """Return function(values), computed in lanes; the memory of the result is poisoned first."""
    Real = REAL_OF_WIDTH[width]

    @wp.kernel(enable_backward=False, module="unique")
    def each(a_in: wp.array(dtype=Real), b_out: wp.array(dtype=Real)):
        i = wp.tid()
        b_out[i] = function(a_in[i])

    out = np.full(len(values), np.nan, np.float32)
    result = lanes_of(out, width)
    wp.launch(each, dim=len(values) // width, inputs=[lanes_of(values, width), result], device="cpu")
    return (result.numpy() if width == 1 else result._values).astype(float)


@pytest.mark.parametrize("width", WIDTHS)
def test_logarithm(width):
    """All numbers of 16 bits in (0, 1): a relative error of 2e-6, the polynomial's 1.1e-6 and a few roundings."""
    u = (np.arange(65536) + 0.5) / 65536
    np.testing.assert_allclose(apply(log_, u, width), np.log(u), rtol=2e-6)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize(("function", "exact"), [(sine_pi, np.sin), (cosine_pi, np.cos)])
def test_sine_and_cosine_of_half_turns(width, function, exact):
    """Half a turn: within 2e-7, the polynomial's 4.7e-8 and two roundings of numbers between 1 and 2 (6e-8 each)."""
    r = np.linspace(-0.5, 0.5, 65536).astype(np.float32)
    np.testing.assert_allclose(apply(function, r, width), exact(np.pi * r.astype(float)), rtol=0, atol=2e-7)


@pytest.mark.parametrize("width", [8, 16])
@pytest.mark.parametrize("rows", [1, 5, 8])
def test_rows_and_bits(width, rows):
    """Least and greatest of some rows of memory, the bits of negative lanes, and their sum."""
    Real = REAL_OF_WIDTH[width]

    @wp.kernel(enable_backward=False, module="unique")
    def look(
        memory: wp.array(dtype=wp.float32), count: int, like: wp.array(dtype=Real), low: wp.array(dtype=Real),
        high: wp.array(dtype=Real), found: wp.array(dtype=int), total: wp.array(dtype=wp.float32),
    ):  # fmt: skip
        low[0] = row_least(memory, 0, count, 9.0, like[0])
        high[0] = row_greatest(memory, 0, count, -9.0, like[0])
        bits = negatives(like[0])
        found[0] = bits
        found[1] = first_bit(bits)
        total[0] = lane_sum(like[0])

    rng = np.random.default_rng(rows)
    memory = rng.uniform(-1, 1, (rows, width)).astype(np.float32)
    values = rng.integers(-8, 9, width).astype(np.float32)
    values[:2] = 1.0, -1.0
    low, high = (lanes_of(np.full(width, np.nan), width) for _ in range(2))
    found, total = wp.full(2, -1, dtype=int, device="cpu"), wp.full(1, float("nan"), dtype=wp.float32, device="cpu")
    given = [wp.array(memory.ravel(), device="cpu"), rows, lanes_of(values, width), low, high, found, total]
    wp.launch(look, dim=1, inputs=given, device="cpu")
    padding = np.full(width - rows, 9.0, np.float32) if rows < width else np.empty(0, np.float32)
    np.testing.assert_array_equal(low._values, np.concatenate([memory.min(1), padding]))
    np.testing.assert_array_equal(high._values, np.concatenate([memory.max(1), -padding]))
    assert found.numpy().tolist() == [sum(1 << i for i in range(width) if values[i] < 0), 1]
    assert total.numpy()[0] == values.sum()
