"""The arm among branches on a GPU: sections of `benchmarks/gpu.py`, which puts them into its report."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
import warp as wp

os.environ.setdefault("GIT_PYTHON_REFRESH", "quiet")

#: Time of the thesis's four embeddings at 1024 worlds (table 5.3) [s], and its success with all features [%].
THESIS_EMBEDDING, THESIS_SUCCESS = 1.2e-3, 68.4


@lru_cache(maxsize=2)
def _task(device: str, quick: bool, worlds: int) -> Any:
    """Return a task of so many worlds, the same one for all sections: building 6144 takes half a minute."""
    from bough.learn.tasks.clearing import make_task
    from bough.learn.tasks.settings import PRESETS

    preset = PRESETS["cpu" if quick else "gpu"]
    return make_task("powerline", preset, num_envs=worlds, seed=0, device=device)


def _wait(device: str) -> None:
    if "cuda" in device:
        torch.cuda.synchronize(torch.device(device))


def _seconds(work: Callable[[], Any], device: str, count: int) -> float:
    """Seconds of one call, of ``count`` in a row after one that warms up."""
    work()
    _wait(device)
    begun = time.perf_counter()
    for _ in range(count):
        work()
    _wait(device)
    return (time.perf_counter() - begun) / count


def check_arm_step(device: str, quick: bool) -> dict[str, Any]:
    """Step all worlds under random actions: no world lost, no contact without room, the same memory every step."""
    worlds = 16 if quick else 6144
    begun = time.perf_counter()
    task = _task(device, quick, worlds)
    built = time.perf_counter() - begun
    generator = torch.Generator(device=task.device).manual_seed(0)
    before = [t.data_ptr() for t in (task.observation, task.reward, task.done, task.actions)]
    for _ in range(5 if quick else 200):
        task.actions.uniform_(-1.0, 1.0, generator=generator)
        observed, reward, done, _ = task.step(task.actions)
    lost, full = int(task.lost.sum()), int(task.simulator.overflow.sum())
    after = [t.data_ptr() for t in (observed["policy"], reward, done, task.actions)]
    finite = bool(torch.isfinite(task.observation).all())
    return {"worlds": worlds, "build_s": built, "lost": lost, "contacts_without_room": full,
            "ok": lost == 0 and full == 0 and finite and before == after}  # fmt: skip


def check_contact(device: str, quick: bool) -> dict[str, Any]:
    """Step worlds in which much touches here and on the CPU, and time it: who has most contacts decides how long.

    Motion in contact parts quickly: the median world must be as near the CPU's as, within a factor of ten, the CPU is
    to itself when the arms start a rounding apart.
    """
    from oracles.contact_case import act, busy

    worlds, steps = (16, 24) if quick else (512, 72)
    where: list[torch.Tensor] = []
    for target, apart in (("cpu", 0.0), ("cpu", 2.0e-7), (device, 0.0)):
        sim = busy(worlds, device=target)
        sim.q.mul_(1.0 + apart)
        most = max(act(sim, steps, look=lambda sim: int(sim._touch.count.max())))
        where.append(torch.cat([sim.observe()[0].flatten(1), sim.q], dim=1).cpu().double())
    own, here = (float((w - where[0]).abs().amax(1).median()) for w in where[1:])
    lost, full = len(sim.faults()), int(sim.overflow.sum())
    return {"worlds": worlds, "most_contacts": most, "cpu_median": own, "median": here, "lost": lost,
            "contacts_without_room": full, "step_s": _seconds(sim.step, device, 2 if quick else 24),
            "ok": here < 10.0 * own + 1e-6 and lost == 0 and full == 0}  # fmt: skip


def check_copies(device: str, quick: bool) -> dict[str, Any]:
    """Count the copies between host and device that the profiler sees in ten replayed policy steps: none."""
    task = _task(device, quick, 16 if quick else 1024)
    for _ in range(3):
        task.step(task.actions)
    kinds = [torch.profiler.ProfilerActivity.CPU]
    kinds += [torch.profiler.ProfilerActivity.CUDA] if "cuda" in device else []
    with torch.profiler.profile(activities=kinds) as profile:
        for _ in range(10):
            task.step(task.actions)
        _wait(device)
    names = [e.key for e in profile.key_averages() if "memcpy" in e.key.lower() and "DtoD" not in e.key]
    return {"copies": names, "ok": not names}


def check_planning(device: str, quick: bool) -> dict[str, Any]:
    """Try a policy step in copies of all worlds of ``reach``, then do it: the same bits; time of a copy and a step."""
    from bough.learn.tasks.clearing import make_reach
    from bough.learn.tasks.imagined import ImaginedWorlds
    from bough.learn.tasks.reach_settings import RUPTURE_FORCE, ReachSettings

    worlds, count = (10, 2) if quick else (300, 32)
    task = make_reach("reach", ReachSettings(), num_envs=worlds, seed=1, device=device, test=True)
    imagined = ImaginedWorlds(task, count, RUPTURE_FORCE)
    for _ in range(10):
        task.step(task.actions.fill_(0.5))
    imagined.take()
    tried = torch.full((worlds * count, task.num_actions), 0.5, device=task.device)
    imagined.step(tried)
    task.step(task.actions)
    same = torch.equal(imagined.simulator.q.unflatten(0, (worlds, count))[:, 0], task.simulator.q)
    times = {"take_s": _seconds(imagined.take, device, 3), "step_s": _seconds(lambda: imagined.step(tried), device, 3)}
    return {"worlds": worlds, "copies": count, **times, "simulator_bytes": imagined.simulator.nbytes, "ok": same}


def measure_shares(device: str, quick: bool) -> dict[str, Any]:
    """Policy steps per second, and how they divide into physics, perception and learning's own forward pass."""
    worlds, count = (16, 2) if quick else (6144, 20)
    task = _task(device, quick, worlds)
    whole = _seconds(lambda: task.step(task.actions), device, count)
    physics = _captured(lambda: task.simulator.step(task.cfg.physics_steps), device)
    sensing = _captured(task.sensor.update, device)
    net = torch.nn.Sequential(
        torch.nn.Linear(task.observation.shape[1], 256), torch.nn.ELU(), torch.nn.Linear(256, 128), torch.nn.ELU(),
        torch.nn.Linear(128, 64), torch.nn.ELU(), torch.nn.Linear(64, task.num_actions),
    ).to(task.device)  # fmt: skip
    with torch.no_grad():
        policy = _seconds(lambda: net(task.observation), device, count)
    parts = {"physics": _seconds(physics, device, count), "perception": _seconds(sensing, device, count)}
    steps = worlds / whole
    return {"worlds": worlds, "policy_steps_per_s": steps, "world_steps_per_s": steps * task.cfg.physics_steps,
            "step_s": whole, "policy_s": policy, **{f"{k}_share": v / whole for k, v in parts.items()},
            "simulator_bytes": task.simulator.nbytes, "ok": True}  # fmt: skip


def _captured(work: Callable[[], Any], device: str) -> Callable[[], Any]:
    if "cuda" not in device:
        return work
    work()
    with wp.ScopedCapture(device=device) as scope:
        work()
    return lambda: wp.capture_launch(scope.graph)


def measure_embedding(device: str, quick: bool) -> dict[str, Any]:
    """Time of the four embeddings of 512 points in 1024 worlds, beside the thesis's."""
    from bough.perception import embed

    worlds = 16 if quick else 1024
    clouds = [torch.randn(worlds, 512, 3, device=device) for _ in range(4)]
    alone = _seconds(lambda: [embed(c) for c in clouds], device, 3 if quick else 50)
    task = _task(device, quick, worlds)
    whole = _seconds(_captured(task.sensor.update, device), device, 3 if quick else 50)
    return {"worlds": worlds, "four_embeddings_s": alone, "thesis_s": THESIS_EMBEDDING, "all_perception_s": whole,
            "ok": True}  # fmt: skip


class TimeUpError(Exception):
    """The time for training is over."""


def measure_training(device: str, quick: bool, seconds: float, out: Path) -> dict[str, Any]:
    """Train towards table 5.2 for as long as there is time, then evaluate in unseen worlds with all contacts on.

    One set of worlds and one baseline: three sets of three policies took 130 s of an H100, half as long as all else.
    """
    from bough.learn.policies.evaluate import evaluate
    from bough.learn.policies.train import Plan, train
    from bough.learn.runs.folder import RunFolder
    from bough.learn.tasks.ppo_settings import PRESETS as SIZES
    from bough.learn.tasks.registry import known_tasks

    registry, name = known_tasks(), "cpu" if quick else "gpu"
    small = {"num_envs": 16, "iterations": 2, "horizon": 8} if quick else {}
    ppo = replace(SIZES[name], checkpoint_every=2 if quick else 10, **small)
    plan = Plan("powerline", registry.of("powerline").presets[name], ppo, 0, device)
    end, done = time.perf_counter() + seconds, 0

    def watch(iterations: int) -> None:
        nonlocal done
        done += iterations
        if time.perf_counter() > end and done % ppo.checkpoint_every == 0:
            raise TimeUpError

    begun = time.perf_counter()
    with contextlib.suppress(TimeUpError):
        train(plan, out, registry, progress=watch)
    took = time.perf_counter() - begun
    rows = evaluate(out, registry, sets=1, worlds=8 if quick else 1024, device=device, baselines=("zero",))
    last = RunFolder(out).metrics()[-1]
    pace = {f"{what}_s_an_iteration": last[f"{what}_seconds"] for what in ("collect", "learn")}
    success = {f"{row.policy}_success_percent": row.mean("Test SR %") for row in rows}
    return {"iterations": done, "policy_steps": done * ppo.horizon * ppo.num_envs, "train_s": took, **pace, **success,
            "thesis_success_percent": THESIS_SUCCESS, "ok": done > 0}  # fmt: skip
