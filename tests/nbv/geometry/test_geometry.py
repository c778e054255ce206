"""The geometry that everything stands on, against values that a person can work out."""

import numpy as np
import pytest
import trimesh
from refusals import refused
from scipy.spatial import ConvexHull

from nbv.config import MissionConfig
from nbv.geometry.carving import Solid, carved
from nbv.geometry.mesh import RayCaster, sample_surface, sample_surface_evenly
from nbv.geometry.ply import read_ply, write_ply
from nbv.geometry.target import find_target
from nbv.geometry.visibility import knn_d95_m
from nbv.types import PointCloud

CUBE = ConvexHull(np.array([[x, y, z] for x in (-0.8, 0.8) for y in (-0.8, 0.8) for z in (0.0, 1.6)]))
NONE = np.zeros((0, 3))
CELLS = 16
CELL_M = 1.6 / CELLS


def carved_top(*made_from):
    """(K, 3) the top of a carved cube, column by column."""
    solid = carved(*made_from, CELLS)
    columns = np.argwhere(solid.cells.any(axis=2))
    top = [np.flatnonzero(solid.cells[x, y])[-1] + 1 for x, y in columns]
    return np.column_stack([solid.low_m[:2] + (columns + 0.5) * solid.cell_m, np.array(top) * solid.cell_m])


def height_at(top_m, x_m, y_m):
    return top_m[np.argmin(np.linalg.norm(top_m[:, :2] - [x_m, y_m], axis=1)), 2]


def test_a_line_of_sight_takes_away_what_it_crosses_and_spares_the_cell_before_its_end():
    down = np.array([[0.05, 0.05, 5.0]]), np.array([[0.05, 0.05, 0.45]])
    top_m = carved_top(CUBE, NONE, *down)
    assert 0.45 < height_at(top_m, 0.05, 0.05) <= 0.45 + 2 * CELL_M
    assert (top_m[:, 2] < 1.59).sum() == 1  # and no other column


def test_a_tunnel_leaves_the_top_where_it_is_and_a_slanted_look_lowers_it_where_it_goes_in():
    across = np.array([[-3.0, 0.05, 0.85]]), np.array([[3.0, 0.05, 0.85]])
    assert carved_top(CUBE, NONE, *across)[:, 2] == pytest.approx(1.6)
    slanted = np.array([[-3.0, 0.05, 3.0]]), np.array([[0.6, 0.05, 0.7]])
    top_m = carved_top(CUBE, NONE, *slanted)
    lowered = top_m[
        top_m[:, 2] < 1.59
    ]  # 3 - 23 / 36 (x + 3) m high: in at x = -0.81 m, half a cell deep 8 cm on
    assert 1 <= len(lowered) <= 2 and lowered[:, 0].max() < -0.6 and lowered[:, 1] == pytest.approx(0.05)


def test_a_point_stays_though_a_line_of_sight_passes_there():
    down = np.array([[0.05, 0.05, 5.0]]), np.array([[0.05, 0.05, 0.0]])
    kept = carved_top(CUBE, np.array([[0.05, 0.05, 1.25]]), *down)
    assert height_at(kept, 0.05, 0.05) == pytest.approx(1.3)
    gone = carved_top(CUBE, NONE, *down)
    assert height_at(gone, 0.05, 0.05) == pytest.approx(CELL_M)


def pocket() -> Solid:
    """The cube with a pocket 0.4 m wide from above to half its height, which lines of sight have looked into."""
    ends = np.stack(np.meshgrid(*[np.linspace(-0.2, 0.2, 17)] * 2), axis=-1).reshape(-1, 2)
    ends = np.column_stack([ends, np.full(len(ends), 0.8)])
    return carved(CUBE, ends, ends + np.array([0.0, 0.0, 4.0]), ends, CELLS)


def test_the_floor_of_a_pocket_is_surface_and_only_seen_from_above():
    solid = pocket()
    floor_m, up = np.array([[0.0, 0.0, 0.8]]), np.array([[0.0, 0.0, 1.0]])
    samples_m, normals, known = solid.surface(floor_m, 10_000, np.random.default_rng(0))
    nearest = np.argmin(np.linalg.norm(samples_m - floor_m, axis=1))
    assert samples_m[nearest] == pytest.approx(floor_m[0]) and normals[nearest, 2] > 0.9
    away_m = np.linalg.norm(samples_m[known] - floor_m, axis=1)
    assert (
        known[nearest] and 2 <= known.sum() <= 9 and (away_m < 2 * CELL_M).all()
    )  # of its cube and those beside it
    assert (samples_m[:, 2] > 0.0).all()  # nothing below the ground
    cameras_m = np.array([[0.3, 0.0, 4.0], [3.0, 0.0, 1.9]])
    assert solid.hides(floor_m, up, cameras_m, np.ones((2, 1), dtype=bool)).ravel().tolist() == [False, True]


def test_a_wall_is_seen_from_its_side_and_hidden_from_behind():
    solid = carved(CUBE, NONE, NONE, NONE, CELLS)
    wall_m, out = np.array([[0.75, 0.0, 0.8]]), np.array([[1.0, 0.0, 0.0]])
    cameras_m = np.array([[3.0, 1.0, 1.0], [-3.0, 0.0, 1.0]])
    ask = np.ones((2, 1), dtype=bool)
    assert solid.hides(wall_m, out, cameras_m, ask).ravel().tolist() == [False, True]
    assert not solid.hides(wall_m, out, cameras_m, ~ask).any()  # nothing was asked


ALL = MissionConfig()


def grid(n, spacing_m):
    return spacing_m * np.stack(np.meshgrid(*[np.arange(n)] * 3), axis=-1).reshape(-1, 3)


def test_the_fifth_neighbour_of_a_cubic_grid():
    """Inside and on faces 5 neighbours are at one spacing; only on the 12 edges the 5th is farther."""
    assert knn_d95_m(grid(20, 0.1), ALL) == pytest.approx(0.1)


def test_too_few_points_have_not_converged():
    assert [np.isinf(knn_d95_m(np.zeros((count, 3)), ALL)) for count in (0, 5, 6)] == [True, True, False]


def test_the_box_keeps_only_points_near_the_target():
    near = grid(8, 0.1) + np.array([-0.35, -0.35, 0.45])
    far = np.random.default_rng(0).uniform(5, 50, (400, 3))
    cloud = np.concatenate([near, far])
    assert knn_d95_m(cloud, ALL) > 1.0
    assert knn_d95_m(cloud, ALL.changed(stop={"knn_region": "box"})) == knn_d95_m(near, ALL)


POINTS = np.random.default_rng(0).normal(size=(20, 3))
COLORS = np.arange(60, dtype=np.uint8).reshape(20, 3)


@pytest.mark.parametrize("colors", [None, COLORS], ids=["bare", "coloured"])
@pytest.mark.parametrize("normals", [None, POINTS[::-1]], ids=["flat", "oriented"])
def test_what_is_written_is_read(tmp_path, colors, normals):
    write_ply(tmp_path / "cloud.ply", PointCloud(POINTS, colors, normals), error=POINTS[:, 0])
    cloud, more = read_ply(tmp_path / "cloud.ply")
    np.testing.assert_allclose(cloud.points_m, POINTS, rtol=1e-6)
    for back, given in ((cloud.colors, colors), (cloud.normals, normals)):
        assert (back is None) == (given is None)
        assert given is None or np.allclose(back, given)
    assert list(more) == ["error"] and np.allclose(more["error"], POINTS[:, 0])
    opened = trimesh.load(tmp_path / "cloud.ply")
    np.testing.assert_allclose(opened.vertices, POINTS, rtol=1e-6)


def test_a_damaged_file_is_refused(tmp_path):
    path = tmp_path / "cloud.ply"
    write_ply(path, PointCloud(POINTS))
    whole = path.read_bytes()
    for damaged in (
        b"",
        whole[:40],
        whole[:-5],
        whole[:-12],
        whole.replace(b"float y", b"float q"),
        whole[:-4] + b"\xff" * 4,
    ):
        path.write_bytes(damaged)
        refused("make it again", read_ply, path)


def test_samples_are_area_weighted_and_lie_on_the_surface():
    # Two triangles of areas 1/2 and 3/2, one of zero area between them.
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 5], [3, 0, 5], [0, 1, 5]], float)
    faces = np.array([[0, 1, 2], [0, 0, 1], [3, 4, 5]])
    points, normals = sample_surface(vertices, faces, 40_000, 0)
    upper = points[:, 2] > 2.5
    assert np.allclose(points[:, 2], np.where(upper, 5, 0))
    assert upper.mean() == pytest.approx(0.75, abs=0.01)
    assert np.allclose(normals, [0, 0, 1])
    lower = points[~upper]
    assert (lower[:, 0] + lower[:, 1]).max() <= 1 + 1e-12
    # Uniform within the triangle: the centroid, and a quarter of the area in the corner half as large.
    assert np.allclose(lower[:, :2].mean(0), 1 / 3, atol=0.01)
    assert np.mean(lower[:, 0] + lower[:, 1] < 0.5) == pytest.approx(0.25, abs=0.02)
    even, normals = sample_surface_evenly(vertices, faces, 4000, 0)
    lower = even[even[:, 2] < 2.5]
    assert len(lower) == 1000  # one in each share
    assert np.allclose(even[:, 2], np.where(even[:, 2] > 2.5, 5, 0)) and np.allclose(normals, [0, 0, 1])
    assert np.allclose(lower[:, :2].mean(0), 1 / 3, atol=0.01)


def test_distances_to_the_surface_are_exact():
    mesh = trimesh.creation.box(extents=(2.0, 2.0, 2.0))
    points = np.array([[1.5, 0.0, 0.0], [0.0, 0.0, 0.25], [2.0, 2.0, 1.0], [1.0, 0.3, -0.2]])
    distances_m = RayCaster(mesh.vertices, mesh.faces).distances_m(points)
    np.testing.assert_allclose(distances_m, [0.5, 0.75, np.sqrt(2.0), 0.0], atol=1e-6)


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
