"""What the command line makes of errors that commands raise."""

import subprocess
import sys
import warnings

import pytest
from bough.cli import main as module
from bough.cli.base.exit_codes import ExitCode
from bough.cli.info import Info


def raising(error, cause=None):
    """Return a command's ``run`` that raises."""

    def run(_self):
        raise error from cause

    return run


def test_ctrl_c_while_a_module_is_imported(monkeypatch, capsys):
    """Exit with 130 and one line where Ctrl-C has become an ImportError on its way; leave other ImportErrors alone."""
    monkeypatch.setattr(Info, "run", raising(ImportError("initialization failed"), KeyboardInterrupt()))
    assert module.main(["info"]) == ExitCode.INTERRUPTED == 130
    assert capsys.readouterr().err == "bough: interrupted; nothing was written\n"
    monkeypatch.setattr(Info, "run", raising(ImportError("initialization failed"), OSError()))
    with pytest.raises(ImportError):
        module.main(["info"])


def test_ctrl_c_inside_an_exec_ends_with_130(tmp_path):
    """Exit with 130, not by the signal, where Ctrl-C came while a text was executed, as dataclasses do."""
    (tmp_path / "pressed.py").write_text(
        "import sys\n"
        "from bough.cli import main\n"
        "from bough.cli.info import Info\n"
        "def run(_self):\n"
        "    exec('raise KeyboardInterrupt')\n"
        "Info.run = run\n"
        "sys.exit(main.main(['info']))\n"
    )
    done = subprocess.run([sys.executable, "-m", "pressed"], capture_output=True, text=True, stdin=subprocess.DEVNULL)
    assert (done.returncode, done.stderr) == (130, "bough: interrupted; nothing was written\n")


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (OSError(28, "No space left"), 1, "No space left"),
        (PermissionError(13, "closed"), 2, "closed"),
        (MemoryError("Unable to allocate 14.6 TiB"), 1, "more memory than is left"),
    ],
)
def test_faults_of_the_machine(monkeypatch, capsys, error, code, said):
    """Tell a full disk and full memory (1) from a folder that is closed to the user (2), each in one line."""
    monkeypatch.setattr(Info, "run", raising(error))
    assert module.main(["info"]) == code
    assert capsys.readouterr().err == f"bough: info: {said}\n"


def test_a_file_left_open_is_no_warning_of_a_command(capsys):
    """Say nothing of a file that some other code left open, which is told whenever memory is cleared, and all else."""
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        warnings.showwarning = module._show_warning
        warnings.warn("unclosed file", ResourceWarning, stacklevel=1)
        warnings.warn("a column\nis empty", RuntimeWarning, stacklevel=1)
    assert capsys.readouterr().err == "bough: warning: a column is empty\n"
