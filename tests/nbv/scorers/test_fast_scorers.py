"""The fast scorers against the same written plainly in double precision (tests/support/scoring_reference.py)."""

from __future__ import annotations

import numpy as np
import pytest
import scoring_reference as reference
from hypothesis import given, settings
from hypothesis import strategies as st
from scoring_state import synthetic_state

from nbv.config import MissionConfig
from nbv.geometry.frustum import in_frustum
from nbv.scorers import b_aware, rank_candidates
from nbv.scorers.repair import repair
from nbv.scorers.repair_single import precision


@settings(max_examples=10)
@given(
    seed=st.integers(0, 10_000),
    n_points=st.integers(2, 1_200),
    low_deg=st.floats(0.0, 12.0),
    width_deg=st.floats(1.0, 40.0),
)
def test_rankings_are_those_of_double_precision(
    seed: int, n_points: int, low_deg: float, width_deg: float
) -> None:
    config = MissionConfig().with_values(
        {
            "b_aware.theta_low_deg": low_deg,
            "b_aware.theta_saturation_deg": low_deg + width_deg,
        }
    )
    state, pool = synthetic_state(n_points, config, seed)
    rankings = rank_candidates(state, pool, config)
    allowed = precision(low_deg, low_deg + width_deg)
    allowed = allowed if np.isfinite(allowed) else 1e-9
    for name, expected in reference.scores(state, pool, config).items():
        np.testing.assert_allclose(rankings[name].scores, expected, rtol=0, atol=allowed)
        np.testing.assert_array_equal(rankings[name].order, reference.order(expected))


def test_near_ties_are_settled_in_double_precision(monkeypatch: pytest.MonkeyPatch) -> None:
    """However bad single precision were, the order must be right while it stays within its error."""
    config = MissionConfig().with_values({f"b_aware.weights.{w}": 0.0 for w in ("nov", "move", "ang")})
    state, pool = synthetic_state(600, config)
    rng = np.random.default_rng(0)
    asked: list[int] = []

    def noisy(visible, weak, candidates_m, box, order, *angles):  # type: ignore[no-untyped-def]
        exact = repair(visible, weak, candidates_m, box.select(order), *angles)
        return exact + rng.uniform(-0.01, 0.01, len(exact))

    def counting(*arguments: object) -> np.ndarray:
        result = repair(*arguments)  # type: ignore[arg-type]
        asked.append(len(result))
        return result

    monkeypatch.setattr(b_aware, "repair_single", noisy)
    monkeypatch.setattr(b_aware, "precision", lambda low, high: 0.01)
    monkeypatch.setattr(b_aware, "repair", counting)
    order = rank_candidates(state, pool, config)["b-aware"].order
    expected = reference.order(reference.scores(state, pool, config)["b-aware"])
    np.testing.assert_array_equal(order, expected)
    assert asked and asked[0] > 10  # there were ties to settle


def test_points_on_the_image_border_get_double_precision() -> None:
    config = MissionConfig()
    pool = synthetic_state(300, config)[1]
    target = np.array(config.target_m)
    planes = reference.frustum_planes(pool.positions_m, target, config.camera)
    x, z = planes[0][:, 0], planes[2][:, 0]
    # Points on the plane through the camera that bounds its image, and a hair (1e-9 m) to either side.
    normal = z[:3] - x[:3]
    rng = np.random.default_rng(1)
    free = target + rng.uniform(-2.0, 2.0, (500, 3))
    distance = (np.column_stack([free, np.ones(500)]) @ (z - x)) / (normal @ normal)
    on_plane = free - distance[:, None] * normal
    hair = rng.choice([-1e-9, 1e-9], 500)[:, None] * normal
    points = on_plane + hair
    got = in_frustum(points, pool.positions_m, target, config.camera)
    np.testing.assert_array_equal(got, reference.in_frustum(points, pool.positions_m, target, config.camera))
    assert 100 < np.count_nonzero(got[:, 0]) < 400
