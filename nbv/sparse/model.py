"""From COLMAP's reconstruction to what a planner may see, and to files other programs open."""

from __future__ import annotations

import contextlib
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pycolmap

from nbv.geometry.frames import Similarity
from nbv.sparse.alignment import Alignment
from nbv.types import Floats, Ints, SparseModel


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
    """The reconstruction in the world frame; points by ascending point id, cameras by ascending image id.

    ``alignment`` must have been computed on the reconstruction's registered images in that order. A
    camera that observes a point twice counts once in its track.
    """
    reconstruction.update_point_3d_errors()
    image_ids = np.array(sorted(reconstruction.reg_image_ids()), dtype=np.int64)
    xyz, errors, track_lengths, observers = _points_by_id(reconstruction)
    count = len(xyz)
    owners = np.repeat(np.arange(count), track_lengths)
    # One row per (point, camera), in that order, without repetitions.
    keys = np.sort(owners * len(image_ids) + np.searchsorted(image_ids, observers))
    keys = keys[np.concatenate([[True], np.diff(keys) > 0])] if len(keys) else keys
    offsets = np.zeros(count + 1, dtype=np.int64)
    np.cumsum(np.bincount(keys // len(image_ids), minlength=count), out=offsets[1:])
    cameras = (keys % len(image_ids)).astype(np.int64)
    world_from_model = alignment.world_from_model
    poses = camera_from_world_poses(camera_from_model_poses(reconstruction), world_from_model)
    centers = -np.einsum("mji,mj->mi", poses[:, :3, :3], poses[:, :3, 3])
    return SparseModel(
        points_m=world_from_model.apply(xyz) if count else np.zeros((0, 3)),
        reprojection_error_px=errors,
        track_offsets=offsets,
        track_cameras=cameras,
        camera_centers_m=centers,
        camera_names=registered_names(reconstruction),
        alignment_rms_m=alignment.rms_m,
        alignment_max_m=alignment.max_m,
    )


# A record of points3D.bin: id, position, colour, error, track length; then (image id, keypoint) per observation.
_POINT = np.dtype(
    [("id", "<u8"), ("xyz", "<f8", 3), ("rgb", "u1", 3), ("error", "<f8"), ("track_length", "<u8")]
)
_OBSERVATION_BYTES = 8


def _points_by_id(reconstruction: pycolmap.Reconstruction) -> tuple[Floats, Floats, Ints, Ints]:
    """Positions (N, 3), errors (N,), track lengths (N,) and the observing image ids in track order, by point id.

    Through COLMAP's own file: pycolmap hands out points and track elements as one Python object each, which
    takes many times as long as writing and reading the model.
    """
    with tempfile.TemporaryDirectory(prefix="nbv-points-") as directory:
        # Three quarters of a model are its images' keypoints, which nobody reads here.
        with contextlib.suppress(OSError):  # no symbolic links on this system: then they are written
            (Path(directory) / "images.bin").symlink_to(os.devnull)
        reconstruction.write_binary(directory)
        data = (Path(directory) / "points3D.bin").read_bytes()
    starts = _record_starts(data)
    octets = np.frombuffer(data, np.uint8)
    records = octets[starts[:, None] + np.arange(_POINT.itemsize)].reshape(-1).view(_POINT)
    order = np.argsort(records["id"])
    records, starts = records[order], starts[order]
    lengths = records["track_length"].astype(np.int64)
    # Where each observation begins: its point's first, then one every 8 bytes.
    before = np.cumsum(lengths) - lengths
    within = np.arange(int(lengths.sum())) - np.repeat(before, lengths)
    at = np.repeat(starts + _POINT.itemsize, lengths) + _OBSERVATION_BYTES * within
    image_ids = octets[at[:, None] + np.arange(4)].reshape(-1).view("<u4").astype(np.int64)
    return records["xyz"].copy(), records["error"].copy(), lengths, image_ids


def _record_starts(data: bytes) -> Ints:
    """Where each record of points3D.bin begins: the one loop that is left, since each depends on all before it."""
    starts: list[int] = []
    add = starts.append
    start, fixed, length_at = 8, _POINT.itemsize, _POINT.itemsize - 8
    for _ in range(int.from_bytes(data[:8], "little")):
        add(start)
        # The lowest two bytes of the track's length: no point is observed 65,536 times.
        start += fixed + _OBSERVATION_BYTES * (data[start + length_at] | data[start + length_at + 1] << 8)
    if start != len(data):
        raise RuntimeError(f"points3D.bin has {len(data)} bytes, its records {start}")
    return np.array(starts, dtype=np.int64)


def files_of(reconstruction: pycolmap.Reconstruction) -> dict[str, bytes]:
    """The model as COLMAP writes it, by file name."""
    with tempfile.TemporaryDirectory(prefix="nbv-model-") as directory:
        reconstruction.write_binary(directory)
        return {path.name: path.read_bytes() for path in Path(directory).iterdir()}


def model_of(files: Mapping[str, bytes]) -> pycolmap.Reconstruction:
    """The model that `files_of` wrote; what COLMAP raises where these are others."""
    reconstruction = pycolmap.Reconstruction()
    with tempfile.TemporaryDirectory(prefix="nbv-model-") as directory:  # COLMAP reads models from files only
        for name, content in files.items():
            (Path(directory) / name).write_bytes(content)
        reconstruction.read_binary(directory)
    return reconstruction


def export_colmap(
    reconstruction: pycolmap.Reconstruction, world_from_model: Similarity, directory: Path, images: Path
) -> None:
    """Write the model in the world frame (metres) as COLMAP binary plus ``points.ply``.

    Parameters
    ----------
    reconstruction
        The model in its own frame.
    world_from_model
        Where it belongs.
    directory
        Made if absent. Gets ``cameras.bin``, ``images.bin``, ``points3D.bin``, ``rigs.bin``, ``frames.bin`` (COLMAP's
        GUI opens it) and ``points.ply``.
    images
        Folder of the photographs, by their names in the model: points take the mean colour of their observations.
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
    directory.mkdir(parents=True, exist_ok=True)
    world.write_binary(directory)
    world.export_PLY(directory / "points.ply")
