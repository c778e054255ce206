"""A sparse model of the user's photographs as arrays, whichever program made it, in a frame of its own."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import cv2  # noqa: F401  before pycolmap: the other order aborts the process when cv2 writes a PNG
import numpy as np
import pycolmap
from numpy.typing import NDArray

from nbv.config import CameraConfig
from nbv.geometry.frames import Similarity
from nbv.sparse.model import camera_from_world_poses
from nbv.types import Floats, Ints


@dataclass(frozen=True)
class SolvedModel:
    """Poses, cameras and points with tracks. Observation ``i`` is of point ``points[i]`` by photograph ``views[i]``."""

    names: tuple[str, ...]  # (M,) of the registered photographs
    poses: Floats  # (M, 4, 4) camera_from_model
    cameras: tuple[pycolmap.Camera, ...]  # (M,) at the size that the photographs are worked on
    xyz: Floats  # (N, 3)
    rgb: NDArray[np.uint8]  # (N, 3)
    points: Ints  # (T,)
    views: Ints  # (T,)
    xy_px: Floats  # (T, 2) pixel centres at half-integers

    @property
    def centers(self) -> Floats:
        """(M, 3) camera centres."""
        return -np.einsum("mji,mj->mi", self.poses[:, :3, :3], self.poses[:, :3, 3])

    @property
    def axes(self) -> Floats:
        """(M, 3) optical axes."""
        return self.poses[:, 2, :3]

    def moved(self, target_from_model: Similarity) -> SolvedModel:
        """The same in another frame."""
        return replace(
            self,
            poses=camera_from_world_poses(self.poses, target_from_model),
            xyz=target_from_model.apply(self.xyz),
        )

    def rays(self) -> Floats:
        """(T, 2) normalised coordinates, right and down, of every observation, distortion taken off."""
        rays = np.zeros_like(self.xy_px)
        for view, camera in enumerate(self.cameras):
            of_view = self.views == view
            if of_view.any():
                rays[of_view] = camera.cam_from_img(self.xy_px[of_view])
        return rays

    def reprojection_errors_px(self) -> Floats:
        """(T,) distance of every observation from where its point is seen."""
        errors = np.full(len(self.xy_px), np.inf)
        for view, camera in enumerate(self.cameras):
            of_view = np.flatnonzero(self.views == view)
            if len(of_view):
                local = self.xyz[self.points[of_view]] @ self.poses[view, :3, :3].T + self.poses[view, :3, 3]
                ahead = local[:, 2] > 1e-9
                seen = np.asarray(camera.img_from_cam(local[ahead]))
                errors[of_view[ahead]] = np.linalg.norm(seen - self.xy_px[of_view[ahead]], axis=1)
        return errors


def solved_from_colmap(
    reconstruction: pycolmap.Reconstruction,
    name_of: Mapping[str, str],
    sizes_px: Mapping[str, tuple[int, int]],
) -> SolvedModel:
    """What a COLMAP model says of the photographs that are there.

    Parameters
    ----------
    reconstruction
        The model; its cameras may be of another size than the photographs, with the same sides' ratio.
    name_of
        From the model's image names to the photographs' names; other images are left out.
    sizes_px
        Width and height that each photograph is worked on at, by name.
    """
    ids = [i for i in sorted(reconstruction.reg_image_ids()) if reconstruction.image(i).name in name_of]
    row = {image_id: index for index, image_id in enumerate(ids)}
    images = [reconstruction.image(i) for i in ids]
    names = tuple(name_of[image.name] for image in images)
    poses = np.tile(np.eye(4), (len(ids), 1, 1))
    cameras, keypoints = [], []
    for index, image in enumerate(images):
        poses[index, :3] = image.cam_from_world().matrix()
        camera = pycolmap.Camera(reconstruction.camera(image.camera_id).todict())
        scale = sizes_px[names[index]][0] / camera.width
        camera.rescale(*sizes_px[names[index]])
        cameras.append(camera)
        keypoints.append(np.array([p.xy for p in image.points2D]).reshape(-1, 2) * scale)
    xyz: list[Any] = []
    rgb: list[Any] = []
    points: list[int] = []
    views: list[int] = []
    xy: list[Any] = []
    for _, point in sorted(reconstruction.points3D.items()):
        seen = [(row[e.image_id], e.point2D_idx) for e in point.track.elements if e.image_id in row]
        if len({view for view, _ in seen}) < 2:
            continue
        for view, feature in seen:
            points.append(len(xyz))
            views.append(view)
            xy.append(keypoints[view][feature])
        xyz.append(point.xyz)
        rgb.append(point.color)
    return SolvedModel(
        names,
        poses,
        tuple(cameras),
        np.array(xyz, dtype=float).reshape(-1, 3),
        np.array(rgb, dtype=np.uint8).reshape(-1, 3),
        np.array(points, dtype=np.int64),
        np.array(views, dtype=np.int64),
        np.array(xy, dtype=float).reshape(-1, 2),
    )


def write_colmap(model: SolvedModel, camera: CameraConfig, folder: Path) -> None:
    """Write the model as COLMAP's binary files with one pinhole camera; images are called ``NAME.jpg``."""
    out = pycolmap.Reconstruction()
    middle = (camera.width_px / 2, camera.height_px / 2)
    out.add_camera_with_trivial_rig(
        pycolmap.Camera(
            camera_id=1,
            model="PINHOLE",
            width=camera.width_px,
            height=camera.height_px,
            params=[camera.focal_px, camera.focal_px, *middle],
        )
    )
    pixels = camera.focal_px * model.rays() + np.array(middle)
    feature = np.zeros(len(model.views), dtype=np.int64)
    for view, name in enumerate(model.names):
        of_view = np.flatnonzero(model.views == view)
        feature[of_view] = np.arange(len(of_view))
        image: Any = pycolmap.Image(
            name=f"{name}.jpg", keypoints=pixels[of_view], camera_id=1, image_id=view + 1
        )
        out.add_image_with_trivial_frame(image, pycolmap.Rigid3d(model.poses[view, :3]))
    bounds = np.searchsorted(model.points, np.arange(len(model.xyz) + 1))
    for point, xyz in enumerate(model.xyz):
        elements = [
            pycolmap.TrackElement(int(model.views[i]) + 1, int(feature[i]))
            for i in range(bounds[point], bounds[point + 1])
        ]
        out.add_point3D(xyz, pycolmap.Track(elements), model.rgb[point])
    out.update_point_3d_errors()
    folder.mkdir(parents=True, exist_ok=True)
    out.write_binary(folder)
