"""Tasks as Gymnasium environments: the bits of the rsl-rl environment, and what Gymnasium promises its users."""

import subprocess
import sys
from dataclasses import replace

import bough
import gymnasium
import numpy as np
import pytest
import torch
from bough.learn.tasks.clearing import make_reach, make_task
from bough.learn.tasks.reach_settings import ReachSettings
from bough.learn.tasks.settings import TaskSettings
from bough.learn.tasks.task import task_seed, unseen_seed
from bough.sim.base.errors import InputError
from bough.sim.base.extras import install_hint
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers.vector import RecordEpisodeStatistics

WORLDS = 4
#: Episodes of five steps, with latencies both ways: what is late must be late in a final observation too.
REACH = replace(ReachSettings(), episode_seconds=0.5, action_delay=1, observation_delay=2)
LINE = replace(TaskSettings(), episode_steps=5, max_noise=(0.02, 0.02))
TASKS = {"reach": (REACH, make_reach), "powerline": (LINE, make_task)}
LONGER = {"reach": replace(REACH, episode_seconds=0.9), "powerline": replace(LINE, episode_steps=9)}


def actions(steps, worlds=WORLDS, seed=1):
    """Return random actions, [steps, worlds, 6]."""
    return np.random.default_rng(seed).uniform(-1.0, 1.0, (steps, worlds, 6)).astype(np.float32)


@pytest.mark.parametrize("name", TASKS)
def test_the_same_bits_as_the_rsl_rl_environment(name):
    """Observe and reward bit for bit what the rsl-rl environment does, over two ends of episodes and final senses."""
    settings, make = TASKS[name]
    plain = make(name, settings, num_envs=WORLDS, seed=task_seed(3, 0))
    env = bough.make_gym(name, WORLDS, settings=settings, seed=3)
    observation, infos = env.reset(seed=3)
    assert infos == {} and np.array_equal(observation, plain.get_observations()["policy"].numpy())
    for k, action in enumerate(actions(11)):
        seen, reward, done, extras = plain.step(torch.from_numpy(action))
        observation, rewards, ended, cut, infos = env.step(action)
        assert np.array_equal(observation, seen["policy"].numpy()), k
        assert np.array_equal(rewards, reward.numpy())
        assert np.array_equal(ended | cut, done.numpy()) and np.array_equal(cut, extras["time_outs"].numpy() > 0)
        assert (k in (4, 9)) == bool(infos)
        if infos:
            assert infos["_final_obs"].all() and cut.all() and not ended.any()
            assert np.array_equal(infos["final_info"]["return"], extras["log"]["return"].numpy())


@pytest.mark.parametrize("name", TASKS)
def test_final_observations_are_what_would_have_come(name):
    """Give at an episode's end the bits that the policy sees in a task whose episodes go on."""
    short, long = (bough.make_gym(name, WORLDS, settings=s, seed=3) for s in (TASKS[name][0], LONGER[name]))
    assert np.array_equal(short.reset()[0], long.reset()[0])
    for action in actions(5):
        observation, _, _, cut, infos = short.step(action)
        going_on, _, _, not_cut, _ = long.step(action)
    assert cut.all() and not not_cut.any()
    assert np.array_equal(np.stack(infos["final_obs"]), going_on)
    assert not np.array_equal(observation, going_on)


def test_resets_and_seeds():
    """Start anew to the bit with the same seed, with other trees with another, with other targets without one."""
    env = bough.make_gym("reach", WORLDS, settings=REACH, seed=3)
    first = env.reset()[0]
    steps = [env.step(a)[0] for a in actions(7)]
    assert np.array_equal(env.reset(seed=3)[0], first)
    assert all(np.array_equal(env.step(a)[0], step) for a, step in zip(actions(7), steps, strict=True))
    before = env.task.places.target.clone()
    assert not np.array_equal(env.reset()[0], first) and not torch.equal(env.task.places.target, before)
    other = env.reset(seed=4)[0]
    assert np.array_equal(other, bough.make_gym("reach", WORLDS, settings=REACH, seed=4).reset()[0])
    test = bough.make_gym("reach", WORLDS, settings=REACH, seed=4, test=True).reset()[0]
    seed = unseen_seed(4, 0)
    expected = make_reach(settings=REACH, num_envs=WORLDS, seed=seed, test=True).get_observations()["policy"]
    assert np.array_equal(test, expected.numpy())


def test_tensors_are_the_task_s_own_memory():
    """Hand out tensors without a copy, with the numbers of the arrays; arrays stay what they were."""
    env, copied = (bough.make_gym("reach", WORLDS, settings=REACH, seed=3, arrays=a) for a in ("torch", "numpy"))
    observation, kept = env.reset()[0], copied.reset()[0]
    assert observation.data_ptr() == env.task.get_observations()["policy"].data_ptr()
    start = kept.copy()
    for action in actions(5):
        seen, rewards, ended, cut, infos = env.step(torch.from_numpy(action))
        arrays = copied.step(action)
        assert seen.data_ptr() == observation.data_ptr()
        for tensor, array in zip((seen, rewards, ended, cut), arrays[:4], strict=True):
            assert isinstance(tensor, torch.Tensor) and np.array_equal(tensor.numpy(), array)
    assert np.array_equal(infos["final_obs"].numpy(), np.stack(arrays[4]["final_obs"])) and infos["_final_obs"].all()
    assert np.array_equal(start, kept)


def test_registered_environments_keep_gymnasium_s_rules():
    """Make worlds by Gymnasium's own names; pass its checker; count what its own wrapper counts."""
    env = gymnasium.make_vec("bough.envs:bough/reach-v0", num_envs=WORLDS, settings=REACH, set=["flag=threshold"])
    assert env.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP
    assert env.observation_space.shape == (WORLDS, 20) and env.observation_space.dtype == np.float32
    assert env.single_action_space == gymnasium.spaces.Box(-1.0, 1.0, (6,), np.float32)
    env = RecordEpisodeStatistics(env)
    observation, _ = env.reset(seed=5)
    assert observation in env.observation_space
    env.action_space.seed(0)
    total = np.zeros(WORLDS)
    for _ in range(5):
        observation, rewards, _, cut, infos = env.step(env.action_space.sample())
        total += rewards
    assert cut.all() and observation in env.observation_space
    np.testing.assert_allclose(infos["episode"]["r"], total, rtol=1e-6)
    assert (infos["episode"]["l"] == 5).all()
    single = gymnasium.make("bough.envs:bough/reach-v0", settings=REACH, render_mode="rgb_array")
    check_env(single.unwrapped, skip_render_check=True)
    names = {f"bough/{name}-v0" for name in ("powerline", "exposure", "inspection", "reach")}
    assert names <= set(gymnasium.registry)


def test_one_world_steps_as_one_of_a_vector():
    """End with the last observation, go on with the episode that has begun, and draw it."""
    one = gymnasium.make("bough.envs:bough/reach-v0", settings=REACH, seed=3, render_mode="rgb_array")
    worlds = bough.make_gym("reach", 1, settings=REACH, seed=3)
    assert np.array_equal(one.reset(seed=3)[0], worlds.reset(seed=3)[0][0])
    for action in actions(5, worlds=1):
        seen, reward, _, cut, info = one.step(action[0])
        observation, rewards, _, _, infos = worlds.step(action)
        assert reward == rewards[0]
    assert cut and np.array_equal(seen, infos["final_obs"][0]) and info["return"] == infos["final_info"]["return"][0]
    assert np.array_equal(one.reset()[0], observation[0])
    picture = one.render()
    assert picture.dtype == np.uint8 and picture.shape[2] == 3


@pytest.mark.parametrize(
    "options, words",
    [({"task": "fly"}, "fly"), ({"arrays": "jax"}, "arrays"), ({"render_mode": "human"}, "render_mode"),
     ({"set": ["trees=7"]}, "--set"), ({"seed": -1}, "--seed"), ({"num_envs": 0}, "num_envs")],
)  # fmt: skip
def test_bad_options_are_refused(options, words):
    """Name what cannot be in one line."""
    with pytest.raises(InputError, match=words):
        bough.make_gym(**{"task": "reach", "num_envs": WORLDS, "settings": REACH} | options)


def test_says_which_extra_is_missing():
    """Name the extra in one line where Gymnasium is not installed."""
    code = (
        "import importlib.util as u; f = u.find_spec;"
        "u.find_spec = lambda n, *a: None if n == 'gymnasium' else f(n, *a);"
        "import bough; bough.make_gym('reach')"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert f"bough: found no gymnasium; allowed: {install_hint('gym')}" in done.stderr
