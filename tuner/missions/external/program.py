"""The program of an own mission: a request goes in, a result comes out; it has a time limit, and leaves no process behind."""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, BinaryIO

import msgspec

from nbv.convert import converted
from nbv.errors import UserError
from nbv.safe_files import RESULT_NODES, open_to_write, parse_json, read_text
from tuner.missions.external.mission_file import MissionFile
from tuner.missions.keeper import adopt_orphans, children_of, end_children

LOG_FILE = "mission.log"
KEPT_BYTES = 500_000
GRACE_S = 5.0  # from SIGTERM to SIGKILL
_CALL = Path(__file__).with_name("call.py")
REQUEST_FILE, RESULT_FILE = "request.json", "result.json"
_LARGEST_RESULT_BYTES = 10_000_000
_Point = tuple[float, float, float]


def run_program(mission: MissionFile, request: Request) -> int | None:
    """Run the mission's program until it ends or its time is over (None, else its exit status), then end what it started.

    Raises `UserError`: the program does not exist or may not be run.
    """
    environment = {
        **os.environ,
        "GATETUNE_OUTPUT": request.output,
        "GATETUNE_INSTANCE": request.instance["name"],
        "GATETUNE_SEED": str(request.seed),
        **{f"PARAMETER_{name}": str(value) for name, value in request.configuration.items()},
    }
    command = list(mission.command)
    if mission.function:
        command = [sys.executable, "-P", str(_CALL), mission.function]
        paths = (str(mission.path.parent), os.environ.get("PYTHONPATH", ""))
        environment["PYTHONPATH"] = os.pathsep.join(path for path in paths if path)
    command.append(f"{request.output}/{REQUEST_FILE}")
    adopt_orphans()
    before = frozenset(children_of(os.getpid()))
    with open_to_write(Path(request.output, LOG_FILE)) as log:
        try:
            process = subprocess.Popen(
                command,
                cwd=mission.path.parent,
                env=environment,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        except (OSError, ValueError) as error:
            raise UserError(
                f"{mission.path}: cannot run {command[0]!r} ({error}); correct 'command'"
            ) from error
        try:
            return process.wait(mission.time_limit_s)
        except subprocess.TimeoutExpired:
            process.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(GRACE_S)
            return None
        finally:
            end_children(before)
            _shorten_log(log)


def _shorten_log(log: BinaryIO) -> None:
    """Leave the beginning and the end of what a program printed, `KEPT_BYTES` each."""
    with Path(f"/proc/self/fd/{log.fileno()}").open("rb") as printed:  # whatever the program made of its name
        left_out = printed.seek(0, os.SEEK_END) - 2 * KEPT_BYTES
        if left_out > 0:
            printed.seek(-KEPT_BYTES, os.SEEK_END)
            end = printed.read()
            log.truncate(KEPT_BYTES)
            log.seek(KEPT_BYTES)
            log.write(b"\n[%d bytes left out]\n" % left_out + end)


class Request(msgspec.Struct, frozen=True):
    """The content of ``request.json``: one mission to run."""

    configuration: Mapping[str, Any]  # every parameter with its value
    instance: Mapping[str, Any]  # its name, and what the mission file says of it
    replicate: int
    seed: int
    output: str  # absolute path of the mission's own folder


def seed_of(instance: str, replicate: int) -> int:
    """Return 31 bits of instance and replicate alone: two configurations meet the same noise."""
    digest = hashlib.sha256(json.dumps([instance, replicate]).encode()).digest()
    return int.from_bytes(digest[:4], "big") >> 1


class Camera(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The centre of a photograph's camera."""

    estimated: _Point  # in the cloud's frame
    reported: _Point  # by telemetry, in metres


class Cloud(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A dense cloud to measure."""

    path: str  # of a PLY in the output folder
    cameras: dict[str, Camera] = {}  # by photograph; they align the cloud


class Result(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The content of ``result.json``: metrics, a cloud, or why the configuration fails."""

    metrics: dict[str, Any] = {}  # numbers, or groups of them; what is none is told by `numbers`
    costs: dict[str, Any] = {}
    cloud: Cloud | None = None
    failure: Annotated[str, msgspec.Meta(min_length=1)] | None = None


def read_result(path: Path) -> Result:
    """Read what a mission left; `UserError` in one line where that is missing, half written or no result."""
    if not path.exists():
        raise UserError(f"no {path.name}")
    text = read_text(path, _LARGEST_RESULT_BYTES)
    result = converted(parse_json(text, path.name, RESULT_NODES), Result, path.name)
    if not (result.metrics or result.cloud or result.failure):
        raise UserError(f"{path.name} needs metrics, cloud or failure")
    return result


def numbers(tree: Mapping[str, Any], prefix: str = "") -> tuple[dict[str, Any], dict[str, Any]]:
    """Return the finite numbers of metrics or costs, in their groups, and by its path whatever is none."""
    values: dict[str, Any] = {}
    others: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, dict):
            values[name], inside = numbers(value, f"{prefix}{name}.")
            others |= inside
        elif (
            isinstance(value, (int, float))
            and not isinstance(value, bool)
            and abs(value) <= sys.float_info.max
        ):
            values[name] = float(value)
        else:
            others[f"{prefix}{name}"] = value
    return values, others
