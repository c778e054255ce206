"""A configuration's digest: what results are found by again."""

from __future__ import annotations

import hashlib
import json

import pytest

from nbv.config import ECONOMIES, MissionConfig, canonical, config_from_dict, preset

CAME_LATER = {
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


def before(config: MissionConfig) -> dict:
    """The configuration as a mission wrote it down before the later fields existed."""
    tree = config.to_dict()
    for room, names in CAME_LATER.items():
        for name in names:
            del tree[room][name]
    return tree


def test_a_field_that_came_later_changes_nothing_until_it_is_used() -> None:
    config = preset("campaign")
    tree = before(config)
    text = json.dumps(tree, sort_keys=True, separators=(",", ":"))
    assert config.digest() == hashlib.sha256(text.encode()).hexdigest()[:16]
    changed = {config.with_values({p: v}).digest() for p, v in (
        ("b_aware.main_term", "matchable"), ("b_aware.matchable_views", 5), ("b_aware.theta_low_deg", 4.0),
        ("pool.max_altitude_m", 1.5))}  # fmt: skip
    assert len(changed | {config.digest(), MissionConfig().digest()}) == 6


def test_the_campaign_preset_is_the_mission_that_all_campaigns_flew() -> None:
    assert preset("campaign").digest() == "ebb0509a42ffd52d"


@pytest.mark.parametrize("name", ["paper", "paper-code"])
def test_the_economies_are_all_that_the_papers_presets_change_about_earlier_missions(name: str) -> None:
    """A record that lacks the later fields is the mission that was flown, not what the preset is now."""
    now = preset(name)
    earlier = config_from_dict(
        before(now.with_values({"sparse.max_pairs": 12, "sparse.global_ba_interval": 5}))
    )
    assert {path.split(".")[0] for path in ECONOMIES} == {"sparse", "dense"}
    assert earlier.digest() != now.digest()
    assert earlier.with_values(ECONOMIES) == now.with_values(ECONOMIES)
    assert earlier.sparse.local_ba_images == 6 and earlier.dense.search == "crop"


def test_parts_of_a_configuration_are_keyed_without_unused_later_fields() -> None:
    assert canonical(preset("campaign").dense) == before(preset("campaign"))["dense"]
    assert canonical(preset("paper").dense)["search"] == "sparse"
