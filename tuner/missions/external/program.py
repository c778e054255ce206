"""The program of an own mission: it has a time limit, and leaves no process behind."""

from __future__ import annotations

import contextlib
import ctypes
import os
import subprocess
import sys
from collections.abc import Iterable
from pathlib import Path

import psutil

from nbv.errors import UserError
from tuner.missions.external.contract import REQUEST_FILE, Request
from tuner.missions.external.mission_file import MissionFile

LOG_FILE = "mission.log"
GRACE_S = 5.0  # from SIGTERM to SIGKILL
_CALL = Path(__file__).with_name("call.py")


def run_program(mission: MissionFile, request: Request) -> int | None:
    """Run the mission's program until it ends or its time is over, then end every process that it started.

    Returns its exit status, negative where a signal ended it; None where its time was over. What it prints goes to
    `LOG_FILE` in the output folder.

    Raises
    ------
    UserError
        The program does not exist or may not be run.
    """
    command, environment = list(mission.command), {**os.environ, **request.environment()}
    if mission.function:
        command = [sys.executable, "-P", str(_CALL), mission.function]
        paths = (str(mission.folder), os.environ.get("PYTHONPATH", ""))
        environment["PYTHONPATH"] = os.pathsep.join(path for path in paths if path)
    command.append(f"{request.output}/{REQUEST_FILE}")
    adopt_orphans()
    before = _below()
    with Path(request.output, LOG_FILE).open("wb") as log:
        try:
            process = subprocess.Popen(
                command,
                cwd=mission.folder,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        except (OSError, ValueError) as error:
            raise UserError(f"{mission.path}: cannot run {command[0]!r} ({error}); mend 'command'") from error
        try:
            return process.wait(mission.time_limit_s)
        except subprocess.TimeoutExpired:
            return None
        finally:
            _end(_below() - before)


def adopt_orphans() -> None:
    """Ask Linux to make this process the parent of what its descendants leave behind, daemons included."""
    ctypes.CDLL(None).prctl(36, 1, 0, 0, 0)  # PR_SET_CHILD_SUBREAPER


def _below() -> set[psutil.Process]:
    return set(psutil.Process().children(recursive=True))


def _end(processes: Iterable[psutil.Process]) -> None:
    for stop in (psutil.Process.terminate, psutil.Process.kill):
        for process in processes:
            with contextlib.suppress(psutil.Error):  # it has ended, or belongs to another user
                stop(process)
        _, processes = psutil.wait_procs(processes, timeout=GRACE_S)
