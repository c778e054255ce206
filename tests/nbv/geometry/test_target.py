"""A thing on the ground is found near the aim, with its size; where there is none, none is found."""

import numpy as np
import pytest

from nbv.geometry.target import find_target


def scene(
    center_m: tuple[float, float] = (0.0, 0.0), height_m: float = 1.6, points: int = 3000
) -> np.ndarray:
    """(N, 3) the upper part of an egg that stands on a noisy ground."""
    rng = np.random.default_rng(3)
    d = rng.standard_normal((points, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    egg = d[d[:, 2] > -0.6] * [0.45 * height_m, 0.4 * height_m, height_m / 2] + [*center_m, height_m / 2]
    ground = np.c_[rng.uniform(-5, 5, (points, 2)), np.zeros(points)] + rng.normal(0, 0.01, (points, 3))
    return np.concatenate([egg, ground])


@pytest.mark.parametrize("height_m", [0.8, 1.6, 2.4])
def test_place_and_size_are_found_from_a_metre_off(height_m: float) -> None:
    found = find_target(scene((0.7, -0.6), height_m), (0.0, 0.0, 0.8))
    assert found is not None
    np.testing.assert_allclose(found.center_m, [0.7, -0.6, height_m / 2], atol=0.05)
    assert found.half_extent_m == pytest.approx(height_m / 2, abs=0.05)


def test_one_side_of_it_is_taken_for_half() -> None:
    """Seen from the south alone, the egg's northern half is not in the model: it lies behind its front all the same."""
    points = scene((0.7, -0.6))
    front = points[(points[:, 2] < 0.25) | (points[:, 1] < -0.75)]
    bearings = np.deg2rad(np.linspace(-60.0, 60.0, 8))
    cameras = np.c_[3.5 * np.sin(bearings), -3.5 * np.cos(bearings), np.full(8, 1.4)] + [0.7, -0.6, 0.0]
    plain, corrected = find_target(front, (0.0, 0.0, 0.8)), find_target(front, (0.0, 0.0, 0.8), cameras)
    assert plain is not None and corrected is not None
    off_m = [np.linalg.norm(np.array(f.center_m)[:2] - [0.7, -0.6]) for f in (plain, corrected)]
    assert off_m[0] > 0.3 and off_m[1] < 0.15


def test_of_two_things_the_nearer_is_meant() -> None:
    both = np.concatenate([scene((0.4, 0.0)), scene((2.8, 0.0), height_m=2.2)])
    found = find_target(both, (0.0, 0.3, 0.8))
    assert found is not None
    np.testing.assert_allclose(found.center_m, [0.4, 0.0, 0.8], atol=0.08)


def test_bare_ground_and_few_points_hold_no_target() -> None:
    ground = scene()[scene()[:, 2] < 0.05]
    assert find_target(ground, (0.0, 0.0, 0.8)) is None
    assert find_target(scene()[:20], (0.0, 0.0, 0.8)) is None
