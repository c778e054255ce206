"""Outcomes that drift with the number of the trial are told, since the default flies first."""

from types import SimpleNamespace

import numpy as np

from tuner.answer.effects import drift_of


def model(residuals):
    numbers = range(len(residuals))
    return SimpleNamespace(
        observations=[SimpleNamespace(number=n) for n in numbers],
        fitted_to=list(numbers),
        leave_one_out_z=lambda: np.asarray(residuals),
    )


def test_residuals_that_rise_with_the_trial_are_a_drift_and_noise_is_none():
    noise = np.random.default_rng(0).normal(size=40)
    assert drift_of(model(noise)) is None
    assert drift_of(model(noise + np.arange(40) / 10)) > 0.5
    assert drift_of(model(np.arange(8.0))) is None  # too few to tell
