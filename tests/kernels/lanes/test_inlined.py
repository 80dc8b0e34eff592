"""Flags of kernels whose functions are all inlined."""

import pytest
import warp as wp
from bough.kernels.effects.rollout import effect_rollout_kernels
from bough.kernels.lanes.inlined import THRESHOLD, inlined
from bough.kernels.tree.rollout import rollout_kernels


@pytest.mark.parametrize(("given", "first"), [(None, "-march=native"), ("", "-mllvm="), ("-O1 -mno-avx", "-O1")])
def test_flags_follow_those_that_warp_is_set_to(monkeypatch, given, first):
    """Keep the user's flags, the processor's own where Warp has none, and end with the thresholds, which then count."""
    monkeypatch.setattr(wp.config, "cpu_compiler_flags", given)
    flags = inlined()["cpu_compiler_flags"].split()
    assert flags[0].startswith(first)
    assert [flag for flag in flags if "threshold" in flag] == flags[-2:]
    assert all(flag.endswith(f"={THRESHOLD}") for flag in flags[-2:])


@pytest.mark.parametrize("kernels", [rollout_kernels(8, 32), effect_rollout_kernels(8, 32, ())])
def test_replays_are_compiled_with_them(kernels):
    """Inline the step into every kernel that replays."""
    for kernel in (kernels.point, kernels.joint):
        assert f"threshold={THRESHOLD}" in kernel.module.options["cpu_compiler_flags"]
