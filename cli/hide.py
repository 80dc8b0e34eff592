"""``bough hide``: a measured case with effects hidden in it, by a simulator that is not bough's."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ..sim.base.console import bar, shown
from .exit_codes import ExitCode


@dataclass(frozen=True)
class Hide:
    """Make a case with effects hidden in it, recorded by MuJoCo; write the folder and OUT_answer.json beside it.

    Exit code 0: done; 2: bad input, nothing written.

    Attributes:
        out: Case folder to write.
        effects: Names of effects, as in a verdict; none for a case that hides nothing.
        outside: An effect that is on no list, beside them.
        joint: Joint that they act at, 0 nearest the base; drawn for each if not given.
        segments: Segments of the branch.
        noise: Noise on displacement and velocity as a fraction of their rms; the force has half of it.
        rate: Sampling rate [Hz]; drawn from 20, 25 and 40 if not given.
        samples: Samples a recording.
        size: Change of displacement that each effect causes, over its rms; drawn from 0.05 to 0.3 if not given.
        seed: Seed of everything random.
    """

    out: Path
    effects: tuple[str, ...] = ()
    outside: str | None = None
    joint: int | None = None
    segments: int = 3
    noise: float = 0.03
    rate: float | None = None
    samples: int = 110
    size: float | None = None
    seed: int = 0

    def run(self) -> int:
        """Hide the effects, say how well they can be seen and what was written; return the exit code."""
        from ..learn.hidden import hide

        with bar("hiding", None):
            answer = hide(
                self.out, effects=self.effects, outside=self.outside, joint=self.joint, segments=self.segments,
                noise=self.noise, rate=self.rate, samples=self.samples, size=self.size, seed=self.seed,
            )  # fmt: skip
        names = ", ".join(effect["name"] for effect in answer["effects"]) or "nothing"
        seen = f", {answer['visible_gap']:.1%} of the motion," if answer["effects"] else ""
        place = shown(self.out)
        print(f"{names}{seen} hidden in {answer['options']['n_traj']} recordings: {place}, answer {place}_answer.json")
        return ExitCode.DONE
