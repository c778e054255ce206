"""Relief and neighbours in photographs: seen, in the way, casting shadows; the contact sheet."""

import numpy as np
import pytest
from scene_helpers import CENTRE_M, SMALL_CAMERA, SMALL_GROUND, pixel_rays, rock_in_picture

from nbv.config import GroundConfig, SceneConfig
from nbv.geometry.frames import look_at
from nbv.geometry.raycasting import RayCaster, rays_of
from nbv.scene import build_scene, preview
from nbv.terrain.neighbours import make_surroundings, neighbour_cylinders

GROUND = GroundConfig(relief_m=0.1, neighbours=3, neighbour_height_m=(0.8, 1.0), neighbour_gap_m=(0.1, 0.3))


@pytest.fixture(scope="module")
def around(ball):
    return make_surroundings(GROUND, 0, ball.sha256)


@pytest.fixture(scope="module")
def scene(ball, around):
    return build_scene(ball, SceneConfig(), SMALL_CAMERA, SMALL_GROUND, surroundings=around)


@pytest.fixture(scope="module")
def behind(ball):
    """A low camera with a neighbour between it and the ball."""
    place = neighbour_cylinders(GROUND, 0, ball.sha256)[0]
    outward = np.array(place.center_m) / np.hypot(*place.center_m)
    position = np.array([*(np.array(place.center_m) + (place.radius_m + 1.0) * outward), 0.9])
    return look_at(position, CENTRE_M)


def true_depths(ball, around, pose):
    """Depth of what each pixel's centre meets first, and whether that is the ball, by plain ray casting."""
    parts = [(ball.vertices_m, ball.faces), *((b.vertices_m, b.faces) for b in around.neighbours)]
    directions = pixel_rays(SMALL_CAMERA) @ pose[:3, :3]
    rays = rays_of(-pose[:3, :3].T @ pose[:3, 3], directions)
    depths = [RayCaster(*mesh).cast(rays).t for mesh in (*parts, around.relief.mesh())]
    return np.min(depths, axis=0), np.argmin(depths, axis=0) == 0


def test_the_rock_is_seen_where_nothing_is_before_it(ball, around, scene, behind) -> None:
    depth, is_ball = true_depths(ball, around, behind)
    assert (rock_in_picture(scene, behind) != (is_ball & np.isfinite(depth))).mean() < 0.002


def test_neighbours_cast_shadows_on_ground_with_relief(scene, around) -> None:
    x = SMALL_GROUND.texel_centres_m(0)
    travel = np.array(SceneConfig().sun_direction)
    level = scene.ground_levels[0]
    for body in around.neighbours:
        top = body.vertices_m[body.vertices_m[:, 2].argmax()]
        foot = top[:2] - (top[2] - 0.3) * travel[:2] / travel[2]  # of its shadow's middle
        column, row = np.searchsorted(x, foot)
        assert level[row - 4 : row + 4, column - 4 : column + 4].mean() < 0.7 * level.mean()


def test_a_sheet_shows_each_view_once(ball, monkeypatch):
    monkeypatch.setattr("nbv.scene.bake.GroundSpec", lambda: SMALL_GROUND)
    sheet = preview(ball)
    assert (sheet.shape, sheet.dtype) == ((2 * 240 + 4, 3 * 320 + 8, 3), np.uint8)
    cells = [sheet[r : r + 240, c : c + 320] for r in (0, 244) for c in (0, 324, 648)]
    for i, cell in enumerate(cells):
        assert cell.std() > 10
        assert not any(np.array_equal(cell, other) for other in cells[:i])
