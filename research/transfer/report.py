"""The report, the tables and the figures of a study of transfer."""

from __future__ import annotations

import csv
import io
import json
from pathlib import Path
from typing import Any

from rich.table import Table

from nbv.errors import UserError
from nbv.mission.result import json_ready
from nbv.mission.run_directory import write_atomic
from nbv.provenance import git_revision
from research.paired_cells import difference_text, interval_sentence, markdown_table, mean_text
from research.transfer.agreement import Estimate
from research.transfer.figures import gains_figure, matrix_figure
from research.transfer.study import REFERENCE, TransferFindings, WorldResult
from tuner.evaluation.baselines import TUNED, label
from tuner.missions.registry import GEOMETRIC_NOTE, is_geometric
from tuner.report.labels import MISSING, format_number, metric_label
from tuner.report.style import save_figure, short_names

REPORT_FILE = "report.md"
DECIMALS = 2


def write_transfer_report(findings: TransferFindings, directory: Path, command: str = "") -> Path:
    """``transfer.json``, ``transfer.csv``, figures and ``report.md``; the report's path.

    Raises
    ------
    UserError
        The directory cannot be written.
    """
    figures = {"gains": gains_figure(findings), "worlds": matrix_figure(findings)}
    drawn = {name: figure for name, figure in figures.items() if figure is not None}
    try:
        directory.mkdir(parents=True, exist_ok=True)
        write_atomic(directory / "transfer.json", json.dumps(json_ready(findings.to_dict()), indent=1))
        write_atomic(directory / "transfer.csv", transfer_csv(findings))
        for name, figure in drawn.items():
            save_figure(figure, directory, name)
        write_atomic(directory / REPORT_FILE, _markdown(findings, list(drawn), command))
    except OSError as error:
        raise UserError(f"cannot write to {directory}: {error.strerror}; choose another --out") from error
    return directory / REPORT_FILE


def _markdown(findings: TransferFindings, figures: list[str], command: str) -> str:
    s, metric = findings.settings, metric_label(findings.settings.metric)
    worlds = [_world(findings, w) for w in findings.worlds]
    lines = [f"# {s.campaign}: does what was tuned hold in other worlds?", ""]
    lines += [f"{metric.full}, {metric.difference_unit}; rocks {', '.join(short_names(s.rocks))}.", ""]
    lines += [line for warning in _warnings(findings) for line in (warning, "")]
    columns = {"name": "world", "missions": "missions", "failed": "failed", "reference": "tuned - Hyb-H"}
    columns |= {"random": "tuned - random", "best": "best", "itself": "ranks itself"}
    lines += markdown_table(list(columns.values()), [[w[key] for key in columns] for w in worlds])
    intervals = [c.mean for w in findings.worlds for c in w.configurations]
    lines += ["", f"{interval_sentence(intervals)} Ranks itself: Spearman correlation of the means over odd "]
    lines[-1] += "and over even replicates; what limits the agreement with any other world."
    lines += [line for name in figures for line in ("", f"![{name}]({name}.png)")]
    if pairs := _pairs(findings):
        lines += [
            "",
            "## Between worlds",
            "",
            *markdown_table(list(pairs[0]), [list(p.values()) for p in pairs]),
        ]
    for w in worlds:
        rows = [
            [c["label"], str(c["missions"]), str(c["failed"]), c["mean"], c["difference"]] for c in w["rows"]
        ]
        header = ["configuration", "missions", "failed", metric.axis, "minus Hyb-H"]
        lines += ["", f"## {w['name']}: {w['what']}", "", *markdown_table(header, rows)]
    lines += ["", f"Revision {git_revision()}; {findings.wall_s / 60:.0f} min of missions."]
    return "\n".join([*lines, "", f"    {command}" if command else ""]) + "\n"


def transfer_csv(findings: TransferFindings) -> str:
    """One row per world and configuration, unrounded."""
    text = io.StringIO()
    rows = csv.writer(text, lineterminator="\n")
    rows.writerow(
        [
            "world",
            "configuration",
            "missions",
            "failed",
            "mean",
            "low",
            "high",
            "minus_hyb_h",
            "minus_hyb_h_low",
            "minus_hyb_h_high",
        ]
    )
    for world in findings.worlds:
        for c in world.configurations:
            cells: list[Any] = [world.name, c.name, c.missions, c.failed]
            for i in (c.mean, c.difference and c.difference.interval):
                cells += [i.mean, i.low, i.high] if i else [None] * 3
            rows.writerow(cells)
    return text.getvalue()


def transfer_table(findings: TransferFindings) -> Table:
    """Worlds for the terminal."""
    metric = metric_label(findings.settings.metric)
    table = Table(
        title=f"Tuned in other worlds: {metric.full}", caption=f"{metric.difference_unit}, 95 % interval"
    )
    for column in ("world", "missions", "failed", "tuned", "tuned - Hyb-H", "tuned - random", "best"):
        table.add_column(column, justify="left" if column in ("world", "best") else "right")
    for w in findings.worlds:
        row = _world(findings, w)
        tuned = mean_text(w.configuration(TUNED).mean, DECIMALS)
        table.add_row(
            w.name, row["missions"], row["failed"], tuned, row["reference"], row["random"], row["best"]
        )
    return table


def pairs_table(findings: TransferFindings) -> Table | None:
    """Pairs of worlds for the terminal; None with one world."""
    if not findings.pairs:
        return None
    table = Table(title="Between worlds", caption="95 % bootstrap over rocks and replicates")
    columns = {"first": "chosen in", "second": "flown in", "spearman": "Spearman", "chosen": "chosen"}
    columns |= {"best": "best there", "regret": "regret"}
    for column in columns.values():
        table.add_column(column, justify="right" if column in ("Spearman", "regret") else "left")
    for row in _pairs(findings):
        table.add_row(*(row[key] for key in columns))
    return table


def _warnings(findings: TransferFindings) -> list[str]:
    out = []
    if any(is_geometric(world.fidelity) for world in findings.settings.worlds.values()):
        out.append(GEOMETRIC_NOTE)
    if findings.missions < findings.expected:
        out.append(
            f"Not complete: {findings.missions} of {findings.expected} missions are in; the same command goes on."
        )
    if findings.failures:
        reasons = ", ".join(f"{reason} {n}" for reason, n in sorted(findings.failures.items()))
        out.append(f"Failed missions are left out of all means and differences (reasons: {reasons}).")
    dropped = {
        (c, a)
        for (a, _), pair in findings.pairs.items()
        for c in findings.settings.ranked
        if c not in pair.configurations
    }
    if dropped and findings.missions == findings.expected:
        names = ", ".join(sorted({label(c) for c, _ in dropped}))
        out.append(f"Not ranked in some pair of worlds, because they finished less than half of it: {names}.")
    return out


def _world(findings: TransferFindings, w: WorldResult) -> dict[str, Any]:
    s = findings.settings
    world = s.worlds[w.name]
    return {
        "name": w.name,
        "what": ", ".join(filter(None, [world.condition.description, world.fidelity])),
        "missions": str(sum(c.missions for c in w.configurations)),
        "failed": str(sum(c.failed for c in w.configurations)),
        "reference": difference_text(w.configuration(TUNED).difference, DECIMALS, bold=False),
        "random": difference_text(w.tuned_minus_random, DECIMALS, bold=False),
        "best": label(w.best) if w.best else MISSING,
        "itself": format_number(w.self_agreement, DECIMALS),
        "rows": [
            {
                "label": label(c.name),
                "missions": c.missions,
                "failed": c.failed,
                "mean": mean_text(c.mean, DECIMALS),
                "difference": MISSING
                if c.name == REFERENCE
                else difference_text(c.difference, DECIMALS, bold=False),
                "best": c.name == w.best,
            }
            for c in w.configurations
        ],
    }


def _pairs(findings: TransferFindings) -> list[dict[str, str]]:
    return [
        {
            "first": first,
            "second": second,
            "spearman": estimate_text(pair.spearman),
            "chosen": label(pair.chosen) if pair.chosen else MISSING,
            "best": label(pair.best) if pair.best else MISSING,
            "regret": estimate_text(pair.regret),
            "configurations": str(len(pair.configurations)),
            "blocks": str(pair.blocks),
        }
        for (first, second), pair in findings.pairs.items()
    ]


def estimate_text(estimate: Estimate) -> str:
    """``0.81 [0.60, 0.93]``."""
    text = format_number(estimate.value, DECIMALS)
    if estimate.low is None or estimate.high is None:
        return text
    return f"{text} [{format_number(estimate.low, DECIMALS)}, {format_number(estimate.high, DECIMALS)}]"
