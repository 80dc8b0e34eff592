"""``bough evaluate``: how well a trained policy does in unseen worlds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from ..learn.tasks.registry import TaskRegistry, known_tasks
from ..learn.tasks.task import require_rsl_rl
from ..sim.base.console import bar, shown, start_warp, tell
from ..sim.base.errors import InputError
from .base.exit_codes import ExitCode


@dataclass(frozen=True)
class Evaluate:
    """Test a policy on unseen sets with all contacts on; print and write the columns of the thesis's table 5.2.

    Writes evaluation.json, .md and .npz (every episode) into the run; they also say what the scenes are like and what
    passed through what. Exit code 0: done; 2: bad input, nothing written.

    Attributes:
        run_folder: Folder that bough train wrote.
        sets: Test sets; the standard deviation is over them.
        worlds: Worlds per set, one episode in each; the task's own number if not given.
        seed: Seed of the sets; no world of training is ever among them.
        device: cpu, cuda or cuda:N; a GPU if there is one.
        baselines: Policies to compare with in the same worlds: no action, random actions, and for reach sampling MPC
            without the tree (mpc) and planning in the simulation itself (mpc-tree, minutes a set); the option without
            a name leaves them out.
        all_scenes: Test in scenes that training leaves out as hardly possible for one arm, too (firm wood, deep or
            many branches); writes evaluation_all_scenes.json and .md instead.
        set: Settings of the task that are others in the tests, name=value, such as forest=Tb; writes
            evaluation_forest-Tb.json and .md then.
        against: Other runs of the task, tested in the same worlds; differences come with the 95 % interval of a paired
            bootstrap over targets.
        oracle: Runs that decide together with those above, and MPC if it is among the baselines, which worlds are
            possible at all; success is then told relative to those, too.
        json: Print the JSON file as JSON instead of a sentence.
    """

    run_folder: tyro.conf.Positional[Path]
    sets: int = 3
    worlds: int | None = None
    seed: int = 0
    device: str | None = None
    baselines: tuple[Literal["zero", "random", "mpc", "mpc-tree"], ...] = ("zero", "random")
    all_scenes: bool = False
    set: tuple[str, ...] = ()
    against: tuple[Path, ...] = ()
    oracle: tuple[Path, ...] = ()
    json: bool = False

    def run(self, registry: TaskRegistry | None = None) -> int:
        """Evaluate, print the table and say where it is; return the exit code."""
        require_rsl_rl()
        for folder in (self.run_folder, *self.against, *self.oracle):
            if not folder.is_dir():  # said before torch is there
                raise InputError(folder, "", "no such folder", "a folder that bough train wrote")
        start_warp()
        registry = registry or known_tasks()
        from ..learn.policies.evaluate import evaluate, files_of
        from ..learn.runs.processes import Processes

        device = Processes().device(self.device)
        others = {folder.resolve() for folder in (*self.against, *self.oracle)}
        with bar("testing", self.sets * (1 + len(self.baselines) + len(others))) as advance:
            evaluate(
                self.run_folder, registry, sets=self.sets, worlds=self.worlds, seed=self.seed, device=device,
                baselines=self.baselines, all_scenes=self.all_scenes, changes=self.set,
                against=self.against, oracle=self.oracle, progress=advance,
            )  # fmt: skip
        data, page = (self.run_folder / name for name in files_of(self.all_scenes, self.set))
        tell(f"{page.read_text()}Wrote {shown(data)} and {page.name}", data, self.json)
        return ExitCode.DONE
