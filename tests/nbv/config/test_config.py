"""A configuration: its digest, what results are found by again; values that cannot be are refused by name; presets."""

import math

import numpy as np
import pytest
from refusals import refused
from scoring_state import few_seeds

from nbv.config import PRESETS, MissionConfig, SceneConfig, config_from_dict, preset
from nbv.errors import UserError


def test_the_campaign_preset_is_what_all_campaigns_flew() -> None:
    assert preset("campaign").digest() == "8d7f3cddffe7c7c6"


def test_names_are_checked_when_a_configuration_is_read() -> None:
    with pytest.raises(UserError, match=r"gate\.kind is 'hybh'; allowed: covis, b-aware, .*hyb-h"):
        MissionConfig().with_values({"gate.kind": "hybh"})
    with pytest.raises(UserError, match=r"gate\.geometry_scorer is 'hyb-h'; allowed: covis"):
        MissionConfig().with_values({"gate.geometry_scorer": "hyb-h"})


def test_a_parameter_has_one_value() -> None:
    with pytest.raises(UserError, match="has two values; leave one out"):
        config_from_dict({"seed.span_deg": 9.0, "seed": {"span_deg": 8.0}})


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"scene.sun_direction": [0.0, 0.5, 0.5]}, "scene.sun_direction is"),
        ({"scene.sun_elevation_deg": "high"}, "scene.sun_elevation_deg is"),
        ({"sensor.focal_error_percent": -100.0}, "sensor.focal_error_percent is"),
        ({"telemetry.attitude_noise_deg": 1.0}, "^telemetry.horizontal_noise_m is 0.0; .* a covariance"),
        ({"telemetry.lever_arm_m": [0.1, 0.0, 0.0]}, "^telemetry.horizontal_noise_m is 0.0; .* a covariance"),
        ({"telemetry.horizontal_noise_m": 0.1}, "^telemetry.vertical_noise_m is 0.0; .* a covariance"),
        ({"wind.mean_speed_m_s": 5}, "wind.mean_speed_m_s 5 .* than the vehicle can hold .flight.max_"),
        ({"sparse.ground_features": 0}, "45 degrees apart.*seeds to 15"),
        ({"sparse.min_registered_seeds": 12}, "below sparse.min_registered_seeds 12"),
        ({"photographs": 7}, "seeds is 8, more than the 7 photographs"),
        ({"seed.upper_share": 0.4, "seeds": 24, "sparse.ground_features": 0}, "26 degrees apart"),
        ({"seed.ring_elevations_deg": [], "seed.ring_azimuth_counts": []}, "at least one ring"),
        ({"seed.ring_azimuth_counts": [0, 0, 0, 0]}, "azimuth_counts is .* at least 1"),
        ({"seed.lowest_deg": -8.0}, "meets the ground: it lies at 0.24 m, and the camera flies no lower"),
        ({"seed.upper_share": 0.4, "seed.span_deg": -30.0}, "meets the ground"),
        ({"seed.ring_azimuth_counts": [3]}, "as long as ring_elevations_deg"),
        ({"seed.recentre_after": 2}, "at least 3: fewer photographs make no model"),
    ],
)
def test_values_that_cannot_be_are_refused(values: dict, says: str) -> None:
    refused(says, MissionConfig().with_values(few_seeds(8)).with_values, values)


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("dense.neighbours", 128),
        ("dense.max_pair_angle_deg", 181.0),
        ("dense.consistency_views", 255),
        ("dense.fusion_voxel_m", 0.0),
        ("evaluation.ground_max_tilt_deg", 90.0),
        ("evaluation.sor_neighbours", 0),
        ("evaluation.thresholds_mm", [-5.0]),
        ("sensor.exposure_ev", 2000.0),
    ],
)
def test_what_would_fail_after_the_flight_is_refused_before(path: str, value: object) -> None:
    refused(f"^{path} is .*; (it|each) must be ", MissionConfig().with_values, {path: value})


def test_a_sun_is_where_its_angles_put_it() -> None:
    def travel(**values: float | None) -> np.ndarray:
        config = MissionConfig().with_values({f"scene.{name}": value for name, value in values.items()})
        return np.array(config.scene.sun_travel)

    assert travel() == pytest.approx(SceneConfig().sun_direction, abs=0)
    low = travel(sun_elevation_deg=20.0, sun_azimuth_deg=90.0)  # in the north: light travels south
    assert low == pytest.approx([0.0, -math.cos(math.radians(20)), -math.sin(math.radians(20))], abs=1e-12)
    # One angle alone: the other stays that of the direction.
    today = travel() / np.linalg.norm(travel())
    lower, turned = travel(sun_elevation_deg=20.0), travel(sun_azimuth_deg=0.0)
    assert lower[:2] / np.linalg.norm(lower[:2]) == pytest.approx(today[:2] / np.linalg.norm(today[:2]))
    assert turned == pytest.approx([-np.linalg.norm(today[:2]), 0.0, today[2]], abs=1e-12)
    assert travel(sun_elevation_deg=None, sun_azimuth_deg=None) == pytest.approx(travel(), abs=0)


def test_the_paper_s_preset_is_the_defaults_and_changes_nothing() -> None:
    assert preset("paper") == MissionConfig()
    assert PRESETS["paper"].values == {}
    reduced = {path.split(".")[0] for path in PRESETS["paper-reduced"].values}
    assert reduced == {"sparse", "dense"}  # the same flight rules, scorers, gate and metrics
