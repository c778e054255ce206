"""Evaluations under several conditions."""

from __future__ import annotations

from pathlib import Path

import fake_campaigns
import pytest

from nbv.config import load_conditions, preset
from tuner.campaign.campaign import Campaign
from tuner.evaluation.comparison import comparison_table, strategy_difference, values_of
from tuner.evaluation.flying import EvaluationRun, run_evaluation
from tuner.evaluation.of_campaign import held_out
from tuner.evaluation.paper_table import MetricRow
from tuner.evaluation.plan import EvaluationPlan
from tuner.missions.executors import InProcessExecutor
from tuner.missions.registry import ignored_by
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


def test_evaluate_says_what_the_campaign_has_not_seen(gatetune, tmp_path: Path) -> None:
    fake_campaigns.run(
        tmp_path / "run", budget=2, sampler="sobol", overrides={"telemetry": "rtk"}, rocks=("slab", "arch")
    )
    code, _, err = gatetune("evaluate", "run", "--rock", "boulder", "--condition", "field")
    assert code == 2 and "telemetry is set by condition 'field' and by overrides" in " ".join(err.split())
    code, _, err = gatetune("evaluate", "run", "--rock", "noroc", "--condition", "low-sun")
    assert code == 2 and "noroc" in err
    asked = held_out(
        Campaign.open(tmp_path / "run", read_only=True),
        rocks=["boulder"],
        conditions=load_conditions(["low-sun"]),
    )
    assert asked.notes[-1] == "Conditions that the campaign has not seen: low-sun."
    code, _, err = gatetune("evaluate", "run", "--rock", "boulder", "--condition", "nowhere")
    assert code == 2 and "unknown condition 'nowhere'" in err


def test_what_geometric_missions_ignore_is_said() -> None:
    assert ignored_by("photogrammetric", TWO) == ""
    assert ignored_by("geometric", TWO[:1]) == ""
    said = ignored_by("geometric", TWO)
    assert said.startswith("Geometric missions ignore") and "telemetry" in said and said.endswith("of field.")
