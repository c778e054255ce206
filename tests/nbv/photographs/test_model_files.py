"""Poses of other programs: what each format says, compared with the cameras that it was written from."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest

from nbv.errors import UserError
from nbv.geometry.frames import look_at
from nbv.photographs.folder import SourcePhotograph
from nbv.photographs.import_source import ImportSource
from nbv.photographs.model_files import read_model

WIDTH, HEIGHT, FOCAL = 640, 480, 500.0
POSES = [look_at(np.array([3 * np.cos(a), 3 * np.sin(a), 1.0]), np.zeros(3)) for a in np.linspace(0, 5, 8)]
POINTS = np.array([[0.1, 0.2, 0.3], [-0.4, 0.1, 0.2], [0.3, -0.3, 0.0]])
K1, K2, P1, P2 = -0.05, 0.02, 0.001, -0.002


def photographs(max_size: int = WIDTH) -> ImportSource:
    found = [
        SourcePhotograph(Path(f"IMG_{i}.JPG"), f"IMG_{i}", str(i), (WIDTH, HEIGHT), 1, "", None, None, None)
        for i in range(len(POSES))
    ]
    return ImportSource(tuple(found), max_size, lambda *_: None)


def seen(pose: np.ndarray, middle: tuple[float, float], lens: tuple[float, ...]) -> np.ndarray:
    """(3, 2) where OpenCV's lens shows `POINTS`."""
    matrix = np.array([[FOCAL, 0, middle[0]], [0, FOCAL, middle[1]], [0, 0, 1]])
    turn = cv2.Rodrigues(pose[:3, :3])[0]
    return cv2.projectPoints(POINTS, turn, pose[:3, 3], matrix, np.array(lens))[0].reshape(-1, 2)


def check(path: Path, middle: tuple[float, float], lens: tuple[float, ...], max_size: int = WIDTH) -> None:
    [(model, source)] = read_model(path, photographs(max_size))
    assert source.upright and model.names == tuple(f"IMG_{i}" for i in range(len(POSES)))
    assert np.allclose(model.poses, POSES, atol=1e-9)
    for pose, camera in zip(POSES, model.cameras, strict=True):
        local = POINTS @ pose[:3, :3].T + pose[:3, 3]
        shown = np.asarray(camera.img_from_cam(local)) * WIDTH / max_size
        assert np.allclose(shown, seen(pose, middle, lens), atol=1e-6)


@pytest.mark.parametrize("text", [False, True])
def test_colmap(tmp_path: Path, text: bool) -> None:
    model = pycolmap.Reconstruction()
    params = [FOCAL, FOCAL, 322.0, 239.0, K1, K2, P1, P2]
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(model="OPENCV", width=WIDTH, height=HEIGHT, params=params, camera_id=1)
    )
    for i, pose in enumerate(POSES):
        keypoints = seen(pose, (322.0, 239.0), (K1, K2, P1, P2))
        image = pycolmap.Image(name=f"IMG_{i}.JPG", keypoints=keypoints, camera_id=1, image_id=i + 1)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    for j, point in enumerate(POINTS):
        track = pycolmap.Track([pycolmap.TrackElement(i + 1, j) for i in range(len(POSES))])
        model.add_point3D(point, track, np.zeros(3, np.uint8))
    (model.write_text if text else model.write_binary)(tmp_path)
    check(tmp_path, (322.0, 239.0), (K1, K2, P1, P2))
    [(solved, _)] = read_model(tmp_path, photographs(320))
    assert np.allclose(solved.xyz, POINTS) and len(solved.views) == len(POSES) * len(POINTS)
    assert solved.reprojection_errors_px().max() < 1e-6
    files = sorted(tmp_path.glob("images.*"))
    files[0].write_bytes(files[0].read_bytes()[:-40] if not text else b"1 2 three\n")
    refused(tmp_path, "cannot be read")


def refused(path: Path, words: str) -> None:
    with pytest.raises(UserError, match=words) as told:
        read_model(path, photographs())
    assert "\n" not in str(told.value)


def test_a_model_of_other_photographs_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "transforms.json"
    frame = {"file_path": "other.jpg", "transform_matrix": np.eye(4).tolist()}
    tree = {"w": WIDTH, "h": HEIGHT, "fl_x": FOCAL, "frames": [frame]}
    path.write_text(json.dumps(tree))
    refused(path, "other photographs: none of its 1 images")
    frame["file_path"] = "IMG_0.JPG"
    path.write_text(json.dumps({**tree, "w": 1000}))
    refused(path, "other photographs: it has IMG_0.JPG with 1000 x 480")


def test_there_is_no_model(tmp_path: Path) -> None:
    refused(tmp_path / "absent.json", "there is no model")
    refused(tmp_path, "no COLMAP model")
