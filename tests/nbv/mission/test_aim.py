"""A rock's own height: where it is measured, what a mission to it is told, and what its crops hold."""

import dataclasses

import numpy as np
import pytest

from nbv.config import preset
from nbv.errors import UserError
from nbv.geometric.geometric_fidelity import GeometricFidelity, run_geometric_mission
from nbv.mission.target_prior import KNOWN_MARGIN_M, with_size_error, with_true_target
from nbv.rocks import load_coarse_rock

CAMPAIGN = preset("campaign")
TALL = "boulder-20001"  # 2.6 m


def test_the_middle_of_a_drawn_rock_is_aimed_at_and_its_ends_are_kept() -> None:
    rock = load_coarse_rock(TALL)
    config = with_true_target(CAMPAIGN, rock)
    top_m = rock.vertices_m[:, 2].max()
    np.testing.assert_allclose(config.target_m, [0.0, 0.0, top_m / 2], atol=1e-3)
    for half_m in (config.dense.crop_half_width_m, config.evaluation.crop_half_extent_m):
        assert config.target_m[2] + half_m >= top_m
        assert half_m >= np.abs(rock.vertices_m[:, :2]).max() + KNOWN_MARGIN_M - 1e-3
    chosen = CAMPAIGN.with_values({"target_m": [0.0, 0.0, 1.0]})
    assert with_true_target(chosen, rock) is chosen


def test_an_imported_rock_is_aimed_at_as_high_as_it_is() -> None:
    drawn = load_coarse_rock(TALL)
    tall = dataclasses.replace(drawn, name="brought")
    true = with_true_target(CAMPAIGN, drawn)
    assert with_true_target(CAMPAIGN, tall) == true
    told = with_size_error(CAMPAIGN, tall, 3)  # without an error
    assert (told.target_m, told.dense) == (true.target_m, true.dense)
    scale = 1.6 / tall.vertices_m[:, 2].max()
    usual = dataclasses.replace(tall, vertices_m=1.005 * scale * tall.vertices_m)
    assert with_true_target(CAMPAIGN, usual) is CAMPAIGN is with_size_error(CAMPAIGN, usual, 3)


def test_a_mission_to_a_tall_rock_keeps_the_identity_of_what_was_asked() -> None:
    asked = CAMPAIGN.with_values({"photographs": 25})
    assert run_geometric_mission(asked, TALL).config_digest == asked.digest()


def test_what_plans_is_told_a_size_with_an_error_and_not_the_true_one() -> None:
    rock = load_coarse_rock(TALL)
    truth_m = with_true_target(CAMPAIGN, rock).target_m[2]
    beliefs = [with_size_error(CAMPAIGN, rock, replicate) for replicate in range(200)]
    ratio = np.array([belief.target_m[2] for belief in beliefs]) / truth_m
    assert 0.79 < ratio.min() < 0.83 and 1.17 < ratio.max() < 1.21 and abs(ratio.mean() - 1.0) < 0.03
    # The true half extents lie within the crop, whichever way the error went; and the crop says no more than the belief.
    assert all(b.dense.crop_half_width_m > max(truth_m, np.abs(rock.vertices_m).max() / 2) for b in beliefs)
    assert with_size_error(CAMPAIGN, rock, 3) == with_size_error(CAMPAIGN, load_coarse_rock(TALL), 3)
    known = CAMPAIGN.with_values({"target.size_error_percent": 0.0})
    assert with_size_error(known, rock, 3).target_m[2] == truth_m
    planned_by = []

    class Seen(GeometricFidelity):
        def __init__(self, context):
            super().__init__(context)
            planned_by.append(self.vehicle_config)

    for replicate in (0, 1):
        Seen.run(CAMPAIGN.with_values({"photographs": 25}), TALL, replicate)
        assert planned_by[-1].target_m == beliefs[replicate].target_m
        assert planned_by[-1].dense == beliefs[replicate].dense


def test_heights_may_count_from_the_target_and_ground_lies_below_it():
    config = preset("campaign").with_values({"target_m": [0.0, 0.0, 0.0]})
    for below_m in (0.0, -0.8):  # 0: nothing is known of it
        config.with_values({"target.ground_m": below_m}).require_flyable()
    with pytest.raises(UserError, match=r"target\.ground_m 0\.1 is not below"):
        config.with_values({"target.ground_m": 0.1}).require_flyable()
