"""What a folder may hold; undistortion and masks; a set on disk."""

import dataclasses
import os
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from photographed_ball import write_part_of_a_set
from PIL import Image
from refusals import refused
from rendered_photographs import FOCAL_35_MM, save, silent

from nbv.photographs import PhotographSet, list_sets
from nbv.photographs.folder import SourcePhotograph, read_folder, read_pixels
from nbv.photographs.import_source import ImportSource, find_masks
from nbv.photographs.importer import common_pinhole, undistorted


def picture(index: int, size: tuple[int, int] = (64, 48)) -> Image.Image:
    pixels = np.random.default_rng(index).integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)
    return Image.fromarray(pixels)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for index in range(9):
        save(picture(index), tmp_path / f"{index}.jpg", 8 - index, np.array([10.0, -20.0, 5.0]))
    return tmp_path


def refusal(folder: Path) -> str:
    return refused(".", read_folder, folder, silent)


def test_exif_is_read_and_the_order_is_that_of_the_clock(folder: Path) -> None:
    found, notes = read_folder(folder, silent)
    assert [p.name for p in found] == [str(i) for i in range(8, -1, -1)]
    assert notes == []
    first = found[0]
    assert first.time == "2026-01-01T12:00:00"
    assert first.focal_35_mm == FOCAL_35_MM
    assert first.device == "Made Up, FocalLengthIn35mmFilm 30"
    assert first.gps == pytest.approx(
        (46.0 - 20 / 111_319.49, 7.0 + 10 / 111_319.49 / np.cos(np.deg2rad(46)), 5.0)
    )


def test_nothing_is_said_to_be_nothing(tmp_path: Path) -> None:
    assert "there is no folder" in refusal(tmp_path / "absent")
    (tmp_path / "notes.txt").write_text("no photograph")
    assert "no photographs" in refusal(tmp_path)


def test_truncated_files_are_named(folder: Path) -> None:
    for name in ("3.jpg", "5.jpg"):
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: len(data) // 2])
    (folder / "6.jpg").write_bytes(b"")
    message = refusal(folder)
    assert "3 of 9" in message and "3.jpg" in message and "5.jpg" in message


def test_a_video_is_told_how_to_become_photographs(tmp_path: Path) -> None:
    (tmp_path / "clip.mp4").write_bytes(b"\0\0\0\x18ftypmp42")
    assert "ffmpeg -i VIDEO" in refusal(tmp_path)
    assert "ffmpeg -i VIDEO" in refusal(tmp_path / "clip.mp4")


def test_too_few(folder: Path) -> None:
    for name in ("0.jpg", "1.jpg"):
        (folder / name).unlink()
    assert "needs 8 or more" in refusal(folder)


def test_names_stay_unique_once_they_can_be_read(folder: Path) -> None:
    for index, byte in enumerate((b"\xe9", b"\xe8")):
        (folder / f"{index}.jpg").rename(folder / os.fsdecode(byte + b".jpg"))
    found, _ = read_folder(folder, silent)
    assert len({p.name for p in found}) == 9 and sum("?" in p.name for p in found) == 2


def test_a_linked_folder_is_told(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> None:
    (folder / "more").symlink_to(tmp_path_factory.mktemp("elsewhere"))
    assert read_folder(folder, silent)[1] == [
        "left out the linked folder more; to have its photographs, copy it there"
    ]


def test_a_telephone_held_both_ways_stays_one_camera(tmp_path: Path) -> None:
    for index in range(9):
        save(picture(index), tmp_path / f"{index}.jpg", index, orientation=6 if index < 4 else 1)
    found, _ = read_folder(tmp_path, silent)
    source = ImportSource(tuple(found), 64, silent).turned()
    assert not source.upright
    assert source.up(found[0].name) == (-1.0, 0.0)
    upright = read_pixels(found[0].path, 64, found[0].quarters(upright=True))
    assert upright.shape == (64, 48, 3)
    # What is on the left of the stored picture is up.
    stored = read_pixels(found[0].path, 64, found[0].quarters(upright=False)).astype(int)
    assert np.abs(np.rot90(stored, -1) - upright).mean() < 12


def lens(k: float, width: int = 320, height: int = 240, focal: float = 260.0) -> pycolmap.Camera:
    return pycolmap.Camera(
        model="SIMPLE_RADIAL", width=width, height=height, params=[focal, width / 2, height / 2, k]
    )


@pytest.mark.parametrize("k", [-0.1, 0.0, 0.1])
def test_the_pinhole_is_filled_and_no_longer_than_it_must_be(k: float) -> None:
    camera = lens(k)
    small = lens(0.05, 160, 120)
    pinhole = common_pinhole([small, camera, small, lens(0.3), small, camera])
    white = np.full((240, 320, 3), 255, np.uint8)
    assert undistorted(white, camera, pinhole).min() > 250
    wider = type(pinhole)(pinhole.width_px, pinhole.height_px, 0.97 * pinhole.focal_px)
    assert undistorted(white, camera, wider).min() == 0
    if k == 0:
        assert pinhole.focal_px == pytest.approx(260.0, rel=0.005)


def test_masks_are_found_by_name(tmp_path: Path) -> None:
    photographs = [
        SourcePhotograph(Path(f"IMG_{i}.JPG"), f"IMG_{i}", "", (64, 48), 1, "", None, None, None)
        for i in range(4)
    ]
    white = np.full((24, 32), 255, np.uint8)
    for name in ("img_0.png", "IMG_1_mask.png", "IMG_2.JPG.png"):
        Image.fromarray(white).save(tmp_path / name)
    found = find_masks(tmp_path, photographs)
    assert set(found) == {"IMG_0", "IMG_1", "IMG_2"}
    source = ImportSource(tuple(photographs), 64, lambda *_: None, masks=found)
    assert source.mask("IMG_3") is None
    (tmp_path / "img_0.png").write_bytes(b"no picture")
    refused("cannot be read", source.mask, "IMG_0")


@pytest.fixture
def small_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> PhotographSet:
    monkeypatch.setenv("GATETUNE_HOME", str(tmp_path))
    return write_part_of_a_set()


def test_what_is_written_is_read_back(small_set: PhotographSet) -> None:
    found = PhotographSet.read("mine")
    assert list_sets() == ["mine"]
    pose, expected = (s.photographs[0].camera_from_world for s in (found, small_set))
    assert np.array_equal(pose, expected)
    assert np.allclose(found.photographs[0].camera_center_m, [3.5, 0, 0.8])

    assert dataclasses.replace(found, photographs=()) == dataclasses.replace(small_set, photographs=())
    for read, written in zip(found.photographs, small_set.photographs, strict=True):
        assert dataclasses.replace(read, camera_from_world=written.camera_from_world) == written
    assert [p.name for p in found.photographs if not p.registered] == ["lost"]
    assert found.true_height_m == pytest.approx(1.6 * 0.23)


def test_pictures_are_checked(small_set: PhotographSet) -> None:
    path = small_set.folder / "images" / "p000.jpg"
    pixels = np.full((360, 480, 3), 100, np.uint8)
    Image.fromarray(pixels).save(path)
    assert np.abs(small_set.image("p000").astype(int) - pixels).max() <= 2
    assert small_set.mask("p000") is None
    path.write_bytes(path.read_bytes()[:300])
    refused("damaged", small_set.image, "p000")
    Image.fromarray(pixels[:40]).save(path)
    refused("480 x 40", small_set.image, "p000")
