"""Intervals by their closed forms, and paired differences of common pairs only."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from tuner.evaluation.comparison import mean_interval, paired_difference


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
