"""Comparison tables and page: Table I's layout, honest sentences, failures named."""

from __future__ import annotations

import html
import io
import re
from pathlib import Path

from made_evaluations import made_run
from rich.console import Console
from rich.table import Table

from tuner.evaluation.comparison import comparison_table
from tuner.report import write_comparison_report
from tuner.report.comparison.facts import comparison_facts
from tuner.report.comparison.tables import (
    PAPER_NOT_COMPARABLE,
    cell,
    comparison_markdown,
    difference_verdict,
    strategies_for_terminal,
    table_i_for_terminal,
)

PAPER_ROWS = [
    "Hausdorff ↓ (mm)",
    "Mean C2C ↓ (mm)",
    "Median C2C ↓ (mm)",
    "P95 C2C ↓ (mm)",
    "Completeness ↑ (%)",
    "F-score ↑ (%)",
    "Completeness ↑ (%)",
    "F-score ↑ (%)",
]
LEVELS = {"covis": 60.0, "b-aware": 55.0, "hyb-h": 58.0, "hyb-o": 66.0}


def printed(table: Table, width: int) -> str:
    console = Console(file=io.StringIO(), width=width)
    console.print(table)
    return console.file.getvalue()  # type: ignore[attr-defined]


def cells(line: str) -> list[str]:
    return [part.strip() for part in line.strip().strip("|").split("|")]


def test_markdown_has_the_layout_of_table_one() -> None:
    table = comparison_table(made_run(LEVELS).records, tuple(LEVELS), "hyb-h")
    lines = comparison_markdown(table, paper=True).splitlines()
    assert cells(lines[0]) == ["Metric", "Covis", "B-aware", "Hyb-H", "Hyb-O"]
    body = [cells(line) for line in lines[2:] if line.startswith("|")]
    metrics = [row for row in body if row[0] in PAPER_ROWS]
    assert [row[0] for row in metrics] == PAPER_ROWS
    for row in metrics:
        assert row[4].startswith("**") and not any(c.startswith("**") for c in row[1:4])  # hyb-o leads in all
        assert all(" ± " in c for c in row[1:])
    # Made at 48 mm only: rows that no mission has are left out.
    assert [row[0] for row in body if row[0].startswith("T&T")] == [
        "T&T precision ↑ (%)",
        "T&T recall ↑ (%)",
        "T&T F-score ↑ (%)",
    ]
    f_score = table.rows[5].cells["covis"]
    assert f_score is not None and f_score.high is not None
    assert metrics[5][1].startswith(f"{f_score.mean:.1f} ± {f_score.high - f_score.mean:.1f}; paper 72.0; +")
    assert "(" not in metrics[5][3]  # the reference itself
    assert body[-1] == ["missions", "12", "12", "12", "12"]
    assert any("t-intervals over rock means" in line for line in lines) and PAPER_NOT_COMPARABLE in lines


def test_differences_keep_the_sign_and_verdicts_the_direction() -> None:
    run = made_run({"tuned": 66.0, "hyb-h": 60.0, "covis": 54.0, "random": 60.02}, noise=0.5)
    table = comparison_table(run.records, tuple(run.plan.strategies), "hyb-h")
    mean_c2c, f_score = table.rows[1], table.rows[5]
    for name, expected in (("tuned", "better"), ("covis", "worse"), ("random", "no difference detected")):
        for row in (mean_c2c, f_score):
            found = row.differences[name]
            assert found is not None and difference_verdict(found, row.metric) == expected, name
    assert cell(mean_c2c, "tuned").difference.startswith("−") and cell(mean_c2c, "hyb-h").difference == ""


def test_no_interval_no_verdict() -> None:
    facts = comparison_facts(made_run({"tuned": 66.0, "hyb-h": 60.0}, rocks=("cobble",), replicates=1))
    assert "too few missions for an interval" in facts.verdicts[0].text
    assert "better" not in facts.verdicts[0].text
    assert any("nothing here speaks for other rocks" in warning for warning in facts.warnings)


def test_terminal_tables() -> None:
    facts = comparison_facts(made_run(LEVELS, failed=(("covis", "slab", 1),)))
    text = printed(table_i_for_terminal(facts.tables["whole"], "Table I"), 140)
    assert "paper 535.1" in text and "11 + 1 failed" in text and "Thresholded @ 80 mm" in text
    names = ("tuned", "movement-only", *LEVELS, "learned", "greedy-oracle", "random")
    many = comparison_facts(made_run({name: 60.0 + 1.5 * i for i, name in enumerate(names)}, noise=0.5))
    text = printed(strategies_for_terminal(many.summary, ""), 80)
    assert max(map(len, text.splitlines())) <= 80
    assert all(cell(many.summary.rows[-1], name).text in text for name in names)


def test_page_and_markdown_file(tmp_path: Path) -> None:
    failed = tuple(("b-aware", "slab", k) for k in range(3))
    page = write_comparison_report(comparison_facts(made_run(LEVELS, failed=failed)), tmp_path, paper=True)
    source = page.read_text()
    text = re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", " ", source)))
    assert source.count('id="verdict"') == 1 and "No difference detected" not in text
    assert "Covis is better than Hyb-H" in text and "12 paired missions on 4 rocks" in text
    assert text.index("Covis is better") < text.index("heuristic gate") < text.index("Table I on the whole")
    assert "B-aware 3; reasons: seed_model_failed 3" in text and "9 + 3 failed" in text
    assert "paper 480.9" in text and "condition ideal" in text
    assert not re.search(r"(src|href)=[\"'](?!data:|#)", source)
    slab = next(row for row in re.findall(r"<tr>.*?</tr>", source) if row.startswith("<tr><td>B-aware</td>"))
    assert slab.count("<td>–</td>") == 1  # rock by rock: the rock on which it failed
    assert (tmp_path / "table.md").read_text().count("| Hausdorff ↓ (mm) |") == 2  # two surfaces
