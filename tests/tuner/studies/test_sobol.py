"""Sobol indices against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from tuner.studies.sensitivity.sobol import bootstrap_interval, main_effect_map, sobol_design, sobol_indices

A, B = 7.0, 0.1


def ishigami(unit):
    x = (2 * unit - 1) * np.pi
    return np.sin(x[:, 0]) + A * np.sin(x[:, 1]) ** 2 + B * x[:, 2] ** 4 * np.sin(x[:, 0])


def ishigami_truth():
    """(first, total, second of (0, 2), variance) in closed form."""
    v1 = 0.5 * (1 + B * np.pi**4 / 5) ** 2
    v2 = A**2 / 8
    v13 = B**2 * np.pi**8 * (1 / 18 - 1 / 50)
    v = v1 + v2 + v13
    return np.array([v1, v2, 0]) / v, np.array([v1 + v13, v2, v13]) / v, v13 / v, v


def test_ishigami_has_its_closed_form_indices():
    design = sobol_design(3, 4096, seed=0, pairs=[(0, 2), (0, 1)])
    found = sobol_indices(design, ishigami(design.points))
    first, total, second, variance = ishigami_truth()
    assert found.first == pytest.approx(first, abs=0.01)
    assert found.total == pytest.approx(total, abs=0.01)
    assert found.second == pytest.approx([second, 0.0], abs=0.02)
    assert found.variance == pytest.approx(variance, rel=0.01)


def test_an_additive_function_has_no_interaction():
    weights = np.array([3.0, 2.0, 1.0, 0.0])
    design = sobol_design(4, 1024, seed=1, pairs=[(0, 1)])
    found = sobol_indices(design, 100.0 + design.points @ weights)  # far from 0: cancellation would show
    expected = weights**2 / (weights**2).sum()
    assert found.first == pytest.approx(expected, abs=0.01)
    assert found.total == pytest.approx(expected, abs=0.01)
    assert found.second == pytest.approx([0.0], abs=0.02)
    assert found.first.sum() == pytest.approx(1.0, abs=0.02)


def test_a_pure_product_is_all_interaction():
    design = sobol_design(2, 2048, seed=2, pairs=[(0, 1)])
    found = sobol_indices(design, np.prod(design.points - 0.5, axis=1))
    assert found.first == pytest.approx([0, 0], abs=0.02)
    assert found.total == pytest.approx([1, 1], abs=0.02)
    assert found.second == pytest.approx([1], abs=0.04)


def test_a_flat_function_has_no_indices():
    design = sobol_design(2, 64, seed=0, pairs=[(0, 1)])
    found = sobol_indices(design, np.full(len(design.points), 3.0))
    assert np.isnan(found.first).all() and np.isnan(found.total).all() and np.isnan(found.second).all()


def test_several_functions_at_once():
    design = sobol_design(3, 256, seed=0, pairs=[(0, 2)])
    x = design.points
    both = np.stack([ishigami(x), x @ np.array([1.0, 0.0, 0.0])])
    found = sobol_indices(design, both)
    alone = sobol_indices(design, both[0])
    assert found.first.shape == (2, 3) and found.second.shape == (2, 1)
    assert found.first[0] == pytest.approx(alone.first) and found.second[0] == pytest.approx(alone.second)


def test_the_bootstrap_covers_the_truth():
    first, total, second, _ = ishigami_truth()
    design = sobol_design(3, 1024, seed=5, pairs=[(0, 2)])
    low, high = bootstrap_interval(design, ishigami(design.points), seed=0)
    assert (low.first <= first).all() and (first <= high.first).all()
    assert (low.total <= total + 0.01).all() and (total <= high.total + 0.01).all()
    assert low.second[0] <= second <= high.second[0]
    # Functions that disagree widen it.
    disagree = np.stack([ishigami(design.points), ishigami(design.points[:, [2, 1, 0]])])
    wide_low, wide_high = bootstrap_interval(design, disagree, seed=0)
    assert (wide_high.first - wide_low.first)[0] > 2 * (high.first - low.first)[0]


def test_the_map_averages_the_other_inputs():
    found = main_effect_map(lambda u: u[:, 0] + 10 * u[:, 2] + 4 * u[:, 1] ** 2, 3, (0, 2), 5, 256, seed=0)
    centres = (np.arange(5) + 0.5) / 5
    assert found == pytest.approx(centres[:, None] + 10 * centres[None] + 4 / 3, abs=0.02)
