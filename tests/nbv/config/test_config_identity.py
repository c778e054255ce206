"""A configuration's digest: what results are found by again."""

from __future__ import annotations

import hashlib
import json

import pytest

from nbv.config import MissionConfig, canonical, config_from_dict, preset
from nbv.errors import UserError

ADDED_SINCE_VERSION_1 = {
    "flight": ("planning_s", "mass_kg", "rotor_diameter_m", "propulsion_efficiency"),
    "gate": ("geometry_scorer", "oracle_quality_weight"),
    "scene": ("sun_elevation_deg", "sun_azimuth_deg"),
    "seed": (
        "ring_radii_m",
        "ring_bearings_deg",
        "count",
        "rings",
        "lowest_deg",
        "span_deg",
        "start_bearing_deg",
        "upper_share",
        "reaim_after",
    ),
    "stop": ("max_photographs", "predicted_percent", "min_gain_percent"),
    "sparse": (
        "ground_features",
        "min_ransac_trials",
        "local_ba_images",
        "local_ba_rounds",
        "local_ba_iterations",
        "global_ba_iterations",
        "update_pairs",
    ),
    "dense": ("max_size_px", "min_baseline_angle_deg", "search"),
    "evaluation": ("floater_radius_m",),
}


def version_1(config: MissionConfig) -> dict:
    """The configuration as a mission wrote it down before the later fields existed."""
    tree = config.to_dict()
    for name in ("condition", "ground", "matchable", "sensor", "target", "telemetry", "wind"):
        del tree[name]
    for section, names in ADDED_SINCE_VERSION_1.items():
        for name in names:
            del tree[section][name]
    return tree


def test_an_added_field_changes_no_digest_until_it_is_used() -> None:
    config = preset("campaign")
    text = json.dumps(version_1(config), sort_keys=True, separators=(",", ":"))
    assert config.digest() == hashlib.sha256(text.encode()).hexdigest()[:16]
    values = {
        "gate.geometry_scorer": "matchable",
        "matchable.views": 5,
        "b_aware.theta_low_deg": 4.0,
        "pool.max_altitude_m": 1.5,
    }
    changed = {config.with_values({path: value}).digest() for path, value in values.items()}
    assert len(changed | {config.digest(), MissionConfig().digest()}) == 6


def test_the_campaign_preset_is_what_all_campaigns_flew() -> None:
    assert preset("campaign").digest() == "ebb0509a42ffd52d"


def test_a_record_of_version_1_is_the_mission_that_was_flown() -> None:
    for name in ("paper", "paper-code", "campaign"):
        assert config_from_dict(version_1(preset(name))) == preset(name)
    assert config_from_dict({"scene": {"mitsuba_samples": 16}}) == MissionConfig()  # a parameter that is gone


def test_parts_are_keyed_without_unused_added_fields() -> None:
    assert canonical(preset("campaign").dense) == version_1(preset("campaign"))["dense"]
    assert canonical(preset("paper-reduced").dense)["search"] == "sparse"


@pytest.mark.parametrize("name", ["main_term", "matchable_views"])
def test_a_file_with_an_old_name_is_told_the_new_one(name: str) -> None:
    new = {"main_term": "gate.geometry_scorer", "matchable_views": "matchable.views"}[name]
    with pytest.raises(UserError, match=f"b_aware.{name} of an earlier version is now {new}"):
        config_from_dict({"b_aware": {name: 6}})
    with pytest.raises(UserError, match=new):
        preset("campaign").with_values({f"b_aware.{name}": 6})


def test_names_are_checked_when_a_configuration_is_read() -> None:
    with pytest.raises(UserError, match=r"gate\.kind is 'hybh'; allowed: covis, b-aware, .*hyb-h"):
        MissionConfig().with_values({"gate.kind": "hybh"})
    with pytest.raises(UserError, match=r"gate\.geometry_scorer is 'hyb-h'; allowed: covis"):
        MissionConfig().with_values({"gate.geometry_scorer": "hyb-h"})
