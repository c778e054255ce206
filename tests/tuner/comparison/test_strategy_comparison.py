"""Strategies compared on the same missions: runs, pairs and intervals."""

import dataclasses
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from in_process import InProcessExecutor
from made_evaluations import made_trial
from scipy import stats

from nbv.config import preset
from tuner.comparison.plan import EvaluationEvent, EvaluationPlan, evaluation_directory, run_evaluation
from tuner.comparison.statistics import (
    PAPER_TABLE_I,
    TABLE_I_ROWS,
    TABLE_I_ROWS_OBSERVABLE,
    comparison_table,
    same_photographs,
    strategy_gain,
)
from tuner.missions.pool import MissionPool
from tuner.problem.baselines import BASELINES, PAPER_STRATEGIES, baseline_configs
from tuner.problem.goal import Objective
from tuner.problem.intervals import mean_interval

BASE = preset("campaign")
GOOD = BASE.with_values({"gate.budget_fraction": 0.75, "gate.d95_m": 0.04})
F48 = TABLE_I_ROWS_OBSERVABLE[5]


def plan(**changes: object) -> EvaluationPlan:
    strategies = {"tuned": GOOD, "hyb-h": BASE, "copy": BASE}
    asked = {"strategies": strategies, "rocks": ("x", "y", "z"), "replicates": 2, "fidelity": "fake"}
    return EvaluationPlan(**{**asked, **changes})


def test_all_share_rocks_and_replicates_for_paired_differences(tmp_path: Path) -> None:
    result = run_evaluation(plan(), tmp_path / "out", InProcessExecutor())
    assert result.complete and result.failures == {}
    assert {(r.strategy, r.rock, r.replicate) for r in result.records} == {
        (s, r, k) for s in ("tuned", "hyb-h", "copy") for r in "xyz" for k in (0, 1)
    }
    # One and the same configuration is run once and counts for both names; without planned views the gate is the same.
    assert plan().missions == 12 and len(list((tmp_path / "out").glob("missions/*/*/mission.json"))) == 12
    orbit = BASE.with_values({"photographs": 24})
    same = {"hyb-h": orbit, "random": orbit.with_values({"gate.kind": "random"})}
    assert plan(strategies=same).missions == 6
    difference = strategy_gain(result.records, "tuned", "hyb-h", Objective(F48.key))
    assert difference is not None and difference.missions == 6
    assert difference.mean == pytest.approx(0.49, abs=0.15)
    same = strategy_gain(result.records, "copy", "hyb-h", Objective(F48.key))
    assert same is not None and same.mean == same.low == same.high == 0


def test_interrupted_evaluation_flies_only_the_rest(tmp_path: Path) -> None:
    def interrupt(event: EvaluationEvent) -> None:
        if event.trial and event.finished == 5:
            os.kill(os.getpid(), signal.SIGINT)

    first = run_evaluation(plan(), tmp_path / "out", InProcessExecutor(), interrupt)
    assert not first.complete
    events: list[EvaluationEvent] = []
    with MissionPool(2, fidelity="fake") as executor:
        second = run_evaluation(plan(), tmp_path / "out", executor, events.append)
    assert second.complete and sum(e.trial is None for e in events) == 12 - 5
    assert all(file.read_text() == "run\n" for file in (tmp_path / "out").rglob("run.txt"))
    whole = run_evaluation(plan(), tmp_path / "whole", InProcessExecutor())
    assert [r.metrics for r in second.records] == [r.metrics for r in whole.records]


def test_failures_are_counted_and_pairs_are_common_ones(tmp_path: Path) -> None:
    with MissionPool(1, fidelity="fake") as executor:
        result = run_evaluation(plan(rocks=("x", "fail", "abort"), replicates=1), tmp_path / "out", executor)
        assert result.complete and result.failures == {"seed_model_failed": 3, "worker_died: SIGABRT": 3}
        table = comparison_table(result.records, ["tuned", "hyb-h"], "hyb-h", (F48,))
        assert table.failures == {"tuned": 2, "hyb-h": 2} and table.missions == {"tuned": 1, "hyb-h": 1}
        difference = table.rows[0].differences["tuned"]
        assert difference is not None and difference.missions == 3, "a failed mission counts as 0"
        again = run_evaluation(plan(rocks=("x", "fail", "abort"), replicates=1), tmp_path / "out", executor)
    assert again.failures == result.failures and again.elapsed_s < 1.0  # nothing was run again


def test_baselines_and_the_papers_table() -> None:
    configs = baseline_configs([name for name in BASELINES if BASELINES[name].plans], BASE)
    assert all(config.gate.kind == name for name, config in configs.items())
    assert dataclasses.astuple(configs.pop("predicted").predicted.weights) == (1.0, 0.0, 0.0, 0.0)
    same = {"gate.kind": "hyb-h", "gate.oracle_coverage": BASE.gate.oracle_coverage}
    assert all(config.with_values(same) == BASE for config in configs.values())
    assert configs["greedy-oracle"].gate.oracle_coverage == "matchable"  # what the dense stage pays back
    assert configs["hyb-o"].gate.oracle_coverage == "reconstruction"  # the paper's text
    assert set(PAPER_TABLE_I) == set(PAPER_STRATEGIES)
    for column in PAPER_TABLE_I.values():
        assert set(column) == {row.key for row in TABLE_I_ROWS}
        # F = 2c / (1 + c) with perfect accuracy bounds the F-score from above (to the printed digits)
        for t in (48, 80):
            c = column[f"whole.completeness_{t}mm"] / 100
            assert column[f"whole.f_score_{t}mm"] <= 200 * c / (1 + c) + 1.0


def test_another_evaluation_lies_beside_the_first(tmp_path: Path) -> None:
    usual = tmp_path / "evaluation"
    for made, name in ((plan(), "evaluation"), (plan(replicates=3), "evaluation-2"), (plan(), "evaluation")):
        place = evaluation_directory(made, usual)
        assert place == tmp_path / name
        run_evaluation(made, place, InProcessExecutor())


def test_closed_forms() -> None:
    interval = mean_interval({"a": [1.0, 3.0], "b": [4.0], "c": [6.0]})
    assert interval is not None and interval.low is not None
    assert interval.mean == pytest.approx(4.0) and interval.method == "rocks"
    assert interval.low == pytest.approx(4 - stats.t.ppf(0.975, 2) * 2 / np.sqrt(3))
    fixed = mean_interval({"a": [1.0, 3.0, 5.0], "b": [4.0, 6.0]})
    assert fixed is not None and fixed.method == "replicates" and fixed.high is not None
    # pooled variance (8 + 2) / 3 with 3 degrees of freedom, three and two per rock: error = sqrt(10/3 * (1/3 + 1/2)) / 2
    assert fixed.high == pytest.approx(4.0 + stats.t.ppf(0.975, 3) * np.sqrt(10 / 3 * (1 / 3 + 1 / 2)) / 2)
    single = mean_interval({"a": [1.0], "b": [2.0]})
    assert single is not None and single.method == "none" and single.low is None
    assert mean_interval({}) is None and mean_interval({"a": []}) is None


def test_pairs() -> None:
    outcomes = {
        "reference": {("a", 0): 10.0, ("a", 1): 20.0, ("b", 0): 30.0, ("c", 0): 5.0},
        "better": {("a", 0): 12.0, ("a", 1): 21.0, ("b", 0): 29.0, ("d", 0): 0.0},
    }
    trials = [
        made_trial(name, rock, k, measured={"metrics": {"f": value}})
        for name, own in outcomes.items()
        for (rock, k), value in own.items()
    ]
    difference = strategy_gain(trials, "better", "reference", Objective("f"))
    assert (difference.missions, difference.rocks) == (3, 2)
    assert difference.mean == pytest.approx((1.5 - 1.0) / 2)


@pytest.mark.parametrize(("once", "same"), [(False, {"hyb-h": "b-aware"}), (True, {})])
def test_strategies_that_took_the_same_photographs_everywhere_are_found(once, same):
    records = [
        made_trial(name, rock, k, photographs=name if name == "covis" or (once and k) else f"{rock} {k}")
        for name in ("covis", "b-aware", "hyb-h")
        for rock in "abc"
        for k in (0, 1)
    ]
    assert same_photographs(records, ["covis", "b-aware", "hyb-h"]) == same
