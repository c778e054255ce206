"""What lines of sight leave of a solid: heights that a person can work out."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from nbv.geometry.carving import Solid, carved

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


def test_places_stay_only_with_lines_in_proportion():
    """Of two columns that ten lines each pass, the one with two places is carved away, that with five is solid."""
    column_m = np.array([[0.05, 0.05], [0.45, 0.05]])
    cameras_m = np.repeat(np.column_stack([column_m, [5.0, 5.0]]), 10, axis=0)
    ends_m = cameras_m * [1, 1, 0]
    places_m = np.concatenate([np.tile([[*column_m[k], 1.25]], (n, 1)) for k, n in enumerate((2, 5))])
    solid = carved(CUBE, places_m, cameras_m, ends_m, CELLS, fewest=3, share=0.3)
    heights_m = [
        solid.low_m[2] + solid.cell_m * (1 + np.flatnonzero(solid.cells[tuple(at)])[-1])
        for at in ((column_m - solid.low_m[:2]) / solid.cell_m).astype(int)
    ]
    assert heights_m == pytest.approx([CELL_M, 1.3])


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
