"""Intervals cover what they say, and paired differences use common pairs only."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from tuner.evaluation.comparison import mean_interval, paired_difference


def coverage(rocks: int, replicates: int, rock_sd: float, trials: int = 1500) -> float:
    rng = np.random.default_rng(0)
    inside = 0
    for _ in range(trials):
        data = {f"r{i}": list(rock_sd * rng.normal() + rng.normal(size=replicates)) for i in range(rocks)}
        interval = mean_interval(data)
        assert interval is not None and interval.low is not None and interval.high is not None
        inside += interval.low <= 0 <= interval.high
    return inside / trials


def test_an_interval_covers_what_it_says() -> None:
    assert coverage(4, 2, 2.0) == pytest.approx(0.95, abs=0.02)
    assert coverage(2, 4, 0.0) == pytest.approx(0.95, abs=0.02)  # over replicates: for these rocks
    assert coverage(2, 4, 2.0) < 0.75  # not for others


def test_closed_forms() -> None:
    interval = mean_interval({"a": [1.0, 3.0], "b": [4.0], "c": [6.0]})
    assert interval is not None and interval.low is not None
    assert interval.mean == pytest.approx(4.0) and interval.method == "rocks"
    assert interval.low == pytest.approx(4 - stats.t.ppf(0.975, 2) * 2 / np.sqrt(3))
    fixed = mean_interval({"a": [1.0, 3.0], "b": [4.0, 6.0]})
    assert fixed is not None and fixed.method == "replicates" and fixed.high is not None
    # pooled variance 2, two per rock: error = sqrt(2 * (1/2 + 1/2)) / 2
    assert fixed.high == pytest.approx(3.5 + stats.t.ppf(0.975, 2) * np.sqrt(2) / 2)
    single = mean_interval({"a": [1.0], "b": [2.0]})
    assert single is not None and single.method == "none" and single.low is None
    assert mean_interval({}) is None and mean_interval({"a": []}) is None


def test_pairs() -> None:
    reference = {("a", 0): 10.0, ("a", 1): 20.0, ("b", 0): 30.0, ("c", 0): 5.0}
    better = {("a", 0): 12.0, ("a", 1): 21.0, ("b", 0): 29.0, ("d", 0): 0.0}
    difference = paired_difference(better, reference, higher_is_better=True)
    assert difference is not None
    assert difference.pairs == 3 and difference.interval.mean == pytest.approx((1.5 - 1.0) / 2)
    assert (difference.wins, difference.losses) == (2, 1)
    worse = paired_difference(better, reference, higher_is_better=False)
    assert worse is not None and (worse.wins, worse.losses) == (1, 2)
    assert paired_difference({("x", 0): 1.0}, reference, True) is None
    same = paired_difference(reference, reference, True)
    assert same is not None and same.wins == same.losses == 0
