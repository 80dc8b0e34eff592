"""``bough check-law``: whether the file of a law has all that a named effect needs."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import tyro

from ..sim.base.console import bar, start_warp, tell
from ..sim.base.errors import InputError
from .base.exit_codes import ExitCode


@dataclass(frozen=True)
class CheckLaw:
    """Say what is missing of a law: its row, units, energy, derivatives, neutral value, recovery from simulated data.

    The file is Python and is run. Exit code 0: nothing is missing; 2: the file is no law; 3: something is missing.

    Attributes:
        file: Python file that registers one effect, as docs/effects.md shows.
        json: Print what every check found as JSON instead of a sentence.
    """

    file: tyro.conf.Positional[Path]
    json: bool = False

    def run(self) -> int:
        """Print a line for every check and one that says what follows; return the exit code."""
        if not self.file.is_file():  # said before Warp is there
            raise InputError("bough check-law", str(self.file), "no such file", "a Python file")
        start_warp()
        from ..learn.laws import check_law, law_from, not_compiled

        effect = law_from(self.file)
        try:
            with bar("checking the law", None):
                findings = list(check_law(effect))
        except Exception as error:
            fault = not_compiled(error, self.file)
            if fault is None:
                raise
            raise fault from None
        missing = sum(f.verdict == "missing" for f in findings)
        lines = [f"{f.verdict:8} {f.check:12} {f.form:7} {f.text}" for f in findings]
        found = {"effect": effect.name, "missing": missing, "findings": [asdict(f) for f in findings]}
        tell("\n".join([*lines, f"{effect.name}: {missing or 'nothing'} missing"]), found, self.json)
        return ExitCode.NOT_TRUSTED if missing else ExitCode.DONE
