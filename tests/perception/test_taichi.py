"""The Taichi kernels against Warp's."""

import subprocess
import sys

import pytest
import torch
from bough.perception import embed, occlusion
from bough.perception.frequencies import draw_frequencies


@pytest.fixture(scope="module")
def kernels():
    """Start Taichi on one CPU thread; it takes seconds to import, which a worker without these tests need not."""
    ti = pytest.importorskip("taichi")
    ti.init(arch=ti.cpu, cpu_max_num_threads=1, log_level=ti.ERROR, offline_cache=False)
    import bough.perception.taichi_kernels as module

    yield module
    ti.reset()


def _mask(*shape, share=0.7):
    return torch.rand(*shape, generator=torch.Generator().manual_seed(8)) < share


def test_embedding_equals_warps(kernels):
    """Embed masked clouds, one of them empty, to 1e-6: sines and sums round differently."""
    points, mask = torch.randn(9, 130, 3, generator=torch.Generator().manual_seed(0)), _mask(9, 130)
    mask[4] = False
    out = torch.full((9, 16), float("nan"))
    kernels.embed(points, mask.int(), torch.from_numpy(draw_frequencies(8)), out)
    torch.testing.assert_close(out, embed(points, mask=mask), rtol=0, atol=1e-6)


@pytest.mark.parametrize("pairs", [5, 200])
def test_occlusion_equals_warps(kernels, pairs):
    """Score clouds on a grid of 1/16 m, where squared distances are exact: equal counts, ties included."""
    generator = torch.Generator().manual_seed(1)
    a = torch.randint(-12, 13, (9, 90, 3), generator=generator) / 16.0
    b = torch.randint(-12, 13, (9, 70, 3), generator=generator) / 16.0
    a[0] += 5.0
    masks, out = (_mask(9, 90), _mask(9, 70)), torch.full((9,), float("nan"))
    kernels.occlusion(a, masks[0].int(), b, masks[1].int(), pairs, 2 / 16.0, out)
    expected = occlusion(a, b, pairs=pairs, threshold=2 / 16.0, first_mask=masks[0], second_mask=masks[1])
    assert torch.equal(out, expected) and out[0] == 0 and out.max() > 0


def test_package_does_not_need_taichi():
    """Import the room where Taichi cannot be imported."""
    code = "import sys; sys.modules['taichi'] = None; import bough.perception, bough.perception.sensor"
    subprocess.run([sys.executable, "-c", code], check=True, stdin=subprocess.DEVNULL)
