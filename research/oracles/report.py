"""Tables of a study of oracles."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from rich.table import Table

from nbv.mission.result import json_ready
from nbv.mission.run_directory import write_atomic
from research.decisions import PERCENT
from research.departures.study import METRICS, metric_key
from research.oracles.states import CoverageSummary, JudgedMission, summarise
from research.oracles.study import OracleFindings, StrategyResult
from research.paired_cells import difference_text, heading, interval_sentence, markdown_table, mean_text
from research.study_directory import preamble
from tuner.evaluation.baselines import label as strategy_label
from tuner.evaluation.comparison import PairedDifference
from tuner.report.labels import MISSING, format_number

_PREFERENCES = {
    "strategy": "strategy",
    "judged by": "judged by coverage",
    "B-aware": "prefers B-aware (% of decisions)",
    "Covis": "prefers Covis (%)",
    "ties": "ties (%)",
    "ties by kind": "ties: same candidate, saturated, other",
    "missions": "missions that prefer B-aware at least once",
    "saturates": "missions with nothing to gain at some capture (median first)",
    "covered": "samples covered before first and last capture (%)",
    "flew": "flew B-aware (%)",
}


def write_oracles_report(findings: OracleFindings, directory: Path) -> None:
    """``oracles.json`` and ``oracles.md``."""
    write_atomic(directory / "oracles.json", json.dumps(json_ready(findings.to_dict()), indent=1))
    write_atomic(directory / "oracles.md", oracles_markdown(findings))


def name_of(strategy: str) -> str:
    """``Hyb-O, seen``."""
    for prefix, label in (("hyb-o-", "Hyb-O"), ("greedy-", "Greedy oracle")):
        if strategy.startswith(prefix):
            return f"{label}, {strategy.removeprefix(prefix)}"
    return strategy_label(strategy)


def _preferences_row(s: StrategyResult) -> list[str]:
    saturates = f"{s.missions_saturated} of {s.missions}"
    if s.saturates_at is not None:
        saturates += f" ({s.saturates_at + 1:g})"
    covered = MISSING
    if s.covered_first is not None and s.covered_last is not None:
        covered = f"{format_number(s.covered_first)}, {format_number(s.covered_last)}"
    return [
        name_of(s.strategy),
        s.coverage,
        mean_text(s.prefers_b_aware, 0),
        mean_text(s.prefers_covis, 0),
        mean_text(s.ties, 0),
        f"{s.same_candidate}, {s.saturated}, {s.other_ties}",
        f"{s.missions_preferring_b_aware} of {s.missions}",
        saturates,
        covered,
        mean_text(s.flew_b_aware, 0),
    ]


def oracles_table(findings: OracleFindings) -> Table:
    """Preferences for the terminal."""
    table = Table(title="What the oracles preferred")
    for column in _PREFERENCES:
        table.add_column(column, justify="left" if column in ("strategy", "judged by") else "right")
    for s in findings.strategies:
        table.add_row(*_preferences_row(s))
    return table


def oracles_markdown(findings: OracleFindings) -> str:
    """Preferences, means, and paired gains over every reference."""
    s = findings.settings
    rows = [(row, metric_key(row, s.surface)) for row in METRICS]
    intervals = [d.interval for d in _all_differences(findings)]
    lines = [
        "# When is a sample covered?",
        "",
        *preamble(findings),
    ]
    lines += [
        "## What the oracles preferred",
        "",
        "Every decision of a mission is judged by the mission's own coverage: which scorer's best candidate would "
        "gain more. Ties are split into both scorers having chosen the same candidate, nothing to gain from either "
        "(saturated), and the rest.",
        "",
        *markdown_table(
            list(_PREFERENCES.values()), [_preferences_row(x) for x in findings.strategies], left=2
        ),
        "",
        "## Means",
        "",
        *markdown_table(
            ["strategy", *(heading(row) for row, _ in rows), "missions"],
            [
                [
                    name_of(x.strategy),
                    *(mean_text(x.cells[key], row.decimals) for row, key in rows),
                    f"{x.missions}" + (f" + {x.failed} failed" if x.failed else ""),
                ]
                for x in findings.strategies
            ],
        ),
    ]
    for reference in s.references:
        others = [x for x in findings.strategies if reference in x.differences]
        lines += ["", f"## Paired differences against {strategy_label(reference)}", ""]
        if reference == s.references[0]:
            lines += [
                "On the same (rock, replicate): mean difference [95 % interval], bold where the interval excludes "
                "zero. *0 exactly*: no mission differs by a single bit. *Other views*: Jaccard distance of the "
                f"chosen viewpoints. {interval_sentence(intervals)}",
                "",
            ]
        lines += markdown_table(
            ["strategy", *(heading(row, difference=True) for row, _ in rows), "other views (%)"],
            [
                [
                    name_of(x.strategy),
                    *(difference_text(x.differences[reference][key], row.decimals) for row, key in rows),
                    mean_text(x.other_views[reference], 0),
                ]
                for x in others
            ],
        )
    return "\n".join(lines) + "\n"


_STATES = (
    "coverage",
    "missions",
    "decisions",
    "prefers B-aware (%)",
    "prefers Covis (%)",
    "ties (%)",
    "ties: same candidate, saturated, other",
    "missions that prefer B-aware at least once",
    "missions with nothing to gain at some capture (median first)",
    "samples covered before first and last capture (%)",
)


def states_markdown(judged: Sequence[JudgedMission]) -> str:
    """Every coverage on the same states."""
    evaluated = dict.fromkeys((j.rock, j.gate, j.directory) for j in judged)
    rocks = ", ".join(dict.fromkeys(rock for rock, _, _ in evaluated))
    gates = ", ".join(dict.fromkeys(strategy_label(gate) for _, gate, _ in evaluated))
    lines = [
        "# Every oracle on the same planning states",
        "",
        f"{len(evaluated)} missions flown by {gates} on {rocks}.",
        "",
        *markdown_table(_STATES, [_states_row(s) for s in summarise(judged)]),
    ]
    return "\n".join(lines) + "\n"


def _states_row(s: CoverageSummary) -> list[str]:
    p = s.preferences
    saturates = f"{s.missions_saturated} of {s.missions}"
    if p.saturates_at is not None:
        saturates += f" ({p.saturates_at + 1})"
    return [
        s.coverage,
        str(s.missions),
        str(p.decisions),
        *(format_number(PERCENT * n / p.decisions, 0) for n in (p.b_aware, p.covis, p.ties)),
        f"{p.same_candidate}, {p.saturated}, {p.other_ties}",
        f"{s.missions_preferring_b_aware} of {s.missions}",
        saturates,
        f"{format_number(s.covered_first)}, {format_number(s.covered_last)}",
    ]


def states_table(judged: Sequence[JudgedMission]) -> Table:
    """The same for the terminal."""
    table = Table(title="Every oracle on the same planning states")
    for i, column in enumerate(_STATES):
        table.add_column(column, justify="right" if i else "left")
    for summary in summarise(judged):
        table.add_row(*_states_row(summary))
    return table


def _all_differences(findings: OracleFindings) -> list[PairedDifference]:
    return [
        d
        for s in findings.strategies
        for by_metric in s.differences.values()
        for d in by_metric.values()
        if d
    ]
