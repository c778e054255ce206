"""Predictions made before the missions: their coverage, and the widening that past surprises ask for."""

from __future__ import annotations

import numpy as np
import pytest
import synthetic

from nbv.errors import UserError
from tuner.problem.observations import Observation
from tuner.surrogate.forward_check import PREDICTED, calibration, half_widths_95, widening
from tuner.surrogate.numerics import NORMAL_95


def test_widening_follows_the_surprises_and_looks_only_back() -> None:
    calm, wild = np.full(40, 1.0), np.full(40, 3.0)
    assert widening(calm) == pytest.approx(np.ones(41))
    factors = widening(wild)
    assert factors[0] == 1 and 2.7 < factors[-1] < 3 and np.all(np.diff(factors) > 0)
    assert widening(np.array([1.0, 1.0, 9.0]))[:3] == pytest.approx(np.ones(3))


def test_intervals_are_posterior_predictive_of_unknown_variance() -> None:
    """Drawn from the prior itself, exactly 95 % of every residual are inside, early or late."""
    rng = np.random.default_rng(1)
    sd = np.sqrt(5 / rng.chisquare(5, 8000))
    z = sd[:, None] * rng.standard_normal((8000, 12))
    inside = np.array([np.abs(row) <= half_widths_95(row)[:-1] for row in z])
    assert inside.mean(0) == pytest.approx(np.full(12, 0.95), abs=0.01)
    normal = np.array([np.abs(row) <= 1.96 * widening(row)[:-1] for row in z])
    assert normal.mean(0)[0] < 0.92
    assert half_widths_95(z[0])[:1] == pytest.approx(
        [2.571], abs=1e-3
    )  # Student's t, five degrees of freedom


def seen(number: int, outcome: float | None, predicted: object = None) -> Observation:
    sampler_state = {} if predicted is None else {PREDICTED: predicted}
    return Observation(number, synthetic.DEFAULT, "r0", 0, outcome, outcome, sampler_state=sampler_state)


def test_missions_are_judged_by_what_was_predicted_of_them() -> None:
    history = [seen(0, 1.0), seen(1, 3.0, [1.0, 1.0]), seen(2, None, [1.0, 1.0]), seen(3, 0.5, [1.0, 0.5])]
    found = calibration(history)
    np.testing.assert_allclose(found.z, [2.0, -1.0])
    assert found.to_dict()["coverage_95"] == 0.5
    assert found.interval_95(10.0, 2.0) == pytest.approx(
        (10 - 2 * found.half_width_95, 10 + 2 * found.half_width_95)
    )
    assert found.half_width_95 > NORMAL_95
    nothing = calibration(history[:1])
    assert (
        nothing.half_width_95 == pytest.approx(2.571, abs=1e-3) and nothing.to_dict()["coverage_95"] is None
    )


@pytest.mark.parametrize("value", ["high", 57.0, [1.0, None], [1.0, float("nan")], [1.0, 0.0]])
def test_a_prediction_that_is_none_is_one_line(value: object) -> None:
    with pytest.raises(
        UserError, match="predicted for trial 7, which is no mean and standard deviation; restore"
    ):
        calibration([seen(7, 57.0, value)])
