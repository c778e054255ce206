"""Predictions made before the missions: their coverage, and the widening that past surprises ask for."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import synthetic

from tuner.surrogate.forward_check import MOST, check_ahead, half_widths_95, widening


def test_widening_follows_the_surprises_and_looks_only_back() -> None:
    calm, wild = np.full(40, 1.0), np.full(40, 3.0)
    assert widening(calm) == pytest.approx(np.ones(41))
    factors = widening(wild)
    assert factors[0] == 1 and 2.7 < factors[-1] < 3 and np.all(np.diff(factors) > 0)
    assert widening(np.array([1.0, 1.0, 9.0]))[:3] == pytest.approx(np.ones(3))


@pytest.mark.parametrize("scale", [0.7, 1.0, 2.5])
def test_intervals_hold_95_percent_whatever_the_models_standard_deviations_are_worth(scale: float) -> None:
    z = scale * np.random.default_rng(0).standard_normal((2000, 40))
    inside = np.array([np.abs(row) <= half_widths_95(row)[:-1] for row in z])
    assert inside[:, 20:].mean() == pytest.approx(0.95, abs=0.02)


def test_intervals_are_the_posterior_predictive_of_an_unknown_variance() -> None:
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


def test_widened_intervals_hold_what_a_changing_landscape_does() -> None:
    """Outcomes that grow exponentially leave the intervals of a model of what came before."""
    rng = np.random.default_rng(0)
    history = synthetic.random_design(60, 0.1, 0)
    growing = [
        dataclasses.replace(o, outcome=float(np.exp(0.1 * i + 0.3 * rng.normal())), rock="r0")
        for i, o in enumerate(history)
    ]
    steady, wild = (
        check_ahead(synthetic.SPACE, h, synthetic.ROCKS, 12, settings=None) for h in (history, growing)
    )
    assert steady is not None and wild is not None
    assert len(steady.z) == MOST
    assert steady.coverage_95 >= 0.85 and steady.factor < 1.3
    assert wild.coverage_95 < 0.8 and wild.factor > 1.5
    assert wild.coverage_95_widened > wild.coverage_95


def test_is_the_prediction_of_the_missions_before() -> None:
    history = synthetic.random_design(16, 0.1, 1)
    check = check_ahead(synthetic.SPACE, history, synthetic.ROCKS, 12)
    later = [dataclasses.replace(o, outcome=(o.outcome or 0) + 100.0 * (o.number > 13)) for o in history]
    changed = check_ahead(synthetic.SPACE, later, synthetic.ROCKS, 12)
    assert check is not None and changed is not None and len(check.z) == 4
    assert changed.z[:2] == pytest.approx(check.z[:2]) and changed.z[2] > 20
    assert check_ahead(synthetic.SPACE, history, synthetic.ROCKS, 16) is None
