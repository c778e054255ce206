"""Seed rings and the candidate pool: counts, positions, filters, order."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scoring_state import few_seeds

from nbv.config import MissionConfig, SeedConfig, preset
from nbv.viewpoints import RINGS, raw_candidates, seed_viewpoints

NOWHERE = np.zeros((0, 3))
VEHICLE = np.array([0.0, -8.0, 3.0])
GOLDEN = Path(__file__).parents[2] / "data" / "golden_scorers"


def test_seeds() -> None:
    config = MissionConfig()
    seeds = seed_viewpoints(config)
    assert [s.id for s in seeds] == [f"seed_{i:02d}" for i in range(24)]
    assert [s.elevation_deg for s in seeds] == [15.0] * 8 + [22.0] * 6 + [29.0] * 6 + [36.0] * 4
    positions = np.array([s.position_m for s in seeds])
    np.testing.assert_allclose(np.linalg.norm(positions - config.target_m, axis=1), 4.0)
    # Every ring starts due north and goes clockwise: the second of the 8 is to the north-east.
    for first in (0, 8, 14, 20):
        assert positions[first, 0] == pytest.approx(0.0)
        assert positions[first, 1] > 3.0
        assert seeds[first].azimuth_deg == 90.0
    np.testing.assert_allclose(positions[1], [2.73205, 2.73205, 1.83528], atol=1e-5)
    np.testing.assert_allclose(positions[9, :2], 3.70874 * np.array([np.sin(np.pi / 3), 0.5]), atol=1e-4)


def turn(count: int, **seed: Any) -> MissionConfig:
    return MissionConfig().with_values(few_seeds(count, **seed))


def test_two_rings_have_even_steps_each() -> None:
    """16 at 10 degrees and 9 at 35, from north on, as far from the target as asked."""
    config = turn(25, upper_share=0.36, lowest_deg=10.0, span_deg=25.0, radius_m=3.5)
    seeds = seed_viewpoints(config)
    assert [s.elevation_deg for s in seeds] == [10.0] * 16 + [35.0] * 9
    expected = [90.0 - 22.5 * k for k in range(16)] + [90.0 - 40.0 * k for k in range(9)]
    np.testing.assert_allclose([s.azimuth_deg for s in seeds], np.mod(expected, 360.0))
    distances_m = np.linalg.norm(np.array([s.position_m for s in seeds]) - config.target_m, axis=1)
    np.testing.assert_allclose(distances_m, 3.5)
    assert [s.id for s in seeds] == [f"seed_{k:02d}" for k in range(25)]


@pytest.mark.parametrize(
    ("seeds", "numbers"), [(24, [8, 6, 6, 4]), (12, [4, 3, 3, 2]), (13, [4, 4, 3, 2]), (3, [1, 1, 1])]
)
def test_seeds_are_shared_out_among_the_rings_as_the_papers_are(seeds: int, numbers: list[int]) -> None:
    assert [number for _, number in SeedConfig().rings(seeds)] == numbers


@pytest.mark.parametrize(
    ("name", "count", "golden"),
    [
        ("paper-code", 105, "15016_seed_paper_weights"),
        ("paper", 163, "15016_40_views_low_novelty_10deg_ring"),
    ],
)
def test_pool_positions_equal_the_reference(name: str, count: int, golden: str) -> None:
    z = np.load(GOLDEN / f"{golden}.npz")
    pool = RINGS.candidates(preset(name), VEHICLE, NOWHERE, 0)
    assert len(pool) == count and pool.counts["raw"] == 170
    reference = dict(zip(z["candidate_ids"].tolist(), z["candidates_m"]))
    assert set(pool.ids) == set(reference)
    np.testing.assert_allclose(pool.positions_m, [reference[i] for i in pool.ids], atol=1e-9)


@settings(max_examples=30)
@given(picks=st.lists(st.integers(0, 169), max_size=12), x=st.floats(-5, 5), y=st.floats(-5, 5))
def test_survivors_obey_every_filter(picks: list[int], x: float, y: float) -> None:
    config = MissionConfig().with_values({"pool.max_travel_m": 7.0})
    raw = raw_candidates(config)
    visited = np.array([raw[i].position_m for i in picks]).reshape(-1, 3)
    vehicle = np.array([x, y, 2.0])
    pool = RINGS.candidates(config, vehicle, visited, 0)
    counts = list(pool.counts.values())
    assert counts == sorted(counts, reverse=True) and counts[-1] == len(pool)
    if len(pool) == 0:
        return
    p = pool.positions_m
    assert (p[:, 2] >= 1.3).all() and (np.linalg.norm(p - vehicle, axis=1) <= 7.0).all()
    gaps = np.linalg.norm(p[:, None] - p[None], axis=2) + 10 * np.eye(len(p))
    assert gaps.min() >= 0.3
    if len(visited):
        assert np.linalg.norm(p[:, None] - visited[None], axis=2).min() >= 0.6
    # Headings face the target.
    aim = p[:, :2] + np.linalg.norm(p[:, :2], axis=1)[:, None] * np.column_stack(
        [np.cos(pool.headings_rad), np.sin(pool.headings_rad)]
    )
    np.testing.assert_allclose(aim, 0.0, atol=1e-9)


def test_what_the_seed_ring_lacks_is_a_candidate_for_predicted_alone_however_low():
    values = few_seeds(12, lowest_deg=10.0, radius_m=3.5)
    paper = preset("campaign").with_values({**values, "pool.min_altitude_m": 2.0})
    planned = paper.with_values({"gate.kind": "predicted"})
    here, none = np.array(paper.target_m), np.zeros((0, 3))
    of_paper, of_planned = (RINGS.candidates(config, here, none, 0) for config in (paper, planned))
    assert "ring" not in of_paper.bands
    ring = np.array(of_planned.bands) == "ring"
    assert ring.sum() == 36  # three between each two seeds
    assert np.allclose(of_planned.elevations_deg[ring], 10.0)
    seeds = np.array([seed.position_m for seed in seed_viewpoints(planned)])
    apart_m = np.linalg.norm(of_planned.positions_m[ring][:, None] - seeds[None], axis=2)
    assert apart_m.min() > 0.4
