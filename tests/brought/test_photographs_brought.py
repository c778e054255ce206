"""Photographs that people bring: one small case of each kind, with what is true beside it, and variants that are drawn."""

import functools
import io
import re
import shutil
import struct
from dataclasses import replace
from pathlib import Path

import drawn_ball as ball
import numpy as np
import pycolmap
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from PIL import Image
from refusals import refused
from rendered_photographs import save, silent, write_folder
from scene_helpers import around

from nbv.geometry.frames import align_umeyama, look_at
from nbv.photographs.dense_reference import object_cloud
from nbv.photographs.folder import SourcePhotograph, _position, read_folder
from nbv.photographs.import_source import ImportSource, find_masks
from nbv.photographs.importer import ImportOptions, find_scale, import_photographs
from nbv.photographs.object_frame import find_object
from nbv.photographs.sparse_model import SolvedModel, cameras_of, match_photographs, read_model, solve
from nbv.types import PointCloud

SET_RADIUS = ball.RADIUS_M * 3.5 / ball.DISTANCE_M


def source_of(folder: Path, masks: Path | None = None, max_size_px: int = 160) -> ImportSource:
    photographs, _ = read_folder(folder, silent, masks)
    found = {} if masks is None else find_masks(masks, photographs)
    return ImportSource(tuple(photographs), max_size_px, silent, masks=found)


refusal = functools.partial(refused, ".")


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
def test_lens_orientation_and_masks(tmp_path, lens, orientation, of_stored, masks_of_stored, form):
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
    same_sides = orientation == 3
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
        ({LENS: "----"}, {LENS: "0.0 mm f/0.0"}, 1),
        ({SERIAL: "0000001"}, {SERIAL: "0000002"}, 2),
        ({FOCAL_35: 65535}, {}, 1),  # EXIF's word for unknown
        ({FOCAL: 18.8, ISO: 100}, {FOCAL: 29.5, ISO: 100}, 2),  # as TIFF/EP has it, without EXIF's block
    ],
)
def test_every_tag_that_says_a_lens_changed_separates_cameras(tmp_path, one, other, cameras):
    for index in range(8):
        tagged(tmp_path, index, one if index % 2 else other)
    found, ids = cameras_of(source_of(tmp_path))
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
    found, ids = cameras_of(source_of(tmp_path, max_size_px=120))
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
def test_where_exif_says_a_photograph_was_taken(north, east, degrees, position):
    told = _position({1: north, 2: (degrees, 0.0, 0.0), 3: east, 4: (10.0, 0.0, 0.0), 6: 7.0})
    assert told == (position and (*position, 7.0))
    assert _position({1: north, 2: (degrees, 0.0, 0.0), 3: east, 4: (10.0, 0.0, 0.0), 6: 0.0}) is None


RINGS = np.array(
    [[r * np.cos(a), r * np.sin(a), h] for r, h in ((40, 14), (28, 28)) for a in np.arange(0, 6, 0.6)]
)
SCALE = 0.37  # model units per metre
ALTITUDES = {
    "all": lambda up: up,
    "none": lambda up: up * np.nan,
    "constant": lambda up: up * 0 + 3,
    "in feet": lambda up: up / 0.3048,
    "of each flight's start": lambda up: up - 14 * (up > 20),
    "some": lambda up: np.where(np.arange(len(up)) % 3 == 0, np.nan, up),
}


@pytest.mark.parametrize("at", [(46.0, 7.0), (-33.9, 179.9999), (64.1, -21.9)])
@pytest.mark.parametrize("noise_m", [0.0, 0.5, 2.0, 20.0])
@pytest.mark.parametrize("altitudes", sorted(ALTITUDES))
def test_the_error_that_gps_tells_holds_the_truth(altitudes: str, noise_m: float, at: tuple) -> None:
    """Photographs that know their places on Earth: what is told of the scale is as good as it says, or there is none."""
    noisy = RINGS + np.random.default_rng(0).normal(0, noise_m, RINGS.shape)
    noisy[:, 2] = 400 + ALTITUDES[altitudes](noisy[:, 2])
    radius_m = 6_371_000.0
    north = at[0] + np.rad2deg(noisy[:, 1] / radius_m)
    east = at[1] + np.rad2deg(noisy[:, 0] / (radius_m * np.cos(np.deg2rad(at[0]))))
    places = zip(north.tolist(), ((east + 180) % 360 - 180).tolist(), noisy[:, 2].tolist(), strict=True)
    photographs = tuple(
        SourcePhotograph(
            Path(f"{k}.jpg"), str(k), "", (1, 1), 1, "", None, None, place if np.isfinite(place[2]) else None
        )
        for k, place in enumerate(places)
    )
    names = tuple(p.name for p in photographs)
    poses = np.array([look_at(SCALE * at_m, np.zeros(3)) for at_m in RINGS])
    none = np.zeros(0, dtype=np.int64)
    model = SolvedModel(
        names, poses, (), np.zeros((0, 3)), np.zeros((0, 3)), none, none, np.zeros((0, 2)), 0.0
    )
    source = ImportSource(photographs, 1280, silent)
    found, metres, notes = find_scale(model, source, ImportOptions())
    if altitudes == "none":
        assert found == "none" and "no GPS with altitude" in notes[0]
    elif noise_m == 20.0:
        assert found == "none" and "too coarse" in notes[0]
    elif noise_m <= 0.5 and altitudes in ("all", "some"):
        assert found == "gps"
    if found == "gps":
        told = float(notes[0].split()[-2]) / 100
        # Degrees are of a sphere here, whose radius is up to 0.5 % that of the ellipsoid's curvature.
        assert metres == pytest.approx(1 / SCALE, rel=max(1.1 * told, 5e-3))
    height = ImportOptions(height_m=1.0)
    assert find_scale(model, source, height) == ("length", None, [])
    of_model = ImportOptions(model=Path("model"), metres_per_unit=2.0)
    assert find_scale(model, source, of_model) == ("model", 2.0, [])


METASHAPE = "File > Export > Export Cameras as Colmap"


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("absent", "there is no model"),
        ("photographs", "no COLMAP model"),
        ("cameras.xml", METASHAPE),
        ("reconstruction.json", "export_colmap"),
        ("transforms.json", "is no COLMAP model"),
    ],
)
def test_what_is_no_colmap_model_is_one_line(tmp_path: Path, name: str, words: str) -> None:
    source = source_of(ball.write_photographs(tmp_path / "photographs"))
    if "." in name:
        (tmp_path / name).write_text("{}")
    assert words in refusal(read_model, tmp_path / name, source)


def test_what_is_a_model_of_something_else_is_one_line(tmp_path: Path) -> None:
    source = source_of(ball.write_photographs(tmp_path / "photographs"))
    ball.model("PINHOLE", name="other_{}.png").write_binary(tmp_path)
    assert "none of its 14 images" in refusal(read_model, tmp_path, source)
    ball.model("PINHOLE", 6).write_binary(tmp_path)
    assert "it has view_01.png with 120 x 160 px, the folder with 160 x 120" in refusal(
        read_model, tmp_path, source
    )
    without = ball.model("PINHOLE")
    for point in list(without.points3D):
        without.delete_point3D(point)
    without.write_binary(tmp_path)
    assert "point_triangulator" in refusal(read_model, tmp_path, source)


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
        assert model.median_px < 1e-6
    if text:
        (tmp_path / "images.txt").write_text("1 2 three\n")
        assert "cannot be read" in refusal(read_model, tmp_path, source)


@pytest.mark.parametrize(
    ("file", "change", "words"),
    [
        (
            "cameras.bin",
            lambda b: b[:16] + bytes(16) + b[32:],
            "no perspective picture is of a PINHOLE of 0 x 0 px",
        ),
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


def test_matching_goes_on_where_it_was(tmp_path: Path) -> None:
    source = source_of(ball.write_photographs(tmp_path / "photographs"))
    steps: list[str] = []

    def killed(what: str, done: int, _: int) -> None:
        steps.append(what)
        if what == "matching photographs":
            raise KeyboardInterrupt

    folder = tmp_path / "work"
    folder.mkdir()
    where = (*cameras_of(source), tmp_path / "database", folder)
    with pytest.raises(KeyboardInterrupt):
        match_photographs(replace(source, progress=killed), *where)
    with pycolmap.Database.open(tmp_path / "database") as database:
        before = database.num_keypoints()
        assert before > 0 and database.num_matched_image_pairs() == 0
    match_photographs(source, *where)
    with pycolmap.Database.open(tmp_path / "database") as database:
        assert (database.num_images(), database.num_cameras()) == (14, 1)
        assert database.num_keypoints() == before and database.num_matched_image_pairs() > 20


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
        "twelve.png": (Image.fromarray(deep), "brighter than 11 of 255, as with 12 bits in 16 or depths"),
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


def pictures(folder: Path, count: int = 9, size: tuple[int, int] = (480, 360)) -> Path:
    """``view_0.jpg`` and so on: smooth pictures of which neighbours are alike, with the noise of a sensor."""
    folder.mkdir(parents=True)
    x, y = np.meshgrid(np.linspace(0, 1, size[0]), np.linspace(0, 1, size[1]))
    waves = np.random.default_rng(0).normal(0, 12, (12, 3))
    for index in range(count):
        grey = 128 + 25 * np.sin(np.array([x + 0.05 * index, y, 0 * x]).T @ waves.T + np.arange(12)).sum(-1).T
        noise = np.random.default_rng(index).normal(0, 4, grey.shape)
        picture = Image.fromarray(np.clip(grey + noise, 0, 255).astype(np.uint8)).convert("RGB")
        save(picture, folder / f"view_{index}.jpg", index)
    return folder


def shrunk(path: Path, to: Path, size: tuple[int, int], quality: int) -> None:
    to.parent.mkdir(parents=True, exist_ok=True)
    Image.open(path).convert("RGB").resize(size, Image.Resampling.BICUBIC).save(to, "JPEG", quality=quality)


def test_copies_are_no_photographs(tmp_path: Path) -> None:
    """Thumbnails of a storage server, pyramids of other programs, and pictures that were saved again."""
    folder = pictures(tmp_path / "all" / "images")
    for path in sorted(folder.iterdir()):
        shrunk(path, folder / "@eaDir" / path.name / "SYNOPHOTO_THUMB_M.jpg", (320, 240), 80)
        shrunk(path, folder / "@eaDir" / path.name / "SYNOPHOTO_THUMB_S.jpg", (120, 90), 60)
        for factor in (2, 4):
            size = (480 // factor, 360 // factor)
            shrunk(path, tmp_path / "all" / f"images_{factor}" / path.name, size, 90)
        shrunk(path, folder / f"{path.stem} (1).jpg", (480, 360), 50)
        shutil.copy(path, folder / f"{path.stem} copy.jpg")
    found, notes = read_folder(tmp_path / "all", silent)
    assert [p.path for p in found] == sorted(folder.glob("view_?.jpg"))
    assert {p.size_px for p in found} == {(480, 360)} and all(p.time for p in found)
    assert notes[0].startswith("left out 54 of 63 pictures, which are others in another size or compression")
    assert len(notes) == 1
    small, _ = read_folder(tmp_path / "all" / "images_4", silent)
    assert len(small) == 9  # what stands alone is a photograph


def test_upright_thumbnails_of_a_turned_photograph_are_copies(tmp_path: Path) -> None:
    for path in sorted(pictures(tmp_path / "photographs").iterdir()):
        shrunk(path, tmp_path / "photographs" / "small" / path.name, (160, 120), 70)
        sideways = Image.open(path).transpose(Image.Transpose.ROTATE_90)
        save(sideways, path, int(path.stem[-1]), orientation=6)
    found, _ = read_folder(tmp_path / "photographs", silent)
    assert len(found) == 9 and {p.size_px for p in found} == {(360, 480)}


def test_neighbouring_views_are_photographs(tmp_path: Path) -> None:
    """Rendered views 3 degrees apart, of one size and of two; and pictures that a clock takes apart."""
    azimuths = 3.0 * np.arange(10)
    folder = write_folder(tmp_path / "photographs", around(azimuths, 25.0, 4.0))
    for path in sorted(folder.iterdir())[::2]:
        Image.open(path).resize((360, 270)).save(path)
    assert len(read_folder(folder, silent)[0]) == 10
    for path in sorted(folder.iterdir()):
        save(Image.open(sorted(folder.iterdir())[0]).copy(), path, int(path.stem[-2:]))
    assert len(read_folder(folder, silent)[0]) == 10


def test_depth_pictures_are_no_photographs(tmp_path: Path) -> None:
    """As a telephone's scanner leaves them: 16 bits of millimetres beside the photographs."""
    folder = pictures(tmp_path / "scan" / "images")
    depth = np.linspace(500, 4000, 64 * 48).reshape(48, 64).astype(np.uint16)
    for name in ("depth", "lidar"):
        (tmp_path / "scan" / name).mkdir()
        for index in range(9):
            Image.fromarray(depth + index).save(tmp_path / "scan" / name / f"{index}.png")
    for asked in ("scan/lidar", "scan"):
        said = refusal(read_folder, tmp_path / asked, silent)
        assert f"give the folder of the photographs: {folder}" in said and "brighten" not in said
    shutil.rmtree(tmp_path / "scan" / "lidar")
    found, notes = read_folder(tmp_path / "scan", silent)
    assert len(found) == 9 and notes == ["left out the depth pictures in depth"]
    assert f"give the folder of the photographs: {folder}" in refusal(
        read_folder, tmp_path / "scan" / "depth", silent
    )


def test_photographs_that_are_too_small_are_refused(tmp_path: Path) -> None:
    said = refusal(
        import_photographs, pictures(tmp_path / "p", size=(64, 48)), "tiny", ImportOptions(), silent
    )
    assert "64 x 48 px at most" in said and "320 px" in said


def test_mirror_images_are_refused(tmp_path: Path) -> None:
    for path in sorted(pictures(tmp_path / "p").iterdir()):
        save(Image.open(path).copy(), path, orientation=2)
    assert "a mirror image (orientation 2): mogrify -auto-orient" in refusal(
        read_folder, tmp_path / "p", silent
    )
