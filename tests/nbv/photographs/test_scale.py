"""The scale of a model from control points and GPS, where the truth is known."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from nbv.errors import UserError
from nbv.geometry.frames import Similarity, look_at
from nbv.photographs.folder import SourcePhotograph
from nbv.photographs.scale import ControlPoints, find_scale, read_control_points
from nbv.photographs.solved import SolvedModel
from nbv.photographs.source import Source

WIDTH, HEIGHT = 640, 480
CAMERA = pycolmap.Camera(model="SIMPLE_RADIAL", width=WIDTH, height=HEIGHT, params=[500, 320, 240, 0.03])
PLACES = np.array([[8 * np.cos(a), 8 * np.sin(a), 4.0] for a in np.linspace(0, 6, 9)])
POINTS = np.array([[1.0, 0, 0], [-1, 1, 0], [0, -1, 0.2], [0.5, 0.5, 1.0]])
POSES = np.array([look_at(p, np.zeros(3)) for p in PLACES])
NAMES = tuple(f"p{i}" for i in range(len(PLACES)))
# The model's frame: turned, shrunk and shifted.
TURN = look_at(np.array([1.0, 2, 3]), np.zeros(3))[:3, :3]
MODEL_FROM_WORLD = Similarity(0.37, TURN, np.array([1.0, -2, 5]))


@pytest.fixture
def model() -> SolvedModel:
    none = np.zeros(0, dtype=np.int64)
    world = SolvedModel(
        NAMES,
        POSES,
        (CAMERA,) * len(PLACES),
        np.zeros((0, 3)),
        np.zeros((0, 3), np.uint8),
        none,
        none,
        np.zeros((0, 2)),
    )
    return world.moved(MODEL_FROM_WORLD)


def source(found: list[SourcePhotograph]) -> Source:
    return Source(tuple(found), WIDTH, lambda *_: None)


def photographs(gps_error_m: float | None = None) -> Source:
    plain = [
        SourcePhotograph(Path(f"p{i}.JPG"), f"p{i}", "", (1280, 960), 1, "", None, None, None, None)
        for i in range(len(PLACES))
    ]
    if gps_error_m is None:
        return source(plain)
    noise = np.random.default_rng(1).normal(0, gps_error_m, PLACES.shape)
    east, north, up = (PLACES + noise).T
    degree = 6_378_137.0 * np.pi / 180
    positions = zip(46 + north / degree, 7 + east / degree / np.cos(np.deg2rad(46)), up, strict=True)
    return source([replace(p, gps=tuple(map(float, at))) for p, at in zip(plain, positions, strict=True)])


def marks(
    path: Path, points: np.ndarray = POINTS, header: str = "EPSG:32654", factor: float = 2.0
) -> ControlPoints:
    """Marks in the users' files, which are twice as large as what is worked on."""
    lines = [header]
    for point in points:
        for i, pose in enumerate(POSES):
            x, y = factor * np.asarray(CAMERA.img_from_cam((pose[:3, :3] @ point + pose[:3, 3])[None]))[0]
            lines.append(f"{point[0] + 494000} {point[1] + 4232000} {point[2]} {x} {y} p{i}.jpg")
    path.write_text("\n".join(lines) + "\n")
    return read_control_points(path, photographs())


def test_control_points_give_scale_and_up(model: SolvedModel, tmp_path: Path) -> None:
    found = find_scale(model, photographs(), None, marks(tmp_path / "gcp.txt"))
    assert found.source == "control points"
    assert found.metres_per_model_unit == pytest.approx(1 / 0.37, rel=1e-6)
    assert np.allclose(found.up, TURN @ [0, 0, 1], atol=1e-6)
    assert found.metres_per_unit(units_per_model_unit=10.0, height_units=3.0) == pytest.approx(
        1 / 3.7, rel=1e-6
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("EPSG:32654\n1 2 3 4 5\n", "line 2: a mark is"),
        ("EPSG:32654\n1 2 nan 4 5 p0.jpg\n", "must be finite"),
        ("EPSG:32654\n", "needs a projection"),
        ("EPSG:32654\n1 2 3 4 5 other.jpg\n", "0 control points are marked"),
        ("EPSG:32654\n1 2 3 4000 5 p0.jpg\n", "in pixels of these photographs"),
    ],
)
def test_control_points_that_cannot_be_used(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "gcp.txt"
    path.write_text(text)
    with pytest.raises(UserError, match=words) as told:
        read_control_points(path, photographs())
    assert "\n" not in str(told.value)


def test_control_points_on_a_line_or_in_other_pixels(model: SolvedModel, tmp_path: Path) -> None:
    line = np.array([[x, x, 0.0] for x in (-1.0, 0.0, 1.0)])
    with pytest.raises(UserError, match="on one line"):
        find_scale(model, photographs(), None, marks(tmp_path / "gcp.txt", line))
    with pytest.raises(UserError, match="do not meet"):
        find_scale(model, photographs(), None, marks(tmp_path / "gcp.txt", factor=0.7))


def test_gps_gives_the_scale_where_it_is_good_enough(model: SolvedModel) -> None:
    found = find_scale(model, photographs(0.1), None, None)
    assert found.source == "gps"
    assert found.metres_per_model_unit == pytest.approx(1 / 0.37, rel=0.02)
    coarse = find_scale(model, photographs(8.0), None, None)
    assert coarse.source == "none" and "too coarse" in coarse.notes[0]
    assert coarse.metres_per_unit(1.0, 1.0) is None
    assert find_scale(model, photographs(), None, None).source == "none"
