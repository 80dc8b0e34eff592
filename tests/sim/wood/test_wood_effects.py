"""Effects of a measured branch in trees: which act, how strongly at which joint, and in the arm's worlds."""

import numpy as np
import torch
from bough.learn.tasks.clearing import make_task
from bough.learn.tasks.settings import PRESETS, of_wood
from bough.sim.effects import effect_of
from bough.sim.wood.branch_file import BranchFile
from bough.sim.wood.effects import give_effects, names_of, sentence, wood_effects
from oracles.contact_case import post, simulator

SEGMENTS = [{"name": f"s{k}", "stiffness_Nmprad": spring, "damping_Nmsprad": 0.3} for k, spring in enumerate((60, 20))]


def branch(*found):
    """Return a branch of two segments that was found to have effects (name, joint, parameters)."""
    effects = [{"name": name, "joint": joint, "parameters": values} for name, joint, values in found]
    segments = [s | {"stiffness_Nmprad": float(s["stiffness_Nmprad"])} for s in SEGMENTS]
    return BranchFile(format="branch-model/1", name="b", segments=segments, effects=tuple(effects))


FOUND = branch(
    ("dry_friction", 1, {"torque_Nm": 0.5}), ("cubic_stiffness", 1, {"cubic_radm2": 3.0, "separate": 0.0}),
    ("dry_friction", 0, {"torque_Nm": 3.0}), ("steady_wind", None, {"pressure_x_Pa": 5.0, "pressure_y_Pa": 0.0}),
    ("force_bias", None, {"force_x_N": 1.0}), ("base_compliance", None, {"compliance_radpNm": 0.1}),
)  # fmt: skip


def test_moments_are_told_over_the_spring_of_their_joint():
    """Take 3 N m at the lower joint of 60 N m/rad as 0.05 rad; leave out what the branch does not do itself."""
    given, left_out = wood_effects(FOUND)
    assert given == (
        ("dry_friction", "torque_Nm", 0.05),
        ("steady_wind", "pressure_x_Pa", 5.0), ("steady_wind", "pressure_y_Pa", 0.0),
        ("cubic_stiffness", "cubic_radm2", 3.0), ("cubic_stiffness", "separate", 0.0),
    )  # fmt: skip
    assert left_out == ("force_bias", "base_compliance")
    assert names_of(given) == ("dry_friction", "steady_wind", "cubic_stiffness")
    assert sentence(given[:1]) == "dry_friction (torque_Nm over its spring 0.05)"


def test_gusts_along_a_course_belong_to_the_measurement():
    """Leave out gusts that follow what was read off recordings; trees have those of one frequency alone."""
    plain = {p.name: p.neutral for p in effect_of("wind_gust").branch.parameters}
    given, left_out = wood_effects(branch(("wind_gust", None, plain | {"rms_Pa": 5.0})))
    assert given == () and left_out == ("wind_gust",)
    given, left_out = wood_effects(branch(("wind_gust", None, plain | {"sine_x_Pa": 5.0})))
    assert left_out == () and ("wind_gust", "sine_x_Pa", 5.0) in given
    assert "rms_Pa" not in [parameter for _, parameter, _ in given]


def test_every_joint_has_its_share():
    """Write 0.05 rad times the spring of each joint, and what has no moment as it is."""
    trees = [post((3.0, 0.0, 0.0), stiffness=k) for k in (40.0, 200.0)]
    given, _ = wood_effects(FOUND)
    sim = simulator(trees, effects=names_of(given))
    give_effects(sim, given)
    np.testing.assert_allclose(sim.effects["dry_friction"]["torque_Nm"].numpy()[:, 0], [2.0, 10.0], rtol=1e-6)
    assert (sim.effects["cubic_stiffness"]["cubic_radm2"][:, 0] == 3.0).all()
    assert (sim.effects["steady_wind"]["pressure_x_Pa"] == 5.0).all()


def test_a_task_s_worlds_feel_the_wind_and_live_it_again():
    """Bend otherwise than in a calm; go back to a snapshot and on to the same bits, memories and gusts included.

    Laws that are off stand beside them, so that the kernel is one that other tests have (`oracles.contact_case.LAWS`).
    """
    plain = PRESETS["cpu"]
    given = (("wind_gust", "sine_x_Pa", 200.0), ("wind_gust", "frequency_Hz", 0.5),
             ("plastic_set", "share", 0.5), ("plastic_set", "yield_rad", 0.01),
             ("cubic_stiffness", "cubic_radm2", 0.0), ("dry_friction", "torque_Nm", 0.0),
             ("quadratic_drag", "coefficient_kgpm3", 0.0), ("tip_mass", "mass_kg", 0.0))  # fmt: skip
    windy = of_wood(plain, plain.scene.wood, given)
    tasks = [make_task("powerline", s, num_envs=8, seed=3, device="cpu") for s in (plain, windy)]
    seen = [task.step(torch.zeros(8, 6))[0]["policy"].clone() for task in tasks for _ in range(10)]
    assert (seen[9] != seen[19]).any()
    task = tasks[1]
    kept = task.snapshot()
    again = []
    for _ in range(2):
        task.restore(kept)
        for _ in range(8):
            out = task.step(torch.full((8, 6), 0.3))[0]["policy"].clone()
        again.append(out)
    assert torch.equal(*again) and torch.isfinite(again[0]).all()
