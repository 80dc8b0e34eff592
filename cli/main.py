"""The command line: flat commands over the rooms, one line on what was written where.

Exit codes: 0 done; 1 the machine failed (a full disk, no memory left); 2 bad input, one line on stderr; 3 done, but
every world diverged or a sampler did not converge; 130 interrupted.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Sequence
from typing import Annotated

import tyro

from ..sim.base.console import dropped_ctrl_c_raised_again, warn
from ..sim.base.errors import InputError
from ..sim.base.files import check_output
from ..version import __version__
from .base.exit_codes import ExitCode
from .check_law import CheckLaw
from .diagnose import Diagnose, Exam
from .evaluate import Evaluate
from .export import Export
from .forest import Forest
from .hide import Hide
from .identify import Identify
from .info import Info
from .play import Play
from .replay import Replay
from .reproduce import Reproduce
from .robots.cameras import Camera
from .robots.probe import Probe
from .robots.recordings import ImportArm, ImportCase, NewCase, Record
from .robots.robot import Robot
from .robots.run import Run
from .simulate import Simulate, simulate_case
from .touch import Touch
from .train import Train
from .view import View

_DESCRIPTION = """Simulate thousands of different trees in parallel; infer the springs of a real one.

Units are SI (m, kg, s, rad, N), quaternions w x y z, z is up. Same command, same seed: same files.
`bough COMMAND --help` explains a command, `bough --version` prints the version."""

Command = (
    Annotated[Info, tyro.conf.subcommand("info")]
    | Annotated[Forest, tyro.conf.subcommand("forest")]
    | Annotated[Simulate, tyro.conf.subcommand("simulate")]
    | Annotated[Replay, tyro.conf.subcommand("replay")]
    | Annotated[NewCase, tyro.conf.subcommand("new-case")]
    | Annotated[ImportCase, tyro.conf.subcommand("import-case")]
    | Annotated[ImportArm, tyro.conf.subcommand("import-arm")]
    | Annotated[Record, tyro.conf.subcommand("record")]
    | Annotated[Identify, tyro.conf.subcommand("identify")]
    | Annotated[Hide, tyro.conf.subcommand("hide")]
    | Annotated[Diagnose, tyro.conf.subcommand("diagnose")]
    | Annotated[Exam, tyro.conf.subcommand("exam")]
    | Annotated[Train, tyro.conf.subcommand("train")]
    | Annotated[Evaluate, tyro.conf.subcommand("evaluate")]
    | Annotated[Play, tyro.conf.subcommand("play")]
    | Annotated[Export, tyro.conf.subcommand("export")]
    | Annotated[CheckLaw, tyro.conf.subcommand("check-law")]
    | Annotated[View, tyro.conf.subcommand("view")]
    | Annotated[Reproduce, tyro.conf.subcommand("reproduce")]
    | Annotated[Touch, tyro.conf.subcommand("touch")]
    | Annotated[Robot, tyro.conf.subcommand("robot")]
    | Annotated[Probe, tyro.conf.subcommand("probe")]
    | Annotated[Run, tyro.conf.subcommand("run")]
    | Annotated[Camera, tyro.conf.subcommand("camera")]
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code; see the head of this module.

    Raises:
        SystemExit: Help was asked for (0) or an option does not exist (2).
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given == ["--version"]:
        print(f"bough {__version__}")
        return ExitCode.DONE
    warnings.showwarning = _show_warning
    config = (tyro.conf.OmitArgPrefixes, tyro.conf.DisallowNone)
    command: Command = tyro.cli(Command, args=given, prog="bough", description=_DESCRIPTION, config=config)
    try:
        with dropped_ctrl_c_raised_again():
            return _run(command)
    except InputError as error:
        print(f"bough: {error}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    except KeyboardInterrupt:
        return _interrupted()
    except OSError as error:  # what reading and writing did not foresee: a full disk, a folder closed to us
        print(f"bough: {error.filename or command.__class__.__name__.lower()}: {error.strerror}", file=sys.stderr)
        return ExitCode.BAD_INPUT if isinstance(error, PermissionError) else ExitCode.FAILED
    except MemoryError:  # what no check of sizes foresaw
        print(f"bough: {command.__class__.__name__.lower()}: more memory than is left", file=sys.stderr)
        return ExitCode.FAILED
    except Exception as error:
        if not _comes_of_ctrl_c(error):
            raise
        return _interrupted()
    finally:
        # Ctrl-C inside exec of a text (as dataclasses do while they are imported) leaves a mark, for which CPython ends
        # by the signal instead of our exit code, whoever has caught it; the next exec of a text removes it
        # (bpo-1054041)
        exec("")


def _run(command: Command) -> int:
    _check_output(command)
    if isinstance(command, Simulate) and command.source.is_dir():
        return simulate_case(command)
    return command.run()


def _check_output(command: Command) -> None:
    """Refuse an output folder that cannot be, before anything is imported or made for it."""
    chosen = next((part for part in vars(command).values() if hasattr(part, "run")), command)  # of a group of commands
    out = getattr(chosen, "out", None)
    if out is not None:
        check_output(out)


def _interrupted() -> int:
    print("bough: interrupted; nothing was written", file=sys.stderr)
    return ExitCode.INTERRUPTED


def _comes_of_ctrl_c(error: BaseException | None) -> bool:
    """Return whether Ctrl-C is behind an error: while a module is imported it may become another one."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _show_warning(message: Warning | str, category: type[Warning], *_place: object, **_options: object) -> None:
    """Print a Python warning as one line without the place in the code.

    Not that a file was left open: it is told whenever memory is next cleared, in the midst of any other command.
    """
    if not issubclass(category, ResourceWarning):
        warn(" ".join(str(message).split()))
