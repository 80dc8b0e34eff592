"""Tests that `make test` leaves to `make test-all`, each with its reason; everything else guards behaviour in minutes.

A key is the beginning of a test's name below ``tests/``. A reason says what the test costs and what `make test` keeps
of the same kind. An entry that fits no test is an error.
"""

_SEARCH = "a whole search (10 to 100 s); make test keeps a null, a hidden drag found and shown, and the real pendulum"
_REAL = "a real recording (6 s each; silverbox minutes); make test keeps the pendulum, the arm and a tree"
_LAWS = "compiles a contact kernel of its own with laws (15 to 40 s); make test keeps the one with five laws in 8 lanes"
_CHAINS = "long chains against known moments; make test keeps SVGD and one case of each chain"
_KILLED = "kills and repeats a command of half a minute; make test keeps killed trainings"
_OTHER = "the same as one that make test keeps, on another scene or width"
_PAGES = "compiles kernels or trains for an example of a page; make test runs those of README, tour and API"
_GPU = "compiles a large kernel for a GPU; make test keeps the plain step and the one with laws in float32"

LONG = {
    "cli/test_diagnose_story.py::test_exam_is_marked_and_goes_on": "an exam of two cases; its parts are tested apart",
    "cli/test_diagnose_story.py::test_a_killed_diagnosis_reaches_the_same_verdict": _SEARCH,
    "cli/test_identify_story.py::test_options_run[options1]": "a posterior with other options; make test keeps one",
    "cli/test_identify_story.py::test_options_run[options2]": "a posterior with other options; make test keeps one",
    "cli/test_identify_story.py::test_options_run[options3]": "a posterior with other options; make test keeps one",
    "cli/test_identify_story.py::test_a_killed_run_goes_on_to_the_same_bits": _KILLED,
    "cli/test_identify_story.py::test_cross_validation": "three posteriors; folds are tested apart",
    "cli/test_model_story.py::test_known_effects_act_while_springs_are_learnt": "a posterior with effects, 14 s",
    "cli/test_simulate_story.py::test_a_strange_mjcf_moves_as_in_mujoco[1]": _OTHER,
    "cli/test_simulate_story.py::test_a_strange_mjcf_moves_as_in_mujoco[4]": _OTHER,
    "cli/test_train_story.py::test_a_run_among_branches_with_effects": _LAWS,
    "cli/test_train_story.py::test_a_run_in_a_diagnosed_branch_s_wood": "four commands that train and test, 50 s",
    "kernels/effects/test_effects.py::test_a_late_sensor_does_not_blur_a_release[0.5]": _OTHER,
    "kernels/test_ptx.py::test_compiles_for_a_gpu[effects": _GPU,
    "kernels/test_ptx.py::test_compiles_for_a_gpu[replay": _GPU,
    "kernels/test_ptx.py::test_compiles_for_a_gpu[step_loaded": _GPU,
    "kernels/test_ptx.py::test_compiles_for_a_gpu[step_terms-64]": _GPU,
    "kernels/test_ptx.py::test_compiles_for_a_gpu[step-64]": _GPU,
    "learn/gap/test_gap.py::test_nothing_hidden_is_called_none[0.01-3]": _SEARCH,
    "learn/gap/test_gap.py::test_nothing_hidden_is_called_none[0.03-3]": _SEARCH,
    "learn/gap/test_gap.py::test_nothing_hidden_is_called_none[0.05-3]": _SEARCH,
    "learn/gap/test_gap.py::test_hidden_effect_is_named": _SEARCH,
    "learn/gap/test_gap.py::test_a_gust_is_found_beside_what_hides_it": _SEARCH,
    "learn/gap/test_gap.py::test_effect_on_no_list_is_unknown": _SEARCH,
    "learn/gap/test_gap_joints.py::test_a_magnet_under_a_pendulum_is_not_nothing": _SEARCH,
    "learn/gap/test_gap_joints.py::test_an_oscillator_whose_rate_alone_is_measured_stiffens": _SEARCH,
    "learn/gap/test_gap_joints.py::test_wind_that_sways_a_tree_before_the_pull_is_noise": _SEARCH,
    "learn/gap/test_gap_real.py::test_silverbox_stiffens": _REAL,
    "learn/gap/test_gap_real.py::test_trees_yield_or_have_hysteresis[5]": _REAL,
    "learn/gap/test_gap_real.py::test_trees_yield_or_have_hysteresis[6]": _REAL,
    "learn/gap/test_gap_real.py::test_trees_yield_or_have_hysteresis[19]": _REAL,
    "learn/gap/test_gap_real.py::test_trees_yield_or_have_hysteresis[22]": _REAL,
    "learn/gap/test_gap_real.py::test_trees_yield_or_have_hysteresis[24]": _REAL,
    "learn/gap/test_gap_real.py::test_trees_yield_or_have_hysteresis[25]": _REAL,
    "learn/gap/test_gap_real.py::test_trees_yield_or_have_hysteresis[29]": _REAL,
    "learn/gap/test_gap_real.py::test_trees_yield_or_have_hysteresis[30]": _REAL,
    "learn/inference/test_coverage.py::test_replayed_joints_cover_the_truth": "forty posteriors; linear ones are kept",
    "learn/inference/test_identify.py::test_same_seed_same_bits": "three posteriors; samplers' seeds are kept",
    "learn/priors/test_prior_learnt.py::test_weights_do_not_depend_on_the_number_of_threads": "learns a prior twice",
    "learn/samplers/test_diagnostics.py::test_long_chains_converge_and_short_ones_do_not[sgld]": _CHAINS,
    "learn/samplers/test_diagnostics.py::test_long_chains_converge_and_short_ones_do_not[sghmc]": _CHAINS,
    "learn/samplers/test_diagnostics.py::test_long_chains_converge_and_short_ones_do_not[emcee]": _CHAINS,
    "learn/samplers/test_samplers.py::test_moments_of_a_normal[mh-0.0": _CHAINS,
    "learn/samplers/test_samplers.py::test_moments_of_a_normal[mh-0.8-5]": _CHAINS,
    "learn/samplers/test_samplers.py::test_moments_of_a_normal[sgld-0.0": _CHAINS,
    "learn/samplers/test_samplers.py::test_moments_of_a_normal[sgld-0.8-5]": _CHAINS,
    "learn/samplers/test_samplers.py::test_moments_of_a_normal[sghmc-0.0": _CHAINS,
    "learn/samplers/test_samplers.py::test_moments_of_a_normal[sghmc-0.8-5]": _CHAINS,
    "learn/samplers/test_svgd.py::test_modes_keep_their_mass[0.3": "modes of other masses; make test keeps two",
    "learn/samplers/test_svgd.py::test_modes_get_their_mass_from_a_broad_start[0.3": "modes of other masses",
    "learn/systems/test_effect_systems.py::test_truth_is_recovered": "fits every law; make test keeps their forces",
    "learn/thesis/test_chapter5.py::test_the_real_task_without_groups": _LAWS,
    "learn/thesis/test_chapter3.py::test_command_writes_everything": "the whole chapter; its parts are tested apart",
    "sim/arms/test_arm_effects.py::test_out_of_reach_the_step_is_the_plain_one[1]": _LAWS,
    "sim/arms/test_arm_effects.py::test_a_push_settles_at_the_force_of_the_cubic_spring": _LAWS,
    "sim/arms/test_arm_effects.py::test_a_branch_that_yields_stays_bent": _LAWS,
    "sim/arms/test_arm_effects.py::test_worlds_in_lanes_equal_worlds_alone": _LAWS,
    "sim/arms/test_arm_effects.py::test_what_a_simulator_carries_includes_memories": _LAWS,
    "sim/arms/test_contact_worlds.py::test_arms_at_full_speed_pass_no_thin_branch[3.0]": _OTHER,
    "sim/engine/test_gpu_ready.py::test_newton_solver": "compiles Newton's kernels too, in a GPU's memory order",
    "sim/engine/test_gpu_ready.py::test_memory_order_of_a_gpu_gives_the_same_bits[1]": _OTHER,
    "sim/engine/test_simulator_effects.py::test_worlds_with_values_of_their_own_keep_their_bits_at_any_width[8": _OTHER,
    "sim/engine/test_gpu_ready.py::test_the_gpu_benchmark_runs_on_a_cpu": "the whole script of a GPU's measurements",
    "sim/engine/test_gpu_ready.py::test_kernels_of_the_arm_compile_for_a_gpu[contact": _GPU,
    "sim/wood/test_wood_effects.py::test_a_task_s_worlds_feel_the_wind_and_live_it_again": _LAWS,
    "test_repository.py::test_examples_of_the_pages_run[contact": _PAGES,
    "test_repository.py::test_examples_of_the_pages_run[effects": _PAGES,
    "test_repository.py::test_examples_of_the_pages_run[gpu": _PAGES,
    "test_repository.py::test_examples_of_the_pages_run[newton": _PAGES,
    "test_repository.py::test_examples_of_the_pages_run[perception": _PAGES,
    "test_repository.py::test_examples_of_the_pages_run[powerline": _PAGES,
    "test_repository.py::test_examples_of_the_pages_run[simulate": _PAGES,
}
