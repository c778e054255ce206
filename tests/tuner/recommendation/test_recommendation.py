"""The recommendation is the best configuration, not the luckiest mission."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic

from tuner.problem.objective import Objective
from tuner.problem.observations import Observation
from tuner.recommendation.recommendation import Recommendation, recommend


def advise(observations: list[Observation], rocks: tuple[str, ...] = synthetic.ROCKS) -> Recommendation:
    result = recommend(synthetic.SPACE, observations, rocks, synthetic.DEFAULT, Objective())
    assert result is not None
    return result


def test_picks_the_best_not_the_luckiest() -> None:
    """A good configuration, flown often with ordinary luck, against a poor one with one lucky mission."""
    rng = np.random.default_rng(0)
    good = synthetic.SPACE.from_unit([0.75, 0.3])
    poor = synthetic.SPACE.from_unit([0.1, 0.95])
    history = []
    for i in range(12):
        history.append(Observation(i, good, "r0", i, 60 + rng.normal(), None))
    for i in range(11):
        history.append(Observation(12 + i, poor, "r0", i, 50 + rng.normal(), None))
    history.append(Observation(23, poor, "r0", 11, 75.0, None))  # the luckiest of all
    assert max(history, key=lambda o: o.outcome or 0).values == poor
    result = advise(history, ("r0",))
    assert result.values == good
    assert result.probability_best > 0.9
    assert result.mean == pytest.approx(60, abs=2.5)
    assert result.per_rock[0].missions == 12
    assert result.per_rock[0].observed == pytest.approx(60, abs=1)


def test_beats_the_luckiest_on_average_in_noise() -> None:
    """Noise as large as the signal: the posterior mean chooses better configurations than the best score."""
    by_model, by_luck = [], []
    for seed in range(12):
        history = synthetic.random_design(32, 0.3, seed)
        by_model.append(synthetic.true_value(advise(history).values))
        standard = sorted(history, key=lambda o: -(o.outcome or 0.0))
        by_luck.append(synthetic.true_value(standard[0].values))
    assert np.mean(by_model) > np.mean(by_luck) + 0.02


def test_interval_of_the_improvement_is_honest() -> None:
    inside = 0
    for seed in range(16):
        history = synthetic.random_design(32, 0.15, seed)
        history.append(synthetic.observe(32, synthetic.DEFAULT, "r0", 0.15, np.random.default_rng(seed)))
        result = advise(history)
        truth = synthetic.true_rock_mean(result.values) - synthetic.true_rock_mean(synthetic.DEFAULT)
        low, high = result.improvement_interval_95
        inside += low <= truth <= high
        assert result.interval_95[0] < result.mean < result.interval_95[1]
    assert inside >= 13


def test_failures_are_counted_and_never_recommended() -> None:
    good = synthetic.SPACE.from_unit([0.2, 0.2])
    bad = synthetic.SPACE.from_unit([0.9, 0.9])
    history = [Observation(i, good, "r0", i, 1.0 + 0.1 * i, None) for i in range(3)]
    history += [Observation(3 + i, bad, "r0", i, None, None, "seed_model_failed") for i in range(3)]
    result = advise(history, ("r0",))
    assert result.values == good and result.failures == 3 and result.observations == 3
    assert recommend(synthetic.SPACE, history[3:], ("r0",), synthetic.DEFAULT, Objective()) is None


def test_only_the_default_flown() -> None:
    result = advise([Observation(0, synthetic.DEFAULT, "r0", 0, 1.0, None)], ("r0",))
    assert result.values == synthetic.DEFAULT and result.improvement == pytest.approx(0.0, abs=1e-9)
    assert result.probability_better_than_default == 0.5
