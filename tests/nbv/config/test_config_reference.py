"""Every parameter says what it is and where its default comes from; presets change only what they say."""

from __future__ import annotations

import pytest

from nbv.config import PRESETS, MissionConfig, parameters, preset


@pytest.mark.parametrize("path", parameters())
def test_a_parameter_has_a_meaning_and_a_source(path: str) -> None:
    about = parameters()[path]
    assert about.meaning
    assert about.source in ("text", "code", "gatetune")
    assert about.reason or about.source == "gatetune"  # the place in the paper or the public code


def test_what_the_paper_prints_is_marked_as_its_text() -> None:
    """Section III of the paper, Eq. 1 to 9."""
    printed = {
        "seed.radius_m": 4.0,
        "seed.ring_azimuth_counts": (8, 6, 6, 4),
        "pool.radius_m": 3.5,
        "pool.upper_elevations_deg": (35.0, 45.0, 55.0),
        "covis.weights.nov": 1.2,
        "b_aware.weights.ang": 0.4,
        "shared.d_travel_m": 10.0,
        "b_aware.alpha_track": 0.6,
        "b_aware.theta_saturation_deg": 25.0,
        "gate.budget_fraction": 0.4,
        "gate.d95_m": 0.14,
        "gate.oracle_samples": 30_000,
        "stop.criterion": "both",
    }
    for path, value in printed.items():
        assert (parameters()[path].source, parameters()[path].default) == ("text", value), path


def test_the_paper_s_preset_is_the_defaults_and_changes_nothing() -> None:
    assert preset("paper") == MissionConfig()
    assert PRESETS["paper"].values == {}
    reduced = {path.split(".")[0] for path in PRESETS["paper-reduced"].values}
    assert reduced == {"sparse", "dense"}  # the same flight rules, scorers, gate and metrics
