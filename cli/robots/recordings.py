"""``bough new-case``, ``import-case``, ``record``: what people and robots record becomes a case folder."""

from __future__ import annotations

import inspect
import re
import signal
import sys
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import tyro

from ...sim.base.console import shown, tell, warn
from ...sim.base.errors import InputError
from ..base.exit_codes import ExitCode

if TYPE_CHECKING:
    from ...learn.cases.case import BranchCase, JointCase
    from ...learn.recordings.questions import Asker


@dataclass(frozen=True)
class NewCase:
    """Make a case folder, which bough identify and bough diagnose read, from CSV files of force and motion.

    Columns and units are guessed from the header, and what was guessed is printed and kept in OUT/assumptions.txt. What
    is missing is asked for on a terminal; elsewhere one line names the flag. Force and displacement along one line, or
    torque and angle, become one joint; forces and motion in space (two or three columns) a branch of segments. Numbers
    may have their unit: 24mm, 350g, 0.5rad; bare ones are m, kg and degrees. Exit code 0: done; 2: bad input, nothing
    written.

    Attributes:
        csv: CSV files, a recording each, in the order in which they were made.
        out: Case folder to write.
        header: Line of the header, where other lines stand before it; found by its number of cells if not given.
        time: Column of the clock.
        time_unit: Its unit: s, ms, us, ns, min.
        rate: Rows per second, for files without a clock.
        resample: Rate of the grid that a clock with jitter is put on [Hz]; its own, rounded, if not given.
        rows: A:B, rows from A on and before B, counted from 0; several make several recordings of one file, or are one
            for each of several files.
        only: COLUMN=TEXT: the rows in which a column has this text; several must all hold.
        force: Column of the force, that of the hand or robot on the branch; three for the axes x y z, two for x z.
        torque: Column of the torque, in place of a force; one for each joint with --mjcf.
        free: Nothing acts: the branch or pendulum was let go and swings freely.
        force_unit: Unit of the force: N, mN, kN, kgf, gf, lbf, and kg, g, lb of a scale; of a torque: Nm, Ncm, Nmm.
        force_zero: What the gauge reads without load, in its unit, or start: what it reads at the start.
        position: Column of the displacement or position; three for the axes x y z, two for x z.
        angle: Column of the angle, in place of a position; one for each joint with --mjcf.
        position_unit: Unit of the position: m, cm, mm, um, in, ft; of an angle: rad, mrad, deg.
        position_zero: Reading at rest, in its unit; start: the first, or the mean before contact; end: the mean of the
            last tenth. If not given, start; end where nothing acts; 0 with --hangs or --mjcf.
        velocity: Columns of the velocity x y z, where it was measured.
        velocity_unit: Its unit: m/s, cm/s, mm/s.
        flip: Turn the sign of force or motion; none: keep both although they point against each other.
        at: Where the branch is pulled or held: the distance from its base along it, such as 90cm; one for each
            recording if they differ.
        pull_angle: Angle between the branch at rest and the line of the pull, in degrees; 90, straight across, if not
            given.
        length: Length of the branch, or one for each segment, base first.
        diameter: Diameter, or those at base and tip, or one for each end of the segments.
        mass: Mass of the branch, or one for each segment; follows from the density if not given.
        density: Density of the wood [kg/m^3]; 900, green wood, if neither it nor the mass is given.
        rises: Degrees of the branch above the horizontal: 90 stands upright, -90 hangs; one for each segment if they
            differ.
        azimuth: Degrees about the vertical from x, in the same way; 0 if not given.
        segments: Into how many segments a branch in space is divided.
        hangs: It swings under its own weight, as a pendulum, without a spring; where it hangs is learnt.
        inertia: Moment of inertia about the base [kg m^2], or the mass that a pull moves [kg]; from length and
            diameter, or learnt, if not given.
        mjcf: MJCF file of a mechanism of several joints, in the order of --angle and --torque.
        unknown: What of it is to be learnt: damping, if not given; others in docs/cases.md.
        no_contact: A:B, seconds from the start in which nothing touches the branch; K:A:B for recording K alone.
        repeats: K:OF, recording K repeats recording OF, counted from 1.
        starts: When each recording starts [s] on one clock; ten seconds after the one before if not given.
        noise: Noise as a share of the rms; estimated if not given.
        name: Name of the case; that of its folder if not given.
        json: Print what was made and assumed as JSON instead of sentences.
    """

    csv: tyro.conf.Positional[tuple[Path, ...]]
    out: Path
    header: int | None = None
    time: str | None = None
    time_unit: str | None = None
    rate: float | None = None
    resample: float | None = None
    rows: tuple[str, ...] = ()
    only: tuple[str, ...] = ()
    force: tuple[str, ...] = ()
    torque: tuple[str, ...] = ()
    free: bool = False
    force_unit: str | None = None
    force_zero: str | None = None
    position: tuple[str, ...] = ()
    angle: tuple[str, ...] = ()
    position_unit: str | None = None
    position_zero: str | None = None
    velocity: tuple[str, ...] = ()
    velocity_unit: str | None = None
    flip: str | None = None
    at: tuple[str, ...] = ()
    pull_angle: str | None = None
    length: tuple[str, ...] = ()
    diameter: tuple[str, ...] = ()
    mass: tuple[str, ...] = ()
    density: float | None = None
    rises: tuple[str, ...] = ()
    azimuth: tuple[str, ...] = ()
    segments: int | None = None
    hangs: bool = False
    inertia: float | None = None
    mjcf: Path | None = None
    unknown: tuple[str, ...] = ()
    no_contact: tuple[str, ...] = ()
    repeats: tuple[str, ...] = ()
    starts: tuple[float, ...] = ()
    noise: float | None = None
    name: str | None = None
    json: bool = False

    def run(self) -> int:
        """Make the case, say what was guessed and assumed; return the exit code."""
        from ...learn.recordings.given import Given
        from ...learn.recordings.new_case import new_case
        from ...learn.recordings.questions import Asker

        if not self.csv:
            raise InputError("new-case", "CSV", "no file", "one or more CSV files of force and motion")
        own = vars(self)
        given = Given(**{f.name: own[f.name] for f in fields(Given) if f.name in own})
        ask = Asker("new-case", sys.stdin.isatty(), flag_helps(NewCase))
        case = new_case(self.csv, self.out, given, ask)
        _say(case, self.out, ask, self.json)
        return ExitCode.DONE


@dataclass(frozen=True)
class ImportCase:
    """Make a case folder, which bough identify and bough diagnose read, from ROS bags of an arm that moves a branch.

    ROS 1, and ROS 2's MCAP and SQLite. The force is that of a wrench topic, of a scale, or of the torques of the arm's
    joints less gravity; the motion that of a pose topic, a frame of TF, or the hand. Two clocks are brought together by
    cross-correlation. What was assumed is printed and kept in OUT/assumptions.txt. Needs pip install -e '.[touch]' in
    bough's folder. Exit code 0: done; 2: bad input, nothing written.

    Attributes:
        bag: Bags, in the order in which they were recorded.
        out: Case folder to write.
        force_from: What the force is of; wrench, else scale, else joints, by what is there, if not given.
        wrench: Topic of the wrench, if there are several.
        wrench_frame: Whether its axes stand still, turn with the end-effector (hand) or with the arm's last link; by
            the name of its frame if not given.
        scale: Topic of a scale's reading along one line (Float64 or Float32).
        scale_unit: Its unit: N, mN, kN, kgf, gf, lbf, kg, g, lb; N if not given.
        direction: x y z of the line of the scale's pull; that of most of the motion if not given.
        joints: Topic of the joint states, if there are several.
        arm: The arm of the joint states, whose base frame is the world's.
        gravity: Whether the efforts hold the arm's own weight (in) or the driver has taken it out; by which leaves less
            of them if not given.
        pose: Topic of the grasp point's or the tag's pose, if there are several; the hand by joint positions if none.
        frame: Frame of TF that moves with the grasp point, such as a tag's.
        clock_offset: How far the motion's clock is ahead of the force's [s]; found by cross-correlation if not given.
        most_offset: Largest offset that is looked for [s].
        during: A:B, seconds from where force and motion have begun; several make several recordings of a bag.
        resample: Rate of the case [Hz]; that of the slowest topic, rounded, if not given.
        force_zero: start: the first reading, or the mean before contact; 0: as the sensor says. If not given, start
            where --no-contact begins with the recording, else 0.
        flip: Turn the sign of the force; none: keep it although it points against the motion.
        at: Where the branch is held: the distance from its base along it, such as 90cm; by --base if not given.
        base: x y z of the branch's base in the frame of the motion [m].
        length: Length of the branch, or one for each segment, base first.
        diameter: Diameter, or those at base and tip, or one for each end of the segments.
        mass: Mass of the branch, or one for each segment; follows from the density if not given.
        density: Density of the wood [kg/m^3]; 900, green wood, if neither it nor the mass is given.
        rises: Degrees of the branch above the horizontal: 90 stands upright, -90 hangs; one for each segment if they
            differ.
        azimuth: Degrees about the vertical from x, in the same way; 0 if not given.
        segments: Into how many segments the branch is divided.
        no_contact: A:B, seconds from the start in which nothing touches the branch; K:A:B for recording K alone.
        repeats: K:OF, recording K repeats recording OF, counted from 1.
        starts: When each recording starts [s] on one clock; ten seconds after the one before if not given.
        noise: Noise as a share of the rms; estimated if not given.
        name: Name of the case; that of its folder if not given.
        json: Print what was made and assumed as JSON instead of sentences.
    """

    bag: tyro.conf.Positional[tuple[Path, ...]]
    out: Path
    force_from: Literal["wrench", "scale", "joints"] | None = None
    wrench: str | None = None
    wrench_frame: Literal["world", "hand", "link"] | None = None
    scale: str | None = None
    scale_unit: str | None = None
    direction: tuple[float, ...] = ()
    joints: str | None = None
    arm: str = "jaco2"
    gravity: Literal["in", "out"] | None = None
    pose: str | None = None
    frame: str | None = None
    clock_offset: float | None = None
    most_offset: float = 10.0
    during: tuple[str, ...] = ()
    resample: float | None = None
    force_zero: Literal["start", "0"] | None = None
    flip: Literal["force", "none"] | None = None
    at: tuple[str, ...] = ()
    base: tuple[float, ...] = ()
    length: tuple[str, ...] = ()
    diameter: tuple[str, ...] = ()
    mass: tuple[str, ...] = ()
    density: float | None = None
    rises: tuple[str, ...] = ()
    azimuth: tuple[str, ...] = ()
    segments: int | None = None
    no_contact: tuple[str, ...] = ()
    repeats: tuple[str, ...] = ()
    starts: tuple[float, ...] = ()
    noise: float | None = None
    name: str | None = None
    json: bool = False

    def run(self) -> int:
        """Make the case, say what was assumed; return the exit code."""
        from ...learn.recordings.bag_force import BagGiven
        from ...learn.recordings.given import Given
        from ...learn.recordings.import_case import import_case
        from ...learn.recordings.questions import Asker
        from ...sim.arms.registry import ARMS

        if not self.bag:
            raise InputError("import-case", "BAG", "no file", "one or more ROS bags")
        if len(self.base) not in (0, 3):
            raise InputError("", "--base", f"{len(self.base)} numbers", "three, x y z")
        if not 0 < self.most_offset <= 600:
            raise InputError("", "--most-offset", f"{self.most_offset:g}", "above 0 s, at most 600")
        own = vars(self)
        bag_given = BagGiven(**{f.name: own[f.name] for f in fields(BagGiven)})
        given = Given(**{f.name: own[f.name] for f in fields(Given) if f.name in own})
        ask = Asker("import-case", sys.stdin.isatty(), flag_helps(ImportCase))
        arm = ARMS.of(self.arm, "import-case", "--arm")
        case = import_case(self.bag, self.out, arm, bag_given, given, ask)
        _say(case, self.out, ask, self.json)
        return ExitCode.DONE


@dataclass(frozen=True)
class ImportArm:
    """Make a case folder of an arm from ROS bags of its free motions: bough diagnose says what its servos' model lacks.

    Joint states with positions are needed, with efforts or beside commanded speeds (Kinova's JointVelocity, or a
    Float64MultiArray on a topic that is called after a velocity). What was assumed is printed and kept in
    OUT/assumptions.txt. Needs pip install -e '.[touch]' in bough's folder. Exit code 0: done; 2: bad input, nothing
    written.

    Attributes:
        bag: Bags, a recording each; nothing touches the arm in them.
        out: Case folder to write.
        arm: The arm, whose joints are those of the joint states in their order.
        gravity: Whether the efforts hold the arm's own weight (in) or the driver has taken it out; by which leaves less
            of them if not given.
        json: Print what was made and assumed as JSON instead of sentences.
    """

    bag: tyro.conf.Positional[tuple[Path, ...]]
    out: Path
    arm: str = "jaco2"
    gravity: Literal["in", "out"] | None = None
    json: bool = False

    def run(self) -> int:
        """Make the case, say what was assumed; return the exit code."""
        from ...learn.recordings.import_arm import import_arm
        from ...sim.arms.registry import ARMS

        if not self.bag:
            raise InputError("import-arm", "BAG", "no file", "one or more ROS bags")
        arm = ARMS.of(self.arm, "import-arm", "--arm")
        case, notes = import_arm(self.bag, self.out, arm, self.arm, self.gravity)
        if not self.json:
            for note in notes:
                print(f"- {note}")
        seconds = sum(float(t.t[-1]) for t in case.trajectories)
        said = (f"{len(case.trajectories)} recordings of {len(case.joints)} joints, {seconds:.0f} s in all. "
                f"Go on with bough diagnose {shown(self.out)} --out DIR.")  # fmt: skip
        tell(said, {"case": str(self.out), "recordings": len(case.trajectories), "assumed": notes}, self.json)
        return ExitCode.DONE


@dataclass(frozen=True)
class Record:
    """Record an arm behind bough robot serve into a ROS 2 bag, 60 joint states and hand poses a second, until Ctrl-C.

    Every tick is in the file before the next one: after kill -9 all of them can be read from OUT/*.db3. Needs
    pip install -e '.[touch,robot]' in bough's folder. Exit code 0: done; 1: no room left, what came before is kept; 2:
    bad input.

    Attributes:
        url: Address of the service.
        out: Folder of the bag; it must not be there yet.
        seconds: End after so many seconds of the service's clock; at Ctrl-C, SIGTERM or its end if not given.
        token_file: File whose first line the service wants to hear.
        certificate: PEM file that vouches for a service over https.
        mcap: Turn the bag into MCAP once it has ended; SQLite if not.
        json: Print ticks and seconds as JSON instead of a sentence.
    """

    url: tyro.conf.Positional[str]
    out: Path
    seconds: float | None = None
    token_file: Path | None = None
    certificate: Path | None = None
    mcap: bool = False
    json: bool = False

    def run(self) -> int:
        """Record, and say how many ticks came and how many did not."""
        from ...learn.recordings.record_bag import check_new_bag, into_mcap, record
        from ...learn.recordings.stream import ticks
        from ...learn.robot.access import read_token

        if self.seconds is not None and not self.seconds > 0:
            raise InputError("", "--seconds", f"{self.seconds:g}", "above 0 s")
        check_new_bag(self.out)
        token = None if self.token_file is None else read_token(self.token_file)
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        told = record(self.url, ticks(self.url, token, self.certificate), self.out, self.seconds, _recording)
        if self.mcap:
            into_mcap(self.out)
        if told.cut_off:
            warn(f"the service has ended or fallen silent after {told.seconds:.1f} s")
        missed = f", {told.missed} did not come" if told.missed else ""
        said = f"{told.ticks} ticks in {told.seconds:.1f} s{missed}. Wrote {shown(self.out)}"
        result = {"out": str(self.out), "ticks": told.ticks, "missed": told.missed, "seconds": told.seconds}
        tell(said, result, self.json)
        return ExitCode.DONE


def _recording(out: Path) -> None:
    print(f"bough: recording into {shown(out)}, Ctrl-C ends", file=sys.stderr, flush=True)


def flag_helps(command: type) -> dict[str, str]:
    """Return the help of every flag of a command, out of its docstring."""
    text = re.sub(r"\n {8,}", " ", (inspect.getdoc(command) or "").partition("Attributes:")[2])
    return {f"--{name.replace('_', '-')}": told for name, told in re.findall(r"^ +(\w+): (.+)$", text, re.MULTILINE)}


def _say(case: BranchCase | JointCase, out: Path, ask: Asker, as_json: bool) -> None:
    """Print warnings, what was assumed, and what to do next."""
    from ...learn.cases.case import BranchCase

    for line in ask.warnings:
        warn(line)
    form = "branch" if isinstance(case, BranchCase) else "joint"
    count = len(case.trajectories)
    recordings = f"{count} recording{'s' if count > 1 else ''}"
    last = f"Wrote {shown(out)}: {recordings} of a {form}. Next: bough diagnose {shown(out)} --out verdict"
    result = {"out": str(out), "form": form, "recordings": count, "assumptions": ask.notes, "warnings": ask.warnings}
    tell("\n".join([*ask.notes, last]), result, as_json)
