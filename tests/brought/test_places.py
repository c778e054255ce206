"""The scale of a model from control points and GPS in the systems and units that people have, where the truth is known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from pyproj import CRS, Transformer

from nbv.errors import UserError
from nbv.geometry.frames import Similarity, look_at
from nbv.photographs.folder import SourcePhotograph
from nbv.photographs.import_source import ImportSource
from nbv.photographs.scale import ControlPoints, find_scale, read_control_points
from nbv.photographs.solved import SolvedModel

WIDTH, HEIGHT = 640, 480
CAMERA = pycolmap.Camera(model="SIMPLE_RADIAL", width=WIDTH, height=HEIGHT, params=[500, 320, 240, 0.03])
PLACES = np.array([[8 * np.cos(a), 8 * np.sin(a), 4.0] for a in np.linspace(0, 6, 9)])
POINTS = np.array([[1.0, 0, 0], [-1, 1, 0], [0, -1, 0.2], [0.5, 0.5, 1.0]])
POSES = np.array([look_at(p, np.zeros(3)) for p in PLACES])
# The model's frame: turned, shrunk and shifted.
TURN = look_at(np.array([1.0, 2, 3]), np.zeros(3))[:3, :3]
MODEL_FROM_WORLD = Similarity(0.37, TURN, np.array([1.0, -2, 5]))


def seen_from(places_m: np.ndarray) -> SolvedModel:
    none = np.zeros(0, dtype=np.int64)
    instance = SolvedModel(
        tuple(f"p{i}" for i in range(len(places_m))),
        np.array([look_at(p, np.zeros(3)) for p in places_m]),
        (CAMERA,) * len(places_m),
        np.zeros((0, 3)),
        np.zeros((0, 3), np.uint8),
        none,
        none,
        np.zeros((0, 2)),
    )
    return instance.moved(MODEL_FROM_WORLD)


MODEL = seen_from(PLACES)


def source(found: list[SourcePhotograph]) -> ImportSource:
    return ImportSource(tuple(found), WIDTH, lambda *_: None)


def photographs(places_m: np.ndarray | None = None, at: tuple[float, float] = (46.0, 7.0)) -> ImportSource:
    """With GPS that says ``places_m`` (N, 3; NaN: no altitude), if anything."""
    plain = [
        SourcePhotograph(Path(f"p{i}.JPG"), f"p{i}", "", (1280, 960), 1, "", None, None, None)
        for i in range(len(PLACES if places_m is None else places_m))
    ]
    if places_m is None:
        return source(plain)
    known = np.isfinite(places_m[:, 2])
    longitude, latitude, up = on_earth(np.nan_to_num(places_m), at)
    gps = zip(latitude.tolist(), longitude.tolist(), up.tolist(), strict=True)
    places = [place if there else None for place, there in zip(gps, known, strict=True)]
    return source([replace(p, gps=place) for p, place in zip(plain, places, strict=True)])


def on_earth(points_m: np.ndarray, at: tuple[float, float]) -> tuple[np.ndarray, ...]:
    """Longitude, latitude and height above the ellipsoid of (N, 3) metres east, north and up of a place 400 m above it."""
    frame = f"+ellps=WGS84 +lat_0={at[0]} +lon_0={at[1]} +h_0=400"
    steps = f"+proj=pipeline +step +inv +proj=topocentric {frame} +step +inv +proj=cart +ellps=WGS84"
    return Transformer.from_pipeline(f"{steps} +step +proj=unitconvert +xy_in=rad +xy_out=deg").transform(
        *points_m.T
    )


def marks(
    path: Path,
    points: np.ndarray = POINTS,
    header: str = "EPSG:32654",
    factor: float = 2.0,
    said: object = None,
) -> ControlPoints:
    """Marks in the users' files, which are twice as large as what is worked on; ``said``: the places as the file has them."""
    lines = [header]
    places = points + np.array([494000, 4232000, 0]) if said is None else np.asarray(said)
    for point, place in zip(points, places):
        for i, pose in enumerate(POSES):
            x, y = factor * np.asarray(CAMERA.img_from_cam((pose[:3, :3] @ point + pose[:3, 3])[None]))[0]
            lines.append(f"{place[0]:.9f} {place[1]:.9f} {place[2]} {x} {y} p{i}.jpg")
    path.write_text("\n".join(lines) + "\n")
    return read_control_points(path, photographs())


def test_control_points_give_scale_and_up(tmp_path: Path) -> None:
    found = find_scale(MODEL, photographs(), None, marks(tmp_path / "gcp.txt"))
    assert found.source == "control points"
    assert found.metres_per_model_unit == pytest.approx(1 / 0.37, rel=5e-4)  # UTM is 0.9996 of the ground
    assert np.allclose(found.up, TURN @ [0, 0, 1], atol=1e-3)
    assert found.metres_per_unit(units_per_model_unit=10.0, height_units=3.0) == pytest.approx(
        1 / 3.7, rel=5e-4
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("EPSG:32654\n1 2 3 4 5\n", "line 2: a mark is"),
        ("EPSG:32654\n1 2 nan 4 5 p0.jpg\n", "must be finite; leave points without Z out"),
        ("EPSG:99999\n1 2 3 4 5 p0.jpg\n", "line 1: 'EPSG:99999' is no coordinate system; write EPSG:CODE"),
        ("EPSG:5773\n1 2 3 4 5 p0.jpg\n", "is no coordinate system"),
        ("1 2 3 4 5 p0.jpg\n" * 2, "line 1: '1 2 3 4 5 p0.jpg' is no coordinate system"),
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


def test_control_points_on_a_line_or_in_other_pixels(tmp_path: Path) -> None:
    line = np.array([[x, x, 0.0] for x in (-1.0, 0.0, 1.0)])
    with pytest.raises(UserError, match="on one line"):
        find_scale(MODEL, photographs(), None, marks(tmp_path / "gcp.txt", line))
    with pytest.raises(UserError, match="do not meet"):
        find_scale(MODEL, photographs(), None, marks(tmp_path / "gcp.txt", factor=0.7))


SYSTEMS = {  # a file's first line: where it is meant for, and what pyproj calls the same
    "EPSG:4326": ((46.0, 7.0), "EPSG:4326"),
    "WGS84": ((-12.8, 45.29), "EPSG:4326"),
    "+proj=longlat +datum=WGS84 +no_defs": ((64.0, -21.0), "EPSG:4326"),
    "EPSG:4258": ((52.0, 13.0), "EPSG:4258"),
    "EPSG:4807": ((48.8, 2.3), "EPSG:4807"),  # grads from Paris
    "EPSG:4267": ((33.4, -111.9), "EPSG:4267"),
    "EPSG:3857": ((46.0, 7.0), "EPSG:3857"),
    "EPSG:2225": ((41.0, -122.0), "EPSG:2225"),  # US survey feet
    "EPSG:2277": ((30.3, -97.7), "EPSG:2277"),
    "EPSG:2222": ((33.4, -111.9), "EPSG:2222"),  # international feet
    "EPSG:2225+6360": ((41.0, -122.0), "EPSG:2225"),
    "+proj=utm +zone=10 +datum=WGS84 +units=us-ft": (
        (41.0, -122.0),
        "+proj=utm +zone=10 +datum=WGS84 +units=us-ft",
    ),
    "WGS84 UTM 32N": ((46.0, 7.0), "EPSG:32632"),
    "WGS84 UTM32T": ((46.0, 7.0), "EPSG:32632"),
    "WGS84 UTM 38S": ((-12.8, 45.29), "EPSG:32738"),
    "ETRS89 / UTM zone 33N": ((59.4, 16.6), "EPSG:25833"),
    "EPSG:31467": ((48.8, 9.2), "EPSG:31467"),  # its own order is north, east
    "EPSG:2056": ((46.9, 7.4), "EPSG:2056"),
    "EPSG:2193": ((-41.3, 174.8), "EPSG:2193"),
    "EPSG:27700": ((51.5, -1.2), "EPSG:27700"),
    "EPSG:4326 ": ((-17.0, 179.99999), "EPSG:4326"),
    "EPSG:4978": ((46.0, 7.0), "EPSG:4978"),
}
HEIGHTS_M = {"": None, "metres": 1.0, "feet": 0.3048, "flat": np.inf}
SHAPE = np.array([[1.0, 0, 0], [-1, 1, 0], [0, -1, 0.2], [0.5, 0.5, 1.0], [-0.6, -0.7, 0.5]])


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    system=st.sampled_from(sorted(SYSTEMS)),
    heights=st.sampled_from(sorted(HEIGHTS_M)),
    swapped=st.booleans(),
    level=st.booleans(),
    noise_m=st.sampled_from([0.0, 0.004]),
)
def test_control_points_in_any_system(
    tmp_path: Path, system: str, heights: str, swapped: bool, level: bool, noise_m: float
) -> None:
    """Right where the file is as its first line says; else refused, or the error that is told holds the truth."""
    at, same = SYSTEMS[system]
    points = SHAPE * [1, 1, 0 if level else 1]
    noisy = points + np.random.default_rng(1).normal(0, noise_m, points.shape)
    longitude, latitude, up = on_earth(noisy, at)
    crs, unit = CRS(same), HEIGHTS_M[heights]
    if crs.is_geocentric:
        said = np.column_stack(
            Transformer.from_crs("EPSG:4979", crs, always_xy=True).transform(longitude, latitude, up)
        )
    else:
        x, y = Transformer.from_crs("EPSG:4326", crs, always_xy=True).transform(longitude, latitude)
        own = crs.axis_info[0].unit_conversion_factor if crs.is_projected else 1.0
        said = np.column_stack([x, y, up / (unit or own)])
        said = said[:, [1, 0, 2]] if swapped else said
    try:
        found = find_scale(MODEL, photographs(), None, marks(tmp_path / "gcp.txt", points, system, said=said))
    except UserError as error:
        assert "does not fit the model" in str(error) or "there are no such places in" in str(error)
        assert (swapped and not crs.is_geocentric) or (heights and not level)
        return
    told = float(found.notes[0].split(" %")[0].split()[-1]) / 100
    assert found.metres_per_model_unit == pytest.approx(1 / 0.37, rel=max(0.01, 1.2 * told))
    assert found.up is None or found.up @ TURN @ [0, 0, 1] > np.cos(np.deg2rad(1.5))
    assert (found.up is not None) == (told < 0.02)
    assert f"read as {system.strip()}" in found.notes[0] and ", heights in " in found.notes[0]


@pytest.mark.parametrize("relief", [0.0, 0.02, 0.3])
def test_east_and_north_that_change_places_are_refused(tmp_path: Path, relief: float) -> None:
    """On level ground a mirror image fits, with the cameras below it."""
    points = SHAPE * [1, 1, relief]
    said = (points + np.array([494000, 494000, 0]))[:, [1, 0, 2]]
    with pytest.raises(
        UserError,
        match=r"the cameras are below the control points; X is east|does not fit the model: .* m rms",
    ):
        find_scale(MODEL, photographs(), None, marks(tmp_path / "gcp.txt", points, "local", said=said))


RINGS = np.array(
    [[r * np.cos(a), r * np.sin(a), h] for r, h in ((40, 14), (28, 28)) for a in np.arange(0, 6, 0.6)]
)
ALTITUDES = {
    "all": lambda up: up,
    "none": lambda up: up * np.nan,
    "constant": lambda up: up * 0 + 3,
    "nearly constant": lambda up: 3 + 0.01 * up,
    "in feet": lambda up: up / 0.3048,
    "of each flight's start": lambda up: up - 14 * (up > 20),
    "some": lambda up: np.where(np.arange(len(up)) % 3 == 0, np.nan, up),
}


@settings(max_examples=40, deadline=None)
@given(
    altitudes=st.sampled_from(sorted(ALTITUDES)),
    noise_m=st.sampled_from([0.0, 0.1, 0.5, 2.0]),
    seed=st.integers(0, 99),
    at=st.sampled_from([(46.0, 7.0), (-33.9, 179.9999), (64.1, -21.9)]),
)
def test_the_error_that_gps_tells_holds_the_truth(
    altitudes: str, noise_m: float, seed: int, at: tuple
) -> None:
    noisy = RINGS + np.random.default_rng(seed).normal(0, noise_m, RINGS.shape)
    noisy[:, 2] = ALTITUDES[altitudes](noisy[:, 2])
    found = find_scale(seen_from(RINGS), photographs(noisy, at), None, None)
    if altitudes == "none":
        assert found.source == "none" and "no GPS with altitude" in found.notes[0]
    elif noise_m <= 0.5 and altitudes in ("all", "some"):
        assert found.source == "gps"
    if found.source == "gps":
        told = float(found.notes[0].split()[-2]) / 100
        assert found.metres_per_model_unit == pytest.approx(1 / 0.37, rel=max(1.1 * told, 1e-3))


def test_gps_gives_the_scale_where_it_is_good_enough() -> None:
    noise = np.random.default_rng(1).normal(0, 1, PLACES.shape)
    found = find_scale(MODEL, photographs(PLACES + 0.1 * noise), None, None)
    assert found.source == "gps"
    assert found.metres_per_model_unit == pytest.approx(1 / 0.37, rel=0.02)
    coarse = find_scale(MODEL, photographs(PLACES + 8 * noise), None, None)
    assert coarse.source == "none" and "too coarse" in coarse.notes[0]
    assert coarse.metres_per_unit(1.0, 1.0) is None
    assert find_scale(MODEL, photographs(), None, None).source == "none"
