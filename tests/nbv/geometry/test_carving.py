"""What lines of sight leave of a solid: heights that a person can work out."""

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from nbv.geometry.carving import CELLS, carved_top

CUBE = ConvexHull(np.array([[x, y, z] for x in (-0.8, 0.8) for y in (-0.8, 0.8) for z in (0.0, 1.6)]))
NONE = np.zeros((0, 3))
CELL_M = 1.6 / CELLS


def height_at(top_m, x_m, y_m):
    return top_m[np.argmin(np.linalg.norm(top_m[:, :2] - [x_m, y_m], axis=1)), 2]


def test_what_nobody_has_looked_through_is_whole():
    top_m = carved_top(CUBE, NONE, NONE, NONE)
    assert len(top_m) == CELLS**2 and top_m[:, 2] == pytest.approx(1.6)


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
