"""Newton's own tests of solvers on `BoughSolver`: those of joints that it takes over pass, others are refused."""

from __future__ import annotations

import importlib
import unittest
from collections.abc import Callable

import newton
import pytest
import warp as wp
from bough.sim.base.errors import InputError
from bough.sim.newton.solver import BoughSolver

pytest.importorskip("newton.tests.test_physics_verification", reason="this Newton brings no tests along")

#: Newton's tests of hinges, slides and balls without drives, and what they ask for beside a solver.
PASSING = {
    "damping": ("test_joint_damping", "test_revolute_joint_damping_decays_velocity", {"sync_joint_qd": True}),
    "damping, kept rates": ("test_joint_damping", "test_revolute_joint_damping_decays_velocity",
                            {"sync_joint_qd": False}),
    "period": ("test_physics_verification", "test_pendulum_period",
               {"uses_generalized_coords": True, "sim_dt": 1 / 960, "sphere_radius": 0.01}),
    "energy": ("test_physics_verification", "test_energy_conservation",
               {"uses_generalized_coords": True, "sim_dt": 1 / 960, "sphere_radius": 0.01}),
    "actuation": ("test_physics_verification", "test_joint_actuation", {}),
}  # fmt: skip

#: Newton's tests of what bough does not take over, and the words of its refusal.
REFUSED = {
    "free fall": ("test_physics_verification", "test_free_fall", {}, "FREE joint"),
    "precession": ("test_physics_verification", "test_torque_free_precession", {}, "D6 joint"),
    "closed loop": ("test_physics_verification", "test_revolute_loop_joint", {}, "closed loop"),
    "drive": ("test_joint_controllers", "test_effort_limit_clamping", {}, "a drive"),
    "force on a free body": ("test_body_force", "test_force_no_rotation", {"use_control": False}, "FREE joint"),
    "gravity by world": ("test_runtime_gravity", "test_global_gravity_bodies", {}, "inside and outside of worlds"),
    "up axis": ("test_up_axis", "test_gravity", {"up_axis": newton.Axis.Z}, "FREE joint"),
}


def _run(module: str, name: str, given: dict) -> None:
    """Run one of Newton's tests with `BoughSolver` as the solver, on the CPU."""
    check: Callable = getattr(importlib.import_module(f"newton.tests.{module}"), name)
    check(unittest.TestCase(), wp.get_device("cpu"), lambda model, **_: BoughSolver(model), **given)


@pytest.mark.parametrize("case", PASSING)
def test_newton_s_own_tests_pass(case):
    """Hold the solver to Newton's closed forms and tolerances."""
    _run(*PASSING[case])


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_not_taken_over_is_refused_by_name(case):
    """Refuse the models of Newton's other tests when the solver is made, in a line that names the joint or body."""
    module, name, given, says = REFUSED[case]
    with pytest.raises(InputError, match=says):
        _run(module, name, given)
