"""The training runs behind table 5.2 and figure 5.4 of the thesis, and the thesis's own numbers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from ....sim.base.errors import InputError
from ...policies.evaluate import JSON, Row, evaluate
from ...policies.train import Plan
from ...runs.folder import RunFolder
from ...tasks.measures import CLEARING_COLUMNS
from ...tasks.ppo_settings import PRESETS, PPOSettings, Preset
from ...tasks.registry import TaskRegistry
from ..common.kept import EVALUATION, kept_rows

COLUMNS = tuple(column.name for column in CLEARING_COLUMNS)
"""Columns of table 5.2 that are measured on test sets."""

TASK = "powerline"
MEDIAN_NOISE, BEST_NOISE = 0.02, 0.005
"""d_max of rows (a) to (e), and that of the camera of the thesis's experiments, row (f) [m]."""
BASELINES = ("zero", "random")
Advance = Callable[[int], None]


@dataclass(frozen=True)
class Run:
    """A policy to train and to test: what it does not see, and how noisy points are.

    Attributes:
        left_out: Observation groups left out.
        noise: d_max, three standard deviations of the noise on points [m].
        repeat: Which of several trainings that differ in their seed alone.
    """

    left_out: tuple[str, ...]
    noise: float
    repeat: int = 0

    @property
    def name(self) -> str:
        """Return the name of its folder."""
        seen = "-".join(("without", *self.left_out)) if self.left_out else "all"
        return f"{seen}-{self.noise:g}-seed{self.repeat}"


@dataclass(frozen=True)
class TableRow:
    """A row of table 5.2.

    Attributes:
        letter: Its letter.
        label: What the policy sees.
        run: The run behind it.
        train_return: The thesis's Train Rew.
        thesis: The thesis's mean and spread by column.
    """

    letter: str
    label: str
    run: Run
    train_return: float
    thesis: dict[str, tuple[float, float]]


def _row(letter: str, label: str, left_out: tuple[str, ...], noise: float, train: float, *pairs: float) -> TableRow:
    thesis = {name: (pairs[2 * k], pairs[2 * k + 1]) for k, name in enumerate(COLUMNS)}
    return TableRow(letter, label, Run(left_out, noise), train, thesis)


TABLE_5_2 = (
    _row("a", "proprioceptive + occlusion", ("kme", "touch", "local"), MEDIAN_NOISE, 1495.6,
         1413.6, 28.7, 36.5, 2.3, 18.0, 1.3, 2.8, 0.3, 237.7, 19.2),
    _row("b", "(a) + local points", ("kme", "touch"), MEDIAN_NOISE, 1531.7,
         1486.5, 49.1, 43.8, 4.5, 25.2, 3.6, 2.1, 0.4, 258.3, 32.1),
    _row("c", "(b) + touch", ("kme",), MEDIAN_NOISE, 1606.6,
         1506.1, 28.5, 46.1, 2.6, 27.9, 4.8, 2.6, 0.8, 268.9, 17.7),
    _row("d", "(b) + KME", ("touch",), MEDIAN_NOISE, 1739.1,
         1630.2, 31.6, 55.7, 1.1, 40.1, 0.4, 1.9, 0.1, 348.2, 22.7),
    _row("e", "all", (), MEDIAN_NOISE, 1704.3,
         1655.9, 26.4, 63.4, 2.8, 46.3, 3.3, 3.8, 0.3, 363.4, 20.6),
    _row("f", "all, less noise", (), BEST_NOISE, 1825.1,
         1763.6, 21.5, 68.4, 2.1, 53.7, 2.2, 3.3, 0.4, 429.8, 25.6),
)  # fmt: skip
THESIS_TRIALS, THESIS_WORLDS, THESIS_ITERATIONS = 1536, 6144, 1250
REMOVED = {"-KME": ("kme",), "-touch": ("touch",), "-local": ("local",), "-occlusion": ("occlusion",), "none": ()}
"""Boxes of figure 5.4 and the observation groups that each leaves out."""


@dataclass(frozen=True)
class Options:
    """Size of a reproduction; see `command_reproduce.Chapter5`."""

    preset: Preset = "cpu"
    device: str = "cpu"
    num_envs: int | None = None
    iterations: int | None = None
    noise_levels: tuple[float, ...] = (0.005, 0.02, 0.04)
    sets: int = 3
    worlds: int = 512
    seeds: int = 3
    seed: int = 0
    jobs: int = 1

    def check(self) -> None:
        """Raise `InputError` for numbers that cannot be."""
        for name, least in (("num_envs", 1), ("iterations", 1), ("sets", 1), ("worlds", 1), ("seeds", 1), ("seed", 0),
                            ("jobs", 1)):  # fmt: skip
            value = getattr(self, name)
            if value is not None and value < least:
                raise InputError("reproduce", f"--{name.replace('_', '-')}", str(value), f"{least} or more")
        levels = self.noise_levels
        if not levels or len(set(levels)) < len(levels) or not all(0 < v < math.inf for v in levels):
            found = ", ".join(f"{v:g}" for v in levels) or "none"
            raise InputError("reproduce", "--noise-levels", found, "one or more different lengths in m, such as 0.02")
        self.ppo.check()

    @property
    def ppo(self) -> PPOSettings:
        """Numbers of PPO: the preset's, but 100 iterations on a CPU if not given."""
        own = PRESETS[self.preset]
        usual = 100 if self.preset == "cpu" else own.iterations
        return replace(
            own,
            num_envs=own.num_envs if self.num_envs is None else self.num_envs,
            iterations=usual if self.iterations is None else self.iterations,
        )

    @property
    def runs(self) -> dict[Run, int]:
        """Every run once and the sets that it is tested on: those of table 5.2, then what figure 5.4 has beside.

        All runs of a seed come before those of the next.
        """
        once = {row.run: self.sets for row in TABLE_5_2}
        for noise in self.noise_levels:
            for left_out in REMOVED.values():
                once.setdefault(Run(left_out, noise), 1)
        return {replace(run, repeat=k): sets for k in range(self.seeds) for run, sets in once.items()}

    def policies(self, run: Run) -> tuple[str, ...]:
        """Policies that are tested beside a run: zero and random for rows (e) and (f) of the first seed."""
        return BASELINES if run in (TABLE_5_2[-2].run, TABLE_5_2[-1].run) else ()

    @property
    def share(self) -> float:
        """Worlds times iterations, of those of the thesis's final model."""
        return self.ppo.num_envs * self.ppo.iterations / (THESIS_WORLDS * THESIS_ITERATIONS)

    def settings(self, run: Run, registry: TaskRegistry) -> Any:
        """Return the settings of a run's task."""
        kind = registry.of(TASK)
        settings = kind.without(kind.presets[self.preset], run.left_out)
        return replace(settings, max_noise=(run.noise, run.noise))

    def plan(self, run: Run, registry: TaskRegistry) -> Plan:
        """Return what a run computes."""
        return Plan(TASK, self.settings(run, registry), self.ppo, self.seed + run.repeat, self.device)


def outcome(folder: RunFolder, options: Options, run: Run, registry: TaskRegistry, advance: Advance) -> dict[str, Row]:
    """Test a run, or read what was found if it was tested so already; return the rows by policy."""
    beside, sets = options.policies(run), options.runs[run]
    how = {"sets": sets, "worlds": options.worlds, "seed": options.seed, "device": options.device}
    about = {"task": TASK, "iteration": options.ppo.iterations, **how}
    file = folder.path / JSON
    rows = kept_rows(file, about, beside)
    if rows is not None:
        advance(sets * (1 + len(beside)))
    else:
        evaluate(folder.path, registry, **how, baselines=beside, progress=advance)  # type: ignore[arg-type]
        rows = kept_rows(file, about, beside) or []
    try:
        return {row["policy"]: _row_of(row) for row in rows}
    except (KeyError, TypeError, IndexError) as error:
        raise InputError(file, "rows", f"numbers that do not fit ({str(error)[:60]})", EVALUATION) from None


def _row_of(kept: dict[str, Any]) -> Row:
    """Return a row as `evaluate` wrote it."""

    def known(value: float | None) -> float:
        """Return a number, NaN where JSON has null."""
        return math.nan if value is None else value

    count = len(kept[COLUMNS[0]]["sets"])
    sets = [{name: known(kept[name]["sets"][k]) for name in COLUMNS} for k in range(count)]
    return Row(kept["policy"], known(kept["Train Rew"]), kept["Trials"], sets)
