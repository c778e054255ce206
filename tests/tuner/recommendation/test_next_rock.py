"""What a recommendation gains on a rock that nobody has flown."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic

from tuner.problem.observations import Observation
from tuner.recommendation.next_rock import next_rock
from tuner.recommendation.recommendation import NextRock
from tuner.surrogate.forward_check import Calibration
from tuner.surrogate.model import RockMeanGP
from tuner.surrogate.settings import SurrogateSettings

GOOD, DEFAULT = synthetic.SPACE.from_unit([0.9, 0.5]), synthetic.SPACE.from_unit([0.1, 0.5])


def stated(slopes: list[float], missions: int = 12, seed: int = 0) -> NextRock:
    """Outcomes rise along the first parameter by each rock's slope; the gain of GOOD is 0.8 of it."""
    rng = np.random.default_rng(seed)
    history = []
    for rock, slope in enumerate(slopes):
        for _ in range(missions):
            values = synthetic.SPACE.from_unit(rng.random(2))
            y = 90.0 + slope * synthetic.SPACE.to_unit(values)[0] + 0.1 * rng.normal()
            history.append(Observation(len(history), values, f"r{rock}", 0, y, y))
    rocks = [f"r{rock}" for rock in range(len(slopes))]
    model = RockMeanGP(synthetic.SPACE, history, rocks, settings=SurrogateSettings(own_landscapes=True))
    return next_rock(model, GOOD, DEFAULT, Calibration(np.zeros(0)))


def test_where_rocks_agree_the_gain_is_stated_and_settled() -> None:
    found = stated([2.0, 2.1, 1.9, 2.0, 2.05, 1.95])
    assert found.gain == pytest.approx(1.6, abs=0.3) and found.interval_95[0] > 0
    assert found.against == () and not found.warnings()


def test_where_rocks_disagree_the_interval_says_so() -> None:
    found = stated([2.0, -2.0, 2.0, 1.0])
    agree = stated([2.0, 2.1, 1.9, 2.0])
    assert found.against == ("r1",) and found.per_rock["r1"] < -1
    assert found.interval_95[0] < -1.0 and found.interval_95[1] > 1.6
    assert np.ptp(found.interval_95) / found.gain > 2 * np.ptp(agree.interval_95) / agree.gain
    assert "worse than the default on r1" in found.warnings()[0] and not agree.warnings()
