"""One job, flown in this process: its result or the reason why there is none is left in its directory."""

from __future__ import annotations

import errno
import traceback
from typing import Any

from nbv.errors import MissionFailure, UserError
from nbv.mission.run_directory import write_atomic
from tuner.missions.job import RESULT_FILE, MissionJob, record_failure
from tuner.missions.now import log_of
from tuner.missions.registry import resolve_runner

_FULL = {errno.ENOSPC, errno.EDQUOT}
_MACHINE_ERRORS = {
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
    """Fly one mission and leave ``mission.json``, or ``worker_error.json``, in its directory; exit status."""
    job = MissionJob.from_dict(tree)
    directory = job.directory
    try:
        directory.mkdir(parents=True, exist_ok=True)
        runner, now = resolve_runner(job.runner), log_of(job.runner, directory)
        options = {} if now is None else {"log": now}
        try:
            result = runner(job.config, job.rock, job.replicate, directory, keep=job.keep, **options)
        finally:
            if now is not None:
                now.end()
        if not (directory / RESULT_FILE).exists():
            write_atomic(directory / RESULT_FILE, result.to_json())
        return 0
    except KeyboardInterrupt:
        raise
    except UserError as error:
        reason, message = "user_error", str(error)
    except MissionFailure as error:
        reason, message = error.reason, error.message
    except MemoryError:
        reason, message = "out_of_memory", "the mission ran out of memory"
    except OSError as error:
        code = errno.errorcode.get(error.errno or 0, "unknown")
        kind = "machine_error" if error.errno in _MACHINE_ERRORS else "os_error"
        reason, message = "disk_full" if error.errno in _FULL else f"{kind}: {code}", str(error)
    except BaseException as error:
        reason, message = "mission_error", f"{type(error).__name__}: {error}"
    traceback.print_exc()
    try:
        record_failure(job, reason, message)
    except OSError:
        traceback.print_exc()
        return EXIT_NOT_WRITABLE
    return EXIT_FAILED
