"""A set on disk: what is written is read back, and a damaged file is one clear line."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from photographed_ball import write_part_of_a_set
from PIL import Image

from nbv.errors import UserError
from nbv.photographs import PhotographSet, Reference, list_sets
from nbv.photographs.photograph_set import REFERENCE_FILE, read_set


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


@pytest.mark.parametrize(
    "change",
    [
        {"height_m": -1.0},
        {"height_m": float("nan")},
        {"scale_source": "guess"},
        {"photographs": []},
        {"format": 99},
        {"camera": {"width_px": 64}},
        {"name": "../../other"},
    ],
)
def test_a_damaged_description_is_one_line(small_set: PhotographSet, change: dict) -> None:
    path = small_set.folder / "set.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **change}))
    with pytest.raises(UserError) as told:
        read_set(small_set.folder)
    assert "\n" not in str(told.value)


def test_pictures_are_checked(small_set: PhotographSet) -> None:
    path = small_set.folder / "images" / "p000.jpg"
    pixels = np.full((360, 480, 3), 100, np.uint8)
    Image.fromarray(pixels).save(path)
    assert np.abs(small_set.image("p000").astype(int) - pixels).max() <= 2
    assert small_set.mask("p000") is None
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(UserError, match="damaged"):
        small_set.image("p000")
    Image.fromarray(pixels[:40]).save(path)
    with pytest.raises(UserError, match="480 x 40"):
        small_set.image("p000")


def test_the_reference_is_read_back_and_a_truncated_one_refused(small_set: PhotographSet) -> None:
    rng = np.random.default_rng(0)
    normals = rng.normal(size=(50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    made = Reference(
        rng.normal(size=(50, 3)), normals, rng.integers(0, 255, (50, 3), dtype=np.uint8), rng.random(50)
    )
    path = small_set.folder / REFERENCE_FILE
    made.write(path)
    found = Reference.read(path)
    assert np.allclose(found.points_m, made.points_m, atol=1e-6)
    assert np.allclose(found.normals, made.normals, atol=1e-6)
    assert np.array_equal(found.colors, made.colors)
    assert np.allclose(found.error_m, made.error_m)
    path.write_bytes(path.read_bytes()[:-5])
    with pytest.raises(UserError, match="damaged"):
        small_set.reference()
