"""What a study leaves: its numbers as JSON, and a table with a few words in markdown and on the terminal."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rich.table import Table

from nbv.mission.result import json_ready
from nbv.safe_files import write_atomic


def write_study(
    stem: Path,
    result: Any,
    title: str,
    lead: str,
    columns: Sequence[str],
    rows: Sequence[Sequence[str]],
    notes: str,
) -> Path:
    """Write ``STEM.json`` and ``STEM.md``; the path of the latter.

    Parameters
    ----------
    stem
        Both files without their endings; the folder is made.
    result
        What becomes JSON.
    title, lead, notes
        Of the report: its heading, what stands above the table, and what below.
    columns, rows
        The table; the first column is flush left.
    """
    stem.parent.mkdir(parents=True, exist_ok=True)
    write_atomic(stem.with_suffix(".json"), json.dumps(json_ready(result), indent=1))
    table = ["| " + " | ".join(row) + " |" for row in (columns, *rows)]
    table.insert(1, "|---|" + "---:|" * (len(columns) - 1))
    report = stem.with_suffix(".md")
    write_atomic(report, "\n".join([f"# {title}", "", lead, "", *table, "", notes]) + "\n")
    return report


def terminal_table(title: str, columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """The table for the terminal."""
    table = Table(title=title)
    for i, column in enumerate(columns):
        table.add_column(column, justify="right" if i else "left")
    for row in rows:
        table.add_row(*row)
    return table
