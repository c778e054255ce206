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
from nbv.geometry.frames import Similarity, camera_centers_m
from nbv.photographs.import_source import ImportSource
from nbv.sparse.colmap import CAMERA_ID, camera_from_world_poses, colmap_camera
from nbv.types import Floats, Ints

_ACROSS = ("p0", "p2", "s0", "s1", "sx1")  # COLMAP's lens parameters whose sign is that of x


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
        return camera_centers_m(self.poses)

    @property
    def axes(self) -> Floats:
        """(M, 3) optical axes."""
        return self.poses[:, 2, :3]

    def moved(self, target_from_model: Similarity) -> SolvedModel:
        poses = camera_from_world_poses(self.poses, target_from_model)
        return replace(self, poses=poses, xyz=target_from_model.apply(self.xyz))

    def mirrored(self) -> SolvedModel:
        """The same of photographs whose left and right change places, in a mirrored world."""
        mirror = np.array([-1.0, 1.0, 1.0, 1.0])
        cameras = []
        for camera in self.cameras:
            names = camera.params_info.replace(" ", "").split(",")
            across = {"cx": camera.width} | dict.fromkeys(_ACROSS, 0.0)  # what turns round, about which value
            params = [across[n] - v if n in across else v for n, v in zip(names, camera.params, strict=True)]
            cameras.append(pycolmap.Camera({**camera.todict(), "params": params}))
        widths = np.array([camera.width for camera in cameras])
        return replace(
            self,
            poses=mirror[:, None] * self.poses * mirror,
            cameras=tuple(cameras),
            xyz=self.xyz * mirror[:3],
            xy_px=np.column_stack([widths[self.views] - self.xy_px[:, 0], self.xy_px[:, 1]]),
        )

    def of_view(self, view: int) -> tuple[Ints, tuple[Ints, Ints]]:
        """Which observations (K,) a photograph has, and their pixels' rows (K,) and columns (K,)."""
        members = np.flatnonzero(self.views == view)
        width, height = self.cameras[view].width, self.cameras[view].height
        columns, rows = self.xy_px[members].astype(int).T
        return members, (np.clip(rows, 0, height - 1), np.clip(columns, 0, width - 1))

    def reprojection_errors_px(self) -> Floats:
        """(T,) distance of every observation from where its point is seen."""
        errors = np.full(len(self.xy_px), np.inf)
        for view, camera in enumerate(self.cameras):
            members = np.flatnonzero(self.views == view)
            local = self.xyz[self.points[members]] @ self.poses[view, :3, :3].T + self.poses[view, :3, 3]
            members, local = members[local[:, 2] > 1e-9], local[local[:, 2] > 1e-9]
            if len(members):
                seen = np.asarray(camera.img_from_cam(local))
                errors[members] = np.linalg.norm(seen - self.xy_px[members], axis=1)
        return errors


def solved_from_colmap(
    reconstruction: pycolmap.Reconstruction, name_of: Mapping[str, str], source: ImportSource
) -> SolvedModel:
    """What a COLMAP model says of the photographs that are there.

    ``name_of`` leads from the model's image names to the photographs' names; other images are left out. Its cameras may be
    of another size than the photographs, with the same sides' ratio.
    """
    ids = [i for i in sorted(reconstruction.reg_image_ids()) if reconstruction.image(i).name in name_of]
    row = {image_id: index for index, image_id in enumerate(ids)}
    names = tuple(name_of[reconstruction.image(i).name] for i in ids)
    poses = np.tile(np.eye(4), (len(ids), 1, 1))
    cameras, keypoints = [], []
    for index, image in enumerate(map(reconstruction.image, ids)):
        poses[index, :3] = image.cam_from_world().matrix()
        camera = pycolmap.Camera(reconstruction.camera(image.camera_id).todict())
        width_px, height_px = source.size_px(names[index])
        keypoints.append(np.array([p.xy for p in image.points2D]).reshape(-1, 2) * (width_px / camera.width))
        camera.rescale(width_px, height_px)
        cameras.append(camera)
    points: list[Any] = []
    observations: list[tuple[int, int]] = []
    xy: list[Any] = []
    for _, point in sorted(reconstruction.points3D.items()):
        seen = [(row[e.image_id], e.point2D_idx) for e in point.track.elements if e.image_id in row]
        if len({view for view, _ in seen}) >= 2:
            observations += [(len(points), view) for view, _ in seen]
            xy += [keypoints[view][feature] for view, feature in seen]
            points.append(point)
    of_point, of_view = np.array(observations, dtype=np.int64).reshape(-1, 2).T
    return SolvedModel(
        names,
        poses,
        tuple(cameras),
        np.array([p.xyz for p in points], dtype=float).reshape(-1, 3),
        np.array([p.color for p in points], dtype=np.uint8).reshape(-1, 3),
        of_point,
        of_view,
        np.array(xy, dtype=float).reshape(-1, 2),
    )


def write_colmap(model: SolvedModel, camera: CameraConfig, folder: Path) -> None:
    """Write the model as COLMAP's binary files with one pinhole camera; images are called ``NAME.jpg``."""
    out = pycolmap.Reconstruction()
    middle = (camera.width_px / 2, camera.height_px / 2)
    out.add_camera_with_trivial_rig(colmap_camera(camera))
    feature = np.zeros(len(model.views), dtype=np.int64)
    for view, name in enumerate(model.names):
        members = np.flatnonzero(model.views == view)
        feature[members] = np.arange(len(members))
        rays = model.cameras[view].cam_from_img(model.xy_px[members]) if len(members) else np.zeros((0, 2))
        image: Any = pycolmap.Image(
            name=f"{name}.jpg",
            keypoints=camera.focal_px * np.asarray(rays) + middle,
            camera_id=CAMERA_ID,
            image_id=view + 1,
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
