"""Our own scorer: closed forms on a sphere, and the oracle's plain loops on the same surface."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from nbv.config import MissionConfig, preset
from nbv.gates.ground_truth import GroundTruthOracle
from nbv.geometry.visibility import lifted
from nbv.scorers.matchable import views_gained
from nbv.scorers.surface import SAMPLES, proxy_surface, sees
from nbv.types import PlanningState

TARGET_M = np.array([0.0, 0.0, 0.8])


def sphere_points(n: int = 400, radius_m: float = 0.6) -> np.ndarray:
    """Even points on a sphere around the target, all above the ground."""
    k = np.arange(n) + 0.5
    z = 1.0 - 2.0 * k / n
    phi = np.pi * (1.0 + 5.0**0.5) * k
    ring = np.sqrt(1.0 - z * z)
    return TARGET_M + radius_m * np.stack([ring * np.cos(phi), ring * np.sin(phi), z], axis=1)


def view(azimuth_deg: float, elevation_deg: float = 20.0, radius_m: float = 3.5) -> np.ndarray:
    a, e = np.deg2rad([azimuth_deg, elevation_deg])
    return TARGET_M + radius_m * np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])


def config(**values: object) -> MissionConfig:
    return preset("campaign").with_values(values)


def surface(points_m: np.ndarray | None = None):
    found = proxy_surface(sphere_points() if points_m is None else points_m, config())
    assert found is not None
    return found


def test_the_surface_is_the_hull_of_the_rock_alone() -> None:
    rng = np.random.default_rng(0)
    ground = np.c_[rng.uniform(-1.4, 1.4, (300, 2)), rng.uniform(-0.03, 0.03, 300)]
    strays = np.array([[1.2, 0.3, 1.4], [-1.1, 0.9, 0.7]])
    far = np.add(sphere_points(), [2.3, 0.0, 0.0])
    proxy = surface(np.concatenate([sphere_points(), ground, strays, far]))
    offset = proxy.samples_m - TARGET_M
    radius = np.linalg.norm(offset, axis=1)
    assert len(offset) == SAMPLES and radius.min() > 0.57 and radius.max() < 0.6 + 1e-9
    assert (np.einsum("ij,ij->i", offset, proxy.normals) > 0.95 * radius).all()  # outward
    assert np.abs(offset.mean(axis=0)).max() < 0.03  # even
    # A first model of few points, or of points in a plane, is taken for a ball on the ground.
    for few in (sphere_points(4), sphere_points() * [1, 1, 0] + [0, 0, 0.5]):
        radius = np.linalg.norm(surface(few).samples_m - TARGET_M, axis=1)
        assert radius.min() > 0.75 and radius.max() < 0.8 + 1e-9


def test_too_near_or_too_far_to_match_gains_nothing() -> None:
    proxy, visited = surface(), np.stack([view(0.0)])
    near, matched = view(0.5), view(12.0)
    gained, lacking = views_gained(proxy, np.stack([near, matched]), visited, config())
    gain = gained / lacking
    seen = sees(proxy, np.stack([visited[0], near, matched]), config())
    missing = (6 - seen[:, 0]).sum()
    # Half a degree beside an earlier view only samples that this one did not see gain.
    assert gain[0] == pytest.approx((seen[:, 1] & ~seen[:, 0]).sum() / missing)
    # Twelve degrees beside it all that both see gain as well: at 0.6 m from a target 3.5 m away the angle
    # from a sample is 9 to 15 degrees.
    assert gain[1] == pytest.approx(seen[:, 2].sum() / missing)


@settings(max_examples=15)
@given(seed=st.integers(0, 10_000), visited=st.integers(0, 12), need=st.integers(2, 9))
def test_equal_to_the_oracle_on_the_same_surface(seed: int, visited: int, need: int) -> None:
    """The oracle casts rays and loops over views; on a convex surface both must count the same."""
    rng = np.random.default_rng(seed)
    points = sphere_points(200) + rng.normal(0.0, 0.02, (200, 3))
    mission = config(
        **{
            "matchable.views": need,
            "gate.oracle_matchable_views": need,
            "gate.oracle_coverage": "matchable",
            "gate.oracle_samples": SAMPLES,
        }
    )
    proxy = proxy_surface(points, mission)
    hull = trimesh.convex.convex_hull(points)
    oracle = GroundTruthOracle(hull.vertices, hull.faces, mission)
    oracle.samples_m, oracle.normals = proxy.samples_m, proxy.normals
    oracle._starts_m = lifted(proxy.samples_m, proxy.normals)
    views = np.stack([view(rng.uniform(0, 360), rng.uniform(5, 60)) for _ in range(visited + 6)])
    state = PlanningState(None, views[:visited], visited, view(0.0), 0.0, 0, 8, 0.1, 0)  # type: ignore[arg-type]
    coverage = oracle.coverage(state)
    have = coverage.partners.max(axis=0, initial=-1) + 1
    missing = (need - np.minimum(have, need)).sum()
    expected = [oracle.gain(c, coverage) * need / max(missing, 1) for c in views[visited:]]
    gained, lacking = views_gained(proxy, views[visited:], views[:visited], mission)
    gain = gained / max(lacking, 1)
    # Rays that graze the hull, and angles at the limits, may fall to either side for a sample or two.
    np.testing.assert_allclose(gain, expected, atol=4.0 / max(missing, 1))
    assert (gain >= 0).all() and (gain <= 1).all()
