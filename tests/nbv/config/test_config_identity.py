"""A configuration's digest: what results are found by again."""

from __future__ import annotations

import hashlib
import json

from nbv.config import MissionConfig, canonical, config_from_dict, preset

ADDED_SINCE_VERSION_1 = {
    "b_aware": ("main_term", "matchable_views"),
    "sparse": (
        "min_ransac_trials",
        "local_ba_images",
        "local_ba_rounds",
        "local_ba_iterations",
        "global_ba_iterations",
        "update_pairs",
    ),
    "dense": ("min_baseline_angle_deg", "search"),
}


def version_1(config: MissionConfig) -> dict:
    """The configuration as a mission wrote it down before the later fields existed."""
    tree = config.to_dict()
    for section, names in ADDED_SINCE_VERSION_1.items():
        for name in names:
            del tree[section][name]
    return tree


def test_an_added_field_changes_no_digest_until_it_is_used() -> None:
    config = preset("campaign")
    text = json.dumps(version_1(config), sort_keys=True, separators=(",", ":"))
    assert config.digest() == hashlib.sha256(text.encode()).hexdigest()[:16]
    values = {
        "b_aware.main_term": "matchable",
        "b_aware.matchable_views": 5,
        "b_aware.theta_low_deg": 4.0,
        "pool.max_altitude_m": 1.5,
    }
    changed = {config.with_values({path: value}).digest() for path, value in values.items()}
    assert len(changed | {config.digest(), MissionConfig().digest()}) == 6


def test_the_campaign_preset_is_the_mission_that_all_campaigns_flew() -> None:
    assert preset("campaign").digest() == "ebb0509a42ffd52d"


def test_a_record_of_version_1_is_the_mission_that_was_flown() -> None:
    for name in ("paper", "paper-code", "campaign"):
        assert config_from_dict(version_1(preset(name))) == preset(name)


def test_parts_of_a_configuration_are_keyed_without_unused_added_fields() -> None:
    assert canonical(preset("campaign").dense) == version_1(preset("campaign"))["dense"]
    assert canonical(preset("paper-reduced").dense)["search"] == "sparse"
