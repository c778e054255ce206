"""Objectives: texts, values, and outcomes beside those of other rocks."""

import math

import fake_missions
import numpy as np
import pytest
from refusals import refused

from nbv.config import MissionConfig
from tuner.problem.goal import Objective, direction_of, parse_goal
from tuner.problem.standardise import RockStandardiser

PHOTOGRAPHS = Objective("costs.images", "minimise")


def test_the_text_says_metric_cost_and_limit_and_is_said_back() -> None:
    assert parse_goal("f_score").second is None
    cheap = parse_goal("completeness@energy<=9")
    assert cheap.second == Objective("costs.energy_wh", "minimise") and cheap.limit == 9.0
    best = parse_goal("observable.f_score_16mm@photographs<=21")
    assert (best.objective.metric, best.second, best.limit) == ("observable.f_score_16mm", PHOTOGRAPHS, 21.0)
    least = parse_goal("photographs@f_score >= 97.5")
    assert least.objective == PHOTOGRAPHS and least.second == Objective() and least.limit == 97.5
    assert str(least) == "photographs@f_score>=97.5"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("f_score@photographs>=21", "costs.images is minimised; write <="),
        ("photographs@f_score<=97", "is maximised; write >="),
        ("f_score@f_score>=9", "the same metric twice"),
        ("f_score@photographs<=1e", "'1e' is not a number"),
        ("f_score at 21", "is not understood; write f_score, f_score@photographs<=21"),
        ("f_score@costs.beauty<=1", "no cost 'costs.beauty'; there are costs.images"),
        ("f_score@beauty<=1", "more or less of 'beauty' is better"),
    ],
)
def test_what_is_no_objective_is_said_in_one_line(text: str, says: str) -> None:
    refused(says, parse_goal, text)


def test_failed_and_missing_are_infeasible_degraded_counts() -> None:
    objective = Objective("observable.f_score_48mm")
    metrics = {"observable": {"f_score_48mm": 61.5, "list": [1]}}
    assert objective.value_or_reason("ok", metrics) == (61.5, "")
    assert objective.value_or_reason("degraded", metrics)[0] == 61.5
    assert objective.value_or_reason("failed", metrics)[0] is None
    assert objective.value_or_reason("ok", {"observable": {"f_score_48mm": math.nan}})[0] is None
    assert objective.value_or_reason("ok", {"observable": {"f_score_48mm": None}})[0] is None
    assert Objective("observable.list").value_or_reason("ok", metrics)[0] is None
    assert Objective(direction="minimise").sign == -1
    assert direction_of("observable.accuracy_48mm") == "maximise"
    refused("unknown direction", Objective, direction="up")


def test_a_metric_that_is_no_number_is_named() -> None:
    """A metric that was not finite is null in mission.json."""
    result = fake_missions.well_flown(MissionConfig(), "r0", 0, {"observable": {"c2c_mean_mm": None}})
    for path, said in (
        ("observable.c2c_mean_mm", "unknown metric"),
        ("observable", "not a number; name one of"),
    ):
        refused(said, result.metric, path)


def test_standardisation_takes_away_rock_offsets_and_scales() -> None:
    rng = np.random.default_rng(0)
    rocks = np.repeat([*"abc"], 400)
    offset, scale = {"a": 10.0, "b": 50.0, "c": 90.0}, {"a": 1.0, "b": 2.0, "c": 4.0}
    y = np.array([offset[r] + scale[r] * rng.normal() for r in rocks])
    z = RockStandardiser.fit(rocks, y).standardise(rocks, y)
    for name in "abc":
        assert abs(z[rocks == name].mean()) < 0.05 and z[rocks == name].std() == pytest.approx(1, rel=0.1)
