"""One job, run in this process: its result or the reason why there is none is left in its directory."""

from __future__ import annotations

import contextlib
import errno
import traceback
from pathlib import Path
from typing import Any

from nbv.errors import MissionFailure, UserError
from nbv.mission.run_directory import RESULT
from nbv.plugins import error_text, failure_of
from nbv.safe_files import write_atomic
from tuner.missions.job import MissionJob, record_failure
from tuner.missions.registry import kind_on

_FULL = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}  # the last: a limit such as ulimit -f
_MACHINE_ERRORS = {
    errno.EACCES,
    errno.EPERM,
    errno.ENODEV,
    errno.ENXIO,
    errno.ETIMEDOUT,
    errno.EIO,
    errno.EMFILE,
    errno.ENFILE,
    errno.ENOMEM,
    errno.EAGAIN,
    errno.EROFS,
    errno.ESTALE,
}
EXIT_FAILED = 1
EXIT_NOT_WRITABLE = 74  # EX_IOERR: not even the error could be written


def run_job(tree: dict[str, Any]) -> int:
    """Run one mission and leave ``mission.json`` in its directory, also of one that failed; exit status."""
    directory = Path(tree["directory"])
    try:
        directory.mkdir(parents=True, exist_ok=True)
        job = _job(tree)
        result = kind_on(job.rock, job.fidelity)(
            job.config, job.rock, job.replicate, directory, keep=job.keep
        )
        if not (directory / RESULT).exists():
            write_atomic(directory / RESULT, result.to_json())
        return 0
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt) and failure_of(error) is None:
            raise
        failed = error
        reason, message = _reason(error)
    try:
        record_failure(tree, reason, message)
    except OSError:
        status = EXIT_NOT_WRITABLE
    else:
        status = EXIT_FAILED
    with contextlib.suppress(OSError):  # the log may lie on the same full disk
        traceback.print_exception(failed)
    return status


def _job(tree: dict[str, Any]) -> MissionJob:
    """The job; what its plug-ins raise while they are imported is their failure, also what they do not raise elsewhere."""
    try:
        return MissionJob.from_dict(tree)
    except BaseException as error:
        if not tree["planners"]:
            raise
        message = str(error) if isinstance(error, UserError) else error_text(error)
        raise MissionFailure("plugin_failed", message) from error


def _reason(error: BaseException) -> tuple[str, str]:
    if (ended := failure_of(error)) is not None:
        return ended.reason, ended.message
    if isinstance(error, UserError):
        return "user_error", str(error)
    if isinstance(error, MissionFailure):
        return error.reason, error.message
    if isinstance(error, MemoryError):
        return "out_of_memory", "the mission ran out of memory"
    if isinstance(error, OSError):
        code = errno.errorcode.get(error.errno or 0, "unknown")
        kind = "machine_error" if error.errno in _MACHINE_ERRORS else "os_error"
        return "disk_full" if error.errno in _FULL else f"{kind}: {code}", str(error)
    return "mission_error", f"{type(error).__name__}: {error}"
