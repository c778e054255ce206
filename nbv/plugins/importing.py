"""Imports other people's modules so that they cannot end, hang or cripple this process; and puts their errors into words."""

from __future__ import annotations

import contextlib
import importlib
import os
import select
import signal
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from nbv.errors import UserError

IMPORT_S = 60.0  # a module that takes longer to import is refused
MESSAGE_LETTERS = 300  # of what a part says, in an error message

_own_process = False  # this process is one mission's alone
_environment: dict[str, str | None] = {}  # variables that the import of a part changed, as they were before


def own_process() -> None:
    """From now on parts are imported unguarded: whatever they do to this process harms one mission alone."""
    global _own_process
    _own_process = True


def environment() -> dict[str, str]:
    """The environment for other processes: without what the import of parts has changed in this one."""
    variables = {**os.environ, **_environment}
    return {name: value for name, value in variables.items() if value is not None}


def imported(name: str, label: str) -> ModuleType:
    """The module ``name``; `UserError` where its import raises, or would end, hang or cripple this process."""
    if name in sys.modules:
        return sys.modules[name]
    if harm := "" if _own_process else _harm_of(name):
        raise UserError(f"{label} cannot be imported: {harm}")
    try:
        with contextlib.nullcontext() if _own_process else _as_before():
            return importlib.import_module(name)
    except UserError:  # of what it registers
        raise
    except (Exception, SystemExit) as error:  # whatever another's module raises
        raise UserError(f"{label} cannot be imported: {error_text(error)}{_place_of(error, name)}") from error


def _harm_of(name: str) -> str:
    """What importing a module does that no ``except`` catches, tried in a child process; empty where that cannot be tried, too."""
    if not sys.platform.startswith("linux") or len([*Path("/proc/self/task").iterdir()]) > 1:
        return ""  # a process with threads cannot be forked
    reads, writes = os.pipe()
    child = os.fork()
    if not child:
        _try_import(name, writes)
    os.close(writes)
    try:
        in_time = bool(select.select([reads], [], [], IMPORT_S)[0])
        problem = os.read(reads, 4 * MESSAGE_LETTERS).decode(errors="replace") if in_time else ""
    finally:
        os.close(reads)
        with contextlib.suppress(ProcessLookupError):
            os.kill(child, signal.SIGKILL)
        with contextlib.suppress(ChildProcessError):
            os.waitpid(child, 0)
    if not in_time:
        return f"it takes longer than {IMPORT_S:g} s"
    return problem.strip() if problem else "it ends the process that imports it, without an error"


def _try_import(name: str, answer: int) -> None:
    """Import in a forked child that ends here; what is wrong, or a blank, goes into the pipe ``answer``."""
    problem = " "
    try:
        null = os.open(os.devnull, os.O_RDWR)
        for number in range(3):
            os.dup2(null, number)
        importlib.import_module(name)
        if not all(Path(f"/proc/self/fd/{number}").exists() for number in range(3)):
            problem = "it closes files that are not its own"
        elif sys.stdout.closed or sys.stderr.closed:
            problem = "it closes sys.stdout or sys.stderr"
    except Exception:
        pass  # so it will here
    except BaseException as error:
        problem = error_text(error) + _place_of(error, name)
    finally:
        with contextlib.suppress(OSError):
            os.write(answer, problem.encode())
        os._exit(0)


@contextlib.contextmanager
def _as_before() -> Iterator[None]:
    """Put back what an import changes of this process: the working directory, handlers of signals, standard streams."""
    folder = os.open(".", os.O_RDONLY)
    variables, streams = dict(os.environ), (sys.stdout, sys.stderr)
    handlers = {number: signal.getsignal(number) for number in signal.valid_signals()}
    try:
        yield
    finally:
        os.fchdir(folder)
        os.close(folder)
        sys.stdout, sys.stderr = streams
        for number, handler in handlers.items():
            if handler is not None and signal.getsignal(number) is not handler:
                with contextlib.suppress(ValueError, OSError):  # in a thread, or one that none may handle
                    signal.signal(number, handler)
        for variable in {name for name, _ in variables.items() ^ os.environ.items()}:
            _environment.setdefault(variable, variables.get(variable))


def error_text(error: BaseException) -> str:
    """``ValueError: what it says``, on one line and not too long, whatever the error's own methods do."""
    try:
        text = " ".join(str(error)[: 10 * MESSAGE_LETTERS].split())
    except Exception:
        text = "(it cannot be printed)"
    return shortened(f"{type(error).__name__}: {text}" if text else type(error).__name__)


def shortened(text: str) -> str:
    return text if len(text) <= MESSAGE_LETTERS else f"{text[: MESSAGE_LETTERS - 1]}…"


def lines_of(error: BaseException) -> dict[str, str]:
    """The last line that was running of each package (``mine.py, line 12``), by the package's name, innermost last."""
    lines: dict[str, str] = {}
    for frame, line in traceback.walk_tb(error.__traceback__):
        package = str(frame.f_globals.get("__name__")).partition(".")[0]
        lines.pop(package, None)
        lines[package] = f"{Path(frame.f_code.co_filename).name}, line {line}"
    return lines


def _place_of(error: BaseException, module: str) -> str:
    """`` (mine.py, line 12)``: the last line of the module's package that was running; empty where none was."""
    line = lines_of(error).get(module.partition(".")[0])
    return f" ({line})" if line else ""
