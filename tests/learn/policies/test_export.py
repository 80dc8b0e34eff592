"""Exported policies: the same actions as the policy in its task, from files alone; damaged ones are refused."""

import json
import shutil

import numpy as np
import onnx
import pytest
import torch
from bough.cli.export import Export
from bough.learn.policies.evaluate import read_policy
from bough.learn.runs.folder import RunFolder
from bough.sim.base.errors import InputError
from onnx.reference import ReferenceEvaluator
from oracles import json_page
from oracles.reach.task import ReachSettings, registry
from oracles.reach.train import short_run


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder of a short run."""
    return short_run(tmp_path_factory.mktemp("run") / "run")


def by_hand(state: dict, x: np.ndarray) -> np.ndarray:
    """Return the actions of a saved network in float64: normalise (deviation + 0.01, as rsl-rl), then ELU layers."""
    values = {k: v.double().numpy() for k, v in state["actor_state_dict"].items()}
    x = (x - values["obs_normalizer._mean"]) / (values["obs_normalizer._std"] + 0.01)
    layers = sorted({int(k.split(".")[1]) for k in values if k.startswith("mlp.")})
    for k in layers:
        x = x @ values[f"mlp.{k}.weight"].T + values[f"mlp.{k}.bias"]
        x = x if k == layers[-1] else np.where(x > 0, x, np.expm1(x))
    return x


def test_files_act_as_the_policy_does(run, tmp_path, capsys):
    """Load both files without bough: actions of any number of observations agree with numpy's own network."""
    assert Export(run, tmp_path / "out").run(registry()) == 0
    assert "policy.onnx" in capsys.readouterr().out
    json_page.check("export", json.loads((tmp_path / "out" / "policy.json").read_text()))
    policy = read_policy(RunFolder(run), registry())
    x = np.random.default_rng(3).normal(0.0, 2.0, (7, 3)).astype(np.float32)
    expected = by_hand(policy.state, x.astype(np.float64))
    script = torch.jit.load(str(tmp_path / "out" / "policy.pt"))
    # float32 sums of at most 256 products of order one: 256 * 6e-8, with room for ELU
    np.testing.assert_allclose(script(torch.as_tensor(x)).detach().numpy(), expected, atol=5e-5)
    graph = ReferenceEvaluator(str(tmp_path / "out" / "policy.onnx"))
    for count in (7, 1):
        np.testing.assert_allclose(graph.run(None, {"observation": x[:count]})[0], expected[:count], atol=5e-5)
    assert [i.name for i in onnx.load(tmp_path / "out" / "policy.onnx").graph.input] == ["observation"]
    task = registry().make("reach", ReachSettings(), num_envs=4, seed=1, device="cpu", test=True)
    with torch.no_grad():
        own = policy.on(task)(task.get_observations()).numpy()
    np.testing.assert_allclose(script(task.observation).detach().numpy(), own, atol=1e-6)
    said = json.loads((tmp_path / "out" / "policy.json").read_text())
    assert (said["task"], said["observation"]["size"], said["action"]["size"]) == ("reach", 3, 2)


def test_damaged_runs_are_refused(run, tmp_path):
    """No run, no checkpoint's network, a network that is none: one error, no folder left."""
    with pytest.raises(InputError, match="no such folder"):
        Export(tmp_path / "none", tmp_path / "out").run(registry())
    copy = tmp_path / "copy"
    shutil.copytree(run, copy)
    place = RunFolder(copy).newest().path / "model.pt"
    state = torch.load(place, weights_only=True)
    state["actor_state_dict"] = {k: v for k, v in state["actor_state_dict"].items() if not k.startswith("mlp.2")}
    torch.save(state, place)
    with pytest.raises(InputError):
        Export(copy, tmp_path / "out").run(registry())
    assert not (tmp_path / "out").exists()
