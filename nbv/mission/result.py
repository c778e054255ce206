"""The outcome of a mission: one JSON document with a versioned schema."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Protocol

import msgspec

from nbv.config import IDEAL, MissionConfig
from nbv.errors import UserError
from nbv.mission.run_directory import RESULT, read_result
from nbv.safe_files import json_ready

SCHEMA_VERSION = 1

Status = Literal["ok", "degraded", "failed"]
if TYPE_CHECKING:
    Number = float
else:
    Number = float | None  # as read: null is what was not finite


@dataclass(frozen=True)
class IterationRecord:
    iteration: int  # 0 is the first adaptive capture
    pool_counts: dict[str, int]  # survivors after each filter
    d95_m: Number  # before this capture
    n_points: int  # sparse points before this capture
    n_registered: int  # registered images before this capture
    alignment_rms_m: Number
    scorer: str  # whose ranking was used
    reason: str  # the gate's
    gate_details: dict[str, Any]
    top: dict[str, dict[str, Number | str]]  # per scorer: its best candidate with score and terms
    chosen: str  # candidate id
    registered: bool  # did the new image register
    message: str


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
    timings_s: dict[str, Number]
    costs: dict[str, Number]  # images, registered_images, flight_time_s, path_length_m, energy_wh, wall_s
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

        As `value_at_path`; `UserError` where there is no such metric.
        """
        value = value_at_path(self.metrics, path)
        if isinstance(value, dict):
            raise UserError(f"metric {path!r} is not a number; name one of {', '.join(value)}")
        if not isinstance(value, (int, float)):
            raise UserError(f"unknown metric {path!r}; mission.json lists the metrics by name")
        return float(value)

    def to_json(self) -> str:
        """JSON text; non-finite numbers become null."""
        return json.dumps(json_ready(self), indent=1)

    @staticmethod
    def load(run: str | Path) -> MissionResult:
        """What the mission in the directory ``run`` left.

        `UserError` for what is no mission result, or one of another schema version.
        """
        run = Path(run)
        if not (run / RESULT).is_file():
            raise UserError(f"{run} holds no {RESULT}; name the directory of a finished mission")
        tree = read_result(run)
        try:
            if tree["schema_version"] != SCHEMA_VERSION:
                raise UserError(
                    f"mission result has schema version {tree['schema_version']}, this version reads {SCHEMA_VERSION}"
                )
            return msgspec.convert(tree, MissionResult)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise UserError(f"{run / RESULT} is not a mission result: {error}") from error


def value_at_path(metrics: Mapping[str, Any], path: str) -> Any:
    """What lies at a dotted path in a mission's metrics; None where there is nothing.

    Where telemetry is right to centimetres nothing is registered: the cloud is where it belongs, and ``registered.X`` is ``X``.
    """
    value: Any = metrics
    for part in path.removeprefix("" if "registered" in metrics else "registered.").split("."):
        value = value.get(part) if isinstance(value, Mapping) else None
    return value


# Functions that run whole missions: the signature that all fidelities share, photogrammetric, geometric and others.


Keep = Literal["all", "summary"]
Log = Callable[[str], None]  # is given a line of text for what a mission has found or chosen


def no_log(line: str) -> None:
    """Ignore the line."""


class MissionFunction(Protocol):
    """A function that runs one mission and measures it; it may take further options.

    The result is a function of (config, rock, replicate): whatever is drawn at random is keyed by these. ``rock`` is a catalogue
    name or the path of a mesh, ``replicate`` the index of the draws. Into ``directory`` the run directory is written, nothing for
    None; of it ``keep`` ``"summary"`` leaves the configuration and ``mission.json``. The result of a mission that failed says so.
    `UserError` for an unknown rock, a bad mesh, an unwritable directory, a missing backend.
    """

    def __call__(
        self, config: MissionConfig, rock: str, replicate: int, directory: Path | None, /, *, keep: Keep
    ) -> MissionResult: ...
