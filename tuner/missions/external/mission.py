"""The fidelity ``external``: a mission of a mission file, run and measured like a built-in one."""

from __future__ import annotations

import io
import shutil
import signal
import tempfile
import time
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import trimesh
from scipy.spatial import KDTree

from nbv.cache import Store
from nbv.config import preset
from nbv.errors import MissionFailure, UserError
from nbv.evaluation import evaluate_cloud
from nbv.geometry.frames import align_umeyama
from nbv.mission.function import Keep
from nbv.mission.result import MissionResult
from nbv.rocks import Rock, frame_of_file, load_rock
from nbv.safe_files import read_bytes, remove, write_atomic
from nbv.types import Floats, PointCloud
from tuner.missions.external.mission_file import ExternalConfig, MissionFile, Score
from tuner.missions.external.program import (
    LOG_FILE,
    REQUEST_FILE,
    RESULT_FILE,
    Cloud,
    Request,
    Result,
    numbers,
    read_result,
    run_program,
    seed_of,
)

OUTPUT = "output"  # the mission's own folder, in its directory
MAX_CLOUD_BYTES = 2 * 1024**3
_OVERLAP_SAMPLES = 20_000
_NEAR = 0.1  # of the mesh's height
_LEAST_OVERLAP = 0.1  # share of points
_LAST_BYTES, _LAST_LETTERS = 4096, 160


def run_external_mission(
    config: ExternalConfig, rock: str, replicate: int, directory: Path | None, /, *, keep: Keep = "summary"
) -> MissionResult:
    """Run one mission of a mission file; with ``keep`` ``"summary"`` its own files are removed once it has been measured.

    Raises `MissionFailure`: ``machine_error: ...``: the mission says nothing about the configuration and may be run
    again.

    Raises `UserError`: the mission file has changed, or its program cannot be run.
    """
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
        result = _run(mission, request)
        (metrics, others), (costs, no_costs) = numbers(result.metrics), numbers(result.costs, "costs.")
        costs["wall_s"] = time.monotonic() - started
        reason, message = result.failure or "", ""
        tunable = {path: value for path, value in others.items() if path in mission.directions} | no_costs
        if tunable and not reason:
            reason, message = "metric_not_a_number", "{} is {!r}".format(*next(iter(tunable.items())))
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


def _run(mission: MissionFile, request: Request) -> Result:
    """Run the program once. Without a result a time-out is the configuration's failure, anything else the machine's."""
    output = Path(request.output)
    remove(output)
    output.mkdir(parents=True)
    write_atomic(output / REQUEST_FILE, msgspec.json.format(msgspec.json.encode(request)))
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
            shutil.rmtree(entry, ignore_errors=True)  # what cannot be removed does not keep the rest
        elif entry.name not in (REQUEST_FILE, RESULT_FILE, LOG_FILE):
            entry.unlink()


def score_cloud(mission: MissionFile, request: Request, cloud: Cloud) -> tuple[dict[str, Any], str, str]:
    """Return a cloud's metrics against its instance's mesh, a warning where they hardly overlap, and the mesh's hash.

    With cameras the cloud is first aligned by the least-squares similarity from estimated to reported centres (Umeyama,
    PAMI 1991). It is then in the mesh's own frame and moved with the mesh to where `nbv.rocks.import_mesh` puts that, or
    there already (``frame: rock``).

    Raises `MissionFailure`: the cloud cannot be read (``machine_error``), aligned or measured.

    Raises `UserError`: there is no such mesh, or no such parameter.
    """
    mesh, score, store = request.instance["mesh"], mission.score or Score(), Store()
    file = mission.path.parent / mesh
    rock = load_rock(str(file) if file.is_file() else mesh, store)
    config = preset("campaign").with_values(score.set)
    points_m = _read_points(Path(request.output, cloud.path))
    if cameras := cloud.cameras.values():
        reported, estimated = ([getattr(c, name) for c in cameras] for name in ("reported", "estimated"))
        try:
            points_m = align_umeyama(np.array(reported), np.array(estimated)).apply(points_m)
        except ValueError as error:  # fewer than three, or all in one place
            raise MissionFailure("not_aligned", str(error)) from error
    if file.is_file() and score.frame == "mesh":
        points_m = frame_of_file(file).apply(points_m)
    warning = _hardly_overlap(points_m, rock, mesh)
    try:
        metrics = evaluate_cloud(PointCloud(points_m), rock, config, store).metrics
    except MissionFailure as error:
        raise MissionFailure(error.reason, "; ".join(filter(None, (error.message, warning)))) from error
    return metrics, warning, rock.sha256


def _hardly_overlap(points_m: Floats, rock: Rock, mesh: str) -> str:
    """Return a sentence where hardly any of the cloud (N, 3) is near the mesh, or of the mesh near the cloud."""
    cloud, surface = (some[:: max(1, len(some) // _OVERLAP_SAMPLES)] for some in (points_m, rock.vertices_m))
    reach_m = _NEAR * float(np.ptp(rock.vertices_m[:, 2]))
    near = [
        float(np.isfinite(KDTree(there).query(here, distance_upper_bound=reach_m)[0]).mean())
        for here, there in ((cloud, surface), (surface, cloud))
    ]
    if min(near) >= _LEAST_OVERLAP:
        return ""
    return (
        f"cloud and mesh hardly overlap: {100 * near[0]:.0f} % of the cloud is near {mesh}, {100 * near[1]:.0f} % of that near "
        "the cloud; put both into one frame (docs/how-to/your-mission.md)"
    )


def _read_points(path: Path) -> Floats:
    """Return the (N, 3) finite vertices of a PLY."""
    try:
        content = io.BytesIO(read_bytes(path, MAX_CLOUD_BYTES))
        points = np.asarray(trimesh.load(content, file_type="ply", process=False).vertices, dtype=float)
        points = points[np.isfinite(points).all(axis=1)]
    except Exception as error:  # a parser's own families of errors
        why = (
            str(error)
            if isinstance(error, UserError)
            else f"{path} is not a PLY file ({type(error).__name__})"
        )
        raise MissionFailure("machine_error: cloud_unreadable", why) from error
    if len(points) == 0:
        raise MissionFailure("cloud_empty", f"{path} has no points")
    return points
