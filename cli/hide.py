"""``bough hide``: a case with known hidden effects, recorded in another simulator."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ..sim.base.console import bar, shown, tell
from .base.exit_codes import ExitCode


@dataclass(frozen=True)
class Hide:
    """Record a case with hidden effects in MuJoCo; write the folder and, beside it, the true values: OUT_answer.json.

    Exit code 0: done; 2: bad input, nothing written.

    Attributes:
        out: Case folder to write.
        effects: Effects to hide, by the names of a verdict; nothing is hidden if not given.
        outside: An effect that the registry does not have, beside them.
        joint: Joint that they act at, 0 nearest the base; drawn for each if not given.
        segments: Segments of the branch.
        noise: Noise of displacement and velocity as a share of their rms; the force has half of it.
        rate: Sampling rate [Hz]; drawn if not given: 20, 25 or 40, with hard probes 50 to 500.
        samples: Samples per recording; 110 if not given, with hard probes 3 to 5 s of them.
        size: Change of displacement that each effect causes, over its rms; drawn from 0.05 to 0.3 if not given.
        hard: In what the case is harder than a model of one: shape, geometry, probes, noise, sensors, forms.
        seed: Seed of everything random.
        json: Print OUT_answer.json as JSON instead of a sentence.
    """

    out: Path
    effects: tuple[str, ...] = ()
    outside: str | None = None
    joint: int | None = None
    segments: int = 3
    noise: float = 0.03
    rate: float | None = None
    samples: int | None = None
    size: float | None = None
    hard: tuple[Literal["shape", "geometry", "probes", "noise", "sensors", "forms"], ...] = ()
    seed: int = 0
    json: bool = False

    def run(self) -> int:
        """Hide the effects, say how well they can be seen and what was written; return the exit code."""
        from ..learn.hidden import hide

        with bar("hiding", None):
            answer = hide(
                self.out, effects=self.effects, outside=self.outside, joint=self.joint, segments=self.segments,
                noise=self.noise, rate=self.rate, samples=self.samples, size=self.size, hard=self.hard,
                seed=self.seed,
            )  # fmt: skip
        names = ", ".join(effect["name"] for effect in answer["effects"]) or "nothing"
        seen = f", {answer['visible_gap']:.1%} of the motion," if answer["effects"] else ""
        place = shown(self.out)
        said = f"{names}{seen} hidden in {answer['options']['n_traj']} recordings: {place}, answer {place}_answer.json"
        tell(said, self.out.with_name(f"{self.out.name}_answer.json"), self.json)
        return ExitCode.DONE
