"""The training runs behind figures 4.4, B.1, B.3, B.4 and B.6 of the thesis, and what it and its author tell."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

from ....sim.base.errors import InputError
from ...policies.compare import Episodes, read_episodes
from ...policies.evaluate import PLANNED, evaluate, files_of
from ...policies.train import Plan
from ...runs.folder import RunFolder
from ...tasks.ppo_settings import PPOSettings, Preset
from ...tasks.registry import TaskRegistry
from ..common.kept import kept_rows

Changes = tuple[str, ...]

TASK = "reach"
FORESTS = ("Ta", "Tb", "Tc", "Td")
FRACTAL = "fractal"
THESIS = ("ppo", "cpo", "pcap")
GENTLER = "pcap-rnn-20N"
"""Recurrent PCAP whose flag and reward are at 20 N instead of 40."""
BEYOND = ("pcap-rnn", GENTLER, "ppo-lagrangian", "skin")
"""Policies that are not the thesis's."""
CHANGED: Mapping[str, tuple[str, Changes]] = {GENTLER: ("pcap-rnn", ("touch_force=20",))}
"""Policies that are another with changed settings."""
COMPARED = (*THESIS, *BEYOND)
"""Policies that verdicts are about: trained with every seed."""
TORQUES = ("ppo+", "cpo+")
"""Policies of figure B.4 beside PCAP."""
MPC, MPC_TREE = PLANNED
"""Sampling MPC without the tree, and with it."""
CPU_ITERATIONS = 150
PERIODS = 800
"""Control periods of an episode (thesis 4.5: the step limit)."""
Advance = Callable[[int], None]

PATTERNS = ("turned by 285", "turned by 300", "turned by 310", "turned by 315", "turned by 320")
AUTHOR_MPC = ((83.3, 4.5, 0.7), (70.0, 11.8, 3.2), (58.3, 24.7, 9.5), (45.0, 31.0, 13.6), (35.0, 36.3, 19.8))
"""Raw success [%], mean force [N], steps above 80 N [%] of a sampling MPC without the tree, by pattern, 60 targets
each: computed from the logs of the thesis's author (github.com/jayadeepj/pcap, commit cbecf391)."""
AUTHOR_TOUCH = {"forest": (89.2, 0.952, 93.0, 80.4), "network": (87.6, 0.946, 84.9, 93.6)}
"""Accuracy [%], AUC, specificity [%] and recall [%] of the author's classifiers, one split (its notebook)."""


@dataclass(frozen=True)
class Run:
    """A policy to train.

    Attributes:
        policy: What it sees and is rewarded for, or one of `CHANGED`.
        forest: Trees that it is trained among.
        springs: Their springs.
        repeat: Which of several trainings that differ in their seed alone.
    """

    policy: str
    forest: str = "Ta"
    springs: str = "rudimentary"
    repeat: int = 0

    @property
    def name(self) -> str:
        """Return the name of its folder."""
        return f"{self.policy}-{self.forest}-{self.springs}-seed{self.repeat}"

    @property
    def tests(self) -> tuple[Changes, ...]:
        """Settings that it is tested with: as it was trained, and PCAP of every forest in all others (4.5.2)."""
        if self.policy != "pcap" or self.springs != "rudimentary":
            return ((),)
        others = FORESTS if self.forest in FORESTS else ("Ta",)
        return ((), *((f"forest={name}",) for name in others if name != self.forest))


@dataclass(frozen=True)
class Options:
    """Size of a reproduction; see `cli.reproduce.Chapter4`."""

    preset: Preset = "cpu"
    device: str = "cpu"
    num_envs: int | None = None
    iterations: int | None = None
    sets: int = 1
    worlds: int = 300
    seeds: int = 3
    ablation_seeds: int = 1
    seed: int = 0
    rounds: int = 2
    mpc: bool = True
    jobs: int = 1

    def check(self) -> None:
        """Raise `InputError` for numbers that cannot be."""
        least = {"num_envs": 1, "iterations": 1, "sets": 1, "worlds": len(PATTERNS), "seeds": 1, "ablation_seeds": 1,
                 "seed": 0, "rounds": 0, "jobs": 1}  # fmt: skip
        for name, lowest in least.items():
            value = getattr(self, name)
            if value is not None and value < lowest:
                raise InputError("reproduce", f"--{name.replace('_', '-')}", str(value), f"{lowest} or more")
        if self.ablation_seeds > self.seeds:
            raise InputError(
                "reproduce", "--ablation-seeds", str(self.ablation_seeds), f"{self.seeds}, as --seeds, or less"
            )

    def ppo(self, registry: TaskRegistry) -> PPOSettings:
        """Numbers of PPO: the preset's, but `CPU_ITERATIONS` on a CPU if not given."""
        own = registry.of(TASK).ppo[self.preset]
        usual = CPU_ITERATIONS if self.preset == "cpu" else own.iterations
        return replace(
            own,
            num_envs=own.num_envs if self.num_envs is None else self.num_envs,
            iterations=usual if self.iterations is None else self.iterations,
        )

    @property
    def runs(self) -> tuple[Run, ...]:
        """Every run once; the thesis's policies first, seed by seed, for the claims are about them."""
        compared = [Run(p, repeat=k) for group in (THESIS, BEYOND) for k in range(self.seeds) for p in group]
        ablations = [
            run
            for k in range(self.ablation_seeds)
            for run in (
                *(Run(policy, repeat=k) for policy in TORQUES),
                *(Run("pcap", forest, repeat=k) for forest in (*FORESTS[1:], FRACTAL)),
                Run("pcap", springs="beam", repeat=k),
            )
        ]
        return (*compared, *ablations)

    def beside(self, run: Run, changes: Changes) -> tuple[str, ...]:
        """Policies that are tested beside a run: MPC, beside the first PPO."""
        return (MPC, MPC_TREE) if self.mpc and run == Run("ppo") and not changes else ()

    def repeats(self, run: Run) -> tuple[Run, ...]:
        """Return a run with every seed that it is trained with."""
        known = set(self.runs)
        return tuple(r for k in range(self.seeds) if (r := replace(run, repeat=k)) in known)

    def settings(self, run: Run, registry: TaskRegistry) -> Any:
        """Return the settings of a run's task."""
        kind = registry.of(TASK)
        policy, changes = CHANGED.get(run.policy, (run.policy, ()))
        settings = kind.of_policy(kind.presets[self.preset], policy)
        return kind.changed(settings, (f"forest={run.forest}", f"springs={run.springs}", *changes), "reproduce")

    def plan(self, run: Run, registry: TaskRegistry) -> Plan:
        """Return what a run computes."""
        settings = self.settings(run, registry)
        memory = registry.of(TASK).ppo_for(settings, self.preset).memory
        ppo = replace(self.ppo(registry), memory=memory)
        return Plan(TASK, settings, ppo, self.seed + run.repeat, self.device)


def tested(
    folder: RunFolder, options: Options, run: Run, changes: Changes, registry: TaskRegistry, advance: Advance
) -> dict[str, Episodes]:
    """Test a run, or read what was found if it was tested so already; return the episodes by policy."""
    beside = options.beside(run, changes)
    how = {"sets": options.sets, "worlds": options.worlds, "seed": options.seed, "device": options.device}
    about = {"task": TASK, "iteration": options.ppo(registry).iterations, **how}
    file = folder.path / files_of(changes=changes)[0]
    episodes = file.with_suffix(".npz")
    if kept_rows(file, about, beside) is not None and episodes.exists():
        advance(options.sets * (1 + len(beside)))
    else:
        evaluate(folder.path, registry, **how, baselines=beside, changes=changes, progress=advance)  # type: ignore[arg-type]
    return {name: read_episodes(episodes, name) for name in ("trained", *beside)}
