"""The scorers against the authors' numbers (tests/data/golden_scorers) and against closed forms."""

from __future__ import annotations

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scoring_state
from scoring_state import sparse_model

from nbv.config import BAwareConfig, MissionConfig, Weights
from nbv.errors import MissionFailure
from nbv.scorers import Rankings
from nbv.scorers.registry import geometry_gain, mean_neighbour_distance
from nbv.scorers.scorer import angular_penalty, box_points, novelty
from nbv.types import CandidatePool, PlanningState, SparseModel

TARGET = np.array([0.0, 0.0, 0.8])


def observed(points: np.ndarray, offsets: list[int], cameras: list[int], centers: np.ndarray) -> SparseModel:
    arrays = (np.ones(len(points)), np.array(offsets), np.array(cameras, dtype=int), centers)
    return SparseModel(points, *arrays, camera_names=(), alignment_rms_m=0.0, alignment_max_m=0.0)


def ring(angles_deg: list[float], radius: float = 3.5, z: float = 0.8) -> np.ndarray:
    a = np.deg2rad(angles_deg)
    return np.column_stack([radius * np.cos(a), radius * np.sin(a), np.full(len(a), z)])


pool_at = functools.partial(scoring_state.pool_at, target_m=TARGET)


def state_of(points: np.ndarray, tracks: list[list[int]], cameras: np.ndarray) -> PlanningState:
    model = scoring_state.sparse_model(points, tracks, cameras)
    return PlanningState(model, cameras, len(cameras), np.array([3.5, 0.0, 0.8]), np.pi, 0, 40, 0.1, 0)


def test_novelty() -> None:  # Eq. 2
    candidates = np.array([[0.0, 0, 0], [0.5, 0, 0], [9.0, 0, 0]])
    np.testing.assert_allclose(novelty(candidates, np.array([[0.0, 0, 0], [0, 1, 0]]), 2.0), [0, 0.25, 1])
    np.testing.assert_array_equal(novelty(candidates, np.zeros((0, 3)), 2.0), 1.0)


def test_angular_penalty() -> None:  # Eq. 4
    candidates = ring([0.0, 5.0, 20.0, 90.0])
    visited = ring([0.0], radius=4.0)  # another radius, the same direction
    np.testing.assert_allclose(
        angular_penalty(candidates, visited, TARGET, 20.0), [1, 0.75, 0, 0], atol=1e-12
    )
    np.testing.assert_array_equal(angular_penalty(candidates, np.zeros((0, 3)), TARGET, 20.0), 0.0)


def test_the_nearest_neighbour_alone_may_be_the_density() -> None:  # Eq. 6
    on_a_line = np.column_stack([[0.0, 1.0, 3.0], np.zeros(3), np.zeros(3)])
    np.testing.assert_allclose(mean_neighbour_distance(on_a_line, 1), [1.0, 1.0, 2.0])


def test_geometry_gain() -> None:  # Eq. 7
    point = TARGET[None]
    candidates = ring([0.0, 5.0, 15.0, 25.0, 40.0, 180.0])
    gain = geometry_gain(candidates, observed(point, [0, 1], [0], ring([0.0], 4.0)), BAwareConfig())
    np.testing.assert_allclose(gain[0], [0, 0, 0.5, 1, 1, 1], atol=1e-9)
    # A second ray at 40 degrees: the nearest counts.
    gain = geometry_gain(candidates, observed(point, [0, 2], [0, 1], ring([0.0, 40.0])), BAwareConfig())
    np.testing.assert_allclose(gain[0], [0, 0, 0.5, 0.5, 0, 1], atol=1e-9)


def test_a_whole_state() -> None:  # Eq. 1
    """One point at the target, seen from azimuths 0 and 40 degrees; two candidates, at 20 and 180."""
    cameras = ring([0.0, 40.0])
    state = state_of(TARGET[None], [[0, 1]], cameras)
    pool = pool_at(ring([20.0, 180.0]))
    rankings = Rankings(state, pool, MissionConfig())

    chord = 2 * 3.5 * np.sin(np.deg2rad(10.0))
    nov = np.array([chord / 2.0, 1.0])
    move = np.array([0.07 * chord + 0.3 * 20 / 180, 0.07 * 7.0 + 0.3])
    covis, b_aware = rankings["covis"], rankings["b-aware"]
    np.testing.assert_allclose(covis.terms["main"], [1.0, 1.0])
    np.testing.assert_allclose(b_aware.terms["main"], [15 / 20, 1.0], atol=1e-9)
    for ranking in (covis, b_aware):
        np.testing.assert_allclose(ranking.terms["nov"], nov)
        np.testing.assert_allclose(ranking.terms["move"], move)
        np.testing.assert_allclose(ranking.terms["ang"], [0.0, 0.0], atol=1e-12)
        np.testing.assert_allclose(ranking.scores, ranking.terms["main"] + 1.2 * nov - 0.1 * move)
        assert ranking.order.tolist() == [1, 0] and ranking.top == 1


def test_ties_keep_pool_order() -> None:
    state = state_of(TARGET[None], [[0, 1]], ring([0.0, 180.0]))
    config = MissionConfig().with_values({"covis.weights.move": 0.0})
    pool = pool_at(ring([270.0, 90.0]))  # mirror images
    assert Rankings(state, pool, config)["covis"].order.tolist() == [0, 1]
    pool = pool_at(ring([90.0, 270.0]))
    assert Rankings(state, pool, config)["covis"].order.tolist() == [0, 1]


def test_box_and_track_length_choose_the_points() -> None:
    points = TARGET + np.array([[2.0, 0, 0], [2.001, 0, 0], [0, 0, -2.0], [0, 0, 0]])
    state = state_of(points, [[0, 1], [0, 1], [1, 2, 3], [3]], ring([0, 90, 180, 270]))
    box = box_points(state.model, MissionConfig())
    np.testing.assert_array_equal(box.points_m, points[[0, 2]])
    assert box.track_lengths.tolist() == [2, 3] and box.track_cameras.tolist() == [0, 1, 1, 2, 3]


def test_an_empty_box_is_a_mission_failure() -> None:
    state = state_of(TARGET[None] + 50.0, [[0, 1]], ring([0.0, 40.0]))
    with pytest.raises(MissionFailure) as failure:
        Rankings(state, pool_at(ring([0.0])), MissionConfig())
    assert failure.value.reason == "no_points_in_box"


GOLDEN = Path(__file__).parents[2] / "data" / "golden_scorers"
NAMES = [
    "15016_seed_paper_weights",
    "15016_40_views_paper_weights",
    "15016_40_views_low_novelty_10deg_ring",
    "65035_40_views_other_weights",
]
CASES = {  # golden array -> (scorer, alphas)
    "covis": ("covis", (0.6, 0.4, 0.0)),
    "baware_paper": ("b-aware", (0.6, 0.4, 0.0)),
    "baware_head": ("b-aware", (0.5, 0.3, 0.2)),
}


def load(name: str) -> dict[str, np.ndarray]:
    with np.load(GOLDEN / f"{name}.npz") as data:
        return {key: data[key] for key in data.files}


def state_and_pool(z: dict[str, np.ndarray]) -> tuple[PlanningState, CandidatePool]:
    order = np.argsort(z["track_point"], kind="stable")
    lengths = np.bincount(z["track_point"], minlength=len(z["points_m"]))
    tracks = np.split(z["track_camera"][order], np.cumsum(lengths)[:-1])
    centers = z["camera_centers_m"]
    model = sparse_model(z["points_m"], tracks, centers, z["reproj_error_px"])
    state = PlanningState(
        model=model,
        visited_m=centers,
        n_seeds=24,
        vehicle_position_m=z["vehicle_position_m"],
        vehicle_heading_rad=float(z["vehicle_heading_rad"]),
        captures_used=len(centers) - 24,
        planned_views=40,
        d95_m=0.1,
        iteration=0,
    )
    return state, scoring_state.pool_at(z["candidates_m"], z["target_m"])


def config_for(weights: np.ndarray, alphas: tuple[float, float, float]) -> MissionConfig:
    w = Weights(*(float(v) for v in weights))
    config = MissionConfig()
    return replace(
        config,
        covis=replace(config.covis, weights=w),
        b_aware=replace(
            config.b_aware,
            weights=w,
            alpha_track=alphas[0],
            alpha_density=alphas[1],
            alpha_reprojection=alphas[2],
        ),
    )


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("case", CASES)
def test_terms_scores_and_ranks_equal_the_reference(name: str, case: str) -> None:
    z = load(name)
    scorer, alphas = CASES[case]
    state, pool = state_and_pool(z)
    ours = Rankings(state, pool, config_for(z["weights"], alphas))[scorer]

    expected = z[case]
    for column, term in enumerate(("main", "nov", "move", "ang")):
        np.testing.assert_allclose(ours.terms[term], expected[:, column], rtol=0, atol=1e-6, err_msg=term)
    np.testing.assert_allclose(ours.scores, expected[:, 4], rtol=0, atol=1e-6)

    # Ranks are equal except among candidates whose reference scores tie (to rounding).
    reference = z[f"{case}_rank"]
    differing = ours.order != reference
    gap = np.abs(expected[ours.order[differing], 4] - expected[reference[differing], 4])
    assert (gap < 1e-9).all(), (ours.order[differing], reference[differing], gap)
    assert sorted(ours.order) == list(range(len(pool)))
