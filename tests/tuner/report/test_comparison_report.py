"""Comparison tables and page: Table I's layout, honest sentences, failures named."""

from __future__ import annotations

import html
import io
import re
from pathlib import Path

import pytest
from made_evaluations import made_run
from rich.console import Console

from nbv.errors import UserError
from tuner.evaluation.comparison import ComparisonTable, comparison_table
from tuner.report import write_comparison_report
from tuner.report.comparison.facts import comparison_facts, in_order
from tuner.report.comparison.tables import (
    PAPER_NOT_COMPARABLE,
    cell,
    comparison_markdown,
    difference_cell,
    terminal_tables,
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


def printed(table: ComparisonTable, width: int, **options: bool) -> str:
    console = Console(file=io.StringIO(), width=width)
    for part in terminal_tables(table, width, **options):
        console.print(part)
    return console.file.getvalue()  # type: ignore[attr-defined]


def cells(line: str) -> list[str]:
    return [part.strip() for part in line.strip().strip("|").split("|")]


def test_markdown_has_the_layout_of_table_one() -> None:
    run = made_run(LEVELS)
    table = comparison_table(run.records, tuple(LEVELS), "hyb-h")
    lines = comparison_markdown(table).splitlines()
    assert cells(lines[0]) == ["Metric", "Covis", "B-aware", "Hyb-H", "Hyb-O"]
    body = [cells(line) for line in lines[2:] if line.startswith("|")]
    assert all(len(row) == 5 for row in body)
    metrics = [row for row in body if row[0] in PAPER_ROWS]
    assert [row[0] for row in metrics] == PAPER_ROWS
    for row in metrics:
        assert row[4].startswith("**") and not any(c.startswith("**") for c in row[1:4])  # hyb-o leads in all
        assert all(" ± " in c for c in row[1:])
    assert [row[0] for row in body if row[0].startswith("T&T")] == [
        "T&T precision ↑ (%)",
        "T&T recall ↑ (%)",
        "T&T F-score ↑ (%)",  # made at 48 mm only: rows that no mission has are left out
    ]
    cell = table.rows[5].cells["covis"]
    assert cell is not None and cell.high is not None
    assert metrics[5][1].startswith(f"{cell.mean:.1f} ± {cell.high - cell.mean:.1f} (+")
    assert "(" not in metrics[5][3]  # the reference itself
    assert body[-1] == ["missions", "12", "12", "12", "12"]
    assert "t-intervals over rock means" in comparison_markdown(table)


def test_markdown_with_the_papers_numbers_beside() -> None:
    run = made_run({"covis": 60.0, "random": 61.0})
    table = comparison_table(run.records, ("covis", "random"), "covis")
    lines = comparison_markdown(table, paper=True).splitlines()
    hausdorff = next(cells(line) for line in lines if line.startswith("| Hausdorff"))
    assert hausdorff[1].endswith("; paper 480.9") and "paper" not in hausdorff[2]  # the paper has no random
    assert PAPER_NOT_COMPARABLE in lines


@pytest.mark.slow
def test_the_rocks_own_floor_stands_below_hausdorff(tmp_path: Path) -> None:
    rocks = ("cobble", "slab")
    failed = tuple(("covis", "cobble", k) for k in range(3))  # a floor is the rock's: others know it
    run = made_run({"covis": 60.0, "random": 61.0}, rocks, failed=failed, floors_mm=(100.0, 150.0))
    table = comparison_table(run.records, ("covis", "random"), "covis")
    assert [row.floor for row in table.rows] == [125.0] + [None] * 10
    lines = comparison_markdown(table, paper=True).splitlines()
    at = next(i for i, line in enumerate(lines) if line.startswith("| Hausdorff"))
    assert cells(lines[at + 1]) == ["– the rocks’ own floor (mm)", "125.0", "125.0"]
    assert "the rocks’ own floor (mm)" in printed(table, 140)
    text = html.unescape(write_comparison_report(comparison_facts(run), tmp_path).read_text())
    assert text.count("the rocks’ own floor (mm)") == 1 and "without error or omission" in text
    without = made_run({"covis": 60.0, "random": 61.0}, rocks)
    text = write_comparison_report(comparison_facts(without), tmp_path / "old").read_text()
    assert "own floor" not in html.unescape(text)


def test_differences_keep_the_sign_and_verdicts_the_direction() -> None:
    run = made_run({"tuned": 66.0, "hyb-h": 60.0, "covis": 54.0, "random": 60.02}, noise=0.5)
    table = comparison_table(run.records, tuple(run.plan.strategies), "hyb-h")
    mean_c2c, f_score = table.rows[1], table.rows[5]
    for name, expected in (("tuned", "better"), ("covis", "worse"), ("random", "no difference detected")):
        for row in (mean_c2c, f_score):
            found = difference_cell(row, name)
            assert found is not None and found.verdict == expected, (name, row.metric.key)
    tuned = difference_cell(mean_c2c, "tuned")
    assert tuned is not None and tuned.difference.startswith("−") and tuned.record == "12–0–0"
    assert difference_cell(mean_c2c, "hyb-h") is None


def test_no_interval_no_verdict() -> None:
    run = made_run({"tuned": 66.0, "hyb-h": 60.0}, rocks=("cobble",), replicates=1)
    table = comparison_table(run.records, ("tuned", "hyb-h"), "hyb-h")
    found = difference_cell(table.rows[5], "tuned")
    assert found is not None and found.verdict == "no interval"
    facts = comparison_facts(run)
    assert "too few missions for an interval" in facts.verdicts[0].text
    assert "better" not in facts.verdicts[0].text
    assert any("nothing here speaks for other rocks" in warning for warning in facts.warnings)


def test_terminal_tables() -> None:
    run = made_run(LEVELS, failed=(("covis", "slab", 1),))
    table = comparison_table(run.records, tuple(LEVELS), "hyb-h")
    text = printed(table, 140, paper=True)
    assert "paper 535.1" in text and "11 + 1 failed" in text and "Thresholded @ 80 mm" in text


def test_tables_of_many_strategies_keep_numbers_on_80_columns() -> None:
    names = (
        "tuned",
        "novelty-only",
        "covis",
        "b-aware",
        "hyb-h",
        "hyb-o",
        "learned",
        "uniform-coverage",
        "random",
    )
    run = made_run({name: 60.0 + 1.5 * i for i, name in enumerate(names)}, noise=0.5)
    table = comparison_table(run.records, names, "hyb-h")
    text = printed(table, 80)
    assert "…" not in text and max(map(len, text.splitlines())) <= 80
    assert "T&T precision ↑ (%)" in text
    f_score = table.rows[5]
    for name in names:
        assert cell(f_score, name).text in text


def test_page_and_markdown_file(tmp_path: Path) -> None:
    failed = (("b-aware", "slab", 0), ("b-aware", "slab", 1), ("b-aware", "slab", 2))
    facts = comparison_facts(made_run(LEVELS, failed=failed))
    page = write_comparison_report(facts, tmp_path, title="Compared", paper=True)
    source = page.read_text()
    text = re.sub(r"\s+", " ", html.unescape(re.sub(r"<[^>]+>", " ", source)))
    assert "Hyb-O is better than Hyb-H" in text and "B-aware is worse than Hyb-H" in text
    assert "B-aware 3; reasons: seed_model_failed 3" in text
    assert "paper 480.9" in text and "9 paired missions on 3 rocks" in text
    assert not re.search(r"(src|href)=[\"'](?!data:|#)", source)
    assert {p.stem for p in (tmp_path / "figures").glob("*.png")} == {"rocks", "sectors"}
    assert (tmp_path / "table.md").read_text().count("| Hausdorff ↓ (mm) |") == 2  # two surfaces


def test_everything_failed(tmp_path: Path) -> None:
    failed = tuple((name, "slab", k) for name in ("covis", "hyb-h") for k in range(2))
    run = made_run({"covis": 60.0, "hyb-h": 58.0}, rocks=("slab",), replicates=2, failed=failed)
    text = write_comparison_report(comparison_facts(run), tmp_path).read_text()
    assert "Covis: no mission in common with Hyb-H" in text


def test_reference_must_be_evaluated() -> None:
    with pytest.raises(UserError, match="reference 'hyb-o' was not evaluated"):
        comparison_facts(made_run({"covis": 60.0}), "hyb-o")


def test_the_page_leads_with_one_verdict_then_table_one(tmp_path: Path) -> None:
    levels = {"tuned": 70.0, "random-tuned-pool": 58.0, "hyb-h": 60.0, "random": 50.0}
    run = made_run({k: v for k, v in levels.items() if "pool" not in k})
    source = write_comparison_report(comparison_facts(run), tmp_path).read_text()
    assert source.count('id="verdict"') == 1
    verdict, table = source.index('id="verdict"'), source.index("Whole surface</h3>")
    assert verdict < table < source.index("What was flown")
    assert "Tuned is better than Hyb-H" in source[verdict:table]
    assert "condition ideal" in source[verdict:table]
    assert in_order(levels) == ("tuned", "hyb-h", "random", "random-tuned-pool")
