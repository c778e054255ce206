"""Strategies compared on the same missions: runs, pairs, intervals; how few photographs are enough, and baselines with as many."""

import dataclasses
import os
import signal
from pathlib import Path

import numpy as np
import pytest
from in_process import InProcessExecutor
from made_evaluations import made_trial
from photographed_ball import spread, write_set
from refusals import refused
from scene_helpers import around
from scipy import stats
from typer.testing import CliRunner

from nbv.config import IDEAL_CONDITION, load_condition, preset
from nbv.errors import UserError
from nbv.photographs import PhotographSet
from tuner.campaign.mission_problem import where_photographed
from tuner.cli import app
from tuner.comparison.plan import (
    EvaluationEvent,
    EvaluationPlan,
    EvaluationRun,
    evaluation_directory,
    run_evaluation,
)
from tuner.comparison.statistics import (
    PAPER_TABLE_I,
    TABLE_I_ROWS,
    TABLE_I_ROWS_OBSERVABLE,
    comparison_table,
    same_photographs,
    strategy_gain,
)
from tuner.missions.job import Trial
from tuner.missions.pool import MissionPool
from tuner.problem.baselines import (
    BASELINES,
    ORBITS,
    PAPER_STRATEGIES,
    at_equal_number,
    baseline_configs,
    ending_at,
    orbits_at_number,
)
from tuner.problem.goal import Objective
from tuner.problem.intervals import mean_interval
from tuner.problem.space_files import load_search_space
from tuner.report.enough import ALL, draw_enough, enough_plans, enough_text, read_enough
from tuner.report.figures import plan_figure
from tuner.report.words import plan_words

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


@pytest.fixture
def ball(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PhotographSet:
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path / "home"))
    return write_set("ball", spread(40), rendered=False)


def run(plan: EvaluationPlan, values: dict[str, list[tuple[float, int]]], names: list[str]) -> EvaluationRun:
    """Missions with these qualities and numbers of photographs."""

    def trial(strategy: str, k: int, quality: float, count: int) -> Trial:
        found = {"observable": {"f_score_48mm": quality}, "reference": {"ceiling": {"f_score_48mm": 99.0}}}
        costs = {"images": float(count), "registered_images": count - 1.0}
        measured = {"metrics": {**found, "taken": names[:count]}, "costs": costs}
        return made_trial(strategy, "ball", k, status="ok" if quality else "failed", measured=measured)

    records = [trial(s, k, *found) for s, several in values.items() for k, found in enumerate(several)]
    return EvaluationRun(plan, records, True, 0.0, Path())


def test_the_smallest_set_that_keeps_what_was_asked_for(ball: PhotographSet, tmp_path: Path) -> None:
    names = [p.name for p in ball.registered]
    everything, few = enough_plans(ball, (16, 20, 24), replicates=3).values()
    evaluated = {
        "ring-16": [(70.0, 16), (60.0, 15), (65.0, 16)],
        "ring-20": [(80.0, 20), (70.0, 20), (75.0, 20)],
        "ring-24": [(88.0, 24), (87.8, 23), (88.1, 24)],
        "random-20": [(72.0, 20), (0.0, 20), (36.0, 20)],
        # Two missions of three would have done, the plan would not.
        "tuned-20": [(74.2, 20), (98.2, 20), (98.5, 20)],
    }
    found = read_enough(run(everything, {ALL: [(90.0, 36)]}, names), run(few, evaluated, names), 95.0)
    assert found.asked_quality == pytest.approx(85.5)
    assert (found.smallest.way, found.smallest.replicate) == ("ring", 0)  # the median, not the best
    assert found.smallest.taken == tuple(names[:24])
    random = found.curves["random"][0]
    assert (random.quality.mean, random.registered) == (36.0, 19.0)  # a failed mission counts
    bounds = [(p.quality.low, p.quality.high) for points in found.curves.values() for p in points]
    assert all(0.0 <= low < high <= 100.0 for low, high in bounds) and bounds[-1][1] == 100.0
    refused("--replicates must be 2 or more", enough_plans, ball, (16,), replicates=1)
    assert np.isclose(found.ceiling, 99.0)
    picture = draw_enough(found, ball, 95.0, tmp_path / "enough.png")
    assert picture.stat().st_size > 20_000
    nothing = read_enough(run(everything, {ALL: [(99.0, 36)]}, names), run(few, evaluated, names), 100.0)
    assert nothing.smallest is None
    with pytest.raises(UserError, match="all photographs gave no"):
        read_enough(run(everything, {ALL: [(0.0, 36)]}, names), run(few, evaluated, names), 95.0)


def test_a_number_is_not_enough_where_a_larger_one_fails(ball: PhotographSet) -> None:
    names = [p.name for p in ball.registered]
    everything, few = enough_plans(ball, (16, 20, 24), replicates=3).values()
    evaluated = {
        "ring-16": [(89.0, 13), (88.5, 13), (89.2, 13)],
        "ring-20": [(0.0, 0), (0.0, 0), (0.0, 0)],
        "random-20": [(87.0, 20), (87.3, 20), (87.1, 20)],
        "random-24": [(80.0, 24), (90.0, 24), (91.0, 24)],
    }
    found = read_enough(run(everything, {ALL: [(90.0, 36)]}, names), run(few, evaluated, names), 95.0)
    assert found.smallest.way == "random" and len(found.smallest.taken) == 20
    assert (found.curves["ring"][1].failed, found.curves["ring"][1].asked) == (3, 20)
    assert "20 photographs would have been enough: random" in enough_text(found, 95.0, Path("listed"))


@pytest.mark.slow
def test_the_command_lists_the_files_that_would_have_done(tmp_path, monkeypatch):
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path / "home"))
    made = write_set("ball", spread(20), rendered=True)
    asked = ["photographs", "enough", "ball", "--number", "16", "--replicates", "2", "--workers", "1"]
    asked += ["--keep", "60", "--out", str(tmp_path / "out"), "--set", "dense.agreeing_views=3"]
    asked += ["--set", "evaluation.gt_samples=5000", "--set", "dense.max_size_px=240"]
    said = CliRunner().invoke(app, asked)
    assert said.exit_code == 0, said.output
    assert "of one processor" in said.output
    listed = (tmp_path / "out" / "enough.txt").read_text().split()
    assert 14 <= len(listed) <= 16 and set(listed) <= {p.source for p in made.photographs}
    assert (tmp_path / "out" / "enough.png").is_file()
    missions = sorted((tmp_path / "out").rglob("mission.json"))
    times = [path.stat().st_mtime_ns for path in missions]
    assert CliRunner().invoke(app, asked).exit_code == 0
    assert [path.stat().st_mtime_ns for path in missions] == times  # nothing is run again
    assert "must be above 0" in str(CliRunner().invoke(app, [*asked, "--keep", "0"]).exception)


def test_an_orbit_flies_the_whole_number() -> None:
    """62 % at 10 degrees and the rest at 35, nothing planned, whatever the tuned plan's own seeds are."""
    tuned = BASE.with_values({"photographs": 26, "seed.radius_m": 4.4})
    found = at_equal_number(baseline_configs(["hyb-h", "orbit", "orbit-two"], BASE), tuned, "hyb-h")
    assert list(found) == ["hyb-h", "hyb-h-26", "orbit-26", "orbit-two-26"]
    one, two = found["orbit-26"], found["orbit-two-26"]
    assert [(c.seeds, c.planned_views) for c in (one, two)] == [(26, 0)] * 2
    assert one.seed_rings == ((10.0, 26),) and two.seed_rings == ((10.0, 16), (35.0, 10))
    assert two.seed.radius_m == 3.5
    assert plan_words(two) == "16 photographs at 10° and 10 at 35°"
    above, beside = plan_figure(two).axes
    assert len(above.lines[1].get_xdata()) == 26 and not len(above.lines[0].get_xdata()), "seeds, no pool"
    assert len({round(up, 3) for up in beside.lines[1].get_ydata()}) == 2, "two rings, two heights"


@pytest.mark.parametrize(("number", "shared_out"), [(8, (6, 2)), (20, (15, 5))])
@pytest.mark.parametrize("space", ["photographs", "gate_weights_and_pool"])
def test_beside_a_tuned_orbit_planners_keep_their_share(space: str, number: int, shared_out) -> None:
    """Of a default that flies a turn, and of the paper's rings."""
    base = BASE.with_values(load_search_space(space).base)
    tuned = BASELINES["orbit"].orbit(base, number)
    found = at_equal_number(baseline_configs(["hyb-h", "covis"], base), tuned, "hyb-h")
    equal = found[f"hyb-h-{number}"]
    assert (equal.seeds, equal.planned_views) == shared_out
    assert equal.seed.layout == "rings" and equal.seed.radius_m == 4.0, "the paper's rings at any number"


def test_baselines_have_the_mean_number_of_a_plan_that_may_end_early() -> None:
    adaptive = BASE.with_values(
        {
            "photographs": 45,
            "seeds": 15,
            "seed.layout": "turn",
            "stop.criterion": "both",
            "stop.knn_threshold_m": 0.1,
        }
    )
    assert adaptive.stop.may_end_early
    counted = ending_at(adaptive, 21)
    assert (counted.photographs, counted.stop.may_end_early) == (21, False)
    found = at_equal_number(baseline_configs(["hyb-h", "random", "orbit"], BASE), counted, "hyb-h")
    assert list(found) == ["hyb-h", "hyb-h-21", "random-21", "orbit-21"]
    assert all(c.photographs == 21 and not c.stop.may_end_early for n, c in found.items() if n != "hyb-h")


def test_an_orbit_is_recentred_where_the_target_must_be_found() -> None:
    instances = (IDEAL_CONDITION, load_condition("field"))
    names = [f"{name}-32" for name in ORBITS]
    assert list(orbits_at_number(BASE, instances[:1])) == names
    found = orbits_at_number(BASE, instances)
    assert [c.seed.recentre_after for c in found.values()] == [0, 0, 0, 0, 16, 16]


def test_orbits_over_photographs_fly_where_these_were_taken(tmp_path, monkeypatch):
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path))
    tuned = BASE.with_values({"photographs": 24, "seeds": 16, "seed.layout": "turn"})
    elevations_deg = np.repeat([30.0, 36.0, 42.0, 48.0], 5)
    write_set("ball", around(np.linspace(0.0, 342.0, 20), elevations_deg), rendered=False)
    found, notes = where_photographed(orbits_at_number(tuned, ()) | {"tuned": tuned}, ["ball"])
    number = tuned.photographs
    ring, two = found[f"orbit-middle-{number}"].seed, found[f"orbit-two-{number}"].seed
    assert (ring.lowest_deg, ring.span_deg) == (pytest.approx(39.0, abs=0.1), 0.0)
    assert (two.lowest_deg, two.upper_deg) == (pytest.approx(34.5, abs=0.1), pytest.approx(43.5, abs=0.1))
    assert list(found) == [f"orbit-middle-{number}", f"orbit-two-{number}", "tuned"]
    assert found["tuned"] is tuned and "39° (the median)" in notes[0]
    assert where_photographed(found, ["slab"]) == (found, ())
