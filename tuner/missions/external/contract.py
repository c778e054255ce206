"""The two documents that pass between gatetune and a mission that is not ours: request in, result out."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from nbv.errors import UserError
from nbv.mission.run_directory import write_atomic
from nbv.safe_files import RESULT_NODES, parse_json, read_text
from tuner.missions.external.checking import check, schema
from tuner.missions.external.mission_file import MissionFile, variable_of
from tuner.missions.external.slots import Slot

REQUEST_FILE, RESULT_FILE = "request.json", "result.json"
_LARGEST_RESULT_BYTES = 10_000_000


@dataclass(frozen=True)
class Request:
    """One mission to fly."""

    mission: MissionFile
    id: str
    configuration: Mapping[str, Any]
    instance: str
    replicate: int
    output: Path  # absolute
    slot: Slot
    check: str = ""  # "fail" asks the mission to report a failure of the configuration

    @property
    def result_path(self) -> Path:
        """Where the mission leaves its result."""
        return self.output / RESULT_FILE

    def to_dict(self) -> dict[str, Any]:
        """As ``request.json`` has it; fits the published schema."""
        return {
            "schema": schema("request")["properties"]["schema"]["const"],
            "mission": self.mission.name,
            "id": self.id,
            "configuration": dict(self.configuration),
            "instance": self.mission.instance(self.instance).to_dict(),
            "replicate": self.replicate,
            "seed": seed_of(self.instance, self.replicate),
            "output": str(self.output),
            "result": str(self.result_path),
            "time_limit_s": self.mission.time_limit_s,
            "slot": self.slot.number,
            "resources": dict(self.slot.resources),
            **({"check": self.check} if self.check else {}),
        }

    def environment(self) -> dict[str, str]:
        """What a mission that reads no JSON needs: ``GATETUNE_RESULT`` and the like, ``PARAMETER_name``, resources."""
        tree = self.to_dict()
        facts = {
            "REQUEST": str(self.output / REQUEST_FILE),
            "RESULT": tree["result"],
            "OUTPUT": tree["output"],
            "INSTANCE": self.instance,
            "REPLICATE": str(self.replicate),
            "SEED": str(tree["seed"]),
            "CHECK": self.check,
        }
        return {
            **{f"GATETUNE_{name}": value for name, value in facts.items()},
            **{variable_of(name): str(value) for name, value in self.configuration.items()},
            **self.slot.environment(),
        }

    def write(self) -> Path:
        """Leave ``request.json`` in the output folder, and no result of an earlier attempt."""
        self.output.mkdir(parents=True, exist_ok=True)
        self.result_path.unlink(missing_ok=True)
        path = self.output / REQUEST_FILE
        write_atomic(path, json.dumps(self.to_dict(), indent=1))
        return path


def seed_of(instance: str, replicate: int) -> int:
    """31 bits that depend on instance and replicate alone: two configurations meet the same noise."""
    digest = hashlib.sha256(json.dumps([instance, replicate]).encode()).digest()
    return int.from_bytes(digest[:4], "big") >> 1


@dataclass(frozen=True)
class Failure:
    """Why a mission has no metrics, and whose fault that is."""

    of: Literal["configuration", "machine"]  # infeasible, or to be flown again
    reason: str
    message: str = ""


@dataclass(frozen=True)
class Result:
    """A checked ``result.json``."""

    metrics: dict[str, Any] = field(default_factory=dict)
    cost: dict[str, float] = field(default_factory=dict)
    artefacts: dict[str, str] = field(default_factory=dict)
    cloud: dict[str, Any] | None = None
    failure: Failure | None = None


def read_result(path: Path) -> Result:
    """Read and check what a mission left.

    Raises
    ------
    UserError
        Missing, half written, against the schema, of a newer version, a number that is not finite, a file outside the
        mission's own folder: one line.
    """
    if not os.path.lexists(path):
        raise UserError(f"no {path.name}")
    text = read_text(path, _LARGEST_RESULT_BYTES, follow=False)
    if not text.strip():
        raise UserError(f"{path.name} is empty; write it under another name, then rename it")
    tree = parse_json(text, path.name, RESULT_NODES, finite=True)
    check(tree, "result", path.name)
    for name, value in _numbers(tree.get("metrics", {}), "metrics"):
        if not math.isfinite(value):  # 1e999
            raise UserError(f"{path.name}: {name} is not a finite number")
    inside = [*tree.get("artefacts", {}).items()]
    if "cloud" in tree:
        inside.append(("cloud.path", tree["cloud"]["path"]))
    for name, relative in inside:
        if not _is_inside(path.parent, relative):
            raise UserError(f"{path.name}: {name} is {relative!r}, no file in the mission's own folder")
    failure = tree.get("failure")
    return Result(
        tree.get("metrics", {}),
        {name: float(value) for name, value in tree.get("cost", {}).items()},
        tree.get("artefacts", {}),
        tree.get("cloud"),
        Failure(failure["of"], failure["reason"], failure.get("message", "")) if failure else None,
    )


def _is_inside(folder: Path, relative: str) -> bool:
    try:
        place = (folder / relative).resolve()
    except (OSError, ValueError, RuntimeError):  # a loop of links, a zero byte
        return False
    return folder.resolve() in place.parents


def _numbers(tree: Mapping[str, Any], prefix: str) -> Iterator[tuple[str, float]]:
    for key, value in tree.items():
        if isinstance(value, Mapping):
            yield from _numbers(value, f"{prefix}.{key}")
        elif isinstance(value, (int, float)) and not isinstance(value, bool):
            yield f"{prefix}.{key}", float(value)
