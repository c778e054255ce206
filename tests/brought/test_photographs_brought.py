"""Photographs that people bring: one small case of each kind, with what is true beside it, and variants that are drawn."""

import io
import json
import re
import shutil
import struct
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue

import drawn_ball as ball
import numpy as np
import pycolmap
import pytest
import rendered_photographs
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from rendered_photographs import save, silent

from nbv.cache import Store
from nbv.errors import UserError
from nbv.geometry.frames import align_umeyama, look_at
from nbv.photographs.dense_reference import object_cloud
from nbv.photographs.folder import MIRRORED, _position, find_masks, read_folder
from nbv.photographs.import_source import ImportSource
from nbv.photographs.importer import ImportOptions, import_photographs
from nbv.photographs.mapping import _cameras, _Images, solve
from nbv.photographs.model_files import read_model
from nbv.photographs.object_frame import find_object
from nbv.types import PointCloud

SET_RADIUS = ball.RADIUS_M * 3.5 / ball.DISTANCE_M


def source_of(folder: Path, masks: Path | None = None, max_size_px: int = 160) -> ImportSource:
    photographs, _ = read_folder(folder, silent, masks)
    found = {} if masks is None else find_masks(masks, photographs)
    return ImportSource(tuple(photographs), max_size_px, silent, masks=found)


def refusal(call, *args: object) -> str:
    with pytest.raises(UserError) as told:
        call(*args)
    assert "\n" not in str(told.value)
    return str(told.value)


def alpha(mask: np.ndarray) -> Image.Image:
    grey = np.full((*mask.shape, 3), 90, np.uint8)
    return Image.fromarray(np.dstack([grey, 255 * mask.astype(np.uint8)]))


def palette(mask: np.ndarray) -> Image.Image:
    picture = Image.fromarray(mask.astype(np.uint8)).convert("P")
    picture.putpalette([0, 0, 0, 128, 0, 0])
    return picture


MASKS = {  # form: of a mask (H, W) the picture, and the words that refuse it
    "255": (lambda m: Image.fromarray(m.astype(np.uint8) * 255), None),
    "0 and 1": (lambda m: Image.fromarray(m.astype(np.uint8)), None),
    "1 bit": (lambda m: Image.fromarray(m), None),
    "16 bits": (lambda m: Image.fromarray(m.astype(np.uint16) * 65535), None),
    "alpha": (alpha, None),
    "palette": (palette, None),
    "twice as large": (lambda m: Image.fromarray(np.kron(m, np.ones((2, 2), np.uint8)) * 255), None),
    "inverted": (lambda m: Image.fromarray((~m).astype(np.uint8) * 255), "black where the cameras look"),
    "white": (lambda m: Image.fromarray(np.full_like(m, 255, np.uint8)), "white everywhere"),
    "black": (lambda m: Image.fromarray(np.zeros_like(m, np.uint8)), "black everywhere"),
    "labels": (lambda m: Image.fromarray(m.astype(np.uint8) * 7), "nowhere brighter than 7"),
    "cut": (lambda m: Image.fromarray(m[20:].astype(np.uint8) * 255), "ratio of sides"),
}


@settings(max_examples=12, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    lens=st.sampled_from(sorted(ball.LENSES)),
    orientation=st.sampled_from(sorted(ball.STORED)),
    of_stored=st.booleans(),
    masks_of_stored=st.booleans(),
    form=st.sampled_from(sorted(MASKS)),
)
def test_lens_orientation_and_masks(
    tmp_path: Path, lens: str, orientation: int, of_stored: bool, masks_of_stored: bool, form: str
) -> None:
    """A model of stored or turned pixels, masks drawn on stored or turned pixels: the ball is where and as large as it is."""
    shutil.rmtree(tmp_path)
    folder = ball.write_photographs(tmp_path / "photographs", lens, orientation)
    (tmp_path / "model").mkdir()
    ball.model(lens, orientation if of_stored else 1).write_binary(tmp_path / "model")
    make, words = MASKS[form]
    (tmp_path / "masks").mkdir()
    for index, (_, mask) in enumerate(ball.drawn(lens), start=1):
        drawn = ball.STORED[orientation][0](mask) if masks_of_stored else mask
        make(np.ascontiguousarray(drawn)).save(tmp_path / "masks" / f"view_{index:02d}.png")
    same_sides = orientation in (2, 3, 4)
    if same_sides:
        assert "nothing tells whether its mask is" in refusal(source_of, folder, tmp_path / "masks")
    source = source_of(folder, None if same_sides else tmp_path / "masks")
    model, source, _ = solve(source, tmp_path / "model")
    fit = align_umeyama(ball.positions_m(), model.centers)
    assert fit.scale == pytest.approx(1.0, rel=1e-6)
    assert np.allclose(fit.apply(model.centers), ball.positions_m(), atol=1e-6)
    if words is not None and not same_sides:
        assert words in refusal(find_object, model, source)
        return
    for (_, mask), photograph in zip(
        ball.drawn(lens), source.photographs if source.masks else (), strict=False
    ):
        true = mask
        if not source.upright:
            true = ball.STORED[orientation][0](mask)
            true = true[:, ::-1] if orientation in MIRRORED else true
        assert (source.mask(photograph.name) == true).all()
    frame = find_object(model, source)
    assert frame.frame_from_model.scale * ball.RADIUS_M == pytest.approx(SET_RADIUS, rel=0.01)
    assert frame.grounded and (frame.high_m - frame.low_m)[2] == pytest.approx(2 * SET_RADIUS, rel=0.02)


@pytest.mark.parametrize("count", [0, 3, 14])
def test_photographs_without_a_mask_say_nothing_where_others_have_one(tmp_path: Path, count: int) -> None:
    folder, masks = ball.write_photographs(tmp_path / "photographs"), tmp_path / "masks"
    (tmp_path / "model").mkdir()
    ball.model("PINHOLE").write_binary(tmp_path / "model")
    masks.mkdir()
    for index, (_, mask) in list(enumerate(ball.drawn("PINHOLE"), start=1))[::-1][:count]:
        Image.fromarray(mask.astype(np.uint8) * 255).save(masks / f"view_{index:02d}.png")
    model, source, _ = solve(source_of(folder, masks if count else None), tmp_path / "model")
    frame = find_object(model, source)
    assert (frame.high_m - frame.low_m)[2] == pytest.approx(2 * SET_RADIUS, rel=0.03)
    assert ("masks for 3 of 14 photographs" in frame.notes) == (count == 3)
    ground = np.random.default_rng(0).uniform([-1, -1, 0], [1, 1, 0], (3000, 3)) + frame.low_m * [0, 0, 1]
    cloud = PointCloud(np.concatenate([ground, ground + np.array([0, 0, 0.5])]), None, None)
    # Masks of all photographs have taken the ground away already.
    assert (object_cloud(cloud, frame).points_m[:, 2] < ground[0, 2] + 0.1).any() == (count == 14)


def tagged(folder: Path, index: int, tags: dict[int, object]) -> None:
    exif = Image.Exif()
    (exif if 0x8827 in tags else exif.get_ifd(0x8769)).update(tags)
    pixels = np.random.default_rng(index).integers(0, 255, (48, 64, 3), dtype=np.uint8)
    Image.fromarray(pixels).save(folder / f"{index}.jpg", exif=exif)


FOCAL, FOCAL_35, ZOOM, LENS, SPEC, PLANE_X, ISO = 0x920A, 0xA405, 0xA404, 0xA434, 0xA432, 0xA20E, 0x8827
SERIAL = 0xA435


@pytest.mark.parametrize(
    ("one", "other", "cameras"),
    [
        ({FOCAL: 18.8}, {FOCAL: 29.5}, 2),
        ({FOCAL_35: 28}, {FOCAL_35: 44}, 2),
        ({LENS: "EF 24 mm"}, {LENS: "EF 50 mm"}, 2),
        ({SPEC: (24.0, 24.0, 2.8, 2.8)}, {SPEC: (50.0, 50.0, 1.8, 1.8)}, 2),
        ({ZOOM: 2.0}, {ZOOM: 1.5}, 2),
        ({PLANE_X: 3000.0}, {PLANE_X: 6000.0}, 2),
        ({FOCAL: 18.8, FOCAL_35: 1}, {FOCAL: 18.8}, 1),
        ({FOCAL: 18.8, FOCAL_35: 0, ZOOM: 0.0, LENS: "----"}, {FOCAL: 18.8, ZOOM: 1.0, LENS: ""}, 1),
        ({FOCAL: 0.0}, {}, 1),
        ({LENS: "Unknown"}, {LENS: "N/A"}, 1),
        ({LENS: "----"}, {LENS: "0.0 mm f/0.0"}, 1),
        ({SERIAL: "0000000"}, {}, 1),
        ({SERIAL: "0000001"}, {SERIAL: "0000002"}, 2),
        ({FOCAL_35: 65535}, {}, 1),  # EXIF's word for unknown
        ({FOCAL: 18.8, ISO: 100}, {FOCAL: 29.5, ISO: 100}, 2),  # as TIFF/EP has it, without EXIF's block
    ],
)
def test_every_tag_that_says_a_lens_changed_separates_cameras(
    tmp_path: Path, one: dict, other: dict, cameras: int
) -> None:
    for index in range(8):
        tagged(tmp_path, index, one if index % 2 else other)
    found, ids = _cameras(source_of(tmp_path))
    assert len(found) == cameras and len(set(ids)) == cameras
    for camera in found.values():
        told = {one.get(FOCAL_35), other.get(FOCAL_35)} - {None, 0, 1, 65535}
        assert camera.has_prior_focal_length == bool(told)
        assert camera.focal_length_x > 0.5 * camera.width


def test_a_part_of_the_sensor_is_a_camera_of_its_own(tmp_path: Path) -> None:
    """Pictures of several sizes are of one size once they are shrunk, and have no tag that says why."""
    for index in range(8):
        size = (300, 200) if index % 2 else (240, 160)
        save(
            Image.fromarray(np.full((*size[::-1], 3), 70 + 20 * index, np.uint8)),
            tmp_path / f"{index}.jpg",
            index,
        )
    found, ids = _cameras(source_of(tmp_path, max_size_px=120))
    assert sorted(set(ids)) == sorted(found) == [1, 2]
    assert {(c.width, c.height) for c in found.values()} == {(120, 80)}


@pytest.mark.parametrize(
    ("north", "east", "degrees", "position"),
    [
        ("N", "E", 40.5, (40.5, 10.0)),
        ("S", "W", 40.5, (-40.5, -10.0)),
        ("S\0\0", "w", 40.5, (-40.5, -10.0)),
        ("South", "E", 40.5, (-40.5, 10.0)),
        ("N", "E", float("nan"), None),
    ],
)
def test_where_exif_says_a_photograph_was_taken(
    north: str, east: str, degrees: float, position: tuple[float, float] | None
) -> None:
    told = _position({1: north, 2: (degrees, 0.0, 0.0), 3: east, 4: (10.0, 0.0, 0.0), 6: 7.0})
    assert told == (position and (*position, 7.0))
    assert _position({1: north, 2: (degrees, 0.0, 0.0), 3: east, 4: (10.0, 0.0, 0.0), 6: 0.0}) is None


def frames() -> list[dict]:
    return rendered_photographs.frames(ball.positions_m(), "images/view_{:02d}.png", 1)


CAMERA = {"w": 160, "h": 120, "fl_x": 130.0, "fl_y": 131.0, "cx": 81.0, "cy": 59.0}
LENS_4 = {"k1": 0.02, "k2": -0.01, "k3": 0.003, "k4": -0.001}
FISHEYE = ("OPENCV_FISHEYE", [130, 131, 81, 59, 0.02, -0.01, 0.003, -0.001])
FOV = {"w": 160, "h": 120, "camera_angle_x": 1.0, "camera_angle_y": 0.8}


@pytest.mark.parametrize(
    ("camera", "true"),
    [
        ({**CAMERA, "k1": 0.1, "p1": 0.01}, ("OPENCV", [130, 131, 81, 59, 0.1, 0, 0.01, 0])),
        ({**CAMERA, "camera_model": "PINHOLE"}, ("PINHOLE", [130, 131, 81, 59])),
        ({**CAMERA, **LENS_4, "camera_model": "OPENCV_FISHEYE"}, FISHEYE),
        ({**CAMERA, **LENS_4, "is_fisheye": True}, FISHEYE),
        (
            {**CAMERA, **LENS_4, "k5": 0.01, "camera_model": "FULL_OPENCV"},
            ("FULL_OPENCV", [130, 131, 81, 59, 0.02, -0.01, 0, 0, 0.003, -0.001, 0.01, 0]),
        ),
        (FOV, ("PINHOLE", [80 / np.tan(0.5), 60 / np.tan(0.4), 80, 60])),
        ({**CAMERA, "is_fisheye": "false"}, ("PINHOLE", [130, 131, 81, 59])),
        (
            {**CAMERA, "frame": {"camera_angle_x": 1.0}},
            ("PINHOLE", [80 / np.tan(0.5), 80 / np.tan(0.5), 81, 59]),
        ),
        ({**CAMERA, "frame": {"fl_x": 120.0}}, ("PINHOLE", [120, 120, 81, 59])),
        ({**CAMERA, "distortion_model": None, "orthographic": False}, ("PINHOLE", [130, 131, 81, 59])),
        (
            {**CAMERA, "camera_type": "PERSPECTIVE"},
            "camera_type is PERSPECTIVE, which camera_model FULL_OPENCV does not",
        ),
        ({**CAMERA, "k1": 0.1, "distortion_model": "none"}, "distortion_model is none, which"),
        ({**CAMERA, "fl_y": 1e9}, "a camera of 160 x 120 px with focal length 130 and 1e+09 px"),
        ({**CAMERA, "fl_x": 0.01, "fl_y": 0.01}, "focal length 0.01 and 0.01 px"),
        ({**CAMERA, "cx": 1e6}, "principal point at (1e+06, 59), outside the picture"),
        ({**CAMERA, "frame": {"w": 320, "h": 240}}, "has a size of its own, but no fl_x of its own"),
        ({**CAMERA, "camera_angle_x": 1.3}, "fl_x is 130, but camera_angle_x says 105.2"),
        ({**CAMERA, "radial": [0.1, 0.2]}, "radial is [0.1, 0.2]"),
        ({**CAMERA, **LENS_4}, "k4 is -0.001, which camera_model FULL_OPENCV does not have; remove it"),
        ({**CAMERA, "p1": 0.01, "is_fisheye": True}, "p1 is 0.01, which camera_model OPENCV_FISHEYE"),
        ({**CAMERA, "ftheta_p0": 0.1}, "ftheta_p0 is 0.1"),
        ({**CAMERA, "camera_model": "EQUIRECTANGULAR"}, "EQUIRECTANGULAR"),
        ({**CAMERA, "camera_model": "SIMPLE_RADIAL_FISHEYE"}, "has one focal length"),
        ({**FOV, "camera_angle_x": 0}, "camera_angle_x is 0; it lies between 0 and pi"),
        ({**CAMERA, "w": 0, "h": 0}, "a camera of 0 x 0 px"),
        ({**CAMERA, "fl_x": 0}, "focal length"),
        ({**CAMERA, "fl_x": float("nan")}, "finite"),
    ],
)
def test_projection_models_of_transforms_json(tmp_path: Path, camera: dict, true: object) -> None:
    source = source_of(ball.write_photographs(tmp_path / "photographs"))
    path = tmp_path / "transforms.json"
    own = camera.get("frame", {})
    shared = {key: value for key, value in camera.items() if key != "frame"}
    path.write_text(json.dumps({**shared, "aabb_scale": 4, "frames": [{**f, **own} for f in frames()]}))
    if isinstance(true, str):
        assert true in refusal(read_model, path, source)
        return
    [(model, _)] = read_model(path, source)
    expected = pycolmap.Camera(model=true[0], width=160, height=120, params=true[1])
    rays = np.column_stack([*np.random.default_rng(0).uniform(-0.5, 0.5, (2, 50)), np.ones(50)])
    assert np.allclose(model.cameras[0].img_from_cam(rays), expected.img_from_cam(rays), atol=1e-9)


@pytest.mark.parametrize("orientation", [1, 6])
def test_without_a_size_the_photographs_own_holds(tmp_path: Path, orientation: int) -> None:
    """As in NeRF's own files, which have a camera_angle_x alone, and names without suffix."""
    source = source_of(ball.write_photographs(tmp_path / "photographs"))
    if orientation == 6:
        turned = tuple(replace(p, orientation=6, size_px=p.size_px[::-1]) for p in source.photographs)
        source = replace(source, photographs=turned)
    bare = [{**f, "file_path": f["file_path"].rpartition(".")[0]} for f in frames()]
    others = [{**bare[0], "file_path": f"./test/r_{k}"} for k in range(3)]
    angle = 2 * np.arctan(80 / 200)
    (tmp_path / "transforms.json").write_text(json.dumps({"camera_angle_x": angle, "frames": bare + others}))
    model, _ = read_model(tmp_path / "transforms.json", source)[0]
    assert len(model.cameras) == len(bare)
    assert (model.cameras[0].width, model.cameras[0].height) == (160, 120)
    assert model.cameras[0].mean_focal_length() == pytest.approx(200)
    (tmp_path / "transforms.json").write_text(json.dumps({"camera_angle_x": angle, "frames": others}))
    assert "names none of the photographs" in refusal(read_model, tmp_path / "transforms.json", source)


def mirrored(frame: dict) -> dict:
    pose = np.array(frame["transform_matrix"]) @ np.diag([-1, 1, 1, 1])
    return {**frame, "transform_matrix": pose.tolist()}


METASHAPE = "File > Export > Export Cameras as Colmap"
NO_MODELS = {  # of a model the file, what it holds (None: there is none), and the words that refuse it
    "one pose": (
        "transforms.json",
        {"frames": frames()[:1]},
        "has the poses of 1 of the 14 photographs; 3 or",
    ),
    "two poses": (
        "transforms.json",
        {"frames": frames()[:2]},
        "has the poses of 2 of the 14 photographs; 3 or",
    ),
    "others": (
        "transforms.json",
        {"frames": [{**frames()[0], "file_path": "a.jpg"}]},
        "none of its 1 images",
    ),
    "other sizes": ("transforms.json", {"w": 1000, "frames": frames()}, "it has view_01.png with 1000 x 120"),
    "mirrored": ("transforms.json", {"frames": [*map(mirrored, frames())]}, "is not a rigid transform"),
    "none": ("absent.json", None, "there is no model"),
    "a folder": ("photographs", None, "no COLMAP model"),
    "Metashape": ("cameras.xml", {}, METASHAPE),
    "OpenSfM": ("reconstruction.json", {}, "export_colmap"),
}


@pytest.mark.parametrize("case", NO_MODELS)
def test_what_is_no_model_of_the_photographs_is_one_line(tmp_path: Path, case: str) -> None:
    source = source_of(ball.write_photographs(tmp_path / "photographs"))
    name, held, words = NO_MODELS[case]
    if held is not None:
        (tmp_path / name).write_text(json.dumps({**CAMERA, **held}))
    assert words in refusal(read_model, tmp_path / name, source)


@pytest.mark.parametrize("text", [False, True])
def test_a_colmap_model_is_what_it_was_written_from(tmp_path: Path, text: bool) -> None:
    source = source_of(ball.write_photographs(tmp_path / "photographs"))
    made = ball.model("SIMPLE_RADIAL")
    (made.write_text if text else made.write_binary)(tmp_path)
    rays = np.column_stack([*np.random.default_rng(0).uniform(-0.5, 0.5, (2, 50)), np.ones(50)])
    for scale in (1.0, 0.5):
        [(model, _)] = read_model(tmp_path, replace(source, max_size_px=int(160 * scale)))
        assert model.names == tuple(p.name for p in source.photographs)
        assert np.allclose(model.poses, [look_at(at, ball.CENTRE_M) for at in ball.positions_m()], atol=1e-9)
        shown = scale * np.asarray(ball.camera("SIMPLE_RADIAL").img_from_cam(rays))
        assert np.allclose(model.cameras[0].img_from_cam(rays), shown, atol=1e-9)
        assert np.allclose(sorted(model.xyz.tolist()), sorted(p.xyz.tolist() for p in made.points3D.values()))
        assert len(model.views) == made.compute_num_observations()
        assert model.reprojection_errors_px().max() < 1e-6
    if text:
        with (tmp_path / "images.txt").open("a") as file:
            file.write("1 " * (6 * 2**20))
        assert "images.txt has a line of more than 10 MB" in refusal(read_model, tmp_path, source)
        (tmp_path / "images.txt").write_text("1 2 three\n")
        assert "cannot be read" in refusal(read_model, tmp_path, source)


def test_a_bad_name_is_that_of_a_set(tmp_path: Path) -> None:
    said = refusal(import_photographs, tmp_path, "My Set", ImportOptions(), silent)
    assert "'My Set' cannot name a set of photographs" in said


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        ("cameras.bin", lambda b: b[:16] + bytes(16) + b[32:], "a camera of 0 x 0 px"),
        ("images.bin", lambda b: b.replace(b"view_03", b"vi\xe9w_03"), "an image's name is not UTF-8"),
        (
            "points3D.bin",
            lambda b: struct.pack("<Q", 10**8),
            "points3D.bin counts more than its 8 bytes hold",
        ),
        ("images.bin", lambda b: b[:-40], "cannot be read"),
        ("points3D.bin", lambda b: b[:51] + struct.pack("<Q", 10**10) + b[59:], "points3D.bin counts more"),
        ("images.bin", lambda b: b[:83] + struct.pack("<Q", 10**9) + b[91:], "images.bin counts more"),
    ],
)
def test_a_damaged_colmap_model_is_one_line_at_once(tmp_path: Path, file: str, change, words: str) -> None:
    source = source_of(ball.write_photographs(tmp_path / "photographs"))
    ball.model("PINHOLE").write_binary(tmp_path)
    whole = (tmp_path / file).read_bytes()
    (tmp_path / file).write_bytes(change(whole))
    assert words in refusal(read_model, tmp_path, source)


def test_rigs_and_frames_of_a_colmap_model_are_not_needed(tmp_path: Path) -> None:
    """Damaged ones, which COLMAP reads for minutes, change nothing."""
    source = source_of(ball.write_photographs(tmp_path / "photographs"))
    ball.model("PINHOLE").write_binary(tmp_path)
    (tmp_path / "frames.bin").write_bytes(struct.pack("<Q", 10**10) + bytes(8))
    rigs = (tmp_path / "rigs.bin").read_bytes()
    (tmp_path / "rigs.bin").write_bytes(rigs[:12] + b"\xff\xff\xff\xff" + rigs[16:])
    [(model, _)] = read_model(tmp_path, source)
    assert np.allclose(model.centers, ball.positions_m()) and len(model.xyz) > 1000


def test_one_name_in_two_folders_of_a_model(tmp_path: Path) -> None:
    """The one of the folder given; where nothing tells, one line. Photographs in folders have names with their folders."""
    out = ball.model("PINHOLE", name="right/{}.png")
    wrong = ball.model("PINHOLE", name="left/{}.png")
    for i, image in wrong.images.items():
        copy = pycolmap.Image(name=image.name, keypoints=np.zeros((0, 2)), camera_id=1, image_id=i + 100)
        out.add_image_with_trivial_frame(copy, pycolmap.Rigid3d())
    out.write_binary(tmp_path)
    [(model, _)] = read_model(tmp_path, source_of(ball.write_photographs(tmp_path / "right")))
    assert np.allclose(model.centers, ball.positions_m())
    message = refusal(read_model, tmp_path, source_of(ball.write_photographs(tmp_path / "other")))
    assert "has one name in two folders" in message
    both = tmp_path / "both"
    for k, side in enumerate(("left", "right")):
        ball.write_photographs(both / side)
        for n, path in enumerate(sorted((both / side).iterdir())):
            Image.fromarray(np.asarray(Image.open(path)) // 2 + n + 20 * k).save(path)
    (both / "masks").mkdir()
    shutil.copy(both / "left" / "view_01.png", both / "masks")
    source = source_of(both)
    assert len(source.photographs) == 28 and "left_view_01" in source.by_name
    [(model, _)] = read_model(tmp_path, source)
    at = model.names.index("right_view_03")
    assert np.allclose(model.centers[at], ball.positions_m()[2])
    for side in ("left", "right"):
        shutil.copytree(both / side, tmp_path / "masks" / side)
    assert find_masks(tmp_path / "masks", source.photographs)["left_view_02"].parent.name == "left"


def test_a_damaged_database_of_matches_is_made_anew(tmp_path: Path) -> None:
    found = source_of(ball.write_photographs(tmp_path / "photographs"))
    source = replace(found, store=Store(tmp_path / "store"))
    images = _Images(source, [p.name for p in source.photographs], *_cameras(source))
    with images.matched() as path:
        whole = path.read_bytes()
    for damaged in (whole, whole[: len(whole) // 2], b"no database" * 1000):
        path.write_bytes(damaged)
        with images.matched() as again, pycolmap.Database.open(again) as database:
            assert again == path and database.num_descriptors() > 0 and database.num_images() == 14


def test_two_imports_of_the_same_photographs_take_turns(tmp_path: Path) -> None:
    found, said = source_of(ball.write_photographs(tmp_path / "photographs")), SimpleQueue[str]()
    first, second = (
        _Images(replace(found, store=Store(tmp_path / "store"), progress=progress), names, *_cameras(found))
        for names in [[p.name for p in found.photographs]]
        for progress in (silent, lambda what, *_: said.put(what))
    )

    def matches() -> Path:
        with second.matched() as path:
            return path

    with ThreadPoolExecutor(1) as pool:
        with first.matched() as path:
            other = pool.submit(matches)
            assert said.get(timeout=30) == "waiting for another import of these photographs"
            assert not other.done()
        assert other.result(timeout=30) == path


def test_only_pictures_that_are_meant_are_opened(tmp_path: Path) -> None:
    """Whatever the suffix; and numbers that have no white are refused, not read as black."""
    deep = (np.arange(64 * 48).reshape(48, 64) % 4096).astype(np.uint16)
    eps = io.BytesIO()
    Image.fromarray((deep >> 8).astype(np.uint8)).save(eps, "EPS")
    cases = {
        "float.tif": (
            Image.fromarray((deep / 4095).astype(np.float32)),
            "float.tif is neither JPEG nor PNG; convert",
        ),
        "twelve.png": (Image.fromarray(deep), "brighter than 11 of 255, as with 12 bits in 16"),
        "full.png": (Image.fromarray(deep * 16), None),
        "eps.heic": (eps.getvalue(), "eps.heic is neither JPEG nor PNG; convert such files"),
        "eps.jpg": (eps.getvalue(), "whatever its name says"),
        "bmp.png": (Image.fromarray(deep.astype(np.uint8)), "whatever its name says"),
        "tiff.jpg": (Image.fromarray(deep), "it is TIFF"),
        "heic.jpg": (b"\0\0\0\x18ftypheic", "it is HEIC"),
        "text.jpg": (b"not a picture", "it is neither JPEG nor PNG"),
    }
    for name, (content, words) in cases.items():
        folder = tmp_path / name.replace(".", "_")
        folder.mkdir()
        for index in range(8):
            save(
                Image.fromarray(np.full((8, 8, 3), 70 + 20 * index, np.uint8)), folder / f"{index}.jpg", index
            )
        if isinstance(content, bytes):
            (folder / name).write_bytes(content)
        else:
            content.save(folder / name, {"bmp.png": "BMP", "tiff.jpg": "TIFF"}.get(name))
        if words is not None:
            said = refusal(read_folder, folder, silent)
            assert words in said and name in said and "BytesIO" not in said
            continue
        whole = source_of(folder, max_size_px=64).pixels("full")
        assert (whole[..., 0] == (deep * 16) >> 8).all()


def test_photographs_with_transparent_parts_are_refused(tmp_path: Path) -> None:
    for index in range(9):
        rgba = np.full((8, 8, 4), (*[80 + 10 * index] * 3, 255), np.uint8)
        rgba[:4, :, 3] -= index < 3
        Image.fromarray(rgba).save(tmp_path / f"{index}.png")
    words = "3 of 9 photographs in .* 0.png .it has transparent parts: mogrify -alpha off, and --masks with what was"
    assert re.search(words, refusal(read_folder, tmp_path, silent))
