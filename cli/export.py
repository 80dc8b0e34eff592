"""``bough export``: a trained policy for programs that know nothing of bough."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import tyro

from ..learn.tasks.registry import TaskRegistry, known_tasks
from ..learn.tasks.task import require_rsl_rl
from ..sim.base.console import shown, tell
from ..sim.base.errors import InputError
from ..sim.base.files import output_folder
from .base.exit_codes import ExitCode


@dataclass(frozen=True)
class Export:
    """Write a policy as TorchScript and ONNX with its normalisation inside, each checked against torch.

    Writes policy.pt, policy.onnx and policy.json, which says what the columns of an observation are. Exit code 0: done;
    2: bad input, nothing written.

    Attributes:
        run_folder: Folder that bough train wrote; its newest checkpoint is taken.
        out: Folder to write to.
        json: Print policy.json as JSON instead of a sentence.
    """

    run_folder: tyro.conf.Positional[Path]
    out: Path
    json: bool = False

    def run(self, registry: TaskRegistry | None = None) -> int:
        """Export, and say how far the files are from torch; return the exit code."""
        require_rsl_rl()
        if not self.run_folder.is_dir():  # said before torch is there
            raise InputError(self.run_folder, "", "no such folder", "a folder that bough train wrote")
        registry = registry or known_tasks()
        from ..learn.policies.evaluate import read_policy
        from ..learn.policies.export import export_policy
        from ..learn.runs.folder import RunFolder

        policy = read_policy(RunFolder(self.run_folder), registry)
        with output_folder(self.out) as work:
            away = export_policy(work, policy, registry)
        said = f"{policy.name}, iteration {policy.iteration}: actions within {away:.1g} of torch's."
        files = f"{shown(self.out)}/policy.pt, policy.onnx and policy.json"
        tell(f"{said} Wrote {files}", self.out / "policy.json", self.json)
        return ExitCode.DONE
