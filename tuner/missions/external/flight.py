"""The fidelity ``external``: a mission of a mission file, flown and measured like one of ours."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from nbv.cache import Store
from nbv.errors import MissionFailure, UserError
from nbv.mission.function import Keep
from nbv.mission.result import MissionResult
from nbv.safe_files import read_bytes
from tuner.missions.external.configuration import ExternalConfig
from tuner.missions.external.contract import REQUEST_FILE, RESULT_FILE, Failure, Request, Result, read_result
from tuner.missions.external.process import LARGEST_LOG_BYTES, Ended, end_all, marked, run_command
from tuner.missions.external.scoring import mesh_sha256, score_cloud
from tuner.missions.external.slots import slots_of, take_slot

LOG_FILE = "mission.log"
OUTPUT = "output"  # of the mission, in its directory
UNTIDY = "untidy_end"
HARDLY_OVERLAP = "hardly_overlap"  # cloud and mesh
_CALL = Path(__file__).with_name("call.py")
_LAST_BYTES, _LAST_LETTERS = 4096, 160
_LOG_BYTES = 2 * LARGEST_LOG_BYTES


def run_external_mission(
    config: ExternalConfig, rock: str, replicate: int, directory: Path | None, /, *, keep: Keep = "summary"
) -> MissionResult:
    """Fly one mission of a mission file; ``rock`` is one of its instances.

    Raises
    ------
    MissionFailure
        ``machine_error: ...``: the machine's failure; the mission says nothing about the configuration.
    UserError
        The mission file has changed, its command cannot be run, or ``config`` is none of a mission file.
    """
    if not isinstance(config, ExternalConfig):
        raise UserError("the fidelity external flies missions of a mission file; name one with --mission")
    try:
        return _run(config, rock, replicate, directory, keep)
    except (UserError, MissionFailure):
        raise
    except Exception as error:  # whatever the program did to its files is no fault of the configuration
        full = isinstance(error, OSError) and error.errno in (errno.ENOSPC, errno.EDQUOT)
        raise MissionFailure(
            "disk_full" if full else "machine_error: contract", f"{type(error).__name__}: {error}"
        ) from error


def _run(
    config: ExternalConfig, rock: str, replicate: int, directory: Path | None, keep: Keep
) -> MissionResult:
    mission = config.mission
    wait_s = mission.time_limit_s + mission.stop_grace_s
    with contextlib.ExitStack() as stack:
        if directory is None:
            directory = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        slot = stack.enter_context(take_slot(mission, slots_of(mission), wait_s))
        output = (directory / OUTPUT).absolute()
        request = Request(mission, directory.name, config.values, rock, replicate, output, slot)
        flown = fly_request(request)
        ended, result = flown.ended, flown.result
        if result.failure is not None and result.failure.of == "machine":  # it is flown again
            raise MissionFailure(f"machine_error: {result.failure.reason}", result.failure.message)
        failure, metrics, warning = result.failure, dict(result.metrics), ""
        if failure is None and result.cloud is not None and mission.score is not None:
            try:
                scored, warning = score_cloud(mission, rock, output, result.cloud, Store())
                metrics |= scored
            except MissionFailure as error:
                if error.reason.startswith("machine_error"):
                    raise
                # Nothing left of the cloud: the configuration's.
                failure = Failure("configuration", error.reason, error.message)
        if failure is None and keep == "summary":
            tidy(request, result)
        provenance = {"mission_file": str(config.file), "revision": f"mission file {config.sha256[:12]}"}
        if sha256 := mesh_sha256(mission, rock):
            provenance["rock_sha256"] = sha256
    notes = [f"ended with status {ended.status}"] if ended.status else []
    notes += [f"{ended.left_behind} processes outlived it and were ended"] if ended.left_behind else []
    notes += [f"{ended.survived} processes could not be ended"] if ended.survived else []
    notes += [warning] if warning else []
    if failure is not None:
        metrics, notes, reason = {}, [failure.message], failure.reason
    else:
        reason = HARDLY_OVERLAP if warning else UNTIDY if notes else ""
    return MissionResult(
        status="failed" if failure is not None else "degraded" if notes else "ok",
        reason=reason,
        message="; ".join(notes),
        config_digest=config.digest(),
        rock=rock,
        replicate=replicate,
        metrics=metrics,
        trace=[],
        timings_s={},
        costs={**result.cost, "wall_s": ended.wall_s},
        provenance=provenance,
    )


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
