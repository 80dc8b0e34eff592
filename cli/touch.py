"""``bough touch``: feel contact in an arm's joint torques."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from ..sim.base.console import bar, shown, start_warp, tell
from ..sim.base.errors import InputError, check_seed
from ..sim.base.files import output_folder
from .base.exit_codes import ExitCode

MODEL = "model.npz"
_JOINTS = 6  # of the simulated arm


@dataclass(frozen=True)
class Record:
    """Record a simulated Jaco 2 in arbitrary motions, touched at seven places from four sides by a hand and a branch.

    Every motion is also made without what it meets. Writes a CSV file of each, recordings.csv (what is touched where)
    and sensor.json. Exit code 0: done; 2: bad input, nothing written.

    Attributes:
        out: Folder to write to.
        rounds: Each has 112 motions: seven places, four sides, a hand and a branch; with and without.
        seconds: Length of a motion [s].
        force: Force on a link from which it is contact [N].
        sensor: sensor.json that bough touch fit wrote; that of a real Jaco 2 if not given.
        seed: Seed of everything random.
        json: Print how many recordings there are as JSON instead of a sentence.
    """

    out: Path
    rounds: int = 4
    seconds: float = 6.0
    force: float = 2.0
    sensor: Path | None = None
    seed: int = 0
    json: bool = False

    def run(self) -> int:
        """Record, and say how much contact there is."""
        start_warp()
        from ..learn.touch.record import Settings, record
        from ..learn.touch.sensor import JACO2, read_sensor

        sensor = JACO2 if self.sensor is None else read_sensor(self.sensor, _JOINTS)
        settings = Settings(self.rounds, self.seconds, self.force, self.seed, sensor)
        settings.check()
        with bar("recording", self.rounds) as advance:
            made = record(self.out, settings, advance)
        touched = sum(bool(r.contact.any()) for r in made)
        said = f"{len(made)} recordings, {touched} with contact. Wrote {shown(self.out)}"
        tell(said, {"out": str(self.out), "recordings": len(made), "with_contact": touched}, self.json)
        return ExitCode.DONE


@dataclass(frozen=True)
class Fit:
    """Learn how an arm's joint torques come out of its driver, from recordings in which nothing touches it.

    Writes sensor.json: rate, offset, friction, noise at rest and in motion, drift, quanta. Exit code 0: done; 2: bad
    input, nothing written.

    Attributes:
        data: Folder of CSV files or ROS bags; rows with contact are left out.
        out: Folder to write to.
        json: Print sensor.json as JSON instead of a sentence.
    """

    data: tyro.conf.Positional[Path]
    out: Path
    json: bool = False

    def run(self) -> int:
        """Fit, and say the noise."""
        from ..learn.touch.read import read_recordings
        from ..learn.touch.sensor import fit_sensor

        sensor = fit_sensor(read_recordings(self.data), str(self.data))
        with output_folder(self.out) as work:
            sensor.write(work / "sensor.json")
        still, moving = (", ".join(f"{v:.3g}" for v in values) for values in (sensor.still, sensor.moving))
        said = f"{sensor.rate:.1f} Hz; noise at rest {still}, and per rad/s {moving}"
        tell(f"{said}. Wrote {shown(self.out)}/sensor.json", self.out / "sensor.json", self.json)
        return ExitCode.DONE


@dataclass(frozen=True)
class Train:
    """Learn to tell contact from recordings; write model.npz.

    The threshold is the one that tells 95 % of the free rows right, each recording told by a model without it. Exit
    code 0: done; 2: bad input, nothing written.

    Attributes:
        data: Folder of CSV files or ROS bags, or of bough touch record.
        out: Folder to write to.
        kind: A forest of decision trees, or a network of three layers.
        seed: Seed of the classifier.
        json: Print area under the curve and threshold as JSON instead of a sentence.
    """

    data: tyro.conf.Positional[Path]
    out: Path
    kind: Literal["forest", "network"] = "forest"
    seed: int = 0
    json: bool = False

    def run(self) -> int:
        """Train, and say how well recordings left out are told."""
        check_seed("touch train", self.seed)

        from ..learn.touch.forest import require_sklearn
        from ..learn.touch.read import read_recordings
        from ..learn.touch.recording import check_labels

        require_sklearn()
        recordings = read_recordings(self.data)
        check_labels(recordings, str(self.data))
        start_warp()
        from ..learn.touch.crossval import FOLDS, left_out
        from ..learn.touch.model import train_model
        from ..learn.touch.scores import auc, pooled, threshold_for

        folds = min(FOLDS, len(recordings))
        with bar("training", folds + 1) as advance:
            told = left_out(recordings, self.kind, self.seed, str(self.data), folds=folds, progress=advance)
            model = train_model(recordings, self.kind, threshold_for(told, 0.95), self.seed, str(self.data))
        with output_folder(self.out) as work:
            model.write(work / MODEL)
        area = auc(*pooled(told, certain=True))
        said = f"AUC {area:.3f} on recordings left out, of {len(recordings)}; threshold {model.threshold:.2f}."
        result = {"out": str(self.out), "auc": float(area), "threshold": float(model.threshold)}
        tell(f"{said} Wrote {shown(self.out)}/{MODEL}", result, self.json)
        return ExitCode.DONE


@dataclass(frozen=True)
class Evaluate:
    """Test on recordings that the classifier has not seen; write touch.json and report.html.

    Without a model each recording is told by a classifier of all others (leave one out); with one, what it was trained
    on is left out. Exit code 0: done; 2: bad input, nothing written.

    Attributes:
        data: Folder of CSV files or ROS bags, or of bough touch record.
        out: Folder to write to.
        model: model.npz that bough touch train wrote.
        free: Recordings of this arm without contact, by which the model learns what its free motion needs: for a model
            of another arm, or of a simulated one.
        kind: Of the classifier that is trained where no model is given.
        seed: Seed of the classifier and of the intervals.
        json: Print touch.json as JSON instead of a sentence.
    """

    data: tyro.conf.Positional[Path]
    out: Path
    model: Path | None = None
    free: Path | None = None
    kind: Literal["forest", "network"] = "forest"
    seed: int = 0
    json: bool = False

    def run(self) -> int:
        """Test, and say what came out and where the report is."""
        check_seed("touch evaluate", self.seed)
        if self.free is not None and self.model is None:
            raise InputError("touch evaluate", "--free", "no --model", "--model with it: leave one out fits its own")
        from ..learn.touch.read import read_recordings
        from ..learn.touch.recording import check_joints, check_labels

        recordings = read_recordings(self.data)
        check_labels(recordings, str(self.data))
        start_warp()
        from ..learn.touch.crossval import left_out, unseen
        from ..learn.touch.evaluation import evaluate, sentence, write_outcome
        from ..learn.touch.forest import require_sklearn
        from ..learn.touch.free_motion import fit_free_motion
        from ..learn.touch.model import read_model

        if self.model is None:
            require_sklearn()
            with bar("leaving one out", len(recordings)) as advance:
                told = left_out(recordings, self.kind, self.seed, str(self.data), progress=advance)
            kind, threshold = f"{self.kind}, leave one recording out", None
        else:
            model = read_model(self.model)
            check_joints(recordings, str(self.data), model.num_dofs)
            if self.free is not None:
                free = read_recordings(self.free)
                check_joints(free, str(self.free), model.num_dofs)
                model = model.with_free_motion(fit_free_motion(free, str(self.free)))
            told = unseen(model, recordings, str(self.data))
            kind, threshold = f"{model.kind} of {self.model}", model.threshold
        outcome = evaluate(told, threshold, str(self.data), self.seed)
        how = {"data": str(self.data), "classifier": kind, "free motion of": str(self.free or "training"),
               "rows": outcome.rows[0], "rows with a certain label": outcome.rows[1], "seed": self.seed}  # fmt: skip
        with output_folder(self.out) as work:
            write_outcome(work, outcome, told, how, f"Touch told from joint torques: {self.data.name}")
        tell(f"{sentence(outcome)} Open {shown(self.out)}/report.html", self.out / "touch.json", self.json)
        return ExitCode.DONE


@dataclass(frozen=True)
class Touch:
    """Feel contact in an arm's joint torques: record, fit a sensor, train, evaluate.

    Attributes:
        work: What to do.
    """

    work: (
        Annotated[Record, tyro.conf.subcommand("record", prefix_name=False)]
        | Annotated[Fit, tyro.conf.subcommand("fit", prefix_name=False)]
        | Annotated[Train, tyro.conf.subcommand("train", prefix_name=False)]
        | Annotated[Evaluate, tyro.conf.subcommand("evaluate", prefix_name=False)]
    )

    def run(self) -> int:
        """Do it; return the exit code."""
        return self.work.run()
