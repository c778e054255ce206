import numpy as np
import pytest
from made_evaluations import made_trial
from scipy import stats

from tuner.comparison.statistics import strategy_difference
from tuner.problem.intervals import mean_interval


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
    difference = strategy_difference(trials, "better", "reference", "f")
    assert (difference.missions, difference.rocks) == (3, 2)
    assert difference.mean == pytest.approx((1.5 - 1.0) / 2)
