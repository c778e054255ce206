"""Our scorers against the authors' public ones on real sparse models (tests/data/golden_scorers)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scoring_state import pool_at, sparse_model

from nbv.config import MissionConfig, Weights
from nbv.scorers import Rankings
from nbv.types import CandidatePool, PlanningState

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
    return state, pool_at(z["candidates_m"], z["target_m"])


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
