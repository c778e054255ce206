"""What a folder may hold, and what is said of the rest."""

import os
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rendered_photographs import FOCAL_35_MM, save, silent

from nbv.errors import UserError
from nbv.photographs.folder import read_folder, read_pixels
from nbv.photographs.import_source import ImportSource


def picture(index: int, size: tuple[int, int] = (64, 48)) -> Image.Image:
    pixels = np.random.default_rng(index).integers(0, 255, (size[1], size[0], 3), dtype=np.uint8)
    return Image.fromarray(pixels)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for index in range(9):
        save(picture(index), tmp_path / f"{index}.jpg", 8 - index, np.array([10.0, -20.0, 5.0]))
    return tmp_path


def refusal(folder: Path) -> str:
    with pytest.raises(UserError) as told:
        read_folder(folder, silent)
    assert "\n" not in str(told.value)
    return str(told.value)


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


def test_too_few_and_copies(folder: Path) -> None:
    (folder / "copy.jpg").write_bytes((folder / "0.jpg").read_bytes())
    found, notes = read_folder(folder, silent)
    assert len(found) == 9 and "left out 1 of 10 pictures" in notes[0]
    (folder / "0.jpg").unlink()
    (folder / "1.jpg").unlink()
    (folder / "2.jpg").unlink()
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
