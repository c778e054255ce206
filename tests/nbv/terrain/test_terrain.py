"""Relief, neighbours and burial: heights as asked, nothing in the crop, nothing of the rock below ground."""

import numpy as np
import pytest
import trimesh

from nbv.config import GroundConfig, MissionConfig
from nbv.errors import UserError
from nbv.geometry.mesh import face_areas
from nbv.geometry.sampling import sample_surface_evenly
from nbv.rocks.procedural import generate_rock
from nbv.rocks.rock import Rock
from nbv.terrain.burial import buried_rock
from nbv.terrain.neighbours import CROP_M, neighbour_cylinders
from nbv.terrain.relief import FILLED_M, FULL_M, RELIEF_HALF_EXTENT_M, STEP_M, relief_of

FEW = GroundConfig(neighbours=6)


@pytest.fixture(scope="module")
def rock() -> Rock:
    return generate_rock("boulder", grid_m=0.06)


def test_relief_has_the_rms_and_slope_that_is_asked() -> None:
    rms, slopes = [], []
    for seed in range(8):
        relief = relief_of(GroundConfig(relief_m=0.08, relief_length_m=1.0), seed)
        n = len(relief.heights_m)
        nodes = np.linspace(-RELIEF_HALF_EXTENT_M, RELIEF_HALF_EXTENT_M, n)
        x, y = np.meshgrid(nodes, nodes)
        part = (np.maximum(abs(x), abs(y)) < FULL_M) & (np.hypot(x, y) > FILLED_M[1])
        rms.append(relief.heights_m[part].std())
        slopes.append(np.gradient(relief.heights_m, STEP_M, axis=1)[part].std())
    assert np.mean(rms) == pytest.approx(0.08, rel=0.05)
    # A Gaussian correlation of length l has rms slope sqrt(2) h / l.
    assert np.mean(slopes) == pytest.approx(np.sqrt(2) * 0.08, rel=0.1)


@pytest.mark.parametrize("seed", range(0, 40, 4))
def test_neighbours_stand_outside_the_crop_and_apart(seed: int) -> None:
    cylinders = neighbour_cylinders(FEW, seed, "rock")
    assert len(cylinders) == 6
    assert cylinders == neighbour_cylinders(FEW, seed, "rock") != neighbour_cylinders(FEW, seed, "other")
    for i, c in enumerate(cylinders):
        # The circle is outside of the square where its centre is farther than the radius beyond a side.
        assert np.abs(c.center_m).max() - c.radius_m >= CROP_M + FEW.neighbour_gap_m[0] - 1e-9
        assert FEW.neighbour_height_m[0] <= c.top_m - c.base_m <= FEW.neighbour_height_m[1]
        for other in cylinders[:i]:
            assert np.hypot(*np.subtract(c.center_m, other.center_m)) > c.radius_m + other.radius_m


def test_a_buried_rock_is_what_is_above_ground(rock: Rock) -> None:
    buried = buried_rock(rock, MissionConfig().with_values({"ground.burial_m": 0.3}))
    assert buried.vertices_m[:, 2].max() == pytest.approx(1.3)
    assert buried.vertices_m[:, 2].min() == pytest.approx(0.0, abs=1e-12)
    samples, _ = sample_surface_evenly(buried.vertices_m, buried.faces, 4000, 0)
    assert samples[:, 2].min() >= -1e-12
    # The cut is exact: no face is lost, none is doubled, and the rim is one closed line.
    corners = rock.vertices_m[rock.faces] - [0, 0, 0.3]
    above = face_areas(rock.vertices_m, rock.faces)[(corners[..., 2] > 0).all(axis=1)].sum()
    cut = face_areas(buried.vertices_m, buried.faces).sum()
    assert above < cut < face_areas(rock.vertices_m, rock.faces).sum()
    counts = np.bincount(trimesh.Trimesh(buried.vertices_m, buried.faces, process=False).edges_unique_inverse)
    rim = np.flatnonzero(np.abs(buried.vertices_m[:, 2]) < 1e-12)
    assert set(counts.tolist()) == {1, 2} and (counts == 1).sum() == len(rim)


def test_a_rock_that_is_buried_whole_is_refused(rock: Rock) -> None:
    with pytest.raises(UserError, match=r"ground\.burial_m is 2: rock 'boulder' is only 1\.60 m high"):
        buried_rock(rock, MissionConfig().with_values({"ground.burial_m": 2.0}))


def test_too_many_neighbours_for_their_room_are_refused() -> None:
    crowd = GroundConfig(neighbours=12, neighbour_gap_m=(0.05, 0.05), neighbour_height_m=(1.5, 1.5))
    with pytest.raises(UserError, match=r"there is room for \d+ of ground.neighbours 12; ask for fewer"):
        neighbour_cylinders(crowd, 0, "rock")
