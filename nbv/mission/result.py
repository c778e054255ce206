"""The outcome of a mission: one JSON document with a versioned schema."""

from __future__ import annotations

import dataclasses
import json
import math
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any, Literal, get_args

from nbv.checksums import CHECKSUM, require_checksum, with_checksum
from nbv.config import IDEAL
from nbv.errors import UserError
from nbv.safe_files import RESULT_BYTES, RESULT_NODES, parse_json, read_text

SCHEMA_VERSION = 1

Status = Literal["ok", "degraded", "failed"]


@dataclass(frozen=True)
class IterationRecord:
    """What happened at one adaptive capture."""

    iteration: int  # 0 is the first adaptive capture
    pool_size: int
    pool_counts: dict[str, int]  # survivors after each filter
    d95_m: float  # before this capture
    n_points: int  # sparse points before this capture
    n_registered: int  # registered images before this capture
    alignment_rms_m: float
    scorer: str  # whose ranking was flown
    reason: str  # the gate's
    gate_details: dict[str, Any]
    oracle_rewards: dict[
        str, float
    ]  # of both scorers' best candidates; simulation only, no gate but the oracles sees it
    features: dict[str, float]  # what a learned gate would read
    top: dict[str, dict[str, float | str]]  # per scorer: its best candidate with score and terms
    chosen: str  # candidate id
    registered: bool  # did the new image register
    message: str
    leg_duration_s: float
    leg_length_m: float
    update_s: float  # wall time of the sparse update
    planning_s: float  # wall time of pool, scorers and gate


@dataclass(frozen=True)
class MissionResult:
    """What one mission returns and leaves behind as ``mission.json``.

    ``status`` is ``ok``; ``degraded`` (metrics exist but something went wrong on the way: images that
    did not register, an empty pool, ...); or ``failed`` (no metrics; ``reason`` says why).
    """

    status: Status
    reason: str  # empty when ok; otherwise a snake_case code
    message: str
    config_digest: str
    rock: str
    replicate: int
    metrics: dict[str, Any]  # {"whole": {...}, "observable": {...}, ...}; empty when failed
    trace: list[IterationRecord]
    timings_s: dict[str, float]
    costs: dict[str, float]  # images, registered_images, flight_time_s, path_length_m, energy_wh, wall_s
    provenance: dict[str, Any] = field(default_factory=dict)
    condition: str = IDEAL
    schema_version: int = SCHEMA_VERSION

    def __repr__(self) -> str:
        """``MissionResult(ok on slab r0: 26 images, 8 of them planned)``."""
        images = self.costs.get("images")
        done = self.reason if images is None else f"{images:.0f} images, {len(self.trace)} of them planned"
        return f"MissionResult({self.status} on {self.rock} r{self.replicate}: {done})"

    def metric(self, path: str) -> float:
        """The metric at a dotted path such as ``observable.f_score_48mm`` or ``registered.observable.f_score_48mm``.

        Where telemetry is exact nothing is registered: the cloud is where it belongs, and ``registered.X`` is ``X``.

        Raises
        ------
        UserError
            There is no such metric.
        """
        node: Any = self.metrics
        parts = path.split(".")
        if parts[0] == "registered" and "registered" not in node:
            parts = parts[1:]
        for part in parts:
            if not isinstance(node, dict) or part not in node:
                raise UserError(f"unknown metric {path!r}; mission.json lists the metrics by name")
            node = node[part]
        if not isinstance(node, (int, float)):
            raise UserError(f"metric {path!r} is not a number; name one of {', '.join(node)}")
        return float(node)

    def to_json(self) -> str:
        """JSON text with a checksum; non-finite numbers become null."""
        return json.dumps(with_checksum(json_ready(asdict(self))), indent=1)

    @staticmethod
    def from_json(text: str, source: str = "the mission result") -> MissionResult:
        """Parse ``to_json``'s text; ``source`` names it in messages.

        Raises
        ------
        UserError
            Not a mission result, one of another schema version, or changed since it was written.
        """
        try:
            tree = parse_json(text, source, RESULT_NODES)
            require_checksum(tree, source)
            tree.pop(CHECKSUM, None)
            if tree["schema_version"] != SCHEMA_VERSION:
                raise UserError(
                    f"mission result has schema version {tree['schema_version']}, this version reads {SCHEMA_VERSION}"
                )
            for record in tree["trace"]:
                require_kinds(record, IterationRecord)
            require_kinds(tree, MissionResult)
            if tree["status"] not in get_args(Status):
                raise ValueError(f"status is {str(tree['status'])[:40]!r}")
            return MissionResult(**{**tree, "trace": [IterationRecord(**record) for record in tree["trace"]]})
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise UserError(f"{source} is not a mission result: {error}") from error

    @staticmethod
    def load(path: Path) -> MissionResult:
        """Read ``mission.json`` (a directory stands for the file in it)."""
        file = path / "mission.json" if path.is_dir() else path
        if not file.is_file():
            raise UserError(f"{path} holds no mission.json; name a mission directory")
        return MissionResult.from_json(read_text(file, RESULT_BYTES), str(file))


_KINDS: dict[str, tuple[type, ...]] = {
    "bool": (bool,),
    "dict": (dict,),
    "float": (int, float, type(None)),  # null: not finite
    "int": (int,),
    "list": (list,),
    "str": (str,),
}


def require_kinds(tree: Any, kind: type) -> None:
    """``TypeError`` where a value is not of its field's kind, or a value of ``dict[str, float]`` is no number."""
    if not isinstance(tree, dict):
        raise TypeError(f"{str(tree)[:40]!r} is not an object")
    for one in fields(kind):
        outer, _, inner = str(one.type).partition("[")
        value = tree.get(one.name)
        of_values = _KINDS.get(inner.removeprefix("str, ").partition("[")[0].rstrip("]"), (object,))
        values = value.values() if isinstance(value, dict) else ()
        if one.name in tree and not (
            isinstance(value, _KINDS.get(outer, (str,))) and all(isinstance(v, of_values) for v in values)
        ):
            raise TypeError(f"{one.name} is {str(value)[:40]!r}, not {one.type}")


def json_ready(value: Any) -> Any:
    """``value`` with non-finite numbers as None, numpy scalars as plain ones, dataclasses as dicts, paths as text, at any depth."""
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, dict):
        return {key: json_ready(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [json_ready(item) for item in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {f.name: json_ready(getattr(value, f.name)) for f in dataclasses.fields(value)}
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "item") and getattr(value, "ndim", None) == 0:  # numpy scalar
        return json_ready(value.item())
    return value
