import math

import fake_missions
import numpy as np
import pytest

from nbv.config import MissionConfig
from nbv.errors import UserError
from tuner.problem.goal import Objective, direction_of
from tuner.problem.standardise import RockStandardiser


def test_failed_and_missing_are_infeasible_degraded_counts() -> None:
    objective = Objective("observable.f_score_48mm")
    metrics = {"observable": {"f_score_48mm": 61.5, "list": [1]}}
    assert objective.value_or_reason("ok", metrics) == (61.5, "")
    assert objective.value_or_reason("degraded", metrics)[0] == 61.5
    assert objective.value_or_reason("failed", metrics)[0] is None
    assert objective.value_or_reason("ok", {})[0] is None
    assert objective.value_or_reason("ok", {"observable": {"f_score_48mm": math.nan}})[0] is None
    assert objective.value_or_reason("ok", {"observable": {"f_score_48mm": None}})[0] is None
    assert Objective("observable.list").value_or_reason("ok", metrics)[0] is None
    assert Objective(direction="minimise").sign == -1
    assert direction_of("observable.accuracy_48mm") == "maximise"
    with pytest.raises(UserError, match="unknown direction"):
        Objective(direction="up")


def test_a_metric_that_is_no_number_is_named() -> None:
    """A metric that was not finite is null in mission.json."""
    result = fake_missions.well_flown(MissionConfig(), "r0", 0, {"observable": {"c2c_mean_mm": None}})
    for path, said in (
        ("observable.c2c_mean_mm", "unknown metric"),
        ("observable", "not a number; name one of"),
    ):
        with pytest.raises(UserError, match=said):
            result.metric(path)


def test_standardisation_takes_away_rock_offsets_and_scales() -> None:
    rng = np.random.default_rng(0)
    rocks = np.repeat([*"abc"], 400)
    offset, scale = {"a": 10.0, "b": 50.0, "c": 90.0}, {"a": 1.0, "b": 2.0, "c": 4.0}
    y = np.array([offset[r] + scale[r] * rng.normal() for r in rocks])
    z = RockStandardiser.fit(rocks, y).standardise(rocks, y)
    for name in "abc":
        assert abs(z[rocks == name].mean()) < 0.05 and z[rocks == name].std() == pytest.approx(1, rel=0.1)
