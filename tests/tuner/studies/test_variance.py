"""Analysis of variance: exact on hand-made designs, unbiased and calibrated on random ones."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from tuner.studies.noise.variance import largest_complete, pooled_variance, variance_components


def effects_design(rng, c=12, k=5, r=3, sd_c=2.0, sd_cr=1.0, sd_r=4.0, sd_b=0.8, sd_e=1.5):
    """(C, K, R) draws of the model."""
    return (
        50.0
        + sd_c * rng.normal(size=(c, 1, 1))
        + sd_cr * rng.normal(size=(c, k, 1))
        + sd_r * rng.normal(size=(1, k, 1))
        + sd_b * rng.normal(size=(1, k, r))
        + sd_e * rng.normal(size=(c, k, r))
    )


def test_a_design_without_noise_is_split_exactly():
    """Additive in configuration and rock: their sample variances come back, everything else is 0."""
    c, k = np.array([1.0, 4.0, 7.0]), np.array([10.0, 30.0])
    y = np.broadcast_to(c[:, None, None] + k[None, :, None], (3, 2, 4)).copy()
    found = variance_components(y)
    assert found.configuration == pytest.approx(np.var(c, ddof=1))
    assert found.rock == pytest.approx(np.var(k, ddof=1))
    for zero in (found.configuration_rock, found.replicate, found.residual, found.within):
        assert zero == pytest.approx(0.0, abs=1e-12)
    assert found.between == pytest.approx(9.0)
    assert found.signal_to_noise == np.inf
    assert found.shares()["rock"] == pytest.approx(200 / 209)


def test_shared_draws_are_not_taken_for_residuals():
    """A draw that all configurations share leaves no residual: paired comparisons would be exact."""
    block = np.array([[0.0, 2.0], [0.0, -2.0]])
    y = np.array([0.0, 1.0, 2.0])[:, None, None] + block[None]
    found = variance_components(y)
    assert found.residual == pytest.approx(0.0, abs=1e-12)
    assert found.replicate == pytest.approx(2.0)  # variance of {0, 2}
    assert found.within == pytest.approx(2.0)
    assert found.paired_signal_to_noise == np.inf
    assert found.signal_to_noise == pytest.approx(1.0 / (2.0 / 2))


def test_components_are_unbiased():
    rng = np.random.default_rng(1)
    runs = [variance_components(effects_design(rng)) for _ in range(600)]
    truth = {
        "configuration": 4.0,
        "configuration_rock": 1.0,
        "rock": 16.0,
        "replicate": 0.64,
        "residual": 2.25,
        "within": 2.89,
        "between": 4.0 + 1.0 / 5,
        "noise": 2.89 / 5,
    }
    for name, expected in truth.items():
        draws = np.array([getattr(run, name) for run in runs])
        error = draws.std() / np.sqrt(len(draws))
        assert abs(draws.mean() - expected) < 4 * error, name


@pytest.mark.parametrize("sd_b, tolerance", [(0.0, 0.02), (1.0, 0.04)])
def test_the_interval_covers_as_often_as_it_says(sd_b, tolerance):
    """Variance between configurations on these rocks is a random draw; its expectation is the model's."""
    rng = np.random.default_rng(2)
    hits, trials = 0, 1500
    true = (4.0 + 1.0 / 5) / ((2.25 + sd_b**2) / 5)
    for _ in range(trials):
        low, high = variance_components(effects_design(rng, sd_b=sd_b)).signal_to_noise_interval()
        hits += low <= true <= high
    assert abs(hits / trials - 0.95) < tolerance


def test_one_rock_cannot_tell_the_interaction():
    found = variance_components(effects_design(np.random.default_rng(0), k=1))
    assert np.isnan(found.configuration_rock) and np.isnan(found.unseen_signal_to_noise)
    assert found.signal_to_noise > 0 and sum(found.shares().values()) == pytest.approx(1.0)


def test_the_largest_complete_part_of_a_design_with_holes():
    y = effects_design(np.random.default_rng(0), c=6, k=2, r=3)
    y[1, 0, 1] = np.nan  # one failed mission: its configuration goes
    values, kept, replicates = largest_complete(y)
    assert kept == [0, 2, 3, 4, 5] and replicates == 3 and np.array_equal(values, y[kept])
    y[:, 1, 2] = np.nan  # interrupted in the third replicate: the first two are used
    values, kept, replicates = largest_complete(y)
    assert kept == [0, 2, 3, 4, 5] and replicates == 2
    y[2:, 0, 0] = np.nan
    assert len(largest_complete(y)[0]) == 0


@pytest.mark.parametrize("shape", [(1, 2, 2), (3, 2, 1), (3, 0, 2), (3, 4)])
def test_designs_without_replication_are_refused(shape):
    with pytest.raises(ValueError, match="need"):
        variance_components(np.zeros(shape))


def test_pooled_variance_is_the_chi_squared_one():
    variance, low, high, degrees = pooled_variance(
        [np.array([1.0, 3.0]), np.array([10.0, 10.0, 13.0]), np.array([5.0])]
    )
    assert (variance, degrees) == (pytest.approx((2 + 6) / 3), 3)
    assert low == pytest.approx(8 / stats.chi2.ppf(0.975, 3)) and high == pytest.approx(
        8 / stats.chi2.ppf(0.025, 3)
    )
    assert pooled_variance([np.array([1.0])]) is None
