"""Missions as flat rows: a campaign's or an evaluation's, for a table elsewhere."""

from __future__ import annotations

import csv
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nbv.errors import UserError
from nbv.mission.result import json_ready
from nbv.mission.run_directory import write_atomic
from tuner.campaign.campaign import Campaign
from tuner.evaluation.flying import EvaluationRun

if TYPE_CHECKING:
    import pandas as pd

TABLES = ("csv", "json", "parquet")


def records_of(source: Campaign | EvaluationRun) -> list[dict[str, Any]]:
    """One row per mission.

    ``rock``, ``condition``, ``replicate``, ``status`` and so on; ``config.PATH`` of a campaign's tuned values or
    ``strategy`` of an evaluation; ``value`` (the campaign's metric, as measured); ``metrics.PATH`` and ``costs.NAME``.
    What a mission does not have is missing from its row. Lists, such as completeness by sector, are left out.
    """
    if isinstance(source, EvaluationRun):
        return [
            {
                "strategy": r.strategy,
                "rock": r.rock,
                "condition": r.condition,
                "replicate": r.replicate,
                "status": r.outcome.status,
                "reason": r.outcome.reason,
                "wall_s": r.outcome.wall_s,
                **_flat("metrics", r.outcome.metrics),
                **_flat("costs", r.outcome.costs),
            }
            for r in source.records
        ]
    return [
        {
            "trial": t.number,
            "state": t.state,
            "rock": t.rock,
            "condition": t.condition,
            "replicate": t.replicate,
            "status": t.status,
            "reason": t.reason,
            "phase": str(t.why.get("phase", "")),
            "value": t.raw,
            "wall_s": t.wall_s,
            "directory": t.directory,
            "config_digest": t.config_digest,
            **_flat("config", t.values),
            **_flat("metrics", t.metrics),
            **_flat("costs", t.costs),
        }
        for t in source.trials()
    ]


def frame_of(source: Campaign | EvaluationRun) -> pd.DataFrame:
    """`records_of` as a pandas frame; ``UserError`` where pandas is missing."""
    try:
        import pandas  # noqa: PLC0415  an extra
    except ImportError as error:
        raise UserError("a frame needs pandas; run: pip install 'gatetune[frames]'") from error
    return pandas.DataFrame(records_of(source))


def write_records(source: Campaign | EvaluationRun, path: Path, kind: str) -> Path:
    """Write `records_of` as one of `TABLES`; only ``parquet`` needs pandas.

    Raises
    ------
    UserError
        The kind is unknown, the file cannot be written, or a package is missing.
    """
    if kind not in TABLES:
        raise UserError(f"{kind!r} is no kind of table; choose from {', '.join(TABLES)}")
    try:
        if kind == "parquet":
            frame_of(source).to_parquet(path)
        elif kind == "json":
            write_atomic(path, json.dumps(json_ready(records_of(source)), indent=1) + "\n")
        else:
            _write_csv(path, records_of(source))
    except ImportError as error:
        raise UserError("parquet needs pyarrow; run: pip install 'gatetune[frames]'") from error
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}; choose another file") from error
    return path


def _write_csv(path: Path, records: Sequence[Mapping[str, Any]]) -> None:
    columns = list(dict.fromkeys(name for record in records for name in record))
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(records)


def _flat(prefix: str, tree: Mapping[str, Any]) -> dict[str, Any]:
    """Scalars of a tree by their path."""
    out: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            out |= _flat(f"{prefix}.{key}", value)
        elif value is None or isinstance(value, (str, int, float, bool)):
            out[f"{prefix}.{key}"] = value
    return out
