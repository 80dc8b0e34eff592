"""``bough train``: train a policy for a task, on one device or many."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from ..learn.policies.run_log import Logger, check_logger
from ..learn.tasks.ppo_settings import PRESETS, PPOSettings, Preset
from ..learn.tasks.registry import TASKS, TaskRegistry, known_tasks
from ..learn.tasks.task import require_rsl_rl
from ..sim.arms.registry import ARMS
from ..sim.base.console import bar, shown, start_warp, tell, warn
from ..sim.base.errors import InputError, check_seed
from .base.exit_codes import ExitCode

if TYPE_CHECKING:
    from ..learn.policies.train import Plan, Trainer
    from ..learn.runs.folder import RunFolder
    from ..learn.runs.processes import Processes


def _task_help() -> str:
    """Return the help of the task; tyro asks for it when help is wanted, so no other command looks for packages."""
    return f"Task to learn. {TASKS.hint()}"


@dataclass(frozen=True)
class Train:
    """Train a policy with PPO; write config.json, metrics.csv, checkpoints, learning.png and report.html.

    Under torchrun every process simulates worlds of its own and all train one policy. Exit code 0: done; 2: bad input,
    nothing written; 3: a loss is no longer finite, the newest checkpoint is from before.

    Attributes:
        task: Task to learn, bough's own or of an installed package.
        out: Folder of the run; it must not hold a run, unless with --resume.
        num_envs: Worlds in each process; the preset's if not given.
        iterations: Updates of the policy; the preset's if not given. With --resume it may be more than at first.
        device: cpu, cuda or cuda:N; a GPU if there is one. Several processes take a GPU each.
        seed: Seed of everything random, 0 if not given.
        preset: Size of the run and of its steps; the device's own if not given.
        policy: What reach's policy sees and is rewarded for: ppo, cpo, pcap, ppo+, cpo+, ppo-lagrangian, skin,
            pcap-rnn; pcap if not given.
        without: Observation groups left out, such as kme,touch.
        set: Settings of the task, name=value, such as forest=Tb springs=beam arm=jaco2.
        model: model.yaml of a branch with lengths and radii, such as bough diagnose writes: all trees are of its wood,
            as those of bough forest --model, and the effects that trees can have act in them.
        arm_model: model.yaml of an arm, as bough diagnose writes of its recordings: the arm's servos have that gain,
            friction, damping, delay and error of gravity compensation.
        logger: Where the numbers of metrics.csv go too: tensorboard (folder tensorboard of the run), wandb (both), or
            none.
        resume: Continue a run that was killed or is to be longer, with its own settings; begin one if there is none.
        json: Print the last row of metrics.csv and where the run is as JSON instead of a sentence.
    """

    task: Annotated[tyro.conf.Positional[str], tyro.conf.arg(help=_task_help)]
    out: Path
    num_envs: int | None = None
    iterations: int | None = None
    device: str | None = None
    seed: int | None = None
    preset: Preset | None = None
    policy: str | None = None
    without: tuple[str, ...] = ()
    set: Annotated[tuple[str, ...], tyro.conf.arg(help_behavior_hint=ARMS.hint)] = ()
    model: Path | None = None
    arm_model: Path | None = None
    logger: Logger = "tensorboard"
    resume: bool = False
    json: bool = False

    def run(self, registry: TaskRegistry | None = None) -> int:
        """Train, say what came out and where the report is; return the exit code."""
        require_rsl_rl()
        self._check()
        start_warp()
        registry = registry or known_tasks()
        from ..learn.policies.train import LostError, train, warn_of_differences
        from ..learn.runs.folder import RunFolder
        from ..learn.runs.processes import Processes

        folder, processes = RunFolder(self.out), Processes.of_torchrun()
        going_on = self.resume and folder.exists
        plan = self._kept(folder, registry, processes) if going_on else self._fresh(registry, processes)
        if going_on and processes.first:
            warn_of_differences(folder, plan)
        try:
            silent = nullcontext(lambda done: None)
            with bar(f"learning {plan.task}", plan.ppo.iterations) if processes.first else silent as advance:
                trainer = train(plan, self.out, registry, resume=going_on, progress=advance, logger=self.logger)
        except LostError as error:
            warn(f"{error}; the newest checkpoint is from before")
            return ExitCode.NOT_TRUSTED
        except KeyboardInterrupt:
            print(f"bough: interrupted; go on with bough train {self.task} --out {self.out} --resume", file=sys.stderr)
            return ExitCode.INTERRUPTED
        if processes.first:
            _tell(trainer, self.json)
        return ExitCode.DONE

    def _check(self) -> None:
        """Raise `InputError` for numbers that cannot be, before torch is there."""
        check_seed("train", self.seed or 0)
        check_logger(self.logger)
        self._sized(PRESETS[self.preset or "cpu"]).check()

    def _sized(self, own: PPOSettings) -> PPOSettings:
        """Return a preset with the sizes that were given."""
        worlds = own.num_envs if self.num_envs is None else self.num_envs
        return replace(own, num_envs=worlds, iterations=own.iterations if self.iterations is None else self.iterations)

    def _fresh(self, registry: TaskRegistry, processes: Processes) -> Plan:
        """Return the plan of a new run."""
        from ..learn.policies.train import Plan

        kind = registry.of(self.task)
        device = processes.device(self.device)
        preset = self.preset or kind.preset_for(device)
        settings = kind.without(kind.of_policy(kind.sized(preset), self.policy), self._left_out)
        settings = kind.changed(settings, self.set, "train")
        ppo = self._sized(kind.ppo_for(settings, preset))
        if self.model is not None:
            settings = kind.of_model(settings, self.model)
        if self.arm_model is not None:
            settings = kind.of_arm(settings, self.arm_model)
        return Plan(self.task, settings, ppo, self.seed or 0, device)

    def _kept(self, folder: RunFolder, registry: TaskRegistry, processes: Processes) -> Plan:
        """Return the plan of the run that is there; what was given must be what it was begun with."""
        from ..learn.policies.train import plan_of

        kept = plan_of(folder, registry)
        if self.task != kept.task:
            raise InputError(folder.path, "task", f"a run of {kept.task}", f"{kept.task}, or another --out")
        _same(folder, "torchrun's processes", processes.count, folder.config()["processes"])
        _same(folder, "--num-envs", self.num_envs, kept.ppo.num_envs)
        _same(folder, "--seed", self.seed, kept.seed)
        kind = registry.of(kept.task)
        if self.preset is not None:
            own = kind.ppo_for(kept.settings, self.preset)
            _same(folder, "--preset", replace(own, num_envs=0, iterations=0),
                  replace(kept.ppo, num_envs=0, iterations=0))  # fmt: skip
        if self.without:
            left = tuple(name for name in kind.groups if name not in self._left_out)
            _same(folder, "--without", left, kept.settings.groups)
        if self.model is not None:
            _same(folder, "--model", kind.of_model(kept.settings, self.model), kept.settings)
        if self.arm_model is not None:
            _same(folder, "--arm-model", kind.of_arm(kept.settings, self.arm_model), kept.settings)
        if self.policy is not None:
            _same(folder, "--policy", kind.of_policy(kept.settings, self.policy), kept.settings)
        if self.set:
            _same(folder, "--set", kind.changed(kept.settings, self.set, "train"), kept.settings)
        wanted = kept.ppo.iterations if self.iterations is None else self.iterations
        device = processes.device(self.device or kept.device)
        return replace(kept, ppo=replace(kept.ppo, iterations=wanted), device=device)

    @property
    def _left_out(self) -> tuple[str, ...]:
        return tuple(name for entry in self.without for name in entry.split(",") if name)


def _same(folder: RunFolder, option: str, given: object, kept: object) -> None:
    """Raise `InputError` where an option is given and not what the run was begun with."""
    if given is not None and given != kept:
        plainly = isinstance(kept, int)
        found, allowed = (given, kept) if plainly else ("other settings", "those that the run was begun with")
        raise InputError(folder.path, option, str(found), f"{allowed}, or no --resume and another --out")


def _tell(trainer: Trainer, as_json: bool) -> None:
    from ..learn.policies.train_report import sentence, write

    write(trainer.folder)
    said = f"{sentence(trainer.folder)} Open {shown(trainer.folder.path)}/report.html"
    tell(said, {"run": str(trainer.folder.path), **trainer.folder.metrics()[-1]}, as_json)
