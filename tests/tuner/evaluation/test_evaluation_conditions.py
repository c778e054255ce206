"""Evaluations under several conditions."""

from __future__ import annotations

from pathlib import Path

import fake_campaigns
import pytest

from nbv.config import load_conditions, preset
from tuner.evaluation.comparison import comparison_table, strategy_difference, values_of
from tuner.evaluation.flying import EvaluationRun, run_evaluation
from tuner.evaluation.paper_table import MetricRow
from tuner.evaluation.plan import EvaluationPlan
from tuner.missions.executors import InProcessExecutor
from tuner.problem.worlds import World
from tuner.report.comparison.facts import comparison_facts
from tuner.report.comparison.page import write_comparison_report

BASE = preset("campaign")
GOOD = BASE.with_values({"gate.budget_fraction": 0.75, "gate.d95_m": 0.04})
F48 = MetricRow("", "F-score", "observable.f_score_48mm", "%", True)
TWO = load_conditions(["ideal", "field"])


def evaluated(directory: Path, **changes: object) -> EvaluationRun:
    fields: dict[str, object] = {
        "strategies": {"tuned": GOOD, "hyb-h": BASE},
        "rocks": ("x", "y", "z"),
        "replicates": 2,
        "fidelity": fake_campaigns.FIDELITY,
        "conditions": TWO,
    }
    return run_evaluation(EvaluationPlan(**{**fields, **changes}), directory, InProcessExecutor())  # type: ignore[arg-type]


def test_every_strategy_flies_every_world_and_is_paired(tmp_path: Path) -> None:
    run = evaluated(tmp_path / "out")
    assert run.complete and run.plan.missions == len(run.records) == 24
    assert {r.world for r in run.records} == {World(r, c) for r in "xyz" for c in ("ideal", "field")}
    assert (tmp_path / "out/missions/tuned/00_x_field_r1/mission.json").is_file()
    assert (tmp_path / "out/missions/tuned/00_x_r1/mission.json").is_file()
    both = strategy_difference(run.records, "tuned", "hyb-h", F48)
    assert both is not None and (both.pairs, both.interval.rocks) == (12, 3)
    field = [r for r in run.records if r.condition == "field"]
    alone = strategy_difference(field, "tuned", "hyb-h", F48)
    assert alone is not None and alone.pairs == 6
    ours, theirs = (values_of(field, name, F48.key) for name in ("tuned", "hyb-h"))
    assert alone.interval.mean == pytest.approx(sum(ours[b] - theirs[b] for b in ours) / 6)
    table = comparison_table(run.records, ("tuned", "hyb-h"), "hyb-h", rows=(F48,))
    assert table.missions == {"tuned": 12, "hyb-h": 12}


def test_its_page_has_a_table_per_condition(tmp_path: Path) -> None:
    run = evaluated(tmp_path / "out", replicates=1)
    page = write_comparison_report(comparison_facts(run), tmp_path / "page").read_text()
    assert "<h3>Under ideal</h3>" in page and "<h3>Under field</h3>" in page and "ideal, field" in page
    ideal = evaluated(tmp_path / "ideal", conditions=TWO[:1], replicates=1)
    assert (
        "Under ideal" not in write_comparison_report(comparison_facts(ideal), tmp_path / "plain").read_text()
    )
