"""One flight of a mission that is not ours: request in, command, result out."""

from __future__ import annotations

import contextlib
import fcntl
import os
import shutil
import signal
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from nbv.errors import MissionFailure, UserError
from nbv.safe_files import read_bytes
from tuner.missions.external.contract import REQUEST_FILE, RESULT_FILE, Failure, Request, Result, read_result
from tuner.missions.external.ending import end_all, marked
from tuner.missions.external.process import LARGEST_LOG_BYTES, Ended, run_command

LOG_FILE = "mission.log"
_CALL = Path(__file__).with_name("call.py")
_LAST_BYTES, _LAST_LETTERS = 4096, 160
_LOG_BYTES = 2 * LARGEST_LOG_BYTES


@dataclass(frozen=True)
class Flown:
    """How a flight ended: with a result, which may be a failure."""

    ended: Ended
    result: Result


def fly_request(request: Request, time_limit_s: float | None = None) -> Flown:
    """Fly once; nothing of an earlier attempt and no process is left.

    A result that the mission left counts whatever came after it. Without one a time-out is the configuration's failure,
    anything else the machine's.

    Parameters
    ----------
    time_limit_s
        Instead of the mission file's.

    Raises
    ------
    UserError
        The command cannot be run.
    """
    with _alone(request.output.parent):
        return _fly(request, time_limit_s or request.mission.time_limit_s)


def _fly(request: Request, limit_s: float) -> Flown:
    mission, output = request.mission, request.output
    end_all(lambda: marked(str(output)), mission.stop_grace_s)
    _remove(output)
    path, log, folder = request.write(), output / LOG_FILE, _identity(output)
    environment = request.environment()
    if mission.function:
        before = os.environ.get("PYTHONPATH", "")
        environment["PYTHONPATH"] = os.pathsep.join(p for p in (str(mission.folder), before) if p)
    ended = run_command(
        _command(request, path), mission.folder, environment, str(output), log, limit_s, mission.stop_grace_s
    )
    if output.parent.is_symlink():  # whoever writes there next would write elsewhere
        output.parent.unlink()
        output.parent.mkdir()
    if _identity(output) != folder:
        moved = f"the mission removed or replaced its output folder {output}; leave it where it is"
        return Flown(ended, Result(failure=Failure("machine", "output_replaced", moved)))
    try:
        return Flown(ended, read_result(request.result_path))
    except UserError as error:
        how = f"{error}; {_how_it_ended(ended)}{_last_words(log)}; see {log}"
    if ended.timed_out:
        late = Failure("configuration", "timeout", f"not done after {limit_s:g} s; see {log}")
        return Flown(ended, Result(failure=late))
    return Flown(ended, Result(failure=Failure("machine", "no_result", how)))


@contextlib.contextmanager
def _alone(directory: Path) -> Iterator[None]:
    """Wait until nothing of an earlier attempt is left: its keeper has the lock while it ends what there is."""
    if directory.is_symlink():
        directory.unlink()
    directory.mkdir(parents=True, exist_ok=True)
    handle = os.open(directory, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        with contextlib.suppress(OSError):  # a network's file system may lock no folders
            fcntl.flock(handle, fcntl.LOCK_EX)
        yield
    finally:
        os.close(handle)


def _identity(path: Path) -> tuple[int, int] | None:
    """Tells the folder at ``path`` from any other, and from a link to it; None where there is nothing."""
    try:
        found = path.lstat()
    except OSError:
        return None
    return found.st_dev, found.st_ino


def _remove(path: Path) -> None:
    """Remove file, folder or link, never what a link leads to."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink()


def _command(request: Request, path: Path) -> list[str]:
    mission = request.mission
    if mission.function:
        return [sys.executable, "-P", str(_CALL), mission.function, str(path)]
    places = {"{request}": str(path), "{result}": str(request.result_path)}
    words = []
    for word in mission.command:
        for name, value in places.items():
            word = word.replace(name, value)
        words.append(word)
    return words if "{request}" in " ".join(mission.command) else [*words, str(path)]


def _how_it_ended(ended: Ended) -> str:
    if ended.status >= 0:
        return f"ended with status {ended.status}"
    known = {number.value: number.name for number in signal.Signals}
    return f"ended by {known.get(-ended.status, f'signal {-ended.status}')}"


def _last_words(log: Path) -> str:
    """The last line that it printed: most programs say there what was wrong."""
    try:
        lines = read_bytes(log, _LOG_BYTES, follow=False)[-_LAST_BYTES:].decode(errors="replace").split("\n")
    except UserError:  # the mission did something to it
        return ""
    said = ["".join(c for c in line if c.isprintable()).strip() for line in lines]
    return next((f": {line[:_LAST_LETTERS]!r}" for line in reversed(said) if line), "")


def tidy(request: Request, result: Result) -> None:
    """Leave of the mission's folder the request, the result, the log and the artefacts that the result names."""
    output = request.output.resolve()
    kept = {REQUEST_FILE, RESULT_FILE, LOG_FILE}
    for artefact in result.artefacts.values():
        for path in (Path(os.path.normpath(output / artefact)), (output / artefact).resolve()):
            if path.is_relative_to(output):
                kept.update(path.relative_to(output).parts[:1])
    for entry in output.iterdir():
        if entry.name not in kept:
            _remove(entry)


def require_no_fault_of_the_machine(result: Result) -> None:
    """`MissionFailure` that has the mission flown again, where the machine failed."""
    if result.failure is not None and result.failure.of == "machine":
        raise MissionFailure(f"machine_error: {result.failure.reason}", result.failure.message)
