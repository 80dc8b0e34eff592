"""Loading of kernels: what must be compiled says so, what is kept does not."""

from contextlib import contextmanager

import warp as wp
from bough.sim.engine import launcher


@wp.kernel(module="unique")
def doubled(x: wp.array(dtype=float)):
    i = wp.tid()
    x[i] = x[i] + x[i]


def test_compiling_is_said_and_a_kept_module_is_not(tmp_path, monkeypatch):
    """Say that kernels are compiled where the cache has no binary of them, and nothing where it has one."""
    wp.init()
    said = []

    @contextmanager
    def heard(text):
        said.append(text)
        yield

    monkeypatch.setattr(launcher, "meanwhile", heard)
    monkeypatch.setattr(wp.config, "kernel_cache_dir", str(tmp_path))
    launcher.load(doubled.module, wp.get_device("cpu"), 1)
    assert said == [launcher.COMPILING] and list(tmp_path.glob("*/*.o"))
    doubled.module.unload()
    launcher.load(doubled.module, wp.get_device("cpu"), 1)
    assert len(said) == 1
    x = wp.array([1.5], dtype=float, device="cpu")
    wp.launch(doubled, dim=1, inputs=[x], device="cpu")
    assert x.numpy().tolist() == [3.0]
