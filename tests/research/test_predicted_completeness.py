"""The prediction's calibration, against the recorded states that it was fitted to and those that judge it."""

import csv
from dataclasses import astuple
from pathlib import Path

import numpy as np
import pytest

from nbv.scorers.prediction import CALIBRATION
from research.other_shapes import KEPT, LATER
from research.predict_completeness import TOLD_FROM, column, features, fit, percent

DATA = Path(__file__).parents[2] / "docs" / "results" / "data"


def states(name):
    with (DATA / name).open() as file:
        return list(csv.DictReader(file))


def test_the_calibration_is_the_fit_of_the_training_states():
    assert np.round(fit(states("predicted_completeness.csv")), 2) == pytest.approx(astuple(CALIBRATION))


def test_on_shapes_that_nothing_was_fitted_to_it_is_seldom_too_high_and_done_means_done():
    rows = [row for row in states("other_shapes.csv") if int(row["photographs"]) >= TOLD_FROM]
    assert {row["rock"] for row in rows} == {make.__name__ for make in (*KEPT, *LATER)}
    completeness = 1.0 / (1.0 + np.exp(-features(rows) @ astuple(CALIBRATION)))
    told, real = 200.0 * completeness / (1.0 + completeness), percent(rows, "completeness")
    assert (told - real > 5.0).mean() <= 0.05
    assert (real[told >= 98.0] >= 97.0).mean() >= 0.95
    assert column(rows, "predicted") == pytest.approx(completeness, abs=1e-3)
