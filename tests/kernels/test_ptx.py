"""The same kernels compile for a GPU (sm_90) on a machine that has none: NVRTC comes with Warp."""

import re

import pytest
import warp as wp
from bough.kernels.effects.inverse import effect_efforts_kernel
from bough.kernels.effects.rollout import effect_rollout_kernels
from bough.kernels.effects.step import term_kernels
from bough.kernels.tree.inverse import inverse_kernels
from bough.kernels.tree.observe import energy_kernel, pose_kernel, probe_kernel
from bough.kernels.tree.reset import reset_kernels
from bough.kernels.tree.rollout import rollout_kernels
from bough.kernels.tree.stability import damping_kernel
from bough.kernels.tree.step import step_kernels
from bough.sim.effects import terms_of
from bough.sim.engine.forest_effects import forest_terms


def some(form):
    """Return terms of a law with a memory, one with a damper and one of the sensor."""
    return terms_of(("dry_friction", "hysteresis_boucwen", "force_bias"), form)


#: A law of each kind that steps freely, with a memory, a damper, a clock.
TERMS = ("dry_friction", "tip_mass", "partial_rupture", "quadratic_drag", "wind_gust")
KERNELS = {
    "step": lambda precision: step_kernels(1, precision).step,
    "step_loaded": lambda precision: step_kernels(1, precision).step_loaded,
    "damping": lambda precision: damping_kernel(1, precision),
    "poses": lambda precision: pose_kernel(1, precision),
    "probes": lambda precision: probe_kernel(1, precision),
    "energy": lambda precision: energy_kernel(1, precision),
    "restore": lambda precision: reset_kernels(precision).restore,
    "revive": lambda precision: reset_kernels(precision).revive,
    "inverse": lambda precision: inverse_kernels(1, precision).inverse,
    "replay_point": lambda precision: rollout_kernels(1, precision).point,
    "replay_joint": lambda precision: rollout_kernels(1, precision).joint,
    "step_terms": lambda precision: term_kernels(1, precision, forest_terms(TERMS)[0]).step,
    "effects_joint": lambda precision: effect_rollout_kernels(1, precision, some("joint")).joint,
    "effects_effort": lambda precision: effect_efforts_kernel(1, precision, some("joint")),
}
ARITHMETIC = {32: r"(?:add|mul|fma|div|sqrt)\S*\.f32", 64: r"(?:add|mul|fma|div|sqrt)\S*\.f64"}


def ptx(name: str, precision: int, folder) -> str:
    """Compile one kernel to PTX for sm_90 and return the text."""
    paths = wp.compile_aot_module(KERNELS[name](precision).module, arch=90, module_dir=folder, use_ptx=True)
    return next(p for p in paths if p.suffix == ".ptx").read_text()


#: What runs every step.
HOT = ("step", "step_loaded", "poses", "probes", "energy")


@pytest.mark.parametrize("precision", [32, 64])
@pytest.mark.parametrize("name", KERNELS)
def test_compiles_for_a_gpu(name, precision, tmp_path):
    """Compile for sm_90; a step computes in its own precision only, and in float32 it needs no stack frame.

    A GPU has little float64 arithmetic, and local memory is its main memory.
    """
    text = ptx(name, precision, tmp_path)
    assert re.search(r"\.target sm_90\b", text)
    assert text.count("_cuda_kernel_forward(") == 1
    if name in HOT:
        assert re.search(ARITHMETIC[precision], text)
        assert not re.search(ARITHMETIC[96 - precision], text)
        assert precision == 64 or ".local" not in text
