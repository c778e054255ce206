"""The COLMAP workspace of another program as arrays, for `nbv.Planner`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pycolmap

from nbv.geometry.frames import Similarity, align_umeyama
from nbv.types import Floats, SparseModel

_FEWEST = 3  # cameras that determine a similarity


def best_model(workspace: Path) -> pycolmap.Reconstruction:
    """Return the sparse model with the most registered images (stale ones of earlier mappings lie beside it).

    Raises
    ------
    OSError
        There is none that can be read.
    """
    models = []
    for folder in sorted((workspace / "sparse").glob("[0-9]*")):
        try:
            models.append(pycolmap.Reconstruction(str(folder)))
        except (ValueError, RuntimeError, IndexError):
            continue
    if not models:
        raise OSError(f"no sparse model in {workspace / 'sparse'}")
    return max(models, key=lambda model: model.num_reg_images())


def camera_centers(model: pycolmap.Reconstruction) -> dict[str, Floats]:
    """Return the camera centre (3,) of each image file, in the model's frame."""
    return {
        Path(image.name).name: np.array(image.projection_center())
        for image in model.images.values()
        if image.has_pose
    }


def sparse_model(model: pycolmap.Reconstruction, reported_m: dict[str, Floats]) -> SparseModel:
    """Return the model in the world, aligned by the cameras whose world positions are ``reported_m``.

    Raises
    ------
    ValueError
        Fewer than three of them.
    """
    centers = camera_centers(model)
    names = [name for name in sorted(centers) if name in reported_m]
    if len(names) < _FEWEST:
        raise ValueError(f"{len(names)} of {len(centers)} registered cameras are known; it takes {_FEWEST}")
    source = np.array([centers[name] for name in names])
    target = np.array([reported_m[name] for name in names])
    world: Similarity = align_umeyama(target, source)
    residual = np.linalg.norm(world.apply(source) - target, axis=1)
    index = {name: i for i, name in enumerate(names)}
    camera_of = {i: index.get(Path(image.name).name, -1) for i, image in model.images.items()}
    tracks, points, errors = [], [], []
    for point in model.points3D.values():
        seen_by = sorted({camera_of[e.image_id] for e in point.track.elements} - {-1})
        if seen_by:
            tracks.append(seen_by)
            points.append(point.xyz)
            errors.append(point.error)
    lengths = [len(track) for track in tracks]
    return SparseModel(
        world.apply(np.array(points).reshape(-1, 3)),
        np.array(errors, dtype=float),
        np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64),
        np.array([c for track in tracks for c in track], dtype=np.int64),
        world.apply(source),
        tuple(names),
        float(np.sqrt((residual**2).mean())),
        float(residual.max()),
    )
