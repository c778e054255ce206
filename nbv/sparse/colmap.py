"""Between arrays and COLMAP's camera and model, and files that other programs open."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pycolmap

from nbv.config import CameraConfig
from nbv.geometry.frames import Similarity, camera_centers_m
from nbv.safe_files import require_whole, write_atomic
from nbv.sparse.alignment import Alignment
from nbv.types import Floats, SparseModel

CAMERA_ID = 1  # every photograph of a mission comes from one camera


def colmap_camera(camera: CameraConfig) -> pycolmap.Camera:
    """A ``PINHOLE`` camera with known intrinsics; both count pixel centres at half-integers."""
    out = pycolmap.Camera(
        model="PINHOLE",
        width=camera.width_px,
        height=camera.height_px,
        params=np.array([camera.focal_px, camera.focal_px, camera.width_px / 2, camera.height_px / 2]),
        camera_id=CAMERA_ID,
    )
    out.has_prior_focal_length = True
    return out


def pipeline_options(threads: int) -> pycolmap.IncrementalPipelineOptions:
    """Options of COLMAP's incremental mapper, with a fixed seed."""
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads, options.random_seed = threads, 0
    # COLMAP iterates to the last bit by default; one part in a million of the cost is far below the noise.
    options.ba_global_function_tolerance = options.ba_local_function_tolerance = 1e-6
    return options


def registered_names(reconstruction: pycolmap.Reconstruction) -> tuple[str, ...]:
    """Names of the registered images, by ascending image id."""
    return tuple(reconstruction.image(i).name for i in sorted(reconstruction.reg_image_ids()))


def camera_from_model_poses(reconstruction: pycolmap.Reconstruction) -> Floats:
    """(M, 4, 4) poses of the registered images in the model's own frame, by ascending image id."""
    ids = sorted(reconstruction.reg_image_ids())
    poses = np.tile(np.eye(4), (len(ids), 1, 1))
    for row, image_id in enumerate(ids):
        poses[row, :3] = reconstruction.image(image_id).cam_from_world().matrix()
    return poses


def camera_from_world_poses(camera_from_model: Floats, world_from_model: Similarity) -> Floats:
    """(M, 4, 4) rigid poses in the world frame (metres) of cameras (M, 4, 4) in the model's frame."""
    poses = np.tile(np.eye(4), (len(camera_from_model), 1, 1))
    rotation = camera_from_model[:, :3, :3] @ world_from_model.rotation.T
    poses[:, :3, :3] = rotation
    translation = world_from_model.scale * camera_from_model[:, :3, 3]
    poses[:, :3, 3] = translation - rotation @ world_from_model.translation
    return poses


def to_sparse_model(reconstruction: pycolmap.Reconstruction, alignment: Alignment) -> SparseModel:
    """The reconstruction in the world frame; points by ascending point id, cameras by ascending image id as in ``alignment``.

    A camera that observes a point twice counts once in its track.
    """
    reconstruction.update_point_3d_errors()
    image_ids = np.array(sorted(reconstruction.reg_image_ids()), dtype=np.int64)
    points = [reconstruction.point3D(i) for i in sorted(reconstruction.point3D_ids())]
    tracks = [sorted({element.image_id for element in point.track.elements}) for point in points]
    world_from_model = alignment.world_from_model
    poses = camera_from_world_poses(camera_from_model_poses(reconstruction), world_from_model)
    return SparseModel(
        points_m=world_from_model.apply(np.array([point.xyz for point in points]).reshape(-1, 3)),
        reprojection_error_px=np.array([point.error for point in points]),
        track_offsets=np.cumsum([0, *map(len, tracks)], dtype=np.int64),
        track_cameras=np.searchsorted(image_ids, [image_id for track in tracks for image_id in track]),
        camera_centers_m=camera_centers_m(poses),
        camera_names=registered_names(reconstruction),
        alignment_rms_m=alignment.rms_m,
        alignment_max_m=alignment.max_m,
    )


def files_of(reconstruction: pycolmap.Reconstruction, *, ply: bool = False) -> dict[str, bytes]:
    """The model as COLMAP writes it, by file name; ``ply``: with its points as ``points.ply``; ``OSError`` without room."""
    with tempfile.TemporaryDirectory(prefix="nbv-model-") as directory:
        reconstruction.write_binary(directory)
        if ply:
            reconstruction.export_PLY(Path(directory, "points.ply"))
        files = list(Path(directory).iterdir())
        for path in files:
            require_whole(path)
        return {path.name: path.read_bytes() for path in files}


def model_of(files: Mapping[str, bytes]) -> pycolmap.Reconstruction:
    """The model that `files_of` wrote."""
    reconstruction = pycolmap.Reconstruction()
    with tempfile.TemporaryDirectory(prefix="nbv-model-") as directory:  # COLMAP reads models from files only
        for name, content in files.items():
            (Path(directory) / name).write_bytes(content)
        reconstruction.read_binary(directory)
    return reconstruction


def export_colmap(
    reconstruction: pycolmap.Reconstruction, world_from_model: Similarity, directory: Path, images: Path
) -> None:
    """Write the model in the world frame (metres) as COLMAP binary, which its GUI opens, plus ``points.ply``, into a new directory.

    Points take the mean colour of their observations in the photographs, which lie in ``images`` by their names in the model.
    """
    world = pycolmap.Reconstruction(reconstruction)
    world.transform(
        pycolmap.Sim3d(
            world_from_model.scale,
            pycolmap.Rotation3d(world_from_model.rotation),
            world_from_model.translation,
        )
    )
    world.extract_colors_for_all_images(images, num_threads=1)
    directory.mkdir(parents=True)
    for name, content in files_of(world, ply=True).items():
        write_atomic(directory / name, content)
