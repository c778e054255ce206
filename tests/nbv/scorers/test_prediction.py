"""What the dense cloud will cover, predicted from the sparse model and coarse depth: closed forms, order, whole missions."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scene_helpers import around
from scoring_state import few_seeds, sparse_model

from nbv.config import preset
from nbv.geometric import run_geometric_mission
from nbv.scorers import prediction
from nbv.scorers.prediction import predict
from nbv.scorers.registry import expected_gain_share

CONFIG = preset("campaign").with_values({"dense.agreeing_views": 3})
NO_POINTS = np.zeros((0, 3))


def orbit(count, elevation_deg=10.0, turn_deg=360.0):
    return around(turn_deg * np.arange(count) / count, elevation_deg)


def model(cameras_m, points_m=NO_POINTS, normals=NO_POINTS):
    """Cameras see the points whose normals face them, and have a depth there."""
    faces = np.einsum("pvk,pk->pv", cameras_m - points_m[:, None], normals) > 0.0
    point, camera = np.nonzero(faces)
    tracks = [np.flatnonzero(row) for row in faces]
    made = sparse_model(points_m, tracks, cameras_m)
    return dataclasses.replace(made, depth_m=points_m[point], depth_cameras=camera)


def drum(*, lid):
    """Points on the side of a drum 1.6 m high, and on its lid where it has one, with normals."""
    rng, n = np.random.default_rng(0), 4000
    bearing = rng.uniform(0, 2 * np.pi, n)
    out = np.column_stack([np.cos(bearing), np.sin(bearing), np.zeros(n)])
    side = 0.8 * out + rng.uniform(0.1, 1.6, n)[:, None] * [0.0, 0.0, 1.0]
    top = 0.8 * np.sqrt(rng.uniform(0, 1, n))[:, None] * out + [0.0, 0.0, 1.6]
    up = np.tile([0.0, 0.0, 1.0], (n, 1))
    return (np.concatenate([side, top]), np.concatenate([out, up])) if lid else (side, out)


def test_without_two_views_nothing_is_covered_and_any_view_mends_what_it_sees_with_others_beside_it():
    made = predict(model(orbit(1)), CONFIG)
    assert made.chance.max() == 0.0 and made.completeness < 0.3
    far = made.expected_gain(orbit(24), left=4)[6:19]  # a ball looks alike from everywhere
    assert np.ptp(far) < 0.3 * far.max()
    assert made.expected_gain(orbit(4)[1:]).max() == 0.0  # no view is near enough to be matched with


def test_a_gap_of_a_ring_is_filled_in_its_middle_and_where_it_is_widest():
    """Seeds every 30 degrees but for one gap of 60: a view 5 degrees beside a seed gains least."""
    seeds, side = np.delete(orbit(12), 1, axis=0), drum(lid=True)
    made = predict(model(seeds, *side), CONFIG)
    beside, between, in_the_gap = made.expected_gain(orbit(72)[[37, 39, 3]])
    assert beside < between < in_the_gap
    assert made.expected_share(orbit(24)) > made.expected_share(orbit(12)) + 0.05


def test_half_an_orbit_covers_its_half_and_the_other_half_mends_most():
    """Bearings 0 to 165 degrees: y > 0."""
    surface = drum(lid=True)
    made = predict(model(orbit(12, turn_deg=180.0), *surface), CONFIG)
    level = np.abs(made.normals[:, 2]) < 0.3
    assert made.chance[level & (made.normals[:, 1] > 0.5)].mean() > 0.7
    assert made.chance[level & (made.normals[:, 1] < -0.5)].mean() < 0.2
    expected_gain = made.expected_gain(orbit(24))
    assert orbit(24)[np.argmax(expected_gain), 1] < 0
    assert expected_gain.min() >= 0.0 and expected_gain.max() <= 1.0
    again = predict(model(np.concatenate([orbit(12, turn_deg=180.0), orbit(12)]), *surface), CONFIG)
    assert again.f_score_percent > made.f_score_percent + 3


def test_a_known_gain_is_given_again_only_where_nothing_that_decides_it_differs():
    seen, pool = model(orbit(12, turn_deg=180.0), *drum(lid=True)), SimpleNamespace(positions_m=orbit(24))
    changes = ({"dense.max_pair_angle_deg": 14.0}, {"camera.focal_px": 900.0}, {"target_m": (0.2, 0.0, 0.8)})
    for config in (CONFIG, *map(CONFIG.with_values, changes), CONFIG):
        for left in (1, 3):
            terms = SimpleNamespace(model=seen, prediction=None, left=left)
            fresh = predict(seen, config).expected_gain(pool.positions_m, left)
            np.testing.assert_array_equal(expected_gain_share(terms, pool, config), fresh)


@settings(max_examples=5)
@given(st.integers(8, 20), st.floats(0.0, 40.0))
def test_twice_the_views_are_never_predicted_to_cover_less(count, elevation_deg):
    """Of every place: in a draw of 600, as in missions, the unknown share varies by some points."""
    surface = drum(lid=True)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(prediction, "SAMPLES", 10_000)
        few, many = (predict(model(orbit(n, elevation_deg), *surface), CONFIG) for n in (count, 2 * count))
    assert many.completeness >= few.completeness - 0.01


def test_a_top_that_no_depth_has_shown_is_predicted_to_have_holes():
    cameras_m = np.concatenate([orbit(20), orbit(12, 35.0)])
    closed, unknown = (predict(model(cameras_m, *drum(lid=lid)), CONFIG) for lid in (True, False))
    assert closed.unknown < 0.05 and 0.1 < unknown.unknown < 0.5
    assert closed.f_score_percent > unknown.f_score_percent + 1.0
    assert predict(model(cameras_m), CONFIG).unknown == 1.0


@pytest.mark.parametrize("ground_m", [-0.5, 0.5])
def test_a_ground_that_telemetry_has_elsewhere_is_not_taken_for_rock(ground_m):
    """The same gains and the same score as of a model that stands on z = 0."""
    up_m = np.array([0.0, 0.0, ground_m])
    side, top = model(orbit(12, 20.0, turn_deg=180.0), *drum(lid=True)), orbit(24)
    plain = np.random.default_rng(0).uniform([-2, -2, 0], [2, 2, 0.01], (4000, 3))
    here = dataclasses.replace(
        side,
        depth_m=np.concatenate([side.depth_m, plain]),
        depth_cameras=np.concatenate([side.depth_cameras, np.arange(4000) % 12]),
    )
    moved = {name: getattr(here, name) + up_m for name in ("points_m", "depth_m", "camera_centers_m")}
    config = CONFIG.changed(target_m=(0.0, 0.0, 0.8 + ground_m), target={"ground_m": ground_m})
    known, told = predict(here, CONFIG), predict(dataclasses.replace(here, **moved), config)
    np.testing.assert_allclose(told.expected_gain(top + up_m), known.expected_gain(top), atol=0.01)
    assert told.f_score_percent == pytest.approx(known.f_score_percent, abs=0.2)


def run_mission(**values):
    config = CONFIG.with_values(
        {
            "photographs": 24,
            **few_seeds(12, radius_m=3.5),
            "gate.kind": "predicted",
            "stop.criterion": "predicted",
            **{f"predicted.weights.{term}": 0.0 for term in ("nov", "move", "ang")},
            **values,
        }
    )
    return run_geometric_mission(config, "slab-3", 0)


@pytest.mark.slow
def test_a_mission_ends_when_enough_is_predicted_and_goes_on_where_it_is_not():
    early, never = (run_mission(**{"stop.predicted_percent": percent}) for percent in (97.0, 100.0))
    assert 12 <= early.costs["images"] < 24 == never.costs["images"]
    assert {record.scorer for record in never.trace} == {"predicted"}
    assert early.metric("observable.f_score_48mm") > 96.0
    aimless = run_mission(**{"stop.predicted_percent": 100.0, "gate.kind": "movement-only"})
    assert never.metric("observable.f_score_48mm") > aimless.metric("observable.f_score_48mm")
