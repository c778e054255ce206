"""The two documents between gatetune and an own mission: a request goes in, a result comes out."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec

from nbv.errors import UserError
from nbv.safe_files import read_bytes

REQUEST_FILE, RESULT_FILE = "request.json", "result.json"
_LARGEST_RESULT_BYTES = 10_000_000
_Point = tuple[float, float, float]


class Request(msgspec.Struct, frozen=True):
    """The content of ``request.json``: one mission to fly."""

    configuration: Mapping[str, Any]  # every parameter with its value
    instance: Mapping[str, Any]  # its name, and what the mission file says of it
    replicate: int
    seed: int
    output: str  # absolute path of the mission's own folder

    def environment(self) -> dict[str, str]:
        """Return the same for a program that reads no JSON."""
        return {
            "GATETUNE_REQUEST": f"{self.output}/{REQUEST_FILE}",
            "GATETUNE_OUTPUT": self.output,
            "GATETUNE_INSTANCE": self.instance["name"],
            "GATETUNE_REPLICATE": str(self.replicate),
            "GATETUNE_SEED": str(self.seed),
            **{f"PARAMETER_{name}": str(value) for name, value in self.configuration.items()},
        }


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

    metrics: dict[str, float | dict[str, float]] = {}
    costs: dict[str, float] = {}
    cloud: Cloud | None = None
    failure: Annotated[str, msgspec.Meta(min_length=1)] | None = None


def read_result(path: Path) -> Result:
    """Read and check what a mission left.

    Raises
    ------
    UserError
        The file is missing, half written, or holds something else than a result; one line says what.
    """
    if not path.exists():
        raise UserError(f"no {path.name}")
    try:
        result = msgspec.json.decode(read_bytes(path, _LARGEST_RESULT_BYTES), type=Result)
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise UserError(f"{path.name}: {error}") from error
    if not (result.metrics or result.cloud or result.failure):
        raise UserError(f"{path.name} needs metrics, cloud or failure")
    return result
