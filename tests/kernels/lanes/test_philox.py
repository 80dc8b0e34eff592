"""Philox 4x32-10 against the known answers of its authors' library (Random123, kat_vectors)."""

import numpy as np
import pytest
import warp as wp
from bough.kernels.lanes.philox import gaussian2, philox, uniform4

KNOWN = [
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344), (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]  # fmt: skip


@wp.kernel(enable_backward=False)
def raw_words(key: wp.array(dtype=wp.vec2ui), counter: wp.array(dtype=wp.vec4ui), out: wp.array(dtype=wp.vec4ui)):
    i = wp.tid()
    out[i] = philox(key[i], counter[i])


@wp.kernel(enable_backward=False)
def numbers(key: wp.vec2ui, uniform_out: wp.array(dtype=wp.vec4), normal_out: wp.array(dtype=wp.vec2)):
    i = wp.tid()
    u = uniform4(key, i, 7, 0, -1)
    uniform_out[i] = u
    normal_out[i] = gaussian2(u[0], u[1])


@pytest.mark.parametrize(("counter", "key", "words"), KNOWN)
def test_words_are_those_of_the_authors(counter, key, words):
    """Three vectors of the reference implementation: zeros, ones, digits of pi."""
    out = wp.zeros(1, dtype=wp.vec4ui, device="cpu")
    inputs = [
        wp.array(np.array([key], np.uint32), dtype=wp.vec2ui, device="cpu"),
        wp.array(np.array([counter], np.uint32), dtype=wp.vec4ui, device="cpu"),
    ]
    wp.launch(raw_words, dim=1, inputs=inputs, outputs=[out], device="cpu")
    assert out.numpy()[0].tolist() == list(words)


def test_numbers_are_uniform_and_normal():
    """Moments of 20000 draws within five standard errors; all uniform numbers lie in [0, 1)."""
    n = 20000
    uniform = wp.full(n, wp.vec4(np.nan), dtype=wp.vec4, device="cpu")
    normal = wp.full(n, wp.vec2(np.nan), dtype=wp.vec2, device="cpu")
    wp.launch(numbers, dim=n, inputs=[wp.vec2ui(3, 4)], outputs=[uniform, normal], device="cpu")
    u, z = uniform.numpy().ravel(), normal.numpy().ravel()
    assert (u >= 0).all() and (u < 1).all()
    assert abs(u.mean() - 0.5) < 5 * (1 / 12) ** 0.5 / len(u) ** 0.5
    assert abs(u.var() - 1 / 12) < 5 * (1 / 180) ** 0.5 / len(u) ** 0.5
    assert abs(z.mean()) < 5 / len(z) ** 0.5
    assert abs(z.var() - 1) < 5 * 2**0.5 / len(z) ** 0.5
    assert abs(np.mean(z[::2] * z[1::2])) < 5 / len(u) ** 0.5
