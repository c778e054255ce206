"""A COLMAP workspace of a made-up flight: cameras anywhere, points about the target, in a frame of COLMAP's own."""

import numpy as np
import pycolmap

SCALE, SHIFT = 0.3, np.array([5.0, -2.0, 1.0])


def colmap(enu):
    """East, north, up (m), turned, scaled and shifted."""
    return SCALE * np.array([-enu[1], enu[0], enu[2]]) + SHIFT


def write_workspace(folder, views, points=200):
    """Photographs ``01.jpg`` ... from ``views`` (N, 3), each point in two to eight of them."""
    rng, model = np.random.default_rng(1), pycolmap.Reconstruction()
    lens = pycolmap.Camera(
        model="PINHOLE", width=640, height=480, params=[465.7, 465.7, 320, 240], camera_id=1
    )
    model.add_camera_with_trivial_rig(lens)
    for i, at in enumerate(views, 1):
        image = pycolmap.Image(name=f"{i:02d}.jpg", camera_id=1, image_id=i)
        image.points2D = pycolmap.Point2DList([pycolmap.Point2D(np.zeros(2)) for _ in range(points)])
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pycolmap.Rotation3d(), -colmap(at)))
    for j in range(points):
        track = pycolmap.Track()
        for i in rng.choice(np.arange(1, len(views) + 1), rng.integers(2, 9), replace=False):
            track.add_element(int(i), j)
        model.add_point3D(colmap(rng.normal((0, 0, 0.8), 0.4)), track, np.zeros(3, dtype=np.uint8))
    (folder / "sparse/0").mkdir(parents=True)
    model.write(str(folder / "sparse/0"))
