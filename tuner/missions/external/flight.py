"""The fidelity ``external``: a mission of a mission file, flown and measured like one of ours."""

from __future__ import annotations

import shutil
import signal
import tempfile
import time
from pathlib import Path
from typing import Any

import msgspec

from nbv.errors import MissionFailure, UserError
from nbv.mission.function import Keep
from nbv.mission.result import MissionResult
from tuner.missions.external.mission_file import ExternalConfig, MissionFile
from tuner.missions.external.program import (
    LOG_FILE,
    REQUEST_FILE,
    RESULT_FILE,
    Request,
    Result,
    read_result,
    run_program,
    seed_of,
)
from tuner.missions.external.scoring import score_cloud

OUTPUT = "output"  # the mission's own folder, in its directory
_LAST_BYTES, _LAST_LETTERS = 4096, 160


def run_external_mission(
    config: ExternalConfig, rock: str, replicate: int, directory: Path | None, /, *, keep: Keep = "summary"
) -> MissionResult:
    """Fly one mission of a mission file.

    Parameters
    ----------
    config
        The mission file and the parameters' values.
    rock
        One of its instances.
    replicate
        The number of the repetition, from 0; it decides the seed.
    directory
        Where request, result, log and the mission's own files go; None: a temporary folder.
    keep
        ``"summary"`` removes the mission's own files once it has been measured.

    Raises
    ------
    MissionFailure
        ``machine_error: ...``: the mission says nothing about the configuration and may be flown again.
    UserError
        The mission file has changed, its program cannot be run, or ``config`` is none of a mission file.
    """
    if not isinstance(config, ExternalConfig):
        raise UserError("the fidelity external flies missions of a mission file; name one with --mission")
    mission = config.mission
    provenance: dict[str, Any] = {
        "mission_file": config.mission_file,
        "revision": f"mission file {config.sha256[:12]}",
    }
    with tempfile.TemporaryDirectory() as temporary:
        output = (directory or Path(temporary)).absolute() / OUTPUT
        instance, seed = mission.instance(rock), seed_of(rock, replicate)
        request = Request(config.values, instance, replicate, seed, str(output))
        started = time.monotonic()
        result = _flown(mission, request)
        costs = {**result.costs, "wall_s": time.monotonic() - started}
        metrics, reason, message = dict(result.metrics), result.failure or "", ""
        if result.cloud and mission.score and not reason:
            try:
                scored, message, provenance["rock_sha256"] = score_cloud(mission, request, result.cloud)
                metrics |= scored
            except MissionFailure as error:
                if error.reason.startswith("machine_error"):
                    raise
                reason, message = error.reason, error.message  # nothing is left of the cloud
        if keep == "summary":
            _tidy(output)
    return MissionResult(
        status="failed" if reason else "degraded" if message else "ok",
        reason=reason or ("hardly_overlap" if message else ""),
        message=message,
        config_digest=config.digest(),
        rock=rock,
        replicate=replicate,
        metrics={} if reason else metrics,
        trace=[],
        timings_s={},
        costs=costs,
        provenance=provenance,
    )


def _flown(mission: MissionFile, request: Request) -> Result:
    """Run the program once. Without a result a time-out is the configuration's failure, anything else the machine's."""
    output = Path(request.output)
    shutil.rmtree(output, ignore_errors=True)
    output.mkdir(parents=True)
    (output / REQUEST_FILE).write_bytes(msgspec.json.format(msgspec.json.encode(request)))
    status = run_program(mission, request)
    try:
        return read_result(output / RESULT_FILE)
    except UserError as error:
        if status is None:
            return Result(failure="timeout")
        how = f"status {status}" if status >= 0 else signal.Signals(-status).name
        raise MissionFailure(
            "machine_error: no_result", f"{error}; it ended with {how}{_last_words(output / LOG_FILE)}"
        ) from error


def _last_words(log: Path) -> str:
    """Return the log's name and the last line that the program printed: most say there what was wrong."""
    lines = log.read_bytes()[-_LAST_BYTES:].decode(errors="replace").splitlines() if log.is_file() else []
    said = ["".join(c for c in line if c.isprintable()).strip() for line in lines]
    return next((f": {line[:_LAST_LETTERS]!r}" for line in reversed(said) if line), "") + f"; see {log}"


def _tidy(output: Path) -> None:
    """Remove what the mission wrote besides request, result and log."""
    for entry in output.iterdir():
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry, ignore_errors=True)
        elif entry.name not in (REQUEST_FILE, RESULT_FILE, LOG_FILE):
            entry.unlink()
