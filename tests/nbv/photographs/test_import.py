"""A folder of rendered photographs, imported: compared with where they were rendered from, and with the ball."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from refusals import refused
from rendered_photographs import CAMERA, MAX_SIZE_PX, POSITIONS_M, render, save, silent, write_folder
from scene_helpers import BALL_RADIUS_M, around

from nbv.cache import Store
from nbv.errors import UserError
from nbv.geometry.frames import align_umeyama
from nbv.photographs import PhotographSet, list_sets
from nbv.photographs import importer as importer_module
from nbv.photographs.importer import ImportOptions, import_photographs
from nbv.photographs.photograph_set import SPARSE, sets_folder

pytestmark = pytest.mark.slow  # by the fixture


def test_poses_are_where_the_photographs_were_taken(ball_set: PhotographSet) -> None:
    assert len(ball_set.registered) == len(POSITIONS_M)
    centers = np.array([p.camera_center_m for p in ball_set.photographs])
    fit = align_umeyama(POSITIONS_M, centers)
    assert np.linalg.norm(fit.apply(centers) - POSITIONS_M, axis=1).max() < 0.02
    # z is up, and the scale that GPS gave is that of the places.
    assert np.rad2deg(np.arccos(fit.rotation[2, 2])) < 0.5
    assert ball_set.scale_source == "gps"
    assert ball_set.metres_per_unit == pytest.approx(fit.scale, rel=0.01)


def test_the_frame_is_the_program_s_world(ball_set: PhotographSet) -> None:
    distances = np.linalg.norm([p.camera_center_m - ball_set.target_m for p in ball_set.registered], axis=1)
    assert np.median(distances) == pytest.approx(3.5)
    points = ball_set.reference().points_m
    low, high = np.percentile(points, [0.2, 99.8], axis=0)
    assert np.allclose((low + high)[:2] / 2, 0, atol=1e-3)
    assert high[2] == pytest.approx(ball_set.height_m, abs=1e-3)
    assert ball_set.true_height_m == pytest.approx(2 * BALL_RADIUS_M, rel=0.03)
    assert np.allclose(np.array(ball_set.extents_m) * ball_set.metres_per_unit, 1.6, rtol=0.04)


def test_the_reference_lies_on_the_ball(ball_set: PhotographSet) -> None:
    reference = ball_set.reference()
    radius = BALL_RADIUS_M / ball_set.metres_per_unit
    off = np.abs(np.linalg.norm(reference.points_m - [0, 0, radius], axis=1) - radius)
    assert np.median(off) < 0.01 * ball_set.height_m
    outward = (reference.points_m - [0, 0, radius]) / radius
    assert np.mean((outward * reference.normals).sum(axis=1) > 0.7) > 0.88
    halves = ball_set.halves
    assert all(0 < score <= 100 for score in halves.f_score)
    assert list(halves.completeness) == sorted(halves.completeness)
    # What one half alone did not see is where the reference is weak.
    assert ball_set.reference_error_m == pytest.approx(float(np.median(reference.error_m)), rel=1e-3)


def test_photographs_are_those_of_one_pinhole(ball_set: PhotographSet) -> None:
    assert (ball_set.camera.width_px, ball_set.camera.height_px) == (MAX_SIZE_PX, 240)
    assert ball_set.camera.focal_px == pytest.approx(
        CAMERA.focal_px * MAX_SIZE_PX / CAMERA.width_px, rel=0.02
    )
    assert "2 cameras" in ball_set.notes[1]
    shown = ball_set.image(ball_set.photographs[0].name).astype(float)
    true = np.asarray(render(POSITIONS_M[0]).resize((MAX_SIZE_PX, 240), Image.Resampling.LANCZOS))
    assert np.abs(shown - true).mean() < 6


def test_a_second_import_goes_on_from_the_store(ball_set, ball_folder, ball_store, monkeypatch):
    def never(*_: object, **__: object) -> None:
        raise AssertionError("worked out again")

    monkeypatch.setattr("nbv.photographs.sparse_model.match_photographs", never)
    monkeypatch.setattr("nbv.photographs.dense_reference.ReferenceMaker._fused", never)
    left = sets_folder() / ".again.killed"
    left.mkdir()
    options = ImportOptions(max_size_px=MAX_SIZE_PX, height_m=0.4)
    again = import_photographs(ball_folder, "again", options, silent, ball_store)
    assert again.true_height_m == pytest.approx(0.4)
    assert again.halves == ball_set.halves
    assert not left.exists()
    shutil.rmtree(again.folder)


def test_a_failure_late_leaves_nothing(ball_set, ball_folder, ball_store, monkeypatch):
    def fails(*_: object, **__: object) -> None:
        raise UserError("no surface")

    monkeypatch.setattr(importer_module, "surface_of", fails)
    options = ImportOptions(max_size_px=MAX_SIZE_PX)
    before = sorted(p.name for p in sets_folder().iterdir())
    for name, force in (("late", False), ("ball", True)):
        refused("no surface", import_photographs, ball_folder, name, options, silent, ball_store, force=force)
    assert sorted(p.name for p in sets_folder().iterdir()) == before
    assert PhotographSet.read("ball").halves == ball_set.halves


def test_a_model_of_other_photographs_of_the_same_names(ball_set: PhotographSet, tmp_path: Path) -> None:
    other = write_folder(tmp_path / "other", POSITIONS_M[::-1][:20], seed=3)
    with pytest.raises(UserError, match="model of other photographs") as told:
        import_photographs(other, "other", ImportOptions(model=ball_set.folder / SPARSE), silent)
    assert "correlation" in str(told.value)
    assert "other" not in list_sets()


def test_photographs_without_overlap(tmp_path: Path, ball_store: Store) -> None:
    for index in range(9):
        blobs = np.random.default_rng(index).integers(0, 255, (30, 40, 3), dtype=np.uint8)
        save(
            Image.fromarray(blobs).resize((320, 240), Image.Resampling.BICUBIC),
            tmp_path / f"{index}.jpg",
            index,
        )
    with pytest.raises(UserError, match="no two of the 9 photographs"):
        import_photographs(tmp_path, "apart", ImportOptions(max_size_px=320), silent, ball_store)
    assert "apart" not in list_sets()


def test_two_objects(tmp_path: Path, ball_store: Store) -> None:
    arc = around(12.0 * np.arange(8), 30.0, 4.0)
    write_folder(tmp_path, arc, prefix="one")
    write_folder(tmp_path, arc, seed=3, prefix="two")
    with pytest.raises(UserError, match="two objects"):
        import_photographs(tmp_path, "two", ImportOptions(max_size_px=320), silent, ball_store)
    assert "two" not in list_sets()
