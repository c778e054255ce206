"""Tables as CSV files: the missions of a campaign or an evaluation, one a row, and those of other reports."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from nbv.errors import UserError
from nbv.safe_files import write_atomic
from tuner.campaign.campaign import Campaign
from tuner.comparison.plan import EvaluationRun
from tuner.missions.job import Trial
from tuner.problem.goal import by_dotted_path

_FORMULA = ("=", "+", "-", "@", "\t", "\r")  # with which a spreadsheet takes a text for a formula


def write_missions(source: Campaign | EvaluationRun, path: Path) -> Path:
    """Write one row per mission; ``UserError`` if the file cannot be written.

    Columns are ``rock``, ``condition``, ``replicate``, ``status`` and so on; ``config.PATH`` of a campaign's tuned values or
    ``strategy`` of an evaluation; ``value`` (the campaign's metric, as measured); ``metrics.PATH`` and ``costs.NAME``.
    What a mission does not have is empty in its row. Lists, such as completeness by sector, are left out.
    """
    if isinstance(source, EvaluationRun):
        rows = [_row(t, {"strategy": t.strategy}) for t in source.records]
    else:
        rows = [_row(t, _of_campaign(t, source.directory)) for t in source.trials()]
    columns = list(dict.fromkeys(name for row in rows for name in row))
    return write_rows(path, columns, ([row.get(name) for name in columns] for row in rows))


def _row(t: Trial, label: Mapping[str, Any]) -> dict[str, Any]:
    return {
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


def _flat(prefix: str, tree: Mapping[str, Any]) -> dict[str, Any]:
    """Return the leaves of a tree, whose names may be paths themselves, without lists."""
    leaves = by_dotted_path(tree, f"{prefix}.")
    return {path: v for path, v in leaves.items() if v is None or isinstance(v, (str, int, float, bool))}


def write_rows(
    path: Path, head: Sequence[str], rows: Iterable[Sequence[Any]], digits: int | None = None
) -> Path:
    """Write a table as CSV, fractions with so many ``digits``; ``UserError`` if the file cannot be written.

    A text that a spreadsheet would take for a formula gets an apostrophe before it.
    """
    file = io.StringIO(newline="")
    writer = csv.writer(file, lineterminator="\n")
    for row in (head, *rows):
        writer.writerow([_cell(value, digits) for value in row])
    try:
        write_atomic(path, file.getvalue())
    except OSError as error:
        raise UserError(f"cannot write {path}: {error.strerror}; choose another file") from error
    return path


def _cell(value: Any, digits: int | None) -> Any:
    if isinstance(value, str) and value.startswith(_FORMULA):
        return f"'{value}"
    return f"{value:.{digits}f}" if digits is not None and isinstance(value, float) else value
