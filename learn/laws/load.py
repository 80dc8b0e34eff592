"""Reading the file of one law."""

from __future__ import annotations

import re
import sys
from importlib import util
from pathlib import Path

from ...sim.base.errors import InputError
from ...sim.effects import Effect, effects

_WHO = "bough check-law"


def law_from(path: str | Path) -> Effect:
    """Run the file of a law and return the one effect that it registers.

    The file is Python and is run: check no file that you would not run.

    Raises:
        InputError: There is no such file, it cannot be run, registers no effect or several, or `register` refuses it.
    """
    file = Path(path)
    if not file.is_file() or file.suffix != ".py":
        raise InputError(_WHO, str(path), "no such file" if file.suffix == ".py" else "no Python file", "a Python file")
    before = {e.name for e in effects()}
    _run(file)
    new = [e for e in effects() if e.name not in before]
    if len(new) != 1:
        found = ", ".join(e.name for e in new) or "none"
        raise InputError(str(path), "register", found, "one effect a file, under a name that no other has")
    return new[0]


def _run(file: Path) -> None:
    """Import a file as a module of its own; Warp reads device functions from their source."""
    name = f"bough_law_{file.stem}"
    spec = util.spec_from_file_location(name, file.resolve())
    assert spec is not None and spec.loader is not None
    module = util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            str(file), _line_of(error, file), f"{type(error).__name__}: {error}", "Python that runs"
        ) from None


def _line_of(error: Exception, file: Path) -> str:
    """Return the last line of the file that an error came through."""
    line, place = getattr(error, "lineno", None), error.__traceback__
    while place is not None:
        if place.tb_frame.f_code.co_filename == str(file.resolve()):
            line = place.tb_lineno
        place = place.tb_next
    return f"line {line}"


def not_compiled(error: Exception, path: str | Path) -> InputError | None:
    """Return what Warp says of a law that it cannot compile, in one line; None for an error of another kind."""
    if not type(error).__name__.startswith("WarpCodegen"):
        return None
    text = str(error.args[0] if error.args else error)  # a KeyError's own text is quoted
    lines = re.findall(rf"at {re.escape(str(Path(path).resolve()))}:(\d+)", text)
    said = " ".join(re.split(r"\n;", text)[-1].split())
    wanted = "a device function of Warp's, of what bough.kernels.lanes offers"
    return InputError(
        str(path), f"line {lines[-1]} of the law, from its def" if lines else "the law", said[:200], wanted
    )
