"""Missions as flat rows: a campaign's or an evaluation's, for a table elsewhere."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from nbv.errors import UserError
from nbv.safe_files import printable, write_atomic
from tuner.campaign.campaign import Campaign
from tuner.comparison.run import EvaluationRun
from tuner.missions.job import Trial


def records_of(source: Campaign | EvaluationRun) -> list[dict[str, Any]]:
    """One row per mission.

    ``rock``, ``condition``, ``replicate``, ``status`` and so on; ``config.PATH`` of a campaign's tuned values or
    ``strategy`` of an evaluation; ``value`` (the campaign's metric, as measured); ``metrics.PATH`` and ``costs.NAME``.
    What a mission does not have is missing from its row. Lists, such as completeness by sector, are left out.
    """
    if isinstance(source, EvaluationRun):
        named = [({"strategy": t.strategy}, t) for t in source.records]
    else:
        named = [(_of_campaign(t, source.directory), t) for t in source.trials()]
    return [
        {
            **label,
            "rock": t.rock,
            "condition": t.condition,
            "replicate": t.replicate,
            "status": t.record.status,
            "reason": t.reason,
            "wall_s": t.record.wall_s,
            **_flat("metrics", t.metrics),
            **_flat("costs", t.costs),
        }
        for label, t in named
    ]


def _of_campaign(t: Trial, run: Path) -> dict[str, Any]:
    return {
        "trial": t.number,
        "state": t.state,
        "phase": str(t.record.metadata.get("phase", "")),
        "value": t.raw,
        "directory": str(t.record.directory.relative_to(run)),
        "config_digest": t.record.config_digest,
        **_flat("config", t.values),
    }


def write_csv(source: Campaign | EvaluationRun, path: Path) -> Path:
    """Write `records_of` as a table; ``UserError`` if the file cannot be written."""
    records = records_of(source)
    columns = list(dict.fromkeys(name for record in records for name in record))
    return write_rows(path, columns, ([record.get(name) for name in columns] for record in records))


def write_rows(
    path: Path, head: Sequence[str], rows: Iterable[Sequence[Any]], digits: int | None = None
) -> Path:
    """Write a table as CSV, fractions with so many ``digits``; ``UserError`` if the file cannot be written."""
    file = io.StringIO(newline="")
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(head)
    for row in rows:
        writer.writerow([c if digits is None or not isinstance(c, float) else f"{c:.{digits}f}" for c in row])
    try:
        write_atomic(path, printable(file.getvalue()))
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}; choose another file") from error
    return path


def _flat(prefix: str, tree: Mapping[str, Any]) -> dict[str, Any]:
    out: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            out |= _flat(f"{prefix}.{key}", value)
        elif value is None or isinstance(value, (str, int, float, bool)):
            out[f"{prefix}.{key}"] = value
    return out
