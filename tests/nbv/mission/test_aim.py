"""A drawn rock's own height: where a mission to it aims, and what its crops hold."""

import numpy as np

from nbv.config import preset
from nbv.geometric.mission import run_geometric_mission
from nbv.mission.belief import KNOWN_MARGIN_M, aimed
from nbv.rocks import load_coarse_rock

CAMPAIGN = preset("campaign")
TALL = "boulder-20001"  # 2.6 m


def test_the_middle_of_a_drawn_rock_is_aimed_at_and_its_ends_are_kept() -> None:
    rock = load_coarse_rock(TALL)
    config = aimed(CAMPAIGN, rock)
    top_m = rock.vertices_m[:, 2].max()
    np.testing.assert_allclose(config.target_m, [0.0, 0.0, top_m / 2], atol=1e-3)
    for half_m in (config.dense.crop_half_width_m, config.evaluation.crop_half_extent_m):
        assert config.target_m[2] + half_m >= top_m
        assert half_m >= np.abs(rock.vertices_m[:, :2]).max() + KNOWN_MARGIN_M - 1e-3
    assert aimed(CAMPAIGN, load_coarse_rock("slab")) is CAMPAIGN
    chosen = CAMPAIGN.with_values({"target_m": [0.0, 0.0, 1.0]})
    assert aimed(chosen, rock) is chosen


def test_a_mission_to_a_tall_rock_keeps_the_identity_of_what_was_asked() -> None:
    result = run_geometric_mission(CAMPAIGN, TALL)
    assert result.config_digest == CAMPAIGN.digest()
