"""COLMAP models of made-up flights: cameras anywhere, points about the target, in a frame of COLMAP's own."""

from collections.abc import Sequence

import numpy as np
import pycolmap

SCALE, SHIFT = 0.3, np.array([5.0, -2.0, 1.0])


def colmap(enu):
    """East, north, up (m), turned, scaled and shifted."""
    return SCALE * np.array([-enu[1], enu[0], enu[2]]) + SHIFT


def model_of(
    camera: pycolmap.Camera,
    names: Sequence[str],
    poses: Sequence[np.ndarray],
    points: np.ndarray,
    seen: np.ndarray,
    pixels: np.ndarray | None = None,
) -> pycolmap.Reconstruction:
    """Photographs with poses (N, 3, 4), points (P, 3) with a track where two or more see them (N, P), in pixels (N, P, 2)."""
    made = pycolmap.Reconstruction()
    camera.camera_id = 1
    made.add_camera_with_trivial_rig(camera)
    pixels = np.zeros((*seen.shape, 2)) if pixels is None else pixels
    for i, (name, pose) in enumerate(zip(names, poses, strict=True), 1):
        image = pycolmap.Image(name=name, keypoints=pixels[i - 1], camera_id=1, image_id=i)
        made.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    for j, point in enumerate(points):
        views = np.flatnonzero(seen[:, j]).tolist()
        if len(views) >= 2:
            track = pycolmap.Track([pycolmap.TrackElement(i + 1, j) for i in views])
            made.add_point3D(point, track, np.zeros(3, np.uint8))
    return made


def write_workspace(folder, views, points=200):
    """Photographs ``01.jpg`` ... from ``views`` (N, 3), each point in two to eight of them."""
    rng = np.random.default_rng(1)
    lens = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[465.7, 465.7, 320, 240])
    poses = [np.column_stack([np.eye(3), -colmap(at)]) for at in views]
    seen = np.argsort(rng.random((len(views), points)), axis=0) < rng.integers(2, 9, points)
    places = [colmap(rng.normal((0, 0, 0.8), 0.4)) for _ in range(points)]
    (folder / "sparse/0").mkdir(parents=True)
    names = [f"{i:02d}.jpg" for i in range(1, len(views) + 1)]
    model_of(lens, names, poses, np.array(places), seen).write(str(folder / "sparse/0"))
