"""``bough evaluate``: how well a trained policy does in unseen worlds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from ..learn.tasks.registry import TaskRegistry, builtin_tasks
from ..learn.tasks.task import require_rsl_rl
from ..sim.base.console import bar, shown, start_warp
from ..sim.base.errors import InputError
from .exit_codes import ExitCode


@dataclass(frozen=True)
class Evaluate:
    """Test a policy on unseen sets with all contacts on; print and write the columns of the thesis's table 5.2.

    Writes evaluation.json and evaluation.md into the run; they also say what the scenes are like and what passed
    through what. Exit code 0: done; 2: bad input, nothing written.

    Attributes:
        run_folder: Folder that bough train wrote.
        sets: Test sets; the standard deviation is over them.
        worlds: Worlds per set, one episode in each.
        seed: Seed of the sets; no world of training is ever among them.
        device: cpu, cuda or cuda:N; a GPU if there is one.
        baselines: Policies to compare with in the same worlds; the option without a name leaves them out.
        all_scenes: Test in scenes that training leaves out as hardly possible for one arm, too (firm wood, deep or
            many branches); writes evaluation_all_scenes.json and .md instead.
    """

    run_folder: tyro.conf.Positional[Path]
    sets: int = 3
    worlds: int = 512
    seed: int = 0
    device: str | None = None
    baselines: tuple[Literal["zero", "random"], ...] = ("zero", "random")
    all_scenes: bool = False

    def run(self, registry: TaskRegistry | None = None) -> int:
        """Evaluate, print the table and say where it is; return the exit code."""
        require_rsl_rl()
        if not self.run_folder.is_dir():  # said before torch is there
            raise InputError(self.run_folder, "", "no such folder", "a folder that bough train wrote")
        start_warp()
        registry = registry or builtin_tasks()
        from ..learn.policies.evaluate import ALL_JSON, ALL_TABLE, JSON, TABLE, evaluate
        from ..learn.runs.processes import Processes

        device = Processes().device(self.device)
        with bar("testing", self.sets * (1 + len(self.baselines))) as advance:
            evaluate(
                self.run_folder, registry, sets=self.sets, worlds=self.worlds, seed=self.seed, device=device,
                baselines=self.baselines, all_scenes=self.all_scenes, progress=advance,
            )  # fmt: skip
        json, page = (ALL_JSON, ALL_TABLE) if self.all_scenes else (JSON, TABLE)
        print((self.run_folder / page).read_text(), end="")
        print(f"Wrote {shown(self.run_folder / json)} and {page}")
        return ExitCode.DONE
